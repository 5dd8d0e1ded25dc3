"""Fits: recovery from afar, uncertainty against closed forms, and what a recording cannot tell."""

import dataclasses

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference import problem as problem_module
from jaxlines.inference.problem import bucket, make_problem
from jaxlines.simulation.integration import make_method

from .cases import FLOW, FREE, MILD_FLOW, NOISE, TIMES, TRUTH, control_line, recording, simulated_pressure


def sd_of(estimate) -> float:
    """The standard deviation of an estimate that must have one."""
    assert estimate.sd is not None, estimate
    return estimate.sd


@pytest.fixture(scope="module")
def pressure():
    return simulated_pressure(control_line())


@pytest.fixture(scope="module")
def good_fit(pressure):
    return jl.fit(control_line(), recording(pressure, 11), free=FREE, derived=["line.effective_bulk_modulus"])


def test_parameters_are_recovered_from_half_and_more_away(good_fit):
    assert good_fit.status == "converged", good_fit.message
    for free in FREE:
        estimate, truth = good_fit.parameters[free.label], TRUTH[free.label]
        assert abs((free.start or 0.0) / truth - 1.0) >= 0.49
        assert abs((free.start or 0.0) - truth) > 10 * sd_of(estimate)  # the start would not pass
        assert abs(estimate.value - truth) < 3.5 * sd_of(estimate)
        assert estimate.ci95 is not None
        assert estimate.ci95[0] < estimate.value < estimate.ci95[1]
    assert good_fit.channels["A.pressure"].sigma == pytest.approx(NOISE, rel=0.15)
    assert good_fit.channels["A.pressure"].white


def test_derived_modulus_and_curves_agree_with_the_truth(good_fit):
    truth = control_line()
    line, oil = truth.components["line"], truth.fluid
    assert isinstance(line, jl.Line)
    curve = good_fit.curves["line"]
    exact = line.effective_bulk_modulus(oil, curve.pressure)
    half = 0.5 * (curve.bulk_modulus_high - curve.bulk_modulus_low)
    assert np.all(np.abs(curve.bulk_modulus - exact) < 2.5 * half)
    assert np.all(half / exact < 0.1)
    derived = good_fit.derived["line.effective_bulk_modulus"]
    assert derived.ci95 is not None
    assert derived.unit == "Pa"
    assert derived.ci95[0] < derived.value < derived.ci95[1]
    assert "at " in derived.note


def test_air_is_conditional_on_the_polytropic_index_and_says_so(good_fit):
    assert any("conditional on the polytropic index" in warning for warning in good_fit.warnings)
    assert "for an index of 1 to 1.4" in good_fit.parameters["fluid.air_fraction"].note


def test_a_known_spread_of_the_polytropic_index_widens_the_interval_of_air(pressure, good_fit):
    """Uniform over [1, 1.4] has a standard deviation of 0.115; the interval then covers the refits at the ends."""
    spread = jl.Known("fluid.polytropic_index", 0.4 / np.sqrt(12.0))
    fit = jl.fit(control_line(), recording(pressure, 11), free=FREE, known=[spread])
    wide, narrow = fit.parameters["fluid.air_fraction"], good_fit.parameters["fluid.air_fraction"]
    assert sd_of(wide) > 5 * sd_of(narrow)
    assert wide.ci95 is not None and wide.ci95[0] < 0.0061 and wide.ci95[1] > 0.0085
    assert wide.value == pytest.approx(narrow.value, rel=1e-3)
    assert not any("conditional on the polytropic" in warning for warning in fit.warnings)


def test_what_the_result_rests_on_is_named_with_the_right_slope(good_fit):
    assert "measured flow 'flow'" in good_fit.scale[0]
    volume = next(s for s in good_fit.scale if s.startswith("line.parts.0.volume"))
    assert "taken as exact" in volume
    assert "fluid.bulk_modulus by +1 %" in volume  # K is proportional to V


