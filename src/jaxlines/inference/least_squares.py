"""Nonlinear least squares of any model: what a problem is, one made of a JAX function, and a search that is checked."""

import abc
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from jaxlines.simulation.precision import computing_in

OFFSET_LIMIT = 0.01
"""Relative offset below which a search counts as converged (Bates and Watts, Technometrics 23, 1981)."""

STATUSES = ("converged", "at_bound", "stalled", "failed")


@runtime_checkable
class LeastSquaresProblem(Protocol):
    """Half the sum of squares of weighted rows r(x), to be minimised over lower <= x <= upper.

    labels: names of the parameters; lower, upper: bounds of the coordinates x, infinite where there are none;
    recording, channel, time: integers of shape (rows,) that say where a row comes from, recording -1 for the row of a
    prior. residuals: (simulated - measured)/sigma, shape (rows,), NaN where the model fails; jacobian: their slopes by
    the coordinates, shape (rows, parameters).
    """

    @property
    def labels(self) -> tuple[str, ...]: ...
    @property
    def lower(self) -> np.ndarray: ...
    @property
    def upper(self) -> np.ndarray: ...
    @property
    def recording(self) -> np.ndarray: ...
    @property
    def channel(self) -> np.ndarray: ...
    @property
    def time(self) -> np.ndarray: ...
    def residuals(self, x) -> np.ndarray:
        """Weighted rows at x."""
        ...

    def jacobian(self, x) -> np.ndarray:
        """Their slopes by x."""
        ...


@dataclasses.dataclass(frozen=True)
class FunctionProblem:
    """A least-squares problem of a function written in JAX, so that a model of any kind can be fitted.

    Args:
        function: x -> weighted residuals, shape (parameters,) -> (rows,), traceable and differentiable forward.
        labels: names of the parameters; lower, upper: their bounds, unbounded by default.
        recording, channel, time: where rows come from; one recording, one channel, rows in order by default.
    """

    function: Callable
    labels: tuple[str, ...]
    lower: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    upper: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    recording: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))
    channel: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))
    time: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))

    def __post_init__(self):
        count = len(self.labels)
        object.__setattr__(self, "labels", tuple(self.labels))
        for name, default in (("lower", -np.inf), ("upper", np.inf)):
            given = np.asarray(getattr(self, name), dtype=float)
            object.__setattr__(self, name, given if given.size else np.full(count, default))
        if self.lower.shape != (count,) or self.upper.shape != (count,) or not np.all(self.lower < self.upper):
            raise ValueError(
                f"bounds need one increasing pair for each of {count} parameters, got {self.lower} and {self.upper}"
            )
        rows = self._num_rows()
        for name, default in (("recording", np.zeros), ("channel", np.zeros), ("time", np.arange)):
            given = np.asarray(getattr(self, name), dtype=int)
            object.__setattr__(self, name, given if given.size else default(rows).astype(int))
            if getattr(self, name).shape != (rows,):
                raise ValueError(f"{name} needs one integer for each of {rows} rows, got {given.shape}")

    def _num_rows(self) -> int:
        import jax

        with computing_in("float64"):
            shape = jax.eval_shape(self.function, jax.ShapeDtypeStruct((len(self.labels),), np.float64)).shape
        if len(shape) != 1:
            raise ValueError(f"the function must return one axis of residuals, got shape {shape}: ravel them")
        return shape[0]

    @functools.cached_property
    def _programs(self) -> tuple[Callable, Callable, Callable]:
        import jax

        slopes = jax.jacfwd(self.function)
        gradient = lambda x: slopes(x).T @ self.function(x)  # noqa: E731
        return jax.jit(self.function), jax.jit(slopes), jax.jit(jax.jacfwd(gradient))

    def _run(self, which: int, x) -> np.ndarray:
        with computing_in("float64"):
            return np.asarray(self._programs[which](np.asarray(x, dtype=float)))

    def residuals(self, x) -> np.ndarray:
        """Weighted residuals at x, shape (rows,)."""
        return self._run(0, x)

    def jacobian(self, x) -> np.ndarray:
        """Their exact slopes by x, shape (rows, parameters)."""
        return self._run(1, x)

    def hessian(self, x) -> np.ndarray:
        """Exact second derivatives of half the sum of squares, shape (parameters, parameters)."""
        return self._run(2, x)


