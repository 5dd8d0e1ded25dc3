"""The posterior of a fit by the no-U-turn sampler, to ArviZ."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxlines.inference.least_squares import FunctionProblem, LeastSquaresProblem, Solution
from jaxlines.simulation.precision import computing_in

if TYPE_CHECKING:
    import arviz

RHAT_LIMIT, ESS_LIMIT = 1.01, 400.0
"""What Vehtari and others (Bayesian Analysis 16, 2021) ask of chains before their draws are used."""


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Draws from a posterior and how far to trust them.

    Fields: labels; draws of the coordinates, shape (chains, draws, parameters); noise_factors: noise over the level
    that rows are divided by, shape (chains, draws, channels), no channels when the noise is known; log_density in the
    unbounded coordinates, and divergent trajectories, shape (chains, draws); rhat and ess, one a parameter, then one a
    noise factor.
    """

    labels: tuple[str, ...]
    draws: np.ndarray
    noise_factors: np.ndarray
    log_density: np.ndarray
    divergent: np.ndarray
    rhat: np.ndarray
    ess: np.ndarray

    @property
    def divergences(self) -> int:
        """Number of trajectories that the integrator lost."""
        return int(self.divergent.sum())

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against using the draws, in words."""
        found = []
        if np.max(self.rhat) > RHAT_LIMIT:
            found.append(f"chains have not mixed (largest R-hat {np.max(self.rhat):.3f}): draw more")
        if np.min(self.ess) < ESS_LIMIT:
            found.append(f"few effective draws ({np.min(self.ess):.0f}, {ESS_LIMIT:.0f} wanted)")
        if self.divergences:
            found.append(f"{self.divergences} divergent trajectories: the posterior has a corner that was not entered")
        return tuple(found)

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Central intervals of the coordinates, shape (2, parameters)."""
        flat = self.draws.reshape(-1, len(self.labels))
        return np.quantile(flat, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)

    def to_arviz(self, to_values: Callable[[np.ndarray], np.ndarray] | None = None) -> "arviz.InferenceData":
        """As ArviZ InferenceData. to_values: coordinates -> values in SI, both of shape (parameters,)."""
        az = _arviz()
        draws = self.draws if to_values is None else np.apply_along_axis(to_values, -1, self.draws)
        posterior: dict[str, Any] = {label: draws[..., i] for i, label in enumerate(self.labels)}
        if self.noise_factors.shape[-1]:
            posterior["noise factor"] = self.noise_factors
        return az.from_dict(posterior, sample_stats={"diverging": self.divergent, "lp": self.log_density})


def _arviz() -> Any:
    """ArviZ, or a word on how to get it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import arviz
    except ImportError as error:
        raise ImportError("draws are judged and kept by ArviZ: pip install 'jaxlines[posterior]'") from error
    return arviz


def _blackjax() -> Any:
    """BlackJAX, or a word on how to get it."""
    try:
        import blackjax
    except ImportError as error:
        raise ImportError("sampling needs BlackJAX: pip install 'jaxlines[posterior]'") from error
    return blackjax


def check_installed() -> None:
    """Raise ImportError, with what to install, before any work is done."""
    _arviz()
    _blackjax()


def whitening(curvature) -> np.ndarray:
    """A matrix L with L L' close to the inverse of a curvature, open directions cut to a standard deviation of 2."""
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    return vectors / np.sqrt(np.maximum(values, 0.25))


def run_chain(key, log_density: Callable, start, warmup: int, draws: int, max_doublings: int = 8):
    """One chain of the no-U-turn sampler with window adaptation, traceable: positions, log densities, divergences.

    Args: log_density over coordinates that are about standard normal; start. Shapes: (draws, coordinates), (draws,).
    Reference: Hoffman and Gelman, JMLR 15, 2014.
    """
    import jax

    blackjax: Any = _blackjax()
    warm, run = jax.random.split(key)
    adaptation = blackjax.window_adaptation(
        blackjax.nuts, log_density, target_acceptance_rate=0.85, max_num_doublings=max_doublings
    )
    (state, parameters), _ = adaptation.run(warm, start, num_steps=warmup)
    kernel = blackjax.nuts(log_density, **(parameters | {"max_num_doublings": max_doublings})).step

    def one(state, key):
        state, info = kernel(key, state)
        return state, (state.position, state.logdensity, info.is_divergent)

    return jax.lax.scan(one, state, jax.random.split(run, draws))[1]


