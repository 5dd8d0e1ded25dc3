"""Statistics of pieces against those of the whole, and what failed lanes leave open."""

import numpy as np
import pytest

from jaxlines.inference.sketch import COARSE, Moments, QuantileSketch
from jaxlines.inference.statistics import Accumulator, exceedance, failure_bounds

RANDOM = np.random.default_rng(2)
VALUES = np.concatenate([3e6 * RANDOM.lognormal(size=50_000), RANDOM.normal(-2e6, 1e5, 5_000), [1e30, -1e25, 0.0]])
PROBABILITIES = (0.001, 0.05, 0.5, 0.9, 0.999)


def sketch_of(values, pieces=1):
    sketch = QuantileSketch(4e6, 3e6)
    for piece in np.array_split(values, pieces):
        part = QuantileSketch(4e6, 3e6)
        part.add(piece[:, None])
        sketch.merge(part)
    return sketch


def test_quantiles_are_right_to_a_bucket():
    sketch = sketch_of(VALUES)
    for q in PROBABILITIES:
        exact = np.quantile(VALUES, q, method="inverted_cdf")
        assert sketch.quantile(q)[0] == pytest.approx(exact, abs=1e-3 * np.hypot(3e6, exact - 4e6))
    assert sketch.quantile(0.0)[0] == VALUES.min()
    assert sketch.quantile(1.0)[0] == VALUES.max()
    assert sketch.total[0] == VALUES.size


def test_merging_is_exact_in_any_order_and_division():
    whole, parts = sketch_of(VALUES), sketch_of(RANDOM.permutation(VALUES), pieces=23)
    assert np.array_equal(whole.codes, parts.codes)
    assert np.array_equal(whole.counts, parts.counts)
    with pytest.raises(ValueError, match="same centre"):
        whole.merge(QuantileSketch(0.0, 1.0))


def test_a_sketch_of_many_times_is_one_of_each():
    series = VALUES[:20_000].reshape(-1, 4)
    both = QuantileSketch(np.full(4, 4e6), np.full(4, 3e6), COARSE)
    both.add(series)
    for r in range(4):
        alone = QuantileSketch(4e6, 3e6, COARSE)
        alone.add(series[:, r : r + 1])
        assert both.quantile(0.3)[r] == alone.quantile(0.3)[0]
        assert np.array_equal(both.histogram(r)[1], alone.histogram()[1])
    stored = QuantileSketch.from_arrays(both.centre, both.unit, both.arrays(), COARSE)
    assert np.array_equal(stored.quantile(0.9), both.quantile(0.9))


def test_histogram_counts_every_value():
    inner = VALUES[:50_000]
    edges, counts = sketch_of(inner).histogram(bins=20)
    assert counts.sum() == inner.size
    exact = np.histogram(inner, edges)[0]
    assert np.abs(counts - exact).max() < 0.01 * inner.size


def test_moments_merge_without_cancellation():
    values = 1e9 + RANDOM.normal(size=(10_000, 2))
    merged = Moments.of(values[:0])
    for piece in np.array_split(values, 7):
        merged = merged.merge(Moments.of(piece))
    assert merged.count == 10_000
    assert np.allclose(merged.mean, values.mean(axis=0), rtol=1e-14)
    assert np.allclose(merged.sd, values.std(axis=0, ddof=1), rtol=1e-9)


def test_exceedance_intervals_are_those_of_the_books():
    """Wilson's and Clopper and Pearson's intervals for 10 of 100 (Brown, Cai and DasGupta, 2001)."""
    found = exceedance(5.0, 10, 100, 0)
    assert found.value == 0.1
    assert found.wilson == pytest.approx((0.0552, 0.1744), abs=1e-4)
    assert found.exact == pytest.approx((0.0490, 0.1762), abs=1e-4)
    assert exceedance(5.0, 10, 100, 25).bounds == pytest.approx((10 / 125, 35 / 125))


@pytest.mark.parametrize("place", [-1e9, 0.5, 1e9])
def test_failed_lanes_bound_the_quantiles_wherever_they_would_lie(place):
    """Whatever the failed lanes would have given, the quantile of all lanes lies within the bounds."""
    values = RANDOM.normal(size=10_000)
    good = np.ones(values.size, dtype=bool)
    good[RANDOM.choice(values.size, 100, replace=False)] = False
    accumulator = Accumulator("y", "1", 0.0, 1.0, thresholds=(1.0,))
    accumulator.add(np.arange(values.size), np.where(good, values, np.nan), good)
    summary = accumulator.summary()
    everything = np.where(good, values, place)
    assert (summary.count, summary.failed) == (9_900, 100)
    for q in summary.quantiles:
        exact = np.quantile(everything, q.probability)
        assert q.bounds[0] - 2e-3 <= exact <= q.bounds[1] + 2e-3
        assert q.bounds[0] <= q.value <= q.bounds[1]
    low, high = summary.exceedances[0].bounds
    assert low - 1e-12 <= (everything > 1.0).mean() <= high + 1e-12


def test_failure_bounds_open_up_beyond_the_failed_share():
    assert failure_bounds(0.5, 90, 10) == pytest.approx((40 / 90, 50 / 90))
    accumulator = Accumulator("y", "1", 0.0, 1.0)
    accumulator.add(np.arange(100), np.linspace(0, 1, 100), np.arange(100) >= 10)
    assert accumulator.summary().quantile(0.05).bounds[0] == -np.inf
    assert accumulator.summary().quantile(0.99).bounds[1] == np.inf
    with pytest.raises(KeyError, match=r"no quantile 0\.123"):
        accumulator.summary().quantile(0.123)


def test_worst_lanes_are_kept_in_order():
    values = RANDOM.normal(size=5_000)
    accumulator = Accumulator("y", "1", 0.0, 1.0)
    for start in range(0, 5_000, 700):
        piece = values[start : start + 700]
        accumulator.add(np.arange(start, start + piece.size), piece, np.ones(piece.size, bool))
    order = np.argsort(-values, kind="stable")[:10]
    assert [index for index, _ in accumulator.summary().largest] == order.tolist()
    assert accumulator.summary().smallest[0][1] == values.min()


def test_no_lane_at_all():
    accumulator = Accumulator("y", "1", 0.0, 1.0, thresholds=(1.0,))
    accumulator.add(np.arange(3), np.full(3, np.nan), np.zeros(3, bool))
    summary = accumulator.summary()
    assert np.isnan(summary.mean)
    assert summary.quantile(0.5).bounds == (-np.inf, np.inf)
    assert summary.exceedances[0].bounds == (0.0, 1.0)
