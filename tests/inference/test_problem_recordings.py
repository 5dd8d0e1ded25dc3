"""Fits of several recordings, priors and noise of inputs, against linear regression on the same numbers.

With article mass, no air and constant fluid the line obeys p' = (K/V)(Q - G (p - p_tank)); without leak p is linear in
K, so that estimates, covariances and maxima a posteriori have closed forms.
"""

import dataclasses

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference import problem as problem_module
from jaxlines.inference.distributions import LogNormal, Normal
from jaxlines.inference.input_noise import InputNoise
from jaxlines.inference.least_squares import LeastSquaresProblem
from jaxlines.inference.noise import Noise

from .cases import linear_line

K, VOLUME, START, NOISE = 1.4e9, 0.03, 3e5, 1e4
TIMES = np.linspace(0.0, 10.0, 24)


def run(seed: int, flow: float, start: float = START, volume: float = VOLUME, count: int = 24, **more) -> jl.Recording:
    """A pressure rise at constant flow, with noise; the volume is a condition of the recording."""
    times, noise = TIMES[:count], NOISE * np.random.default_rng(seed).standard_normal(count)
    pressure = start + K / volume * flow * times + noise
    channels = {"A.pressure": pressure, "flow": np.full(count, flow)}
    return jl.Recording(times, channels, name=f"run {seed}", conditions={"line.volume": volume}, **more)


RUNS = [run(1, 1e-5), run(2, 2e-5, volume=0.02, start=4e5), run(3, 1.5e-5, count=17, start=5e5)]
MODULUS = jl.Free("fluid.bulk_modulus", (5e8, 4e9), start=2.5e9)
STARTS = jl.Free("initial.A.pressure", (1e5, 1e6), start=2e5, local=True)
SHARED = {"free": [MODULUS, STARTS], "noise": {"A.pressure": NOISE}}


@pytest.fixture(scope="module")
def joint():
    return jl.fit(linear_line(), RUNS, **SHARED)


def regression(runs, priors=()):
    """Estimates and covariance of (K, one start a run) by weighted linear least squares; priors: (index, mean, sd)."""
    rows, right = [], []
    for i, recording in enumerate(runs):
        flow, volume = recording.channels["flow"], recording.conditions["line.volume"]
        for t, q, p in zip(recording.times, flow, recording.channels["A.pressure"], strict=True):
            row = np.zeros(1 + len(runs))
            row[0], row[1 + i] = q * t / volume, 1.0
            rows.append(row / NOISE)
            right.append(p / NOISE)
    for index, mean, sd in priors:
        rows.append(np.eye(1 + len(runs))[index] / sd)
        right.append(mean / sd)
    design = np.array(rows)
    covariance = np.linalg.inv(design.T @ design)
    return covariance @ design.T @ np.array(right), covariance


def test_shared_and_local_parameters_are_those_of_one_regression(joint):
    values, covariance = regression(RUNS)
    assert joint.status == "converged"
    labels = ["fluid.bulk_modulus", *(f"initial.A.pressure [run {i}]" for i in (1, 2, 3))]
    assert list(joint.parameters) == labels
    for i, label in enumerate(labels):
        assert joint.parameters[label].value == pytest.approx(values[i], rel=1e-6)
        assert joint.parameters[label].sd == pytest.approx(np.sqrt(covariance[i, i]), rel=1e-4)
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(joint.correlations, covariance / np.outer(scale, scale), atol=1e-4)


def test_channels_and_runs_carry_the_names_of_their_recordings(joint):
    assert list(joint.channels) == [f"A.pressure [run {i}]" for i in (1, 2, 3)]
    assert [run.name for run in joint.runs] == ["run 1", "run 2", "run 3"]
    assert float(joint.runs[1].circuit["line.volume"]) == pytest.approx(0.02)
    assert joint.runs[2].initial["A.pressure"] == pytest.approx(5e5, abs=3e4)
    misfit = np.concatenate([(c.simulated - c.measured) / NOISE for c in joint.channels.values()])
    density = -0.5 * misfit @ misfit - misfit.size * np.log(NOISE * np.sqrt(2 * np.pi))
    assert joint.log_likelihood == pytest.approx(density, rel=1e-9)


