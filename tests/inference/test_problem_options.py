"""Ratios, sensors and inputs as parameters, steady starts, robust losses, relative noise, starts and failures."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

import jaxlines as jl
from jaxlines.inference.checkpoint import Memory
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.noise import Noise
from jaxlines.inference.parameters import Free
from jaxlines.inference.problem import Problem
from jaxlines.inference.recording_check import check_recording
from jaxlines.inference.search import Evaluator, search

from .cases import linear_line

K, VOLUME, START = 1.4e9, 0.03, 3e5
TIMES = np.linspace(0.0, 10.0, 24)
FLOW = 1e-5 * (1.0 + np.sin(TIMES))
MODULUS = jl.Free("fluid.bulk_modulus", (5e8, 4e9), start=2.5e9)


def integral(flow) -> np.ndarray:
    """The integral of samples joined linearly."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (flow[1:] + flow[:-1]) * np.diff(TIMES))])


def recording(pressure, flow=FLOW, **more) -> jl.Recording:
    """A pressure and the flow."""
    return jl.Recording(TIMES, {"A.pressure": pressure, "flow": flow}, **more)


PRESSURE = START + K / VOLUME * integral(FLOW)
NOISE = np.random.default_rng(11).standard_normal(TIMES.size)
ARGUMENTS = {"free": [MODULUS], "initial": {"A.pressure": START}}


def sd_of(estimate) -> float:
    """The standard deviation of an estimate that must have one."""
    assert estimate.sd is not None, estimate
    return estimate.sd


def closed_form(pressure, weights) -> float:
    """K by weighted linear regression."""
    slope = integral(FLOW) / VOLUME
    return float(np.sum(weights * slope * (pressure - START)) / np.sum(weights * slope**2))


def test_relative_noise_ends_where_weights_and_estimates_agree():
    """The estimate is the regression at the weights that are reported, and those are near the truth."""
    pressure = PRESSURE + NOISE * 0.02 * PRESSURE
    fit = jl.fit(linear_line(), recording(pressure), noise={"A.pressure": Noise(1e3, None)}, **ARGUMENTS)
    estimate, noise = fit.parameters["fluid.bulk_modulus"], fit.noise["A.pressure"]
    simulated = START + estimate.value / VOLUME * integral(FLOW)
    assert estimate.value == pytest.approx(closed_form(pressure, 1.0 / noise.level(simulated) ** 2), rel=1e-5)
    assert noise.relative == pytest.approx(0.02, rel=0.35) and noise.absolute == 1e3
    assert abs(estimate.value - K) < 3.0 * sd_of(estimate)


def test_known_relative_noise_weighs_by_what_is_simulated():
    """Weights from the readings themselves would trust low outliers; the closed form takes the simulated ones."""
    pressure = PRESSURE + NOISE * 0.2 * PRESSURE
    fit = jl.fit(linear_line(), recording(pressure), noise={"A.pressure": Noise(0.0, 0.2)}, check=False, **ARGUMENTS)
    value = fit.parameters["fluid.bulk_modulus"].value
    simulated = START + value / VOLUME * integral(FLOW)
    assert value == pytest.approx(closed_form(pressure, (0.2 * simulated) ** -2.0), rel=1e-3)
    assert value != pytest.approx(closed_form(pressure, (0.2 * pressure) ** -2.0), rel=5e-3)