@dataclasses.dataclass(frozen=True)
class AbstractRewritten(abc.ABC):
    """A problem with the parameters, bounds and origins of rows of another one, `plain`, but rows of its own."""

    plain: LeastSquaresProblem

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.plain.labels

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates."""
        return self.plain.lower

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates."""
        return self.plain.upper

    @property
    def recording(self) -> np.ndarray:
        """Recording of a row, -1 for priors."""
        return self.plain.recording

    @property
    def channel(self) -> np.ndarray:
        """Channel of a row."""
        return self.plain.channel

    @property
    def time(self) -> np.ndarray:
        """Sample of a row."""
        return self.plain.time

    @abc.abstractmethod
    def residuals(self, x) -> np.ndarray:
        """Weighted rows, shape (rows,)."""

    @abc.abstractmethod
    def jacobian(self, x) -> np.ndarray:
        """Their slopes by the coordinates, shape (rows, parameters)."""


@dataclasses.dataclass(frozen=True)
class Solution:
    """Where a search ended.

    Fields: x; cost: half the sum of squares; status: one of STATUSES, judged from the projected gradient at x;
    message: the same in words; residuals, jacobian at x; start; num_evaluations.
    """

    x: np.ndarray
    cost: float
    status: str
    message: str
    residuals: np.ndarray
    jacobian: np.ndarray
    start: np.ndarray
    num_evaluations: int

    @property
    def ok(self) -> bool:
        """Whether it is an optimum, inside the bounds or on one."""
        return self.status in ("converged", "at_bound")


def stuck_at_bounds(problem: LeastSquaresProblem, x, gradient) -> np.ndarray:
    """Which coordinates lie on a bound with the downhill direction pointing out of it."""
    margin = 1e-9 * np.where(np.isfinite(problem.upper - problem.lower), problem.upper - problem.lower, 0.0)
    low, high = x <= problem.lower + margin, x >= problem.upper - margin
    return (low & (gradient >= 0.0)) | (high & (gradient <= 0.0))


def relative_offset(jacobian, residuals) -> float:
    """Length of the residuals in the tangent space over what noise alone would put there.

    Reference: Bates and Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares",
    Technometrics 23, 1981.
    """
    if jacobian.shape[1] == 0:
        return 0.0
    scale = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(scale > 0, scale, 1.0), full_matrices=False)
    left = left[:, singular > 1e-13 * singular[0]]
    inside = left.T @ residuals
    outside = np.linalg.norm(residuals - left @ inside) / np.sqrt(max(residuals.size - left.shape[1], 1))
    return float(np.linalg.norm(inside) / np.sqrt(max(left.shape[1], 1)) / max(outside, 1e-300))


def _judge(problem, x, residuals, jacobian, word: str) -> tuple[str, str]:
    """Status of an end point from its own gradient and bounds, not from the optimiser's word."""
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(jacobian))):
        return "failed", "the model or its derivatives are not finite where the search ended"
    stuck = stuck_at_bounds(problem, x, jacobian.T @ residuals)
    free = jacobian[:, ~stuck]
    offset = relative_offset(free, residuals)
    scale = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    step = np.linalg.lstsq(free / scale, -residuals, rcond=1e-13)[0] / scale
    tiny = bool(np.all(np.abs(step) <= 1e-9 * np.maximum(np.abs(x[~stuck]), 1e-300)))
    if offset > OFFSET_LIMIT and not tiny:
        return "stalled", f"the search stopped before the optimum (relative offset {offset:.2g}): {word}"
    if stuck.any():
        at = [f"{problem.labels[i]} at {x[i]:.6g}" for i in np.flatnonzero(stuck)]
        return "at_bound", "the optimum lies on a bound: " + ", ".join(at)
    return "converged", f"the remaining step is {offset:.1e} of a standard error"