def test_the_problem_serves_other_tools(joint):
    problem, x = joint.problem, joint.coordinates
    assert isinstance(problem, LeastSquaresProblem)
    rows = problem.residuals(x)
    assert rows.shape == (24 + 24 + 17,) == problem.recording.shape == problem.channel.shape
    assert np.bincount(problem.recording).tolist() == [24, 24, 17]
    assert problem.time[24:27].tolist() == [0, 1, 2]
    step = 1e-4 * (problem.upper - problem.lower)
    for i in range(4):
        shift = np.eye(4)[i] * step
        difference = (problem.residuals(x + shift) - problem.residuals(x - shift)) / (2 * step[i])
        np.testing.assert_allclose(problem.jacobian(x)[:, i], difference, rtol=1e-5, atol=1e-6 / step[i])


def test_recordings_of_one_bucket_share_their_programs(joint):
    del joint
    programs = (problem_module._predict, problem_module._sensitivities)
    before = [getattr(p, "_cache_size")() for p in programs]  # noqa: B009
    jl.fit(linear_line(), [run(4, 1e-5), run(5, 3e-5, count=17)], **SHARED)
    assert [getattr(p, "_cache_size")() for p in programs] == before  # noqa: B009


def test_priors_pull_as_in_a_regression_with_their_rows(joint):
    prior = Normal(1.39e9, 1e6)
    free = [dataclasses.replace(MODULUS, prior=prior), STARTS]
    fit = jl.fit(linear_line(), RUNS, free=free, noise={"A.pressure": NOISE})
    values, covariance = regression(RUNS, [(0, 1.39e9, 1e6)])
    estimate = fit.parameters["fluid.bulk_modulus"]
    assert estimate.value == pytest.approx(values[0], rel=1e-6)
    assert estimate.sd == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-3)
    assert "prior: normal 1.39e+09, sd 1e+06" in estimate.note
    assert abs(estimate.value - joint.parameters["fluid.bulk_modulus"].value) > 2e6  # it did pull
    assert fit.problem is not None
    assert fit.problem.recording[-1] == -1 and fit.problem.residuals(fit.coordinates).size == 66


def test_noise_with_a_prior_is_estimated_and_weighs(joint):
    """With noise to be estimated the prior's weight depends on it: the fixed point agrees with the regression at it."""
    free = [dataclasses.replace(MODULUS, prior=LogNormal(1.3e9, 0.01)), STARTS]
    fit = jl.fit(linear_line(), RUNS, free=free)
    sigma = fit.noise["A.pressure"].absolute
    assert sigma == pytest.approx(NOISE, rel=0.25) and sigma != NOISE
    x = fit.coordinates
    assert fit.problem is not None
    gradient = fit.problem.jacobian(x).T @ fit.problem.residuals(x)
    assert np.all(np.abs(gradient) * [estimate.sd for estimate in fit.parameters.values()] < 0.01)
    assert fit.parameters["fluid.bulk_modulus"].value < joint.parameters["fluid.bulk_modulus"].value


def slopes_by_samples(value: float) -> np.ndarray:
    """dK/du_k of a run at constant flow Q: dK/K = -(t'dI)/(t't Q) for a change I of the integrated flow u."""
    step, integral = TIMES[1], np.tril(np.ones((24, 24)), 0)
    integral[:, 0] -= 0.5  # trapezoids: half weight at both ends
    integral -= 0.5 * np.eye(24)
    integral[0] = 0.0
    return TIMES @ integral * step / (TIMES @ TIMES) / 1e-5 * value


