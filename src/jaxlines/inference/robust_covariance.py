"""Intervals where residuals are not white: clusters of recordings, moving blocks, autoregression; a rule to choose."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxlines.inference.curvature import gauss_newton_covariance, noise_variance
from jaxlines.inference.least_squares import AbstractRewritten, LeastSquaresProblem, Solution, solve
from jaxlines.inference.noise_models import series_of, solve_with_autoregression, whiteness
from jaxlines.inference.uncertainty import WHITE_LIMIT, p_value_text

MANY_RECORDINGS = 20
"""Recordings from which a covariance clustered by recording is trusted (fewer make it too small: Cameron and Miller,
"A practitioner's guide to cluster-robust inference", Journal of Human Resources 50, 2015)."""


def sandwich_covariance(residuals, jacobian, clusters) -> np.ndarray:
    """(J'J)^-1 (sum_c s_c s_c') (J'J)^-1 with s_c = J_c' r_c, times G/(G - 1) (n - 1)/(n - p).

    Right for any correlation within a cluster when clusters are independent and many (`MANY_RECORDINGS`).

    Args: residuals, shape (rows,); jacobian, shape (rows, parameters); clusters: integers, -1 for priors, whose
    information is taken as it is.
    Reference: Liang and Zeger, Biometrika 73, 1986; Cameron and Miller, 2015.
    Raises: ValueError for fewer than two clusters.
    """
    names = np.unique(clusters[clusters >= 0])
    if names.size < 2:
        raise ValueError(f"a covariance clustered by recording needs at least two recordings, got {names.size}")
    bread = gauss_newton_covariance(jacobian)
    scores = np.stack([jacobian[clusters == c].T @ residuals[clusters == c] for c in names])
    rows, count = int(np.sum(clusters >= 0)), jacobian.shape[1]
    factor = names.size / (names.size - 1) * (rows - 1) / max(rows - count, 1)
    prior = jacobian[clusters < 0]
    return bread @ (factor * scores.T @ scores + prior.T @ prior) @ bread


class Scatter(NamedTuple):
    """How much recordings differ in what they say, beyond their noise.

    estimates: what each recording says alone, to first order, shape (recordings, parameters), NaN where it cannot tell;
    sd: their standard deviations; between: standard deviation between recordings beyond these; p: that there is none.
    """

    estimates: np.ndarray
    sd: np.ndarray
    between: np.ndarray
    p: np.ndarray


def between_recordings(problem: LeastSquaresProblem, solution: Solution, variance: float | None = None) -> Scatter:
    """The scatter between recordings, one parameter at a time, from one Gauss-Newton step of each recording.

    Reference: DerSimonian and Laird, "Meta-analysis in clinical trials", 1986 (Cochran's Q and the moment estimator).
    """
    from scipy.special import chdtrc

    count = solution.x.size
    variance = noise_variance(solution.residuals, count) if variance is None else variance
    names = np.unique(problem.recording[problem.recording >= 0])
    estimates, sd = np.full((names.size, count), np.nan), np.full((names.size, count), np.nan)
    for i, name in enumerate(names):
        own = problem.recording == name
        slopes, rows = solution.jacobian[own], solution.residuals[own]
        moved = np.any(slopes != 0.0, axis=0)
        if not moved.any() or rows.size <= moved.sum():
            continue
        spread = gauss_newton_covariance(slopes[:, moved], variance)
        told = np.isfinite(np.diag(spread))
        size = np.linalg.norm(slopes[:, moved], axis=0)
        step = -np.linalg.lstsq(slopes[:, moved] / size, rows, rcond=1e-12)[0] / size
        estimates[i, moved] = np.where(told, solution.x[moved] + step, np.nan)
        sd[i, moved] = np.where(told, np.sqrt(np.abs(np.diag(spread))), np.nan)
    weights = np.where(np.isfinite(sd), 1.0 / np.where(np.isfinite(sd), sd, 1.0) ** 2, 0.0)
    total = np.maximum(weights.sum(axis=0), 1e-300)
    known = np.where(weights > 0, estimates, 0.0)
    mean = (weights * known).sum(axis=0) / total
    q = (weights * (known - mean) ** 2).sum(axis=0)
    freedom = (weights > 0).sum(axis=0) - 1
    spare = total - (weights**2).sum(axis=0) / total
    between = np.sqrt(np.maximum(q - freedom, 0.0) / np.where(spare > 0, spare, np.inf))
    p = np.array([chdtrc(f, value) if f > 0 else np.nan for f, value in zip(freedom, q, strict=True)])
    return Scatter(estimates, sd, np.where(freedom > 0, between, np.nan), p)


@dataclasses.dataclass(frozen=True)
class Shifted(AbstractRewritten):
    """A problem whose data are the model's at some point plus other noise: rows r(x) + shift."""

    shift: np.ndarray

    def residuals(self, x) -> np.ndarray:
        """Rows of the plain problem, shifted."""
        return self.plain.residuals(x) + self.shift

    def jacobian(self, x) -> np.ndarray:
        """Slopes of the plain problem."""
        return self.plain.jacobian(x)


def block_length(piece: np.ndarray) -> int:
    """Length of moving blocks, n^(1/3) (6 a^2/(1 - a^2)^2)^(1/3) with a the correlation of neighbours, at least 1.

    Reference: Carlstein, Annals of Statistics 14, 1986; Kuensch, Annals of Statistics 17, 1989.
    """
    centred = piece - piece.mean()
    power = float(centred @ centred)
    a = float(centred[1:] @ centred[:-1]) / power if power > 0 and piece.size > 2 else 0.0
    a = min(abs(a), 0.97)
    ideal = piece.size ** (1.0 / 3.0) * (6.0 * a**2 / (1.0 - a**2) ** 2) ** (1.0 / 3.0)
    return int(np.clip(np.ceil(ideal), 1, max(piece.size // 4, 1)))


def block_bootstrap(
    problem: LeastSquaresProblem,
    solution: Solution,
    *,
    count: int = 200,
    block: int | None = None,
    refit: bool = True,
    seed: int = 0,
) -> np.ndarray:
    """Estimates from data made anew of the fitted model and blocks of its residuals, shape (draws, parameters).

    Blocks are drawn within each recording and channel. Residuals are centred and enlarged by sqrt(n/(n - p)).

    Args: block: samples a block, `block_length` by default; refit: search anew for every draw, or take one
    Gauss-Newton step from the optimum (cheap, and the same to first order). Failed searches are left out.
    """
    rng = np.random.default_rng(seed)
    pieces, rows = series_of(problem), problem.residuals(solution.x)
    total = sum(piece.size for piece in pieces)
    enlarge = np.sqrt(total / max(total - solution.x.size, 1))
    size = np.linalg.norm(solution.jacobian, axis=0)
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(solution.jacobian / size, rcond=1e-12) / size[:, None]
    draws = []
    for _ in range(count):
        drawn = rng.standard_normal(rows.size)  # priors: what was known might as well have been this
        drawn = np.where(problem.recording < 0, rows - drawn, 0.0)
        for piece in pieces:
            drawn[piece] = enlarge * _blocks(rows[piece], block or block_length(rows[piece]), rng)
        if not refit:
            draws.append(np.clip(solution.x - inverse @ drawn, problem.lower, problem.upper))
            continue
        end = solve(Shifted(problem, drawn - rows), solution.x, max_evaluations=50)
        if end.ok:
            draws.append(end.x)
    return np.array(draws).reshape(-1, solution.x.size)


def _blocks(piece, block: int, rng) -> np.ndarray:
    """A series of the same length from moving blocks of a centred one."""
    block = min(block, piece.size)
    starts = rng.integers(0, piece.size - block + 1, size=-(-piece.size // block))
    series = (piece - piece.mean())[(starts[:, None] + np.arange(block)).ravel()]
    return series[: piece.size]


@dataclasses.dataclass(frozen=True)
class NoiseStatement:
    """How uncertain estimates are, by which model of the noise, and why.

    Fields: method: "white", "clusters", "autoregressive" or "blocks"; x: estimates in coordinates (those of generalised
    least squares with "autoregressive"); covariance of the coordinates; factor: 95 % intervals are x +- factor * sd;
    sentence: what was done and why; whiteness_p; scatter between recordings, None for a single one.
    """

    method: str
    x: np.ndarray
    covariance: np.ndarray
    factor: float
    sentence: str
    whiteness_p: float
    scatter: Scatter | None

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the coordinates."""
        return np.sqrt(np.diag(self.covariance))


def uncertainty_under_noise(
    problem: LeastSquaresProblem, solution: Solution, *, noise: str = "estimated", draws: int = 200, seed: int = 0
) -> NoiseStatement:
    """The covariance that the residuals allow: white noise if they are white, else the first that applies of

    clusters by recording (with `MANY_RECORDINGS` or more), autoregressive noise (if it leaves white residuals), moving
    blocks. Args: noise: as in `profiles.interval`; draws, seed of the bootstrap.
    """
    from scipy.special import stdtrit

    p = whiteness(problem, solution.residuals)
    recordings = np.unique(problem.recording[problem.recording >= 0]).size
    variance, count = noise_variance(solution.residuals, solution.x.size, noise), solution.x.size
    scatter = between_recordings(problem, solution) if recordings > 1 else None
    freedom = solution.residuals.size - count if noise == "estimated" else np.inf

    def statement(method, x, covariance, freedom, sentence):
        factor = float(stdtrit(max(freedom, 1), 0.975)) if np.isfinite(freedom) else 1.959963984540054
        return NoiseStatement(method, x, covariance, factor, sentence, p, scatter)

    if p > WHITE_LIMIT:
        found = gauss_newton_covariance(solution.jacobian, variance)
        return statement("white", solution.x, found, freedom, f"residuals are white ({p_value_text(p)})")
    why = f"residuals are not white ({p_value_text(p)}): "
    if recordings >= MANY_RECORDINGS:
        found = sandwich_covariance(solution.residuals, solution.jacobian, problem.recording)
        word = why + f"the covariance is that of {recordings} independent recordings, whatever their noise"
        return statement("clusters", solution.x, found, recordings - 1, word)
    whitened, end = solve_with_autoregression(problem, solution)
    orders = ", ".join(str(model.order) for model in whitened.models)
    left = whiteness(whitened, end.residuals)
    if end.ok and left > WHITE_LIMIT:
        word = why + f"the noise is taken as autoregressive of order {orders}, which leaves white ones "
        found = gauss_newton_covariance(end.jacobian)
        return statement("autoregressive", end.x, found, freedom, word + f"({p_value_text(left)})")
    found = np.atleast_2d(np.cov(block_bootstrap(problem, solution, count=draws, refit=False, seed=seed).T))
    word = f"{why.rstrip(': ')}, nor after autoregression of order {orders}: the covariance is from moving blocks. "
    word += "A term that the model lacks may be the cause, and then no interval covers the truth"
    return statement("blocks", solution.x, found, np.inf, word)
