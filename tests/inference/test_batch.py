"""Batched fits: the same as one by one, deaf to failing lanes, and intervals that cover."""

import numpy as np
import pytest

import jaxlines as jl

from .cases import FLOW, FREE, TIMES, TRUTH, control_line, recording, simulated_pressure


@pytest.fixture(scope="module")
def pressure():
    return simulated_pressure(control_line())


@pytest.fixture(scope="module")
def recordings(pressure):
    return [recording(pressure, seed) for seed in range(5)]


@pytest.fixture(scope="module")
def batch(recordings):
    return jl.fit_batch(control_line(), recordings, free=FREE)


def test_a_batch_equals_single_fits(recordings, batch):
    assert batch.status == ("converged",) * 5
    for lane in (0, 3):
        single = jl.fit(control_line(), recordings[lane], free=FREE)
        for i, (name, estimate) in enumerate(single.parameters.items()):
            assert batch.names[i] == name
            assert estimate.sd is not None
            assert batch.values[lane, i] == pytest.approx(estimate.value, abs=1e-3 * estimate.sd)
            assert batch.sd[lane, i] == pytest.approx(estimate.sd, rel=1e-3)
        assert batch.rmse[lane, 0] == pytest.approx(single.channels["A.pressure"].rmse, rel=1e-6)


def test_numbers_of_a_lane_are_its_own_and_a_failing_lane_disturbs_none(recordings, batch):
    volumes = [{"line.volume": 0.03}, {"line.volume": 0.06}, {"line.volume": np.nan}]
    own = jl.fit_batch(control_line(), recordings[:3], free=FREE, local=volumes)
    assert own.status[0] == "converged" and own.status[2] == "failed"
    np.testing.assert_allclose(own.values[0], batch.values[0], rtol=1e-6)
    assert own.values[1, 0] == pytest.approx(2 * batch.values[1, 0], rel=0.1)  # twice the volume, twice the modulus


def test_wrong_batches_are_refused(recordings):
    short = recordings[0].window(0.0, 5.0)
    with pytest.raises(ValueError, match=r"recordings of a batch must have one length"):
        jl.fit_batch(control_line(), [recordings[0], short], free=FREE)
    with pytest.raises(ValueError, match=r"local needs one dictionary a recording"):
        jl.fit_batch(control_line(), recordings, free=FREE, local=[{}])
    with pytest.raises(KeyError, match=r"line.volum"):
        jl.fit_batch(control_line(), recordings[:1], free=FREE, local=[{"line.volum": 1.0}])


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(pressure):
    """95 % intervals of 200 data sets: 181 to 198 hits is the 99 % binomial band, failures count as misses."""
    fits = jl.fit_batch(control_line(), [recording(pressure, seed) for seed in range(100, 300)], free=FREE)
    truth = np.array([TRUTH[name] for name in fits.names])
    coordinates = np.stack([f.to_coordinate(fits.values[:, i]) for i, f in enumerate(FREE)], axis=1)
    slopes = np.stack([f.slope(fits.values[:, i]) for i, f in enumerate(FREE)], axis=1)
    exact = np.array([float(f.to_coordinate(v)) for f, v in zip(FREE, truth, strict=True)])
    hits = (np.abs(coordinates - exact) < 1.96 * fits.sd / slopes) & (np.array(fits.status) == "converged")[:, None]
    assert np.all((hits.sum(axis=0) >= 181) & (hits.sum(axis=0) <= 198)), hits.sum(axis=0)


def test_delay_of_an_input_is_recovered(pressure):
    """The flow channel lags the pressure by 0.15 s; the fit finds the lag from half a sample and more away."""
    late = np.interp(TIMES - 0.15, TIMES, FLOW)
    smooth = np.convolve(np.pad(FLOW, 10, mode="edge"), np.hanning(21) / np.hanning(21).sum(), mode="valid")
    late = np.interp(TIMES - 0.15, TIMES, smooth)
    truth = simulated_pressure(control_line(), flow=smooth)
    data = recording(truth, 3, noise=1e4, flow=late)
    free = [*FREE, jl.Free("flow.delay", (-1.0, 1.0), start=0.3)]
    fit = jl.fit(control_line(), data, free=free, interpolation="cubic")
    assert fit.parameters["flow.delay"].value == pytest.approx(-0.15, abs=0.01)