@pytest.mark.slow
@pytest.mark.parametrize("part", ["calibration", "white"])
def test_uncertainty_of_recorded_inputs_follows_closed_form(part):
    arguments = {"free": [MODULUS], "noise": {"A.pressure": NOISE}, "initial": {"A.pressure": START}}
    noise = InputNoise(white=2e-6) if part == "white" else InputNoise(gain=0.02, offset=3e-7)
    estimate = jl.fit(linear_line(), RUNS[0], input_noise={"flow": noise}, **arguments).parameters["fluid.bulk_modulus"]
    plain = NOISE / np.linalg.norm(1e-5 * TIMES / VOLUME)
    by_sample = slopes_by_samples(estimate.value)
    expected = np.hypot(0.02 * estimate.value, 3e-7 * by_sample.sum())
    if part == "white":
        expected = 2e-6 * np.linalg.norm(by_sample)
    assert estimate.sd is not None
    assert np.sqrt(estimate.sd**2 - plain**2) == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_measured_starts_of_several_runs_add_their_share():
    """K = sum s (p - p_first)/sum s^2: the noise of the first sample of each run counts once, for all of that run."""
    fit = jl.fit(linear_line(), RUNS, free=[MODULUS], noise={"A.pressure": NOISE})
    slopes = [r.channels["flow"] * r.times / r.conditions["line.volume"] for r in RUNS]
    total = sum(float(s @ s) for s in slopes)
    rises = [r.channels["A.pressure"] - r.channels["A.pressure"][0] for r in RUNS]
    estimate = fit.parameters["fluid.bulk_modulus"]
    assert estimate.value == pytest.approx(
        sum(float(s @ p) for s, p in zip(slopes, rises, strict=True)) / total, rel=1e-6
    )
    variance = 1.0 / total + sum(float(s.sum()) ** 2 for s in slopes) / total**2
    assert estimate.sd == pytest.approx(NOISE * np.sqrt(variance), rel=1e-3)


def test_wrong_calls_say_what_is_wrong():
    twice = [RUNS[0], RUNS[0], RUNS[1]]
    with pytest.raises(ValueError, match=r"two recordings are called 'run 1'"):
        jl.fit(linear_line(), twice, **SHARED)
    with pytest.raises(TypeError, match=r"needs a Recording or a list"):
        jl.fit(linear_line(), [], **SHARED)
    with pytest.raises(ValueError, match=r"volume is free and among the conditions of run 1"):
        jl.fit(linear_line(), RUNS, free=[jl.Free("line.volume", (0.01, 0.1))])
    with pytest.raises(KeyError, match=r"run 9, conditions: .*did you mean"):
        jl.fit(linear_line(), dataclasses.replace(RUNS[0], conditions={"line.volum": 1.0}, name="run 9"), **SHARED)
    with pytest.raises(ValueError, match=r"input_noise is given for 'spool', which is no input"):
        jl.fit(linear_line(), RUNS, input_noise={"spool": 1.0}, **SHARED)
    with pytest.raises(ValueError, match=r"sampling must be one of sobol, latin"):
        jl.fit(linear_line(), RUNS, starts=2, sampling="grid", **SHARED)
    with pytest.raises(ValueError, match=r"was it recorded in bar.*check=False"):
        wrong = {**RUNS[0].channels, "A.pressure": RUNS[0].channels["A.pressure"] * 1e-5}
        jl.fit(linear_line(), dataclasses.replace(RUNS[0], channels=wrong), **SHARED)
    with pytest.raises(ValueError, match=r"cannot be free: run 1 starts \"steady\""):
        jl.fit(linear_line(), dataclasses.replace(RUNS[0], initial="steady"), **SHARED)
    with pytest.raises(ValueError, match=r'use "cubic"'):
        jl.fit(linear_line(), RUNS, free=[jl.Free("flow.delay", (0.0, 1.0))], interpolation="hold")
    assert Noise().estimated
