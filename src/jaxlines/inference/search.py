"""Bounded nonlinear least squares around a problem, with an honest word on how it ended."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from jaxlines.inference.checkpoint import Memory
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.parameters import Free
from jaxlines.inference.uncertainty import UNINFORMED

OFFSET_GOAL = 1e-4
"""Relative offset at which a search stops: nothing that the data could tell is left to gain."""

OFFSET_LIMIT = 0.01
"""Relative offset below which a search counts as converged: the remaining step is under 1 % of a standard error
(Bates and Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares",
Technometrics 23, 1981; they suggest 0.001 to 0.01)."""

NEAR_FAILURE = 3.0
"""An end point is near failure when a simulation failed within this many standard errors of it."""


@dataclasses.dataclass(frozen=True)
class Found:
    """Where a search ended: values in SI, simulated channels and slopes there a recording, and how it ended.

    followed: whether single trajectories showed them, not windows (see `shooting.search_in_windows`).
    """

    values: np.ndarray
    coordinates: np.ndarray
    simulated: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]
    cost: float
    status: str
    message: str
    num_evaluations: int
    followed: bool = True


class Failed(RuntimeError):
    """No start of a search could be simulated."""


class Evaluator:
    """What SciPy's search sees of a problem: p + 1 rows in place of all, with the same cost, gradient and J'J.

    With h = r/|r| an orthogonal transformation takes the rows r to (|r|, 0, ..., 0) and the Jacobian J to (h'J, R),
    R the triangular factor of what is left, J - h h'J. A search that uses no more than r and J of one point cannot
    tell the difference, so that a memory of these few numbers is enough to repeat it exactly.
    """

    def __init__(self, problem: JointProblem, stage: str, memory: Memory, report: Callable[[int, float], None]):
        self.problem, self.stage, self.memory, self.report = problem, stage, memory, report
        self.count, self.last, self.settled = 0, None, False
        self.failed: list[np.ndarray] = []
        self.widths = problem.upper - problem.lower

    def residuals(self, x) -> np.ndarray:
        """(|r|, 0, ..., 0), shape (parameters + 1,); NaN where a simulation fails."""
        known = self.memory.recall(self.stage, x)
        if "norm" not in known:
            norm = float(np.linalg.norm(self.problem.residuals(x)))
            self.memory.keep(self.stage, x, norm=norm if np.isfinite(norm) else None)
        norm = known["norm"]
        self.count += 1
        self.report(self.count, np.inf if norm is None else 0.5 * norm**2)
        if norm is None:
            self.failed.append(np.array(x))
        return np.concatenate([[np.nan if norm is None else norm], np.zeros(self.widths.size)])

    def jacobian(self, x) -> np.ndarray:
        """Slopes of these rows by coordinates, shape (parameters + 1, parameters)."""
        known = self.memory.recall(self.stage, x)
        if "jacobian" not in known:
            rows, jacobian = self._full(x)
            if not np.all(np.isfinite(jacobian)):
                raise Failed(f"a derivative is not finite: {self.problem.why_it_fails(self.problem.to_values(x))}")
            settled = relative_offset(jacobian, rows, self.widths) < OFFSET_GOAL
            small = _condensed(rows, jacobian)
            self.memory.keep(self.stage, x, jacobian=small.tolist(), settled=bool(settled), write=True)
        self.settled = known["settled"]
        return np.array(known["jacobian"])

    def _full(self, x) -> tuple[np.ndarray, np.ndarray]:
        """All rows and their slopes at coordinates."""
        simulated, slopes = self.problem.sensitivities(self.problem.to_values(x))
        self.last = (np.array(x), simulated, slopes)
        return self.problem.rows(self.problem.to_values(x), simulated), self.problem.row_slopes(x, simulated, slopes)

    def stop_when_settled(self, intermediate_result) -> None:
        """Callback of SciPy's search: nothing left to gain."""
        del intermediate_result
        if self.settled:
            raise StopIteration

    def at(self, x) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Simulated channels and slopes at a point, computed again only if it is not the last."""
        if self.last is None or not np.array_equal(self.last[0], x):
            self._full(x)
        assert self.last is not None
        return self.last[1], self.last[2]


def _condensed(rows, jacobian) -> np.ndarray:
    """(h'J, R) of `Evaluator`, shape (parameters + 1, parameters)."""
    count, norm = jacobian.shape[1], float(np.linalg.norm(rows))
    direction = rows / norm if norm > 0.0 else np.zeros_like(rows)
    along = direction @ jacobian
    triangle = np.asarray(np.linalg.qr(jacobian - np.outer(direction, along), mode="r"))
    small = np.zeros((count + 1, count))
    small[0], small[1 : 1 + triangle.shape[0]] = along, triangle
    return small


def relative_offset(jacobian, residuals, widths) -> float:
    """Residual in the tangent space over what noise alone would put there; columns of movable coordinates only.

    A direction that the data leave open (see `uncertainty.covariance`) counts only while a walk along it within the
    bounds would still gain in likelihood (by 0.5, one standard error), as on a plateau far from the optimum.
    """
    if jacobian.shape[1] == 0:
        return 0.0
    if not np.all(np.isfinite(jacobian)):
        return np.inf
    left, singular, _ = np.linalg.svd(jacobian * widths, full_matrices=False)
    left, singular = left[:, singular > 0.0], singular[singular > 0.0]
    inside = left.T @ residuals
    level = _level(residuals, left, inside)
    steps, known = np.abs(inside) / level, singular > level / UNINFORMED
    firm = float(np.sqrt(np.mean(steps[known] ** 2))) if known.any() else 0.0
    reach = np.minimum(steps, singular / level)  # a walk ends at its best point or at the bounds
    gainful = ~known & (steps * reach - 0.5 * reach**2 > 0.5)
    return max(firm, float(np.max(steps[gainful], initial=0.0)))


def _level(residuals, left, inside) -> float:
    """Standard deviation of the rows outside the tangent space."""
    freedom = max(residuals.size - left.shape[1], 1)
    return max(float(np.linalg.norm(residuals - left @ inside)) / np.sqrt(freedom), 1e-300)


def judge(free: Sequence[Free], coordinates, residuals, jacobian, optimiser_message: str) -> tuple[str, str]:
    """Status of an end point from its own gradient and bounds, not from the optimiser's word."""
    bounds = np.array([f.coordinate_bounds() for f in free])
    near = 1e-6 * (bounds[:, 1] - bounds[:, 0])
    gradient = jacobian.T @ residuals
    low = (coordinates - bounds[:, 0] < near) & (gradient > 0)
    high = (bounds[:, 1] - coordinates < near) & (gradient < 0)
    movable = ~(low | high)
    widths = bounds[:, 1] - bounds[:, 0]
    offset = relative_offset(jacobian[:, movable], residuals, widths[movable])
    step = np.linalg.lstsq(jacobian[:, movable], -residuals, rcond=1e-8)[0] if movable.any() else np.zeros(0)
    tiny = bool(np.all(np.abs(step) < 1e-7 * (bounds[movable, 1] - bounds[movable, 0])))
    if offset > OFFSET_LIMIT and not tiny:
        return "stalled", f"the search stopped before the optimum (relative offset {offset:.2g}): {optimiser_message}"
    stuck = [f"{f.label} at its {'lower' if low[i] else 'upper'} one" for i, f in enumerate(free) if not movable[i]]
    if stuck:
        return "at_bound", "the optimum lies on a bound, " + ", ".join(stuck)
    return "converged", f"the remaining step is {offset:.1e} of a standard error"


def nearest_failure(problem: JointProblem, x, residuals, jacobian, failed) -> tuple[float, str]:
    """Distance to the nearest simulation that failed, in standard errors, and what failed; infinite without any.

    The distance is |J dx| over the level of the residuals: how far the simulated channels are apart, to first order.
    """
    if not failed:
        return np.inf, ""
    level = max(float(np.linalg.norm(residuals)) / np.sqrt(max(residuals.size - x.size, 1)), 1e-300)
    distances = [float(np.linalg.norm(jacobian @ (point - x))) / level for point in failed]
    nearest = failed[int(np.argmin(distances))]
    return min(distances), problem.why_it_fails(problem.to_values(nearest))


def search(
    problem: JointProblem,
    start: np.ndarray,
    report: Callable[[int, float], None],
    *,
    stage: str = "search",
    memory: Memory | None = None,
    max_evaluations: int = 100,
) -> Found:
    """One trust-region search from a start (search coordinates), at the noise levels of the problem.

    SciPy sees z = (x - lower)/(upper - lower): it takes a start within 1e-10 of a bound, in whatever unit, for one on
    it and moves it, which would be fatal to a conductance of 1e-12 m^3/(s Pa).

    stage, memory: under which name evaluations are remembered, and where. Raises: Failed when the start cannot be
    simulated.
    """
    from scipy.optimize import least_squares

    evaluator = Evaluator(problem, stage, memory or Memory(), report)
    widths = evaluator.widths

    def of(z) -> np.ndarray:
        return np.clip(problem.lower + widths * z, problem.lower, problem.upper)

    first = np.clip((start - problem.lower) / widths, 1e-9, 1.0 - 1e-9)
    start = of(first)
    if not np.all(np.isfinite(evaluator.residuals(start))):
        reason = problem.why_it_fails(problem.to_values(start))
        raise Failed(f"the simulation fails at the start of the search: {reason}")
    found = least_squares(
        lambda z: evaluator.residuals(of(z)),
        first,
        jac=lambda z: evaluator.jacobian(of(z)) * widths,  # pyright: ignore[reportArgumentType]
        bounds=(0.0, 1.0),
        x_scale="jac",
        ftol=1e-12,
        xtol=1e-9,
        gtol=1e-12,
        max_nfev=max_evaluations,
        callback=evaluator.stop_when_settled,
    )
    return _ended(problem, evaluator, of(found.x), found.message)


def _ended(problem: JointProblem, evaluator: Evaluator, x: np.ndarray, message: str) -> Found:
    """The end point, looked at again."""
    simulated, slopes = evaluator.at(x)
    values = problem.to_values(x)
    residuals, jacobian = problem.rows(values, simulated), problem.row_slopes(x, simulated, slopes)
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(jacobian))):
        raise Failed(f"the simulation fails where the search ended: {problem.why_it_fails(values)}")
    status, message = judge(problem.free, x, residuals, jacobian, message)
    distance, reason = nearest_failure(problem, x, residuals, jacobian, evaluator.failed)
    if distance < NEAR_FAILURE:
        status = "near_failure"
        message = f"simulations fail {distance:.2g} standard errors away ({reason}); without that: {message}"
    cost = 0.5 * float(residuals @ residuals)
    return Found(values, x, tuple(simulated), tuple(slopes), cost, status, message, evaluator.count)
