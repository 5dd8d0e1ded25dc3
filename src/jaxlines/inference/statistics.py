"""What a sweep says of its outputs: moments, quantiles, exceedance, worst cases; failed lanes bound all of them."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxlines.inference.sketch import Moments, QuantileSketch

NORMAL_95 = 1.959963984540054
QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
WORST = 10


class Quantile(NamedTuple):
    """A quantile of the lanes that succeeded, with what is not known about it.

    ci95: interval for the number of lanes alone (order statistics, independent lanes); bounds: where it lies whatever
    the failed lanes would have given (-inf, inf where they leave it open).
    """

    probability: float
    value: float
    ci95: tuple[float, float]
    bounds: tuple[float, float]


class Exceedance(NamedTuple):
    """The probability of more than a threshold.

    value: share of the lanes that succeeded; wilson, exact: 95 % intervals for it (Wilson, 1927; Clopper and Pearson,
    1934) from the number of lanes; bounds: the share of all lanes if no, or every, failed lane exceeded it.
    """

    threshold: float
    value: float
    wilson: tuple[float, float]
    exact: tuple[float, float]
    bounds: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Summary:
    """One reduction over all lanes.

    Fields: name; unit; count of lanes that succeeded, failed lanes; mean, sd, standard_error of the mean (independent
    lanes), minimum, maximum, of those that succeeded; quantiles; exceedances; histogram: edges, counts; worst: index,
    value of the largest and of the smallest lanes, most extreme first.
    """

    name: str
    unit: str
    count: int
    failed: int
    mean: float
    sd: float
    standard_error: float
    minimum: float
    maximum: float
    quantiles: tuple[Quantile, ...]
    exceedances: tuple[Exceedance, ...]
    histogram: tuple[np.ndarray, np.ndarray]
    largest: tuple[tuple[int, float], ...]
    smallest: tuple[tuple[int, float], ...]

    def quantile(self, probability: float) -> Quantile:
        """One of the quantiles. Raises KeyError when it was not asked for."""
        for found in self.quantiles:
            if np.isclose(found.probability, probability):
                return found
        raise KeyError(f"{self.name}: no quantile {probability:g}; there are {[q.probability for q in self.quantiles]}")


def failure_bounds(probability: float, good: int, failed: int) -> tuple[float, float]:
    """Probabilities among the good lanes between which a quantile of all lanes lies.

    Rank q n of n = good + failed lanes: if all failed lanes were lowest it is rank q n - failed of the good ones, if
    all were highest rank q n. Where these are no ranks of good lanes, the quantile could be any failed value: the
    probability is then -1 or 2.
    """
    rank = probability * (good + failed)
    low, high = (rank - failed) / good, rank / good
    return (low if low > 0 or not failed else -1.0), (high if high < 1 or not failed else 2.0)


def exceedance(threshold: float, above: int, good: int, failed: int) -> Exceedance:
    """The probability of more than a threshold, from counts: `above` of `good` lanes, and `failed` others."""
    from scipy.stats import binomtest

    if not good:
        return Exceedance(threshold, np.nan, (0.0, 1.0), (0.0, 1.0), (0.0, 1.0))
    test, every = binomtest(above, good), good + failed
    wilson, exact = (test.proportion_ci(0.95, method) for method in ("wilson", "exact"))
    intervals = (float(wilson.low), float(wilson.high)), (float(exact.low), float(exact.high))
    return Exceedance(threshold, above / good, *intervals, (above / every, (above + failed) / every))


class Accumulator:
    """The statistics of one reduction, from pieces of the table in the order of its rows.

    Args: name, unit; centre, scale: of its sketch; thresholds for exceedance, probabilities of quantiles.
    """

    def __init__(self, name: str, unit: str, centre: float, scale: float, thresholds=(), probabilities=QUANTILES):
        self.name, self.unit, self.thresholds, self.probabilities = name, unit, tuple(thresholds), tuple(probabilities)
        self.sketch, self.moments = QuantileSketch(centre, scale), Moments(0, np.zeros(1), np.zeros(1))
        self.above = np.zeros(len(self.thresholds), dtype=np.int64)
        self.failed = 0
        self.largest: list[tuple[int, float]] = []
        self.smallest: list[tuple[int, float]] = []

    def add(self, index: np.ndarray, values: np.ndarray, good: np.ndarray) -> None:
        """Add lanes: their indices, values and whether they succeeded, each shape (lanes,)."""
        kept, at = values[good], index[good]
        self.failed += int(values.size - kept.size)
        self.sketch.add(kept[:, None])
        self.moments = self.moments.merge(Moments.of(kept[:, None]))
        self.above += np.asarray([(kept > threshold).sum() for threshold in self.thresholds], dtype=np.int64)
        self.largest = _extreme(self.largest, at, kept, -1.0)
        self.smallest = _extreme(self.smallest, at, kept, 1.0)

    def summary(self) -> Summary:
        """What was found."""
        good, sd = self.moments.count, float(self.moments.sd[0])
        return Summary(
            name=self.name,
            unit=self.unit,
            count=good,
            failed=self.failed,
            mean=float(self.moments.mean[0]) if good else np.nan,
            sd=sd,
            standard_error=sd / np.sqrt(good) if good else np.nan,
            minimum=float(self.sketch.low[0]) if good else np.nan,
            maximum=float(self.sketch.high[0]) if good else np.nan,
            quantiles=tuple(self._quantile(q) for q in self.probabilities),
            exceedances=tuple(
                exceedance(t, int(above), good, self.failed)
                for t, above in zip(self.thresholds, self.above, strict=True)
            ),
            histogram=self.sketch.histogram(),
            largest=tuple(self.largest),
            smallest=tuple(self.smallest),
        )

    def _quantile(self, q: float) -> Quantile:
        good = self.moments.count
        if not good:
            return Quantile(q, np.nan, (-np.inf, np.inf), (-np.inf, np.inf))
        half = NORMAL_95 * np.sqrt(q * (1 - q) / good)
        interval = [float(self.sketch.quantile(p)[0]) for p in (q - half, q + half)]
        bounds = [float(self.sketch.quantile(p)[0]) for p in failure_bounds(q, good, self.failed)]
        return Quantile(q, float(self.sketch.quantile(q)[0]), (interval[0], interval[1]), (bounds[0], bounds[1]))


def _limit(values: np.ndarray) -> float:
    """The WORST-th smallest value, or infinity when there are not so many."""
    return np.partition(values, WORST - 1)[WORST - 1] if values.size > WORST else np.inf


def _extreme(known: list, index: np.ndarray, values: np.ndarray, sign: float) -> list:
    """The WORST smallest of sign * value, of those known and new ones; equal ones in the order of their indices."""
    ordered = sign * values
    limit = _limit(ordered)
    few = [*np.flatnonzero(ordered < limit), *np.flatnonzero(ordered == limit)[:WORST]]
    found = [*known, *((int(index[i]), float(values[i])) for i in few)]
    return sorted(found, key=lambda item: (sign * item[1], item[0]))[:WORST]


@dataclasses.dataclass(frozen=True)
class Band:
    """A sensor over time, over all lanes.

    Fields: name; unit; times [s], shape (times,); mean, sd, shape (times,); quantiles: probability -> shape (times,);
    low, high: smallest and largest value; bounds: probability -> (low, high) with the failed lanes anywhere.
    """

    name: str
    unit: str
    times: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray
    quantiles: dict[float, np.ndarray]
    bounds: dict[float, tuple[np.ndarray, np.ndarray]]


def band(name: str, unit: str, times, sketch: QuantileSketch, moments: Moments, failed: int, probabilities) -> Band:
    """The band of a sensor from its sketch over (times) and its moments."""
    good = moments.count
    quantiles = {q: sketch.quantile(q) for q in probabilities}
    bounds = {}
    for q in probabilities:
        low, high = failure_bounds(q, good, failed) if good else (-1.0, 2.0)
        bounds[q] = (sketch.quantile(low), sketch.quantile(high))
    return Band(name, unit, np.asarray(times), moments.mean, moments.sd, sketch.low, sketch.high, quantiles, bounds)