def test_text_of_a_fit_shows_estimates_and_warnings(good_fit):
    text = str(good_fit)
    for word in ("converged", "fluid.bulk_modulus", "95 %", "residuals white", "rests on", "validity"):
        assert word in text


def test_air_left_out_fails_the_whiteness_test(pressure):
    circuit = control_line().replace({"fluid.air_fraction": 0.0})
    fit = jl.fit(circuit, recording(pressure, 11), free=[FREE[0], *FREE[2:]])
    assert not fit.channels["A.pressure"].white
    assert fit.channels["A.pressure"].whiteness_p < 1e-6
    assert any("not white" in warning for warning in fit.warnings)


def test_modulus_and_volume_without_a_known_flow_are_fixed_only_together(pressure):
    free = [
        FREE[0],
        jl.Free("line.volume", (0.01, 0.1), start=0.05, transform="log"),
        jl.Free("valve.gain", (0.2, 5.0), start=2.0, transform="log"),
        jl.Free("leak.conductance", (1e-13, 2e-11), start=3e-12, transform="log"),
    ]
    fit = jl.fit(control_line(), recording(pressure, 2), free=free, initial={"A.pressure": 3e5})
    assert any("only together" in sentence and "line.volume" in sentence for sentence in fit.identifiability)
    for name in ("line.volume", "valve.gain"):
        assert fit.parameters[name].kind == "unidentified"
        assert fit.parameters[name].sd is None
    assert fit.singular_values[-1] < 1e-3 * fit.singular_values[0]


def test_liquid_and_wall_stiffness_are_fixed_only_together_but_their_sum_is(pressure):
    free = [
        FREE[0],
        jl.Free("line.wall_modulus", (1e9, 1e12), start=1e11, transform="log"),
        *FREE[2:],
    ]
    circuit = control_line(air_fraction=0.0)
    data = recording(simulated_pressure(circuit, flow=MILD_FLOW), 3, flow=MILD_FLOW)
    fit = jl.fit(circuit, data, free=free, derived=["line.effective_bulk_modulus"])
    words = " ".join(fit.identifiability)
    assert "fluid.bulk_modulus" in words and "line.wall_modulus" in words and "only together" in words
    series = 1 / (1 / 1.4e9 + 1 / 3e10)
    derived = fit.derived["line.effective_bulk_modulus"]
    assert derived.kind == "interval"
    assert derived.value == pytest.approx(series, abs=4 * sd_of(derived))
    assert sd_of(derived) / series < 0.02


def test_air_that_is_not_there_gets_an_upper_limit():
    circuit = control_line(air_fraction=0.0)
    data = recording(simulated_pressure(circuit, flow=MILD_FLOW), 4, flow=MILD_FLOW)
    fit = jl.fit(control_line(), data, free=FREE)
    estimate = fit.parameters["fluid.air_fraction"]
    assert estimate.kind == "upper_limit"
    assert estimate.ci95 is not None and estimate.ci95[0] == 0.0
    assert 1e-6 < estimate.ci95[1] < 2e-3  # far below the 7e-3 that the other recordings reveal


def test_a_bound_is_reported(pressure):
    free = [jl.Free("fluid.bulk_modulus", (1.6e9, 4e9), start=2.2e9), *FREE[1:]]
    fit = jl.fit(control_line(), recording(pressure, 11), free=free)
    assert fit.status == "at_bound"
    assert "fluid.bulk_modulus at its lower one" in fit.message
    assert "on a bound" in fit.parameters["fluid.bulk_modulus"].note


def test_missing_samples_weigh_nothing(pressure):
    data = recording(pressure, 5)
    drop = np.zeros(TIMES.size, bool)
    drop[30:60:2] = True
    wild = np.where(drop, 9e9, data.channels["A.pressure"])
    holes = np.where(drop, np.nan, data.channels["A.pressure"])
    masked = jl.Recording(TIMES, {"A.pressure": wild, "flow": FLOW}, mask={"A.pressure": ~drop})
    missing = jl.Recording(TIMES, {"A.pressure": holes, "flow": FLOW})
    first, second = (jl.fit(control_line(), r, free=FREE) for r in (masked, missing))
    for name, estimate in first.parameters.items():
        assert second.parameters[name].value == pytest.approx(estimate.value, rel=1e-9)
        assert abs(estimate.value - TRUTH[name]) < 4 * sd_of(estimate)