def test_robust_losses_agree_with_scipy_and_bear_outliers():
    pressure = PRESSURE + 1e4 * NOISE
    pressure[[5, 12, 20]] += [3e5, -4e5, 6e5]
    slope = integral(FLOW) / VOLUME * 1e9
    plain = jl.fit(linear_line(), recording(pressure), noise={"A.pressure": 1e4}, check=False, **ARGUMENTS)
    for loss in ("huber", "student"):
        fit = jl.fit(
            linear_line(), recording(pressure), noise={"A.pressure": 1e4}, loss=loss, loss_scale=2.0, **ARGUMENTS
        )

        def student(z):  # rho(z^2) and two derivatives, as SciPy wants it, for nu = 2
            return np.stack([3.0 * np.log1p(z / 2.0), 3.0 / (2.0 + z), -3.0 / (2.0 + z) ** 2])

        peer = least_squares(
            lambda k: (START + k * slope - pressure) / 1e4,
            [2.5],
            loss="huber" if loss == "huber" else student,  # pyright: ignore[reportArgumentType]
            f_scale=2.0 if loss == "huber" else 1.0,
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
        )
        estimate = fit.parameters["fluid.bulk_modulus"]
        assert estimate.value == pytest.approx(peer.x[0] * 1e9, rel=1e-6)
        assert abs(estimate.value - K) < 3.0 * sd_of(estimate)
        assert abs(plain.parameters["fluid.bulk_modulus"].value - K) > 3.0 * sd_of(estimate)


def test_robust_noise_level_is_estimated():
    pressure = PRESSURE + 1e4 * NOISE
    pressure[5] += 5e6
    fit = jl.fit(linear_line(), recording(pressure), loss="student", **ARGUMENTS)
    assert fit.noise["A.pressure"].absolute == pytest.approx(1e4, rel=0.6)
    assert fit.parameters["fluid.bulk_modulus"].value == pytest.approx(K, rel=0.01)


def test_starts_are_ranked_and_a_latin_hypercube_has_one_point_a_slice():
    fit = jl.fit(linear_line(), recording(PRESSURE + 1e4 * NOISE), starts=6, sampling="latin", seed=3, **ARGUMENTS)
    assert [s.cost for s in fit.starts] == sorted(s.cost for s in fit.starts)
    assert sorted(s.number for s in fit.starts) == list(range(6))
    begin = np.sort([s.start[0] for s in fit.starts if s.number > 0])
    assert np.floor((begin - 5e8) / 3.5e9 * 5).astype(int).tolist() == [0, 1, 2, 3, 4]
    assert all(s.status == "converged" for s in fit.starts)
    assert np.ptp([s.end[0] for s in fit.starts]) < 1e-5 * K


def test_known_noise_of_samples_weighs_them():
    level = np.where(np.arange(24) % 2 == 0, 1e4, 1e5)
    pressure = PRESSURE + level * NOISE
    fit = jl.fit(linear_line(), recording(pressure, noise={"A.pressure": level}), **ARGUMENTS)
    assert fit.parameters["fluid.bulk_modulus"].value == pytest.approx(closed_form(pressure, level**-2.0), rel=1e-7)
    slope = integral(FLOW) / VOLUME
    sd = 1.0 / np.sqrt(np.sum((slope / level) ** 2))
    assert fit.parameters["fluid.bulk_modulus"].sd == pytest.approx(sd, rel=1e-5)


def test_an_end_beside_failing_simulations_is_near_failure(monkeypatch):
    """Simulations that fail above 1.38 GPa keep the search from the optimum at 1.4 GPa."""
    predict = Problem.predict

    def failing(self, values):
        found = predict(self, values)
        return np.full_like(found, np.nan) if values[0] > 1.38e9 else found

    monkeypatch.setattr(Problem, "predict", failing)
    free = [dataclasses.replace(MODULUS, start=8e8)]
    fit = jl.fit(linear_line(), recording(PRESSURE + 1e4 * NOISE), free=free, initial={"A.pressure": START})
    assert fit.status == "near_failure"
    assert "simulations fail" in fit.message


class Curved:
    """y = a exp(-b t): the parts of a problem that a search uses."""

    free = (Free("a", (0.1, 10.0)), Free("b", (0.1, 5.0)))
    labels = ("a", "b")
    lower, upper = np.array([0.1, 0.1]), np.array([10.0, 5.0])
    t = np.linspace(0.0, 2.0, 40)
    data = 3.0 * np.exp(-1.3 * t) + 0.05 * np.random.default_rng(2).standard_normal(40)

    def to_values(self, x):
        return np.asarray(x)

    def predict(self, values):
        return [values[0] * np.exp(-values[1] * self.t)]

    def sensitivities(self, values):
        decay = np.exp(-values[1] * self.t)
        return [values[0] * decay], [np.stack([decay, -values[0] * self.t * decay], axis=1)]

    def rows(self, values, simulated):
        return simulated[0] - self.data

    def row_slopes(self, x, simulated, slopes):
        return slopes[0]

    def residuals(self, x):
        return self.rows(x, self.predict(x))

    def why_it_fails(self, values):
        return ""


