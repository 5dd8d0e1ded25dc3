"""How sure a fit is: covariance, intervals, what cannot be told apart, whether residuals are white."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from jaxlines.inference.parameters import Free

NORMAL_95, NORMAL_ONE_SIDED_95 = 1.959963984540054, 1.6448536269514722
UNINFORMED = 1.0 / np.sqrt(12.0)
"""Standard deviation of a uniform distribution in units of its width: what is known from the bounds alone."""

OPEN_SHARE, OPEN_REMAINDER = 0.5, 0.1
"""A number counts as unidentified when more than this share of its variance comes from directions that the data leave
open, and its standard deviation is more than this part of what the bounds alone would give."""

WHITE_LIMIT = 0.01
"""Level of the whiteness test: right models fail it once in a hundred."""


FEWEST_TESTED = 30
"""Samples from which residuals can be called white: with fewer the test finds even neighbours correlated by 0.6 in
less than half of all cases."""


class Estimate(NamedTuple):
    """A number with its uncertainty.

    kind: "interval" (sd and 95 % interval), "upper_limit" (not detected: ci95 = (0, one-sided 95 % limit)), or
    "unidentified" (the data leave it open: no sd, no interval); note: conditions, in words.
    """

    value: float
    sd: float | None
    ci95: tuple[float, float] | None
    unit: str
    kind: str
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Covariance:
    """Joint covariance of free and known parameters in analysis coordinates, and what the data leave open.

    Fields: joint, shape (free + known, free + known); free_part: its upper left block from the data alone;
    open_share: for each free parameter the share of its variance that comes from directions the data leave
    open; open_directions: those directions in coordinates, shape (directions, free); singular_values of the
    Jacobian scaled by the widths of the bounds, largest first; gain: minus d estimates / d rows, shape (free, rows).
    """

    joint: np.ndarray
    free_part: np.ndarray
    open_share: np.ndarray
    open_directions: np.ndarray
    singular_values: np.ndarray
    gain: np.ndarray

    def under(self, spread: np.ndarray) -> "Covariance":
        """The same where rows are not white: spread, the covariance of gain @ rows, shape (free, free)."""
        change, count = spread - self.gain @ self.gain.T, spread.shape[0]
        joint = self.joint.copy()
        joint[:count, :count] += change
        return dataclasses.replace(self, joint=joint, free_part=self.free_part + change)


def covariance(jacobian, known_jacobian, widths, known_sd) -> Covariance:
    """Covariance at the optimum from the weighted Jacobian, in the coordinates of its columns.

    Args: jacobian, shape (samples, free), of residuals divided by their noise; known_jacobian, shape (samples,
    known); widths of the bounds in the same coordinates; known_sd: standard uncertainties of the known numbers.

    Directions in which a standard error would exceed what the bounds alone say (width/sqrt(12)) are left open:
    they get that variance and are reported. Known numbers enter through d free / d known = -J^+ J_known.
    """
    scaled = jacobian * widths
    left, singular, right = np.linalg.svd(scaled, full_matrices=False)
    known = singular > 1.0 / UNINFORMED
    variances = np.where(known, 1.0 / np.where(known, singular, 1.0) ** 2, UNINFORMED**2)
    directions = right * widths
    parts = directions**2 * variances[:, None]
    free_part = (directions.T * variances) @ directions
    open_share = parts[~known].sum(axis=0) / parts.sum(axis=0)
    told = (directions[known].T / singular[known]) @ left[:, known].T
    gain = -told @ known_jacobian
    spread = np.diag(np.asarray(known_sd, dtype=float) ** 2)
    joint = np.block([[free_part + gain @ spread @ gain.T, gain @ spread], [spread @ gain.T, spread]])
    return Covariance(joint, free_part, open_share, directions[~known], singular, told)


def is_open(open_share, sd, bounds_sd) -> bool:
    """Whether the data leave a number open; bounds_sd: its standard deviation from the bounds alone."""
    return bool(open_share > OPEN_SHARE and sd > OPEN_REMAINDER * bounds_sd)


def student_factor(freedom, probability: float = 0.975) -> np.ndarray:
    """Quantile of Student's t; that of the normal distribution where the degrees of freedom are infinite."""
    from scipy.special import ndtri, stdtrit

    freedom = np.asarray(freedom, dtype=float)
    finite = np.isfinite(freedom)
    return np.where(finite, stdtrit(np.where(finite, freedom, 1.0), probability), ndtri(probability))