def test_uncertainty_of_volume_and_noise_follow_closed_form():
    """Article mass, no air, no leak, constant flow: p = p0 + (K/V) Q t, so that K is a regression slope."""
    circuit = control_line("article", air_fraction=0.0).replace({"leak.conductance": 0.0, "line.wall_modulus": np.inf})
    flow = np.full(TIMES.size, 1e-5)
    slope = 1.4e9 / 0.03 * 1e-5
    noise = np.random.default_rng(6).standard_normal(TIMES.size)
    data = jl.Recording(TIMES, {"A.pressure": 3e5 + slope * TIMES + 1e4 * noise, "flow": flow})
    free = [jl.Free("fluid.bulk_modulus", (5e8, 4e9), start=2.5e9), jl.Free("initial.A.pressure", (1e5, 1e6))]
    plain = jl.fit(circuit, data, free=free, noise={"A.pressure": 1e4})
    fitted = np.polyfit(TIMES, data.channels["A.pressure"], 1)
    scale = 0.03 / 1e-5
    sd_slope = 1e4 / np.sqrt(np.sum((TIMES - TIMES.mean()) ** 2))
    estimate = plain.parameters["fluid.bulk_modulus"]
    assert estimate.value == pytest.approx(fitted[0] * scale, rel=1e-6)
    assert estimate.sd == pytest.approx(sd_slope * scale, rel=1e-4)
    known = jl.fit(circuit, data, free=free, noise={"A.pressure": 1e4}, known=[jl.Known("line.volume", 3e-4)])
    expected = np.hypot(sd_slope * scale, fitted[0] * scale * 0.01)  # K is proportional to V
    assert known.parameters["fluid.bulk_modulus"].sd == pytest.approx(expected, rel=1e-3)
    assert any("standard uncertainty 0.0003" in sentence for sentence in known.scale)


def test_start_value_is_taken_from_the_recording_with_its_noise(pressure):
    free = FREE[:3]
    implied = jl.fit(control_line(), recording(pressure, 7), free=free)
    told = jl.fit(control_line(), recording(pressure, 7), free=free, initial={"A.pressure": "measured"})
    exact = jl.fit(control_line(), recording(pressure, 7), free=free, initial={"A.pressure": 3e5})
    name = "fluid.air_fraction"
    assert implied.parameters[name].value == told.parameters[name].value
    assert sd_of(implied.parameters[name]) > 3 * sd_of(exact.parameters[name])
    assert abs(implied.parameters[name].value - TRUTH[name]) < 3.5 * sd_of(implied.parameters[name])


def test_start_value_is_taken_through_a_sensor_with_gain_and_gauge_reference(pressure):
    circuit = control_line()
    sensor = jl.PressureSensor("A", gain=1.02, offset=5e3, reference="gauge")
    circuit = jl.Circuit(circuit.fluid, circuit.components | {"gauge": sensor})
    noise = 1e3 * np.random.default_rng(9).standard_normal(TIMES.size)
    data = jl.Recording(TIMES, {"gauge": 1.02 * (pressure - 101325.0) + 5e3 + noise, "flow": FLOW})
    fit = jl.fit(circuit, data, free=FREE[:3])
    assert fit.status == "converged"
    assert fit.initial["A.pressure"] == pytest.approx(3e5, abs=4e3)
    estimate = fit.parameters["fluid.air_fraction"]
    assert abs(estimate.value - TRUTH["fluid.air_fraction"]) < 3.5 * sd_of(estimate)