def test_condensed_rows_lead_the_same_way_as_all_rows():
    """Cost, gradient and J'J are kept, so that SciPy's search takes the same steps."""
    problem, x = Curved(), np.array([8.0, 0.3])
    evaluator = Evaluator(problem, "test", Memory(), lambda count, cost: None)  # pyright: ignore[reportArgumentType]
    rows, small = evaluator.residuals(x), evaluator.jacobian(x)
    full, jacobian = problem.residuals(x), problem.sensitivities(x)[1][0]
    assert rows @ rows == pytest.approx(full @ full, rel=1e-13)
    np.testing.assert_allclose(small.T @ rows, jacobian.T @ full, rtol=1e-12)
    np.testing.assert_allclose(small.T @ small, jacobian.T @ jacobian, rtol=1e-12)
    found = search(problem, x, lambda count, cost: None)  # pyright: ignore[reportArgumentType]
    peer = least_squares(problem.residuals, x, bounds=(problem.lower, problem.upper), xtol=1e-12)
    np.testing.assert_allclose(found.values, peer.x, rtol=1e-4)
    assert found.status == "converged"


def test_a_recording_is_checked_on_its_own():
    data = recording(PRESSURE * 1e-5)
    found = check_recording(linear_line(), data, initial={"A.pressure": START})
    assert [(fault.kind, fault.channel, fault.grave) for fault in found] == [("unit", "A.pressure", True)]
    assert "was it recorded in bar" in found[0].text
    assert check_recording(linear_line(), recording(PRESSURE)) == ()


@pytest.mark.slow
def test_ratios_tie_two_volumes():
    """Two vessels in a fixed ratio: only their sum, 1.5 times the first, is seen."""
    parts = [jl.Vessel(volume=0.02), jl.Vessel(volume=0.01)]
    circuit = jl.Circuit(linear_line().fluid, linear_line().components | {"line": jl.Line("A", parts)})
    free = [Free(("line.parts.0.volume", "line.parts.1.volume"), (0.005, 0.1), ratios=(1.0, 0.5), name="V")]
    data = recording(PRESSURE + 1e4 * NOISE)
    fit = jl.fit(circuit, data, free=free, initial={"A.pressure": START})
    assert fit.parameters["V"].value == pytest.approx(
        K / closed_form(data.channels["A.pressure"], 1.0) * 0.02, rel=1e-5
    )
    assert float(fit.circuit["line.parts.1.volume"]) == pytest.approx(0.5 * fit.parameters["V"].value)


@pytest.mark.slow
def test_gain_and_offset_of_an_input_and_its_delay_are_found():
    times = np.linspace(0.0, 10.0, 384)
    flow = 1e-5 * (1.0 + np.sin(times))
    late = 0.4
    shown = 1e-5 * (
        times - (np.cos(times - late) - np.cos(late))
    )  # integral of the delayed flow, true from before t = 0
    pressure = START + K / VOLUME * (1.05 * shown + 2e-7 * times)
    data = jl.Recording(
        times, {"A.pressure": pressure + 1e3 * np.random.default_rng(1).standard_normal(384), "flow": flow}
    )
    data = jl.Recording(data.times[20:], {name: values[20:] for name, values in data.channels.items()})
    free = [
        Free("flow.gain", (0.5, 2.0), start=1.5),
        Free("flow.offset", (-1e-5, 1e-5), start=5e-6),
        Free("flow.delay", (0.0, 2.0), start=1.0),
        Free("initial.A.pressure", (1e5, 2e6)),
    ]
    fit = jl.fit(linear_line(), data, free=free, interpolation="cubic")
    assert fit.status == "converged"
    for name, truth in {"flow.gain": 1.05, "flow.offset": 2e-7, "flow.delay": late}.items():
        estimate = fit.parameters[name]
        assert abs(estimate.value - truth) < 4.0 * sd_of(estimate) + 2e-3 * abs(truth), name
    assert fit.parameters["flow.offset"].unit == "m^3/s" and fit.parameters["flow.delay"].unit == "s"


