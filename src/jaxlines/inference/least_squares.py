"""Nonlinear least squares of any model (see `least_squares_problem`): a search that is checked, from many starts."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlines.inference.least_squares_problem import (
    AbstractRewritten as AbstractRewritten,
    FunctionProblem as FunctionProblem,
    LeastSquaresProblem as LeastSquaresProblem,
)

OFFSET_LIMIT = 0.01
"""Relative offset below which a search counts as converged (Bates and Watts, Technometrics 23, 1981)."""

OFFSET_GOAL = 1e-6
"""Relative offset at which the trust region stops: a millionth of a standard error is left to gain."""

STATUSES = ("converged", "at_bound", "stalled", "failed")


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


class _Watched:
    """The rows and slopes that a search sees, and whether it may stop: less than OFFSET_GOAL is left to gain.

    It sees z = (x - shift)/scale, 0..1 between finite bounds: SciPy takes a start within 1e-10 of a bound, in whatever
    unit, for one on it and moves it, which would be fatal to a conductance of 1e-12 m^3/(s Pa).
    """

    def __init__(self, problem: LeastSquaresProblem, method: str):
        self.problem, self.method = problem, method
        finite = np.isfinite(problem.upper - problem.lower)
        self.shift = np.where(finite, problem.lower, 0.0)
        self.scale = np.where(finite, problem.upper - problem.lower, 1.0)
        self.last, self.rows, self.settled = np.zeros(0), np.zeros(0), False

    def x(self, z) -> np.ndarray:
        """Coordinates of the problem."""
        return np.clip(self.shift + self.scale * z, self.problem.lower, self.problem.upper)

    def z(self, x) -> np.ndarray:
        """What the search sees of them."""
        return (x - self.shift) / self.scale

    def _finite(self, rows) -> np.ndarray:
        """Rows that make a search turn back where the model fails."""
        return rows if self.method == "trf" else np.where(np.isfinite(rows), rows, 1e100)

    def residuals(self, z) -> np.ndarray:
        """Rows at z."""
        self.last, self.rows = np.array(z), self._finite(self.problem.residuals(self.x(z)))
        return self.rows

    def jacobian(self, z) -> np.ndarray:
        """Slopes at z; a search asks for them where it has just asked for rows."""
        slopes = self._finite(self.problem.jacobian(self.x(z)))
        if np.array_equal(z, self.last) and np.all(np.isfinite(slopes)):
            free = ~stuck_at_bounds(self.problem, self.x(z), slopes.T @ self.rows)
            self.settled = relative_offset(slopes[:, free], self.rows) < OFFSET_GOAL
        return slopes * self.scale

    def stop(self, intermediate_result) -> None:
        """Callback of the trust-region search."""
        del intermediate_result
        if self.settled:
            raise StopIteration


def _attempt(problem, start, method: str, max_evaluations: int, tolerance: float):
    """One run of SciPy's search; x, the optimiser's word and its number of evaluations."""
    from scipy.optimize import least_squares

    seen = _Watched(problem, method)
    bounds = (seen.z(problem.lower), seen.z(problem.upper)) if method == "trf" else (-np.inf, np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        found = least_squares(
            seen.residuals,
            seen.z(start),
            jac=seen.jacobian,  # pyright: ignore[reportArgumentType]
            method=method,  # pyright: ignore[reportArgumentType]
            bounds=bounds,
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=tolerance,
            max_nfev=max_evaluations,
            callback=seen.stop if method == "trf" else None,
        )
    return seen.x(found.x), found.message, found.nfev


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