def make_estimate(parameter: Free, value: float, sd: float, unit: str, kind: str, freedom: float = np.inf) -> Estimate:
    """The estimate of a free parameter.

    sd: standard deviation of its coordinate, or of its value when the kind is "upper_limit"; freedom: its degrees of
    freedom, for Student's t.
    """
    if kind == "upper_limit":
        limit = value + float(student_factor(freedom, 0.95)) * sd
        return Estimate(value, sd, (0.0, limit), unit, kind, "not detected: 95 % upper limit")
    if kind == "unidentified":
        return Estimate(value, None, None, unit, kind, "the recording leaves it open within its bounds")
    coordinate = parameter.to_coordinate(value)
    reach = float(student_factor(freedom)) * sd
    low, high = (float(parameter.to_value(coordinate + sign * reach)) for sign in (-1, 1))
    low, high = max(low, parameter.bounds[0]), min(high, parameter.bounds[1])  # nothing outside was held possible
    return Estimate(value, float(parameter.slope(value)) * sd, (low, high), unit, kind)


def p_value_text(p: float) -> str:
    """A p-value as it is read: "p = 0.098", "p < 1e-99"."""
    if math.isnan(p):
        return "not tested: too few samples"
    return f"p = {p:.2g}" if p > 1e-99 else "p < 1e-99"


def whiteness_text(p: float) -> str:
    """The verdict of a whiteness test: "white (p = 0.31)", "NOT white (p = 0.0001)", "white or not: too few ..."."""
    if math.isnan(p):
        return "too few to tell whether white"
    return f"{'white' if p > WHITE_LIMIT else 'NOT white'} ({p_value_text(p)})"


def ljung_box(residuals, used, lags: int = 20) -> float:
    """p-value of the Ljung-Box test that equally spaced residuals are uncorrelated up to `lags`.

    Q = n (n + 2) sum_k r_k^2/(n - k), chi-squared with `lags` degrees of freedom; pairs with a missing sample are
    left out; NaN for fewer than five samples.
    Reference: Ljung and Box, "On a measure of lack of fit in time series models", Biometrika 65, 1978.
    """
    from scipy.special import chdtrc  # the tail of chi-squared; scipy.stats takes half a second to import

    count = int(used.sum())
    lags = min(lags, count // 5)
    if lags < 1:
        return float("nan")
    centred = np.where(used, residuals - residuals[used].mean(), 0.0)
    variance = (centred**2).sum() / count
    if variance <= 0.0:
        return 1.0
    statistic = 0.0
    for lag in range(1, lags + 1):
        pairs = int((used[lag:] & used[:-lag]).sum())
        if pairs:
            correlation = (centred[lag:] * centred[:-lag]).sum() / pairs / variance
            statistic += pairs * (count + 2.0) / count * correlation**2
    return float(chdtrc(lags, statistic))


def whiteness_p(residuals, used) -> float:
    """p-value that equally spaced residuals are white: Ljung and Box over 2 and over 20 lags, twice the smaller.

    Few lags find neighbours alike, which 20 lags of a short series miss one time in 25 at a correlation of 0.6 and 121
    samples; many find echoes. NaN where nothing was found in fewer samples than `FEWEST_TESTED`: that says nothing.
    """
    p = min(1.0, 2.0 * min(ljung_box(residuals, used, 2), ljung_box(residuals, used, 20)))
    return float("nan") if used.sum() < FEWEST_TESTED and not p <= WHITE_LIMIT else p


def describe_open_directions(labels, found: Covariance, widths) -> tuple[str, ...]:
    """What the recording cannot tell apart, in words; `widths` of the bounds make coordinates comparable."""
    sentences = []
    for direction in found.open_directions / widths:
        size = np.abs(direction) / np.abs(direction).max()
        names = [labels[i] for i in np.argsort(-size) if size[i] > 0.1]
        if len(names) == 1:
            sentences.append(f"the recording says nothing about {names[0]} within its bounds")
        else:
            sentences.append(f"the recording fixes {', '.join(names[:-1])} and {names[-1]} only together")
    return tuple(sentences)


def describe_correlations(labels, correlations, limit: float = 0.95) -> tuple[str, ...]:
    """Pairs that trade off strongly, in words."""
    return tuple(
        f"{labels[i]} and {labels[j]} trade off (correlation {correlations[i, j]:+.3f}): "
        "each interval holds only because both were free together"
        for i in range(len(labels))
        for j in range(i)
        if abs(correlations[i, j]) > limit
    )
