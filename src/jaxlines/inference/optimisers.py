"""First-order and quasi-Newton optimisers for large or user-defined objectives, through the same problem object."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxlines.inference.least_squares import LeastSquaresProblem
from jaxlines.simulation.precision import computing_in


class Objective(Protocol):
    """A sum of terms over batches, to be minimised over lower <= x <= upper.

    num_batches: parts that can be evaluated alone (recordings); value_and_gradient: of the sum over some of them.
    """

    @property
    def labels(self) -> tuple[str, ...]: ...
    @property
    def lower(self) -> np.ndarray: ...
    @property
    def upper(self) -> np.ndarray: ...
    @property
    def num_batches(self) -> int: ...
    def value_and_gradient(self, x, batches: Sequence[int]) -> tuple[float, np.ndarray]:
        """Sum over some batches, and its slopes by x."""
        ...


@dataclasses.dataclass(frozen=True)
class SquaresObjective:
    """Half the sum of squares of one or several least-squares problems of the same parameters, a batch each.

    Each is evaluated only when its batch is drawn, so that a step costs what its recordings cost.
    """

    problems: tuple[LeastSquaresProblem, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.problems[0].labels

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds."""
        return self.problems[0].lower

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds."""
        return self.problems[0].upper

    @property
    def num_batches(self) -> int:
        """One a problem."""
        return len(self.problems)

    def value_and_gradient(self, x, batches: Sequence[int]) -> tuple[float, np.ndarray]:
        """Half the sum of squares of some problems, and its slopes J'r."""
        value, slopes = 0.0, np.zeros(len(self.labels))
        for i in batches:
            rows = self.problems[i].residuals(x)
            value += 0.5 * float(rows @ rows)
            slopes = slopes + self.problems[i].jacobian(x).T @ rows
        return value, slopes


@dataclasses.dataclass(frozen=True)
class FunctionObjective:
    """An objective of one's own: function(x, batch) -> scalar, written in JAX; batch is an integer.

    gradient: "reverse" for many parameters, "forward" for models that refuse reverse mode.
    """

    function: Callable
    labels: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    num_batches: int = 1
    gradient: str = "reverse"
    _programs: dict[str, Any] = dataclasses.field(default_factory=dict, repr=False)

    def value_and_gradient(self, x, batches: Sequence[int]) -> tuple[float, np.ndarray]:
        """The sum over some batches, and its slopes."""
        import jax

        if not self._programs:
            slopes = {"reverse": jax.grad, "forward": jax.jacfwd}[self.gradient](self.function)
            self._programs["run"] = jax.jit(lambda x, batch: (self.function(x, batch), slopes(x, batch)))
        with computing_in("float64"):
            parts = [self._programs["run"](np.asarray(x, dtype=float), np.asarray(i)) for i in batches]
        return float(sum(float(v) for v, _ in parts)), np.sum([np.asarray(g) for _, g in parts], axis=0)


class Minimum(NamedTuple):
    """Where an optimiser ended: x, value there over all batches, status ("converged", "stalled", "failed"), a message,
    and the value of every step (of its batches, scaled to all)."""

    x: np.ndarray
    value: float
    status: str
    message: str
    history: np.ndarray


def _projected_gradient(objective: Objective, x, slopes) -> np.ndarray:
    """Slopes without those that point out of a bound."""
    out = ((x <= objective.lower) & (slopes > 0)) | ((x >= objective.upper) & (slopes < 0))
    return np.where(out, 0.0, slopes)


def _judged(objective: Objective, x, history, tolerance: float) -> Minimum:
    """The end point, looked at over all batches: the projected gradient must be small beside the first one."""
    value, slopes = objective.value_and_gradient(x, range(objective.num_batches))
    if not (np.isfinite(value) and np.all(np.isfinite(slopes))):
        return Minimum(x, value, "failed", "the objective is not finite at the end", np.asarray(history))
    width = np.where(np.isfinite(objective.upper - objective.lower), objective.upper - objective.lower, 1.0)
    gain = float(np.max(np.abs(_projected_gradient(objective, x, slopes) * width), initial=0.0))
    small = gain <= tolerance * max(abs(value), 1.0)
    word = f"slope across the bounds {gain:.2g}, value {value:.6g}"
    return Minimum(x, value, "converged" if small else "stalled", word, np.asarray(history))


def minimise(
    objective: Objective,
    start,
    optimiser,
    *,
    steps: int,
    batch_size: int | None = None,
    seed: int = 0,
    tolerance: float = 1e-3,
) -> Minimum:
    """Minimise with an optimiser of Optax, over random batches; the last iterate counts.

    Coordinates are scaled by the widths of finite bounds, so that a learning rate of 0.01 moves each by about 1 % of
    its width; a step that leaves the bounds is cut back to them (projection).

    Args: optimiser: such as `optax.adam(optax.cosine_decay_schedule(0.05, 500))`; steps; batch_size: batches a step,
    all by default; tolerance: of the projected slope, relative to the value, that counts as converged.
    Returns: a `Minimum`, judged over all batches. A step whose gradient is not finite is left out.
    """
    import jax.numpy as jnp
    import optax

    rng = np.random.default_rng(seed)
    width = np.where(np.isfinite(objective.upper - objective.lower), objective.upper - objective.lower, 1.0)
    x, history = np.clip(np.asarray(start, dtype=float), objective.lower, objective.upper), []
    count = objective.num_batches if batch_size is None else min(batch_size, objective.num_batches)
    order: list[int] = []
    with computing_in("float64"):
        state = optimiser.init(jnp.asarray(x / width))
        for _ in range(steps):
            if len(order) < count:
                order += [int(i) for i in rng.permutation(objective.num_batches)]
            chosen, order = order[:count], order[count:]
            value, slopes = objective.value_and_gradient(x, chosen)
            factor = objective.num_batches / count
            history.append(value * factor)
            if not np.all(np.isfinite(slopes)):
                continue
            update, state = optimiser.update(jnp.asarray(slopes * width * factor), state, jnp.asarray(x / width))
            x = np.clip(
                np.asarray(optax.apply_updates(jnp.asarray(x / width), update)) * width,
                objective.lower,
                objective.upper,
            )
    return _judged(objective, x, history, tolerance)


def minimise_lbfgs(objective: Objective, start, *, max_iterations: int = 500, tolerance: float = 1e-6) -> Minimum:
    """Minimise by the limited-memory quasi-Newton method with bounds (L-BFGS-B), over all batches at once.

    Reference: Byrd, Lu, Nocedal and Zhu, SIAM J. Sci. Comput. 16, 1995.
    """
    from scipy.optimize import minimize

    width = np.where(np.isfinite(objective.upper - objective.lower), objective.upper - objective.lower, 1.0)
    history: list[float] = []

    def scaled(z):
        """Value and slopes in coordinates of width 1."""
        value, slopes = objective.value_and_gradient(z * width, range(objective.num_batches))
        history.append(value)
        return value, slopes * width

    found = minimize(
        scaled,
        np.clip(np.asarray(start, dtype=float), objective.lower, objective.upper) / width,
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(objective.lower / width, objective.upper / width, strict=True)),
        options={"maxiter": max_iterations, "ftol": 1e-15, "gtol": 1e-10, "maxcor": 20},
    )
    return _judged(objective, np.clip(found.x * width, objective.lower, objective.upper), history, tolerance)