def test_two_channels_get_their_own_noise(pressure):
    circuit = control_line()
    circuit = jl.Circuit(circuit.fluid, circuit.components | {"drain": jl.FlowSensor("leak.a")})
    simulation = jl.simulate(circuit, TIMES, {"flow": FLOW}, initial={"A.pressure": 3e5})
    rng = np.random.default_rng(8)
    channels = {
        "A.pressure": simulation["A.pressure"] + NOISE * rng.standard_normal(TIMES.size),
        "drain": simulation["drain"] + 1e-7 * rng.standard_normal(TIMES.size),
        "flow": FLOW,
    }
    fit = jl.fit(circuit, jl.Recording(TIMES, channels), free=FREE)
    assert fit.status == "converged"
    assert fit.channels["drain"].sigma == pytest.approx(1e-7, rel=0.15)
    assert fit.channels["A.pressure"].sigma == pytest.approx(NOISE, rel=0.15)
    assert fit.channels["drain"].unit == "m^3/s"


def test_several_starts_agree_and_are_counted(pressure):
    fit = jl.fit(control_line(), recording(pressure, 11), free=FREE, starts=3)
    assert fit.status == "converged"
    assert any("of 3 starts reached the best optimum" in warning for warning in fit.warnings)


def test_progress_is_told(pressure):
    said = []
    jl.fit(control_line(), recording(pressure, 11), free=FREE, progress=lambda text, share: said.append((text, share)))
    assert len(said) > 5
    assert all(0.0 <= share <= 1.0 for _, share in said)


def test_a_circuit_that_cannot_be_simulated_is_a_failed_fit_not_a_crash(pressure):
    fit = jl.fit(control_line(), recording(pressure, 11), free=FREE, max_steps=5)
    assert fit.status == "failed"
    assert "fails at the start of the search: the step limit was reached" in fit.message
    assert fit.parameters == {}


