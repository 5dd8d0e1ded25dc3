"""Noise that is not white: series of residuals, their autoregressive models, and the weighting that whitens them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxlines.inference.least_squares import LeastSquaresProblem
from jaxlines.inference.uncertainty import whiteness_p


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


def whiteness(problem: LeastSquaresProblem, residuals) -> float:
    """p-value that all series of residuals are white: the smallest of `whiteness_p`, times their number.

    NaN when every series has too few samples to tell.
    """
    recording, channel, time = problem.recording, problem.channel, problem.time
    values = []
    for pair in set(zip(recording[recording >= 0], channel[recording >= 0], strict=True)):
        rows = np.flatnonzero((recording == pair[0]) & (channel == pair[1]))
        grid, used = np.zeros(time[rows].max() + 1), np.zeros(time[rows].max() + 1, dtype=bool)
        grid[time[rows]], used[time[rows]] = residuals[rows], True
        values.append(whiteness_p(grid, used))
    told = [p for p in values if not np.isnan(p)]
    return min(1.0, min(told) * len(told)) if told else float("nan")


def fit_autoregression(pieces: Sequence[np.ndarray], max_order: int = 12, freedom_lost: int = 0) -> Autoregression:
    """An autoregressive model of one noise seen in several pieces, its order by BIC, coefficients by least squares.

    Args: pieces: equally spaced values, each without gaps; freedom_lost: parameters of the model whose residuals they
    are. A model that would grow without end gives way to Yule and Walker's.
    Reference: Brockwell and Davis, "Time Series: Theory and Methods", 1991, chapters 8 and 9.
    """
    max_order = max(0, min(max_order, max((piece.size for piece in pieces), default=0) // 4))
    used = [piece for piece in pieces if piece.size > max_order]
    count, products = sum(piece.size - max_order for piece in used), np.zeros((max_order + 1, max_order + 1))
    for p in used:  # of each sample with those before it
        lagged = np.stack([p[max_order - k : p.size - k] for k in range(max_order + 1)])
        products += lagged @ lagged.T
    best, best_bic = Autoregression(np.zeros(0), 1.0), np.inf
    for order in range(max_order + 1):
        inner, across = products[1 : order + 1, 1 : order + 1], products[1 : order + 1, 0]
        coefficients = np.linalg.lstsq(inner, across, rcond=None)[0] if order else np.zeros(0)
        if not _stationary(coefficients):
            coefficients = _yule_walker(pieces, order)
        squares = float(products[0, 0] - 2.0 * coefficients @ across + coefficients @ inner @ coefficients)
        variance = max(squares, 1e-300) / count
        bic = count * np.log(variance) + order * np.log(count)
        if bic < best_bic:
            sd = np.sqrt(variance * count / max(count - order - freedom_lost, 1))
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
    from scipy.linalg import solve_triangular

    order, a = model.order, model.coefficients
    white = np.array(rows, dtype=float)
    for k in range(order):
        white[order:] -= a[k] * rows[order - 1 - k : rows.shape[0] - 1 - k]
    first = min(order, rows.shape[0])
    if first:
        white[:first] = solve_triangular(_first_root(model, first), rows[:first], lower=True)
    return white / model.sd


def _first_root(model: Autoregression, count: int) -> np.ndarray:
    """The Cholesky factor of the stationary covariance of the first samples, for errors of variance 1."""
    from scipy.linalg import solve_discrete_lyapunov

    drive = np.zeros((model.order, model.order))
    drive[0, 0] = 1.0
    covariance = solve_discrete_lyapunov(_companion(model.coefficients), drive)
    return np.linalg.cholesky(covariance[:count, :count])


def carry(columns: np.ndarray, model: Autoregression) -> np.ndarray:
    """W^-T g of columns g, W what `whiten` does, so that the inner products of two are g'V h, V the noise's covariance.

    With the rows of a gain as columns this is the covariance of what the gain makes of the noise. columns: shape
    (times, columns), consecutive samples.
    """
    from scipy.signal import lfilter

    order, a, times = model.order, model.coefficients, columns.shape[0]
    first = min(order, times)
    found = np.array(columns, dtype=float)
    if times > first:  # W is banded: back substitution is a filter that runs backwards
        found[first:] = np.asarray(lfilter([1.0], [1.0, *(-a)], columns[: first - 1 if first else None : -1], axis=0))[
            ::-1
        ]
    for t in range(first):
        for k in range(max(order - t, 1), min(order, times - 1 - t) + 1):
            found[t] += a[k - 1] * found[t + k]
    if first:
        found[:first] = _first_root(model, first).T @ found[:first]
    return found * model.sd