def sample_posterior(
    problem: LeastSquaresProblem,
    solution: Solution,
    *,
    noise: str = "inferred",
    noise_prior: tuple[float, float] = (0.0, 1.0),
    warmup: int = 400,
    draws: int = 500,
    chains: int = 4,
    seed: int = 0,
) -> Posterior:
    """Sample the posterior of a problem, its prior flat in the coordinates within their bounds, beside rows of priors.

    Chains run in coordinates that the Laplace approximation makes about standard normal, each from its own draw of it;
    the gradient comes from forward mode, whatever the number of rows.

    Args:
        problem: a `FunctionProblem` (traced), or any other whose rows do not call JAX.
        solution: its optimum; noise: "inferred" (a factor a channel, its logarithm normal with mean and standard
            deviation `noise_prior`) or "known"; warmup, draws: a chain; chains; seed.
    Returns: a `Posterior`, whose `warnings` say whether to use it.
    Raises: ImportError without BlackJAX and ArviZ.
    """
    import jax

    from jaxlines.inference.density import called_on_host, make_density, with_slopes

    traced = isinstance(problem, FunctionProblem)
    both = with_slopes(problem.function) if traced else called_on_host(problem)
    density = make_density(
        both,
        problem.lower,
        problem.upper,
        problem.channel,
        problem.recording,
        noise=noise,
        noise_prior=noise_prior,
    )
    data = problem.recording >= 0
    squares = np.bincount(problem.channel[data], solution.residuals[data] ** 2)
    logs = 0.5 * np.log(np.maximum(squares / np.maximum(np.bincount(problem.channel[data]), 1), 1e-12))
    centre = density.to_z(solution.x, logs)
    with computing_in("float64"):
        root = whitening(laplace_curvature(problem, density, centre))
        keys = jax.random.split(jax.random.key(seed), (chains, 2))

        def chain(keys):
            start = jax.random.normal(keys[0], centre.shape)
            return run_chain(keys[1], lambda u: density.log_density(centre + root @ u), start, warmup, draws)

        u, log_density, divergent = jax.jit(jax.vmap(chain))(keys)
        x, levels = jax.vmap(jax.vmap(lambda u: density.to_x(centre + root @ u)))(u)
        x, factors = np.asarray(x), np.exp(np.asarray(levels))
        heights, lost = np.asarray(log_density), np.asarray(divergent)
    rhat, ess = _diagnose(np.concatenate([x, factors], axis=-1))
    return Posterior(problem.labels, x, factors, heights, lost, rhat, ess)


def laplace_curvature(problem: LeastSquaresProblem, density, centre) -> np.ndarray:
    """Curvature of -ln p at a point z: Gauss-Newton's for the rows, 2 n for a noise factor, and a little for priors."""
    import jax

    size = len(problem.labels)
    x, logs = (np.asarray(part) for part in density.to_x(centre))
    turn = np.asarray(jax.jvp(lambda z: density.to_x(z)[0], (centre,), (np.ones_like(centre),))[1])
    data = problem.recording >= 0
    weights = np.where(data, np.exp(-logs)[problem.channel], 1.0) if logs.size else np.ones(data.size)
    slopes = problem.jacobian(x) * weights[:, None] * turn
    counts = np.bincount(problem.channel[data], minlength=logs.size)[: logs.size]
    curvature = np.zeros((centre.size, centre.size))
    curvature[:size, :size] = slopes.T @ slopes
    curvature[range(size, centre.size), range(size, centre.size)] = 2.0 * counts
    return curvature + 0.1 * np.eye(centre.size)


def _diagnose(draws) -> tuple[np.ndarray, np.ndarray]:
    """Rank-normalised R-hat and bulk effective sample size of every quantity, draws (chains, draws, quantities)."""
    az = _arviz()
    count = range(draws.shape[-1])
    rhat = np.array([float(az.rhat(draws[..., i])) if draws.shape[0] > 1 else 1.0 for i in count])
    return rhat, np.array([float(az.ess(draws[..., i])) for i in count])
