"""Bounded nonlinear least squares around a problem: starts, noise levels, an honest word on convergence."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxlines.inference.parameters import Free
from jaxlines.inference.problem import Problem
from jaxlines.inference.uncertainty import UNINFORMED

OFFSET_GOAL = 1e-4
"""Relative offset at which a search stops: nothing that the data could tell is left to gain."""

OFFSET_LIMIT = 0.01
"""Relative offset below which a search counts as converged: the remaining step is under 1 % of a standard error
(Bates and Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares",
Technometrics 23, 1981; they suggest 0.001 to 0.01)."""


@dataclasses.dataclass(frozen=True)
class Found:
    """Where a search ended: values in SI, residuals and Jacobian there, and how it ended."""

    values: np.ndarray
    coordinates: np.ndarray
    simulated: np.ndarray
    slopes: np.ndarray
    cost: float
    status: str
    message: str
    num_evaluations: int


class Failed(RuntimeError):
    """No start of a search could be simulated."""


class _Evaluator:
    """Residuals and Jacobian in search coordinates, weighted by the noise, remembering the last point."""

    def __init__(self, problem: Problem, sigma: np.ndarray, report: Callable[[int, float], None]):
        self.problem, self.sigma, self.report = problem, sigma, report
        self.count, self.last, self.settled = 0, None, False
        self.used, self.measured = problem.used, problem.measured
        self.widths = np.array([high - low for low, high in (f.coordinate_bounds() for f in problem.free)])

    def values(self, coordinates) -> np.ndarray:
        return np.array([f.to_value(c) for f, c in zip(self.problem.free, coordinates, strict=True)])

    def residuals(self, coordinates) -> np.ndarray:
        simulated = self.problem.predict(self.values(coordinates))
        self.count += 1
        residuals = ((simulated - self.measured) / self.sigma)[self.used]
        self.report(self.count, 0.5 * float(residuals @ residuals) if np.all(np.isfinite(residuals)) else np.inf)
        return residuals

    def jacobian(self, coordinates) -> np.ndarray:
        simulated, slopes = self.problem.sensitivities(self.values(coordinates))
        self.last = (np.array(coordinates), simulated, slopes)
        jacobian = weighted_jacobian(self.problem, coordinates, slopes, self.sigma)
        residuals = ((simulated - self.measured) / self.sigma)[self.used]
        self.settled = relative_offset(jacobian, residuals, self.widths) < OFFSET_GOAL
        return jacobian

    def stop_when_settled(self, intermediate_result) -> None:
        """Callback of SciPy's search: nothing left to gain."""
        del intermediate_result
        if self.settled:
            raise StopIteration

    def at(self, coordinates) -> tuple[np.ndarray, np.ndarray]:
        """Simulated channels and slopes at a point, computed again only if it is not the last."""
        if self.last is None or not np.array_equal(self.last[0], coordinates):
            self.jacobian(coordinates)
        assert self.last is not None
        return self.last[1], self.last[2]


def weighted_jacobian(problem: Problem, coordinates, slopes, sigma) -> np.ndarray:
    """Jacobian of the weighted residuals by the search coordinates, shape (used samples, free)."""
    values = [f.to_value(c) for f, c in zip(problem.free, coordinates, strict=True)]
    steps = np.array([f.slope(v) for f, v in zip(problem.free, values, strict=True)])
    return (slopes[..., : len(steps)] * steps / sigma[:, None])[problem.used]


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
    freedom = max(residuals.size - left.shape[1], 1)
    level = max(float(np.linalg.norm(residuals - left @ inside)) / np.sqrt(freedom), 1e-300)
    steps, known = np.abs(inside) / level, singular > level / UNINFORMED
    firm = float(np.sqrt(np.mean(steps[known] ** 2))) if known.any() else 0.0
    reach = np.minimum(steps, singular / level)  # a walk ends at its best point or at the bounds
    gainful = ~known & (steps * reach - 0.5 * reach**2 > 0.5)
    return max(firm, float(np.max(steps[gainful], initial=0.0)))


def judge(free: tuple[Free, ...], coordinates, residuals, jacobian, optimiser_message: str) -> tuple[str, str]:
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


def search(problem: Problem, start: np.ndarray, sigma: np.ndarray, report, *, max_evaluations: int = 100) -> Found:
    """One trust-region search from a start (search coordinates) with noise levels sigma, shape (channels,).

    Raises: Failed when the start cannot be simulated.
    """
    from scipy.optimize import least_squares

    evaluator = _Evaluator(problem, sigma, report)
    bounds = np.array([f.coordinate_bounds() for f in problem.free]).T
    margin = 1e-9 * (bounds[1] - bounds[0])
    start = np.clip(start, bounds[0] + margin, bounds[1] - margin)
    if not np.all(np.isfinite(evaluator.residuals(start))):
        reason = problem.why_it_fails(evaluator.values(start))
        raise Failed(f"the simulation fails at the start of the search: {reason}")
    found = least_squares(
        evaluator.residuals,
        start,
        jac=evaluator.jacobian,  # pyright: ignore[reportArgumentType]
        bounds=bounds,
        x_scale="jac",
        ftol=1e-12,
        xtol=1e-9,
        gtol=1e-12,
        max_nfev=max_evaluations,
        callback=evaluator.stop_when_settled,
    )
    simulated, slopes = evaluator.at(found.x)
    residuals = ((simulated - evaluator.measured) / sigma)[evaluator.used]
    jacobian = weighted_jacobian(problem, found.x, slopes, sigma)
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(jacobian))):
        reason = problem.why_it_fails(evaluator.values(found.x))
        raise Failed(f"the simulation fails where the search ended: {reason}")
    status, message = judge(problem.free, found.x, residuals, jacobian, found.message)
    values = evaluator.values(found.x)
    cost = 0.5 * float(residuals @ residuals)
    return Found(values, found.x, simulated, slopes, cost, status, message, evaluator.count)


def start_points(problem: Problem, count: int, seed: int) -> np.ndarray:
    """The given start, then points of a scrambled Sobol sequence over the coordinate bounds."""
    first = np.array([f.start_coordinate() for f in problem.free])
    if count <= 1:
        return first[None]
    from scipy.stats import qmc

    bounds = np.array([f.coordinate_bounds() for f in problem.free])
    sobol = qmc.Sobol(len(problem.free), rng=seed)
    unit = sobol.random(2 ** int(np.ceil(np.log2(count))))[: count - 1]
    return np.concatenate([first[None], bounds[:, 0] + unit * (bounds[:, 1] - bounds[:, 0])])


def estimate_sigma(problem: Problem, simulated) -> np.ndarray:
    """Noise level of each channel from its residuals, with the parameters shared out as degrees of freedom."""
    used, residuals = problem.used, np.where(problem.used, simulated - problem.measured, 0.0)
    counts = used.sum(axis=0)
    freedom = np.maximum(counts * (1.0 - len(problem.free) / used.sum()), 1.0)
    floor = 1e-12 * np.maximum(np.nanmax(np.abs(problem.measured), axis=0), 1e-300)
    return np.maximum(np.sqrt((residuals**2).sum(axis=0) / freedom), floor)
