"""Noise that is not white: autoregressive models of residuals, and the weighting that makes them white."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxlines.inference.least_squares import AbstractRewritten, LeastSquaresProblem, Solution, solve
from jaxlines.inference.uncertainty import ljung_box


class Autoregression(NamedTuple):
    """Noise n_t = sum_k a_k n_{t-k} + e_t: coefficients a, standard deviation of e; order 0 is white noise."""

    coefficients: np.ndarray
    sd: float

    @property
    def order(self) -> int:
        """Number of coefficients."""
        return self.coefficients.size


def series_of(problem: LeastSquaresProblem) -> list[np.ndarray]:
    """The rows of each recording and channel in order of time, cut where samples are missing; priors left out."""
    recording, channel, time = problem.recording, problem.channel, problem.time
    found = []
    for pair in sorted(set(zip(recording[recording >= 0], channel[recording >= 0], strict=True))):
        rows = np.flatnonzero((recording == pair[0]) & (channel == pair[1]))
        rows = rows[np.argsort(time[rows], kind="stable")]
        found += np.split(rows, np.flatnonzero(np.diff(time[rows]) != 1) + 1)
    return found


def whiteness(problem: LeastSquaresProblem, residuals, lags: int = 20) -> float:
    """p-value that all series of residuals are white: the smallest of Ljung and Box, times their number."""
    recording, channel, time = problem.recording, problem.channel, problem.time
    values = []
    for pair in set(zip(recording[recording >= 0], channel[recording >= 0], strict=True)):
        rows = np.flatnonzero((recording == pair[0]) & (channel == pair[1]))
        grid, used = np.zeros(time[rows].max() + 1), np.zeros(time[rows].max() + 1, dtype=bool)
        grid[time[rows]], used[time[rows]] = residuals[rows], True
        values.append(ljung_box(grid, used, lags))
    return min(1.0, min(values) * len(values)) if values else 1.0


def fit_autoregression(pieces: Sequence[np.ndarray], max_order: int = 12, freedom_lost: int = 0) -> Autoregression:
    """An autoregressive model of one noise seen in several pieces, its order by BIC, coefficients by least squares.

    Args: pieces: equally spaced values, each without gaps; freedom_lost: parameters of the model whose residuals they
    are. A model that would grow without end gives way to Yule and Walker's.
    Reference: Brockwell and Davis, "Time Series: Theory and Methods", 1991, chapters 8 and 9.
    """
    max_order = max(0, min(max_order, max((piece.size for piece in pieces), default=0) // 4))
    used = [piece for piece in pieces if piece.size > max_order]
    target = np.concatenate([piece[max_order:] for piece in used])
    lagged = np.stack(
        [np.concatenate([p[max_order - k : p.size - k] for p in used]) for k in range(1, max_order + 1)], axis=1
    ) if max_order else np.zeros((target.size, 0))  # fmt: skip
    best, best_bic = Autoregression(np.zeros(0), 1.0), np.inf
    for order in range(max_order + 1):
        coefficients = np.linalg.lstsq(lagged[:, :order], target, rcond=None)[0] if order else np.zeros(0)
        if not _stationary(coefficients):
            coefficients = _yule_walker(pieces, order)
        error = target - lagged[:, :order] @ coefficients
        variance = max(float(error @ error), 1e-300) / target.size
        bic = target.size * np.log(variance) + order * np.log(target.size)
        if bic < best_bic:
            sd = np.sqrt(variance * target.size / max(target.size - order - freedom_lost, 1))
            best, best_bic = Autoregression(coefficients, float(sd)), bic
    return best


def _companion(coefficients) -> np.ndarray:
    """The matrix that moves (n_t, n_t-1, ...) one sample on."""
    return np.vstack([coefficients, np.eye(coefficients.size)[:-1]])


def _stationary(coefficients) -> bool:
    """Whether noise with these coefficients stays finite."""
    return not coefficients.size or bool(np.max(np.abs(np.linalg.eigvals(_companion(coefficients)))) < 0.9999)


def _yule_walker(pieces, order: int) -> np.ndarray:
    """Coefficients from autocovariances, always stationary."""
    from scipy.linalg import solve_toeplitz

    total = sum(piece.size for piece in pieces)
    covariances = [sum(float(p[k:] @ p[: p.size - k]) for p in pieces if p.size > k) / total for k in range(order + 1)]
    return solve_toeplitz(np.array(covariances[:-1]) * (1 + 1e-9 * (np.arange(order) == 0)), np.array(covariances[1:]))


def whiten(rows: np.ndarray, model: Autoregression) -> np.ndarray:
    """Uncorrelated rows of variance 1 from consecutive rows of a noise; rows: shape (times,) or (times, columns).

    e_t = (n_t - sum a_k n_{t-k})/sd; the first ones through the Cholesky factor of their stationary covariance, so that
    no row is lost (Harvey, "Forecasting, Structural Time Series Models and the Kalman Filter", 1989, section 3.5).
    """
    from scipy.linalg import solve_discrete_lyapunov, solve_triangular

    order, a = model.order, model.coefficients
    white = np.array(rows, dtype=float)
    for k in range(order):
        white[order:] -= a[k] * rows[order - 1 - k : rows.shape[0] - 1 - k]
    first = min(order, rows.shape[0])
    if first:
        drive = np.zeros((order, order))
        drive[0, 0] = 1.0
        covariance = solve_discrete_lyapunov(_companion(a), drive)
        white[:first] = solve_triangular(np.linalg.cholesky(covariance[:first, :first]), rows[:first], lower=True)
    return white / model.sd


@dataclasses.dataclass(frozen=True)
class Whitened(AbstractRewritten):
    """A problem whose rows are made uncorrelated by a noise model a channel: generalised least squares.

    Fields: plain: the problem; models: one `Autoregression` a channel.
    """

    models: tuple[Autoregression, ...]

    @functools.cached_property
    def _pieces(self) -> list[np.ndarray]:
        return series_of(self.plain)

    def _whitened(self, rows) -> np.ndarray:
        white = np.array(rows, dtype=float)
        for piece in self._pieces:
            white[piece] = whiten(rows[piece], self.models[self.plain.channel[piece[0]]])
        return white

    def residuals(self, x) -> np.ndarray:
        """Whitened rows of variance 1."""
        return self._whitened(self.plain.residuals(x))

    def jacobian(self, x) -> np.ndarray:
        """Their slopes."""
        return self._whitened(self.plain.jacobian(x))


def channel_noise(problem: LeastSquaresProblem, residuals, max_order: int = 12) -> tuple[Autoregression, ...]:
    """One autoregressive model a channel, from the residuals of all its recordings."""
    pieces = series_of(problem)
    models = []
    for channel in range(int(problem.channel.max(initial=0)) + 1):
        own = [residuals[rows] for rows in pieces if problem.channel[rows[0]] == channel]
        share = sum(p.size for p in own) / max(sum(rows.size for rows in pieces), 1)
        models.append(fit_autoregression(own, max_order, round(share * len(problem.labels))) if own else None)
    return tuple(m or Autoregression(np.zeros(0), 1.0) for m in models)


def solve_with_autoregression(
    problem: LeastSquaresProblem, solution: Solution, *, max_order: int = 12, rounds: int = 3, tolerance: float = 1e-9
) -> tuple[Whitened, Solution]:
    """Fit again with autoregressive noise: noise models from residuals, whitened fit, a few rounds.

    Returns: the whitened problem, its noise of variance 1, and its solution, whose (J'J)^-1 is the covariance.
    Reference: feasible generalised least squares; Seber and Wild, "Nonlinear Regression", 1989, chapter 6.
    """
    residuals, end = solution.residuals, solution
    whitened = Whitened(problem, channel_noise(problem, residuals, max_order))
    for _ in range(rounds):
        whitened = Whitened(problem, channel_noise(problem, residuals, max_order))
        before, end = end.x, solve(whitened, end.x, tolerance=tolerance)
        residuals = problem.residuals(end.x)
        if np.allclose(end.x, before, rtol=1e-7, atol=0.0):
            break
    return whitened, end