CASES = {
    "as it is": {},
    "zero air": {"fluid.air_fraction": 0.0},
    "no leak": {"leak.conductance": 0.0},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("flow", ["reversing", "zero"])
def test_jacobian_equals_central_differences(case, flow):
    signal = MILD_FLOW if flow == "reversing" else np.zeros(TIMES.size)
    start = 3e5 if flow == "reversing" else 6e6
    circuit = control_line().replace(CASES[case])
    free = [
        jl.Free("fluid.bulk_modulus", (5e8, 4e9)),
        jl.Free("fluid.air_fraction", (0.0, 0.1)),
        jl.Free("leak.conductance", (0.0, 2e-11)),
        jl.Free("initial.A.pressure", (1e5, 1e7)),
        jl.Free("valve.gain", (0.5, 2.0)),
    ]
    data = jl.Recording(TIMES, {"A.pressure": np.full(TIMES.size, start), "flow": signal})
    problem = make_problem(circuit, data, free, (), {}, make_method(None, "forward", 10**5), 1e-10, "float64")
    point = np.array([1.4e9, float(circuit["fluid.air_fraction"]), float(circuit["leak.conductance"]), start, 1.0])
    _, slopes = problem.sensitivities(point)
    sizes = np.array([1.4e9, 7e-3, 1e-12, 3e5, 1.0])
    for i, size in enumerate(sizes):
        step = np.zeros(5)
        step[i] = 5e-4 * size
        points = [problem.predict(point + k * step) for k in (-2, -1, 1, 2)]
        difference = (points[0] - 8 * points[1] + 8 * points[2] - points[3]) / 12 / 5e-4
        exact = slopes[..., i] * size
        np.testing.assert_allclose(exact, difference, atol=1e-5 * max(np.abs(exact).max(), 1.0), rtol=0)


def compiled_programs() -> list[int]:
    """How many programs each compiled function holds."""
    programs = (problem_module._predict, problem_module._sensitivities)
    return [getattr(program, "_cache_size")() for program in programs]  # noqa: B009


def test_a_second_fit_with_other_values_compiles_nothing(pressure, good_fit):
    del good_fit
    jl.fit(control_line(), recording(pressure, 9), free=FREE)
    before = compiled_programs()
    other = control_line().replace({"line.volume": 0.031, "fluid.density": 870.0})
    jl.fit(other, recording(pressure, 10), free=FREE)
    assert compiled_programs() == before


def test_recordings_of_similar_length_share_a_program():
    assert [bucket(n) for n in (10, 16, 17, 24, 25, 1501, 1537)] == [12, 16, 24, 24, 32, 1536, 2048]


def test_float32_fit_finds_the_neighbourhood(pressure):
    fit = jl.fit(control_line(), recording(pressure, 11), free=FREE, precision="float32", tolerance=1e-5)
    assert fit.parameters["fluid.bulk_modulus"].value == pytest.approx(1.4e9, rel=0.02)


def wrong(**changes):
    """A call of fit with something wrong in it."""
    arguments = {"circuit": control_line(), "recording": recording(np.linspace(3e5, 1e7, TIMES.size), 1), "free": FREE}
    arguments |= changes
    return jl.fit(arguments.pop("circuit"), arguments.pop("recording"), **arguments)


def test_wrong_calls_say_what_is_wrong():
    with pytest.raises(KeyError, match=r"did you mean fluid.air_fraction"):
        wrong(free=[jl.Free("fluid.air_fracton", (1e-5, 0.1))])
    with pytest.raises(ValueError, match=r"bounds must lie in 1e\+08\.\.1e\+11 Pa, got 1\.\.2: was it given in bar"):
        wrong(free=[jl.Free("fluid.bulk_modulus", (1.0, 2.0))])
    with pytest.raises(ValueError, match=r"twice among the free and known"):
        wrong(known=[jl.Known("fluid.bulk_modulus", 1e7)])
    with pytest.raises(ValueError, match=r"at least one free parameter"):
        wrong(free=[])
    with pytest.raises(ValueError, match=r"noise is given for 'B.pressure', which is not fitted"):
        wrong(noise={"B.pressure": 1.0})
    with pytest.raises(ValueError, match=r"noise of A.pressure must be positive"):
        wrong(noise={"A.pressure": -1.0})
    with pytest.raises(ValueError, match=r"starts must be at least 1"):
        wrong(starts=0)
    with pytest.raises(KeyError, match=r"no state is called 'B\.pressure'"):
        wrong(initial={"B.pressure": 1e5})


def test_wrong_recordings_say_what_is_wrong():
    data = recording(np.linspace(3e5, 1e7, TIMES.size), 1)
    pressure = data.channels["A.pressure"]
    with pytest.raises(ValueError, match=r"needs a channel 'flow' as input"):
        wrong(recording=jl.Recording(TIMES, {"A.pressure": pressure}))
    with pytest.raises(ValueError, match=r"no channel of the recording is an output"):
        wrong(recording=jl.Recording(TIMES, {"flow": FLOW}))
    with pytest.raises(KeyError, match=r"A.pressure"):
        wrong(recording=jl.Recording(TIMES, {"A.presure": pressure, "flow": FLOW}))
    gap = np.where(np.arange(TIMES.size) == 7, np.nan, FLOW)
    with pytest.raises(ValueError, match=r"input channel 'flow' has 1 missing samples, the first at 0.7 s"):
        wrong(recording=jl.Recording(TIMES, {"A.pressure": pressure, "flow": gap}))
    with pytest.raises(ValueError, match=r"was it given in L/min"):
        wrong(recording=jl.Recording(TIMES, {"A.pressure": pressure, "flow": FLOW * 1e9}))
    with pytest.raises(KeyError, match=r"there are line\.effective_bulk_modulus"):
        wrong(derived=["line.colour"])


def test_a_recording_is_not_changed_by_a_fit(pressure):
    data = recording(pressure, 11)
    before = dataclasses.replace(data, channels={k: v.copy() for k, v in data.channels.items()})
    jl.fit(control_line(), data, free=FREE)
    assert np.array_equal(before.channels["A.pressure"], data.channels["A.pressure"])