def _attempt(problem, start, method: str, max_evaluations: int, tolerance: float):
    """One run of SciPy's search; x and the optimiser's word."""
    from scipy.optimize import least_squares

    def finite(rows):
        """Rows that make a search turn back where the model fails."""
        return rows if method == "trf" else np.where(np.isfinite(rows), rows, 1e100)

    bounds = (problem.lower, problem.upper) if method == "trf" else (-np.inf, np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        found = least_squares(
            lambda x: finite(problem.residuals(x)),
            start,
            jac=lambda x: finite(problem.jacobian(x)),  # pyright: ignore[reportArgumentType]
            method=method,  # pyright: ignore[reportArgumentType]
            bounds=bounds,
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=max_evaluations,
        )
    return found.x, found.message, found.nfev


def _inside(problem, start) -> np.ndarray:
    """A start strictly inside the bounds, as the trust region needs it."""
    width = np.where(np.isfinite(problem.upper - problem.lower), problem.upper - problem.lower, 0.0)
    return np.clip(np.asarray(start, dtype=float), problem.lower + 1e-9 * width, problem.upper - 1e-9 * width)


def solve(problem: LeastSquaresProblem, start, *, max_evaluations: int = 1000, tolerance: float = 1e-15) -> Solution:
    """Minimise half the sum of squares from a start.

    Bounded problems: the trust-region reflective search (Branch, Coleman and Li, SIAM J. Sci. Comput. 21, 1999).
    Unbounded ones: Levenberg-Marquardt (More, 1978) first, the trust region where that stalls. Columns are scaled
    by the Jacobian, so that units do not matter.

    Args: start: coordinates, clipped into the bounds; max_evaluations a search; tolerance: relative change of cost, of
    x, or gradient at which it stops, for models with an adaptive time step no lower than that step's tolerance.
    Returns: a `Solution`; with status "failed" when the model fails at the start.
    """
    start = _inside(problem, start)
    rows = problem.residuals(start)
    slopes = problem.jacobian(start)
    if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(slopes))):
        message = "the model or its derivatives are not finite at the start of the search"
        return Solution(start, np.inf, "failed", message, rows, slopes, start, 1)
    unbounded = not (np.any(np.isfinite(problem.lower)) or np.any(np.isfinite(problem.upper)))
    many_rows = rows.size >= start.size
    ends = []
    for method in ("lm", "trf") if unbounded and many_rows else ("trf",):
        ends.append(_ended(problem, start, *_attempt(problem, start, method, max_evaluations, tolerance)))
        if ends[-1].ok:
            break
    return min(ends, key=lambda end: end.cost)


def _ended(problem, start, x, word: str, count: int) -> Solution:
    """The end point, pressed onto bounds that hold it and looked at afresh."""
    residuals, jacobian = problem.residuals(x), problem.jacobian(x)
    if np.all(np.isfinite(jacobian)) and np.all(np.isfinite(residuals)):
        x, residuals, jacobian = _onto_bounds(problem, x, residuals, jacobian)
    status, message = _judge(problem, x, residuals, jacobian, word)
    cost = 0.5 * float(residuals @ residuals)
    return Solution(x, cost if np.isfinite(cost) else np.inf, status, message, residuals, jacobian, start, count)


def _onto_bounds(problem, x, residuals, jacobian):
    """An interior search stays a hair inside: move coordinates that a bound holds onto it if that costs nothing."""
    width = np.where(np.isfinite(problem.upper - problem.lower), problem.upper - problem.lower, 1.0)
    gradient = jacobian.T @ residuals
    low = (x - problem.lower < 1e-6 * width) & (gradient > 0)
    high = (problem.upper - x < 1e-6 * width) & (gradient < 0)
    if not (low | high).any():
        return x, residuals, jacobian
    moved = np.where(low, problem.lower, np.where(high, problem.upper, x))
    rows = problem.residuals(moved)
    if not rows @ rows <= residuals @ residuals:
        return x, residuals, jacobian
    slopes = problem.jacobian(moved)
    return (moved, rows, slopes) if np.all(np.isfinite(slopes)) else (x, residuals, jacobian)


def multi_start(
    problem: LeastSquaresProblem,
    starts: int | Sequence | np.ndarray,
    *,
    seed: int = 0,
    max_evaluations: int = 1000,
    tolerance: float = 1e-15,
) -> tuple[Solution, ...]:
    """Searches from many starts, ranked by their cost, best first (the waterfall); failed ones come last.

    Args: starts: how many points of a Latin hypercube over the bounds, or the starts themselves, shape
    (starts, parameters); seed of the hypercube; max_evaluations, tolerance: as in `solve`.
    Raises: ValueError when starts are counted and a bound is infinite.
    """
    points = spread_starts(problem, starts, seed) if isinstance(starts, int) else np.asarray(starts, dtype=float)
    ends = [solve(problem, start, max_evaluations=max_evaluations, tolerance=tolerance) for start in points]
    return tuple(sorted(ends, key=lambda end: end.cost))


def spread_starts(problem: LeastSquaresProblem, count: int, seed: int = 0) -> np.ndarray:
    """Points of a Latin hypercube over the bounds, shape (count, parameters). Raises ValueError for infinite ones."""
    from scipy.stats import qmc

    if not np.all(np.isfinite(problem.upper - problem.lower)):
        raise ValueError("many starts need finite bounds to spread over: give bounds, or the starts themselves")
    unit = qmc.LatinHypercube(len(problem.labels), rng=seed).random(count)
    return problem.lower + unit * (problem.upper - problem.lower)
