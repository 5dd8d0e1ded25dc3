"""Quantiles and moments of more numbers than fit in memory, from pieces in any order."""

import dataclasses

import numpy as np

RESOLUTION = 1024
"""Buckets per unit of a sketch: quantiles are right to a thousandth of a typical spread."""

COARSE = 128
"""The same where a sketch is kept for each of many times."""

_KEY_BITS = 32
_KEY_ZERO = 1 << (_KEY_BITS - 1)


class QuantileSketch:
    """How many values of each row (a reduction, or a sensor at one time) fell into each of many fixed buckets.

    Bucket k holds the x with asinh((x - centre)/unit) resolution within k +- 1/2: buckets of unit/resolution near the
    centre that widen in proportion to the distance beyond a unit, so that no value is out of range. Counts are whole
    numbers: sketches of pieces add up to the sketch of the whole exactly, in any order and any division, which
    compacting sketches (KLL, t-digest) do not. A quantile is in the same bucket as the order statistic that it stands
    for.

    Args: centre, unit [those of the values], shape (rows,), and resolution: buckets per unit; the same in all pieces.
    Reference: Masson, Rim and Lee, "DDSketch", 2019 (mergeable sketches of logarithmic buckets).
    """

    def __init__(self, centre, unit, resolution: int = RESOLUTION):
        self.centre, self.unit = np.atleast_1d(np.asarray(centre, float)), np.atleast_1d(np.asarray(unit, float))
        rows, self.resolution = self.centre.size, resolution
        self.codes, self.counts = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.low, self.high = np.full(rows, np.inf), np.full(rows, -np.inf)

    @property
    def total(self) -> np.ndarray:
        """How many values each row has, shape (rows,)."""
        return np.bincount(self.codes >> _KEY_BITS, self.counts, self.centre.size).astype(np.int64)

    def add(self, values: np.ndarray) -> None:
        """Add finite values, shape (lanes, rows)."""
        if not values.size:
            return
        keys = np.rint(np.arcsinh((values - self.centre) / self.unit) * self.resolution).astype(np.int64)
        first = keys.min(axis=0)
        width = int((keys.max(axis=0) - first).max()) + 1
        rows = np.arange(self.centre.size)
        if width * rows.size <= max(1 << 20, 16 * values.size):
            dense = np.bincount((keys - first + rows * width).ravel(), minlength=width * rows.size)
            filled = np.flatnonzero(dense)
            row = filled // width
            codes, counts = (row << _KEY_BITS) + filled % width + first[row] + _KEY_ZERO, dense[filled]
        else:
            codes, counts = np.unique(((rows << _KEY_BITS) + keys + _KEY_ZERO).ravel(), return_counts=True)
        self._gather(codes, counts)
        self.low, self.high = np.minimum(self.low, values.min(axis=0)), np.maximum(self.high, values.max(axis=0))

    def merge(self, other: "QuantileSketch") -> None:
        """Add another sketch with the same centre and unit."""
        if not (np.array_equal(self.centre, other.centre) and np.array_equal(self.unit, other.unit)):
            raise ValueError("sketches can only be merged when they have the same centre and unit")
        self._gather(other.codes, other.counts)
        self.low, self.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)

    def _gather(self, codes: np.ndarray, counts: np.ndarray) -> None:
        every, place = np.unique(np.concatenate([self.codes, codes]), return_inverse=True)
        self.counts = np.bincount(place, np.concatenate([self.counts, counts]), every.size).astype(np.int64)
        self.codes = every

    def quantile(self, probability) -> np.ndarray:
        """Values below which a share of each row lies, shape (rows,); infinite for shares outside 0..1.

        Args: probability, a number or shape (rows,).
        """
        wanted = np.broadcast_to(np.asarray(probability, float), self.centre.shape)
        row = self.codes >> _KEY_BITS
        bounds = np.searchsorted(row, np.arange(self.centre.size + 1))
        found = np.full(self.centre.size, np.nan)
        for r in range(self.centre.size):
            piece = slice(bounds[r], bounds[r + 1])
            if bounds[r + 1] > bounds[r] and not np.isnan(wanted[r]):
                found[r] = self._in_row(r, self.codes[piece] - (r << _KEY_BITS) - _KEY_ZERO, piece, wanted[r])
        return found

    def _in_row(self, r: int, keys: np.ndarray, piece: slice, probability: float) -> float:
        """Within its bucket, a quantile is interpolated as if the values were spread evenly."""
        if not 0.0 <= probability <= 1.0:
            return -np.inf if probability < 0.0 else np.inf
        above = np.cumsum(self.counts[piece])
        rank = probability * above[-1]
        bucket = min(int(np.searchsorted(above, rank)), keys.size - 1)
        inside = (rank - above[bucket] + self.counts[piece][bucket]) / self.counts[piece][bucket]
        x = self.centre[r] + self.unit[r] * np.sinh((keys[bucket] - 0.5 + inside) / self.resolution)
        return float(np.clip(x, self.low[r], self.high[r]))

    def histogram(self, r: int = 0, bins: int = 60) -> tuple[np.ndarray, np.ndarray]:
        """Edges, shape (bins + 1,), and counts, shape (bins,), of a row, from its smallest to its largest value."""
        mine = (self.codes >> _KEY_BITS) == r
        keys = self.codes[mine] - (r << _KEY_BITS) - _KEY_ZERO
        middles = np.clip(self.centre[r] + self.unit[r] * np.sinh(keys / self.resolution), self.low[r], self.high[r])
        low, high = (self.low[r], self.high[r]) if keys.size else (0.0, 1.0)
        counts, edges = np.histogram(middles, bins, (low, high), weights=self.counts[mine])
        return edges, counts.astype(np.int64)

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything that was counted, to be stored."""
        return {"codes": self.codes, "counts": self.counts, "low": self.low, "high": self.high}

    @classmethod
    def from_arrays(cls, centre, unit, arrays, resolution: int = RESOLUTION) -> "QuantileSketch":
        """The sketch of stored arrays."""
        sketch = cls(centre, unit, resolution)
        sketch.codes, sketch.counts = arrays["codes"].astype(np.int64), arrays["counts"].astype(np.int64)
        sketch.low, sketch.high = arrays["low"], arrays["high"]
        return sketch


@dataclasses.dataclass
class Moments:
    """Count, mean and sum of squared deviations of each row, merged without cancellation.

    Reference: Chan, Golub and LeVeque, "Algorithms for computing the sample variance", 1983.
    """

    count: int
    mean: np.ndarray
    squares: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "Moments":
        """Of values, shape (lanes, rows)."""
        if not len(values):
            return cls(0, np.zeros(values.shape[1]), np.zeros(values.shape[1]))
        mean = values.mean(axis=0)
        return cls(len(values), mean, ((values - mean) ** 2).sum(axis=0))

    def merge(self, other: "Moments") -> "Moments":
        """Of both together."""
        count = self.count + other.count
        if not count:
            return self
        apart = other.mean - self.mean
        mean = self.mean + apart * (other.count / count)
        return Moments(count, mean, self.squares + other.squares + apart**2 * (self.count * other.count / count))

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation, shape (rows,); NaN for fewer than two values."""
        return np.sqrt(self.squares / (self.count - 1)) if self.count > 1 else np.full(self.mean.shape, np.nan)