@pytest.mark.slow
def test_gain_offset_and_delay_of_a_sensor_are_found():
    """The pressure itself calibrates the sensor beside it; its delay shows in the curve of the pressure."""
    times = np.linspace(0.0, 10.0, 192)
    parts = linear_line().components | {"gauge": jl.PressureSensor("A", gain=1.0, delay=0.1)}
    flow = 1e-5 * np.cos(times)
    pressure = START + K / VOLUME * 1e-5 * np.sin(times)
    late = START + K / VOLUME * 1e-5 * np.sin(np.maximum(times - 0.3, 0.0))
    noise = np.random.default_rng(3).standard_normal((2, 192))
    channels = {"A.pressure": pressure + 100.0 * noise[0], "gauge": 1.04 * late + 2e4 + 100.0 * noise[1], "flow": flow}
    free = [
        Free("gauge.gain", (0.5, 2.0), start=0.8),
        Free("gauge.offset", (-1e5, 1e5), start=0.0),
        Free("gauge.delay", (0.05, 1.0), start=0.6),
        Free("initial.A.pressure", (1e5, 1e6)),
    ]
    circuit = jl.Circuit(linear_line().fluid, parts)
    fit = jl.fit(circuit, jl.Recording(times, channels), free=free)
    for name, truth in {"gauge.gain": 1.04, "gauge.offset": 2e4, "gauge.delay": 0.3}.items():
        assert fit.parameters[name].value == pytest.approx(truth, rel=1e-2), name  # the flow is joined linearly


@pytest.mark.slow
def test_a_steady_start_moves_with_the_parameters():
    """p0 = p_tank + Q0/G: the start alone fixes G, and its slope dp0/dG is that of the closed form."""
    circuit, flow = linear_line(1e-12), np.full(24, 1e-5)
    truth = circuit.replace({"leak.conductance": 2e-12})
    tank = float(truth.fluid.atmospheric_pressure)
    pressure = np.full(24, tank + 1e-5 / 2e-12)
    data = [recording(pressure + 1e4 * NOISE, flow, name="a"), recording(pressure + 1e4 * NOISE[::-1], flow, name="b")]
    free = [Free("leak.conductance", (2e-13, 2e-11), start=1e-12, transform="log")]
    fit = jl.fit(circuit, data, free=free, initial="steady", noise={"A.pressure": 1e4}, check=False)
    estimate = fit.parameters["leak.conductance"]
    mean = np.mean([d.channels["A.pressure"] for d in data])
    assert estimate.value == pytest.approx(1e-5 / (mean - tank), rel=1e-6)
    assert sd_of(estimate) == pytest.approx(2e-12**2 / 1e-5 * 1e4 / np.sqrt(48), rel=0.01)
    assert fit.runs[0].initial == "steady"


@pytest.mark.slow
def test_an_interrupted_problem_key_sees_every_change():
    from jaxlines.inference.checkpoint import problem_key

    def key(**changes) -> str:
        fit = jl.fit(linear_line(), recording(PRESSURE + changes.pop("shift", 0.0)), **(ARGUMENTS | changes))
        assert isinstance(fit.problem, JointProblem)
        return problem_key(fit.problem.with_sigma([np.ones((24, 1))]))

    first = key()
    assert key() == first
    assert len({first, key(shift=1.0), key(tolerance=1e-8), key(free=[dataclasses.replace(MODULUS, start=1e9)])}) == 4
