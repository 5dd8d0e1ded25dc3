"""Batched fits: the same as one by one, deaf to failing lanes, and intervals that cover."""

import dataclasses

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
    assert batch.engine == "explicit" and np.all(batch.offset < 5e-3)
    for lane in (0, 3):
        single = jl.fit(control_line(), recordings[lane], free=FREE)
        for i, (name, estimate) in enumerate(single.parameters.items()):
            assert batch.names[i] == name
            assert estimate.sd is not None
            assert batch.values[lane, i] == pytest.approx(estimate.value, abs=5e-3 * estimate.sd)
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
    with pytest.raises(ValueError, match=r"engine must be auto, explicit"):
        jl.fit_batch(control_line(), recordings[:1], free=FREE, engine="lockstep")
    with pytest.raises(ValueError, match=r"starts must have shape \(1, 4\)"):
        jl.fit_batch(control_line(), recordings[:1], free=FREE, starts=np.ones((4, 1)))
    with pytest.raises(ValueError, match=r"start values of a batch must be numbers"):
        jl.fit_batch(control_line(), [dataclasses.replace(recordings[0], initial="steady")], free=FREE)
    with pytest.raises(ValueError, match=r"initial.A.pressure cannot be free and have a value of its own"):
        jl.fit_batch(control_line(), recordings[:1], free=FREE, local=[{"initial.A.pressure": 3e5}])


def test_conditions_and_start_values_of_recordings_are_numbers_of_their_own(recordings):
    told = [dataclasses.replace(r, conditions={"line.volume": 0.06}, initial={"A.pressure": 3e5}) for r in recordings]
    own = [{"line.volume": 0.06, "initial.A.pressure": 3e5}] * 5
    by_recording = jl.fit_batch(control_line(), told, free=FREE[:3])
    by_local = jl.fit_batch(control_line(), recordings, free=FREE[:3], local=own)
    np.testing.assert_array_equal(by_recording.values, by_local.values)


def test_a_sharp_prior_wins_over_the_data_and_a_wide_one_does_not(recordings, batch):
    """Of a normal prior and a nearly normal likelihood the estimate is the mean weighted by 1/sd^2."""
    mean, sd = batch.values[0, 0] + 3 * batch.sd[0, 0], batch.sd[0, 0]
    for factor in (1e-2, 1e2):
        prior = jl.Normal(mean, factor * sd)
        free = [dataclasses.replace(FREE[0], prior=prior), *FREE[1:]]
        held = jl.fit_batch(control_line(), recordings[:1], free=free)
        weight = 1.0 / (1.0 + factor**2)
        assert (held.values[0, 0] - batch.values[0, 0]) / sd == pytest.approx(3 * weight, abs=0.05)
        assert held.sd[0, 0] / sd == pytest.approx(np.sqrt(factor**2 * weight), rel=0.05)


def test_known_noise_sets_standard_deviations(recordings, batch):
    """Twice the noise, twice the standard deviations; the estimates stay."""
    once, twice = (jl.fit_batch(control_line(), recordings[:2], free=FREE, noise={"A.pressure": s}) for s in (4e4, 8e4))
    np.testing.assert_allclose(twice.sd, 2 * once.sd, rtol=1e-3)
    assert np.all(np.abs(twice.values - once.values) < 1e-2 * once.sd)
    np.testing.assert_allclose(batch.noise[:, 0], 4e4, rtol=0.25)  # what it estimates without: 5 standard errors


def test_an_optimum_beyond_a_bound_is_said_to_lie_on_it(recordings):
    free = [jl.Free("fluid.bulk_modulus", (1.6e9, 4e9), transform="log"), *FREE[1:]]
    held = jl.fit_batch(control_line(), recordings[:2], free=free)
    assert held.status == ("at_bound",) * 2
    np.testing.assert_allclose(held.values[:, 0], 1.6e9)
    assert "fluid.bulk_modulus" in held.messages[0]


def test_lanes_that_cannot_run_in_step_are_refused_or_left_to_the_adaptive_solver(recordings):
    uneven = dataclasses.replace(recordings[0], times=TIMES + 0.01 * np.sin(TIMES))
    with pytest.raises(ValueError, match=r"sampled at different times"):
        jl.fit_batch(control_line(), [recordings[0], uneven], free=FREE, engine="explicit")
    gained = [*FREE[:3], jl.Free("flow.gain", (0.5, 2.0))]
    with pytest.raises(ValueError, match=r"flow.gain scales or shifts a recorded input"):
        jl.fit_batch(control_line(), recordings[:1], free=gained, engine="explicit")


@pytest.mark.slow
def test_the_adaptive_solver_finds_the_same(recordings, batch):
    other = jl.fit_batch(control_line(), recordings[:2], free=FREE, engine="adaptive")
    assert other.engine == "adaptive" and other.status == ("converged",) * 2
    assert np.all(np.abs(other.values - batch.values[:2]) < 5e-3 * batch.sd[:2])
    np.testing.assert_allclose(other.sd, batch.sd[:2], rtol=1e-2)


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
