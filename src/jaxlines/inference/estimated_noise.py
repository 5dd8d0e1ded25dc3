"""Noise levels that are estimated beside the parameters, by maximum likelihood."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlines.inference.least_squares import AbstractRewritten, LeastSquaresProblem, Solution, solve


@dataclasses.dataclass(frozen=True)
class EstimatedNoise:
    """A problem whose noise levels are parameters beside the others, by maximum likelihood.

    With s_c the noise of channel c and n_c its rows the cost is sum r^2/(2 s_c^2) + n_c ln s_c, up to a constant: half
    the sum of squares of r/s_c and of one more row a channel, sqrt(n_c (1 + 2 ln s_c - 2 ln s_ref)), which makes J'J
    equal the second derivative by ln s_c where s_ref^2 is the mean square of r. The coordinates of the levels are their
    logarithms, bounded below by s_ref exp(-0.45), where this row ends.

    Fields: plain: the problem with unit weights (or weights that the levels multiply); channels: their names, in the
    order of `plain.channel`; reference: s_ref, one a channel, in the unit of the residuals; bounds of the levels.
    """

    plain: LeastSquaresProblem
    channels: tuple[str, ...]
    reference: np.ndarray
    bounds: tuple[float, float]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters, then of the noise levels."""
        return (*self.plain.labels, *(f"noise of {name}" for name in self.channels))

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates."""
        levels = np.maximum(np.log(self.reference) - 0.45, np.log(self.bounds[0]))
        return np.concatenate([self.plain.lower, levels])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates."""
        return np.concatenate([self.plain.upper, np.full(len(self.channels), np.log(self.bounds[1]))])

    def _with_levels(self, group, value) -> np.ndarray:
        return np.concatenate([group, np.full(len(self.channels), value)])

    @property
    def recording(self) -> np.ndarray:
        """Recording of a row, -1 in the rows of the levels."""
        return self._with_levels(self.plain.recording, -1)

    @property
    def channel(self) -> np.ndarray:
        """Channel of a row, -1 in the rows of the levels."""
        return self._with_levels(self.plain.channel, -1)

    @property
    def time(self) -> np.ndarray:
        """Sample of a row, -1 in the rows of the levels."""
        return self._with_levels(self.plain.time, -1)

    def _counts(self) -> np.ndarray:
        """Rows a channel."""
        return np.bincount(self.plain.channel[self.plain.recording >= 0], minlength=len(self.channels))

    def _weights(self, x) -> np.ndarray:
        """1/s of every row, 1 for priors."""
        weights = np.exp(-np.asarray(x, dtype=float)[len(self.plain.labels) :])
        return np.where(self.plain.recording >= 0, weights[self.plain.channel], 1.0)

    def _level_rows(self, x) -> np.ndarray:
        logs = np.asarray(x, dtype=float)[len(self.plain.labels) :]
        return np.sqrt(self._counts() * (1.0 + 2.0 * (logs - np.log(self.reference))))

    def residuals(self, x) -> np.ndarray:
        """Weighted residuals, then the rows of the levels."""
        rows = self.plain.residuals(np.asarray(x)[: len(self.plain.labels)])
        return np.concatenate([rows * self._weights(x), self._level_rows(x)])

    def jacobian(self, x) -> np.ndarray:
        """Slopes of all rows by parameters and logarithms of levels."""
        count, levels = len(self.plain.labels), len(self.channels)
        weights, x = self._weights(x), np.asarray(x, dtype=float)
        rows, slopes = self.plain.residuals(x[:count]), self.plain.jacobian(x[:count])
        found = np.zeros((rows.size + levels, count + levels))
        found[: rows.size, :count] = slopes * weights[:, None]
        data = np.flatnonzero(self.plain.recording >= 0)
        found[data, count + self.plain.channel[data]] = -(rows * weights)[data]
        found[rows.size + np.arange(levels), count + np.arange(levels)] = self._counts() / self._level_rows(x)
        return found

    def log_likelihood(self, x) -> float:
        """ln of the normal density of the data at parameters and levels, priors left out."""
        x, data = np.asarray(x, dtype=float), self.plain.recording >= 0
        rows = (self.plain.residuals(x[: len(self.plain.labels)]) * self._weights(x))[data]
        logs = float(self._counts() @ x[len(self.plain.labels) :])
        return -0.5 * float(rows @ rows) - logs - 0.5 * rows.size * np.log(2.0 * np.pi)


@dataclasses.dataclass(frozen=True)
class Weighted(AbstractRewritten):
    """A problem whose rows are divided by the noise of their channel; priors are left as they are."""

    levels: np.ndarray

    def _weights(self) -> np.ndarray:
        return np.where(self.recording >= 0, 1.0 / self.levels[self.channel], 1.0)

    def residuals(self, x) -> np.ndarray:
        """Rows over their noise."""
        return self.plain.residuals(x) * self._weights()

    def jacobian(self, x) -> np.ndarray:
        """Their slopes."""
        return self.plain.jacobian(x) * self._weights()[:, None]


def channel_levels(problem: LeastSquaresProblem, residuals, bounds: tuple[float, float]) -> np.ndarray:
    """Root mean square of the residuals of each channel, kept within bounds: the most likely noise levels."""
    data = problem.recording >= 0
    counts = np.maximum(np.bincount(problem.channel[data]), 1)
    squares = np.bincount(problem.channel[data], residuals[data] ** 2)
    return np.clip(np.sqrt(squares / counts), *bounds)


def solve_estimating_noise(
    problem: LeastSquaresProblem,
    channels: Sequence[str],
    start,
    *,
    bounds: tuple[float, float] = (1e-12, 1e12),
    rounds: int = 50,
    max_evaluations: int = 100,
    tolerance: float = 1e-12,
) -> tuple[EstimatedNoise, Solution]:
    """Fit parameters and one noise level a channel by maximum likelihood, from a start of the parameters.

    Parameters at given levels and levels at given parameters take turns, each raising the likelihood, then all are
    fitted together. Unlike sum n_c ln s_c, the turns need no bound of the levels far from the optimum.

    Args: problem: with unit weights; channels: names, in the order of `problem.channel`; start of the parameters;
    bounds of the levels; rounds at most; max_evaluations, tolerance: as in `solve`.
    Returns: the problem in parameters and levels, at reference levels from here, and its solution.
    Raises: ValueError for levels that are not positive.
    """
    if not 0.0 < bounds[0] < bounds[1]:
        raise ValueError(f"bounds of noise levels must be positive and increasing, got {bounds[0]:g}..{bounds[1]:g}")
    x, rows = np.asarray(start, dtype=float), problem.residuals(start)
    levels = channel_levels(problem, np.where(np.isfinite(rows), rows, 1.0), bounds)
    for _ in range(rounds):
        end = solve(Weighted(problem, levels), x, max_evaluations=max_evaluations, tolerance=tolerance)
        if end.status == "failed":
            break
        x, before = end.x, levels
        levels = channel_levels(problem, problem.residuals(x), bounds)
        if np.all(np.abs(np.log(levels / before)) < 1e-5):
            break
    whole = EstimatedNoise(problem, tuple(channels), levels, bounds)
    first = np.concatenate([x, np.log(levels)])
    return whole, solve(whole, first, max_evaluations=max_evaluations, tolerance=tolerance)
