"""How much recordings differ in what they say, beyond their noise."""

from typing import NamedTuple

import numpy as np

from jaxlines.inference.analysis import unit_of
from jaxlines.inference.curvature import gauss_newton_covariance, noise_variance
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.least_squares import LeastSquaresProblem, Solution
from jaxlines.inference.search import Found
from jaxlines.inference.uncertainty import p_value_text


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


class Between(NamedTuple):
    """Scatter of one parameter between recordings: its standard deviation beyond their noise, in `unit`; p-value that
    there is none; number of recordings that tell of it."""

    sd: float
    p: float
    unit: str
    recordings: int

    def sentence(self, name: str) -> str:
        """In words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        size = f"differs by {self.sd:.2g}{unit} (sd) beyond its noise" if self.p <= 0.05 else "does not differ"
        return f"{name} {size} between {self.recordings} recordings ({p_value_text(self.p)})"


def scatter_of(problem: JointProblem, found: Found) -> dict[str, Between]:
    """The scatter of every parameter that two or more recordings tell of, at the end of a search; SI."""
    if len(problem.trials) < 2:
        return {}
    rows = problem.rows(found.values, found.simulated)
    slopes = problem.row_slopes(found.coordinates, found.simulated, found.slopes)
    end = Solution(found.coordinates, found.cost, found.status, "", rows, slopes, found.coordinates, 0)
    told, steps = between_recordings(problem, end, variance=1.0), problem.steps(found.coordinates)
    counts = np.isfinite(told.estimates).sum(axis=0)
    return {
        label: Between(float(told.between[i] * steps[i]), float(told.p[i]), unit_of(problem, i), int(counts[i]))
        for i, label in enumerate(problem.labels)
        if counts[i] > 1
    }
