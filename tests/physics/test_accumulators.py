"""Accumulators against printed points, closed forms, a reference equation of state, and conservation of mass."""

from typing import Any

import jax
import numpy as np
import pytest
import test_components as components
from hypothesis import given, settings, strategies as st
from jax.flatten_util import ravel_pytree

import jaxlines as jl
from jaxlines.physics.accumulators import Accumulator, NitrogenAccumulator
from jaxlines.physics.component import Situation
from jaxlines.physics.containers import volume_at
from jaxlines.physics.nitrogen import IdealGas

ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
AIRY = jl.Oil(1.4e9, 850.0, air_fraction=0.02, polytropic_index=1.2, modulus_slope=8.0)
PARTS = {
    "accumulator": Accumulator("a", 1e-3, 6e6, 1.2),
    "nitrogen accumulator": NitrogenAccumulator("a", 2e-3, 6e6, 1e-9, 5.0),
    "adiabatic ideal gas": NitrogenAccumulator("a", 2e-3, 6e6, 1e-9, np.inf, gas=IdealGas()),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize(
    ("index", "compliance", "gas"),
    [(1.0, 2.5e-11, 5e-4), (1.2, 2.338463e-11, 5.612310e-4), (1.4, 2.176810e-11, 6.095068e-4)],
)
@pytest.mark.parametrize("width", [0.02, 0.05])
def test_polytropic_points_at_twice_the_precharge(index, compliance, gas, width):
    accumulator = Accumulator("a", 1e-3, 1e7, index, width)
    assert accumulator.gas_volume(2e7) == pytest.approx(gas, abs=6e-11)
    assert accumulator.compliance(2e7) == pytest.approx(compliance, abs=6e-18)
    exact = 1e-3 * 0.5 ** (1 / index) / (index * 2e7)
    assert accumulator.compliance(2e7) == pytest.approx(exact, rel=1e-6)
    assert accumulator.capacity(ARTICLE, 2e7) == pytest.approx(850 * exact, rel=1e-6)


@settings(max_examples=50, deadline=None)
@given(st.floats(1e3, 5e7), st.floats(1e3, 5e7), st.floats(1.0, 1.6), st.floats(1e-3, 0.05))
def test_oil_in_an_accumulator_grows_with_pressure(first, second, index, width):
    accumulator = Accumulator("a", 1e-3, 1e7, index, width)
    low, high = sorted((first, second))
    assert 0.0 <= accumulator.oil_volume(low) <= accumulator.oil_volume(high) < 1e-3
    assert accumulator.compliance(low) >= 0.0
    if high < 0.5e7:
        assert accumulator.oil_volume(high) < 1e-3 * 1e-5
        assert accumulator.capacity(AIRY, high) < 1e-3 * accumulator.capacity(AIRY, 1.5e7)


@pytest.mark.parametrize("oil", [AIRY, ARTICLE])
def test_capacity_is_the_derivative_of_mass(oil):
    accumulator = Accumulator("a", 1e-3, 1e7, 1.3)
    for p in (9.8e6, 1e7, 1.03e7, 2e7, 4e7):
        h = 1e-4 * p
        mass = [accumulator.oil_mass(oil, p + k * h) for k in (-2, -1, 1, 2)]
        slope = (8 * (mass[2] - mass[1]) - (mass[3] - mass[0])) / (12 * h)
        assert accumulator.capacity(oil, p) == pytest.approx(slope, rel=1e-6)


def test_filling_a_polytropic_accumulator_at_constant_flow():
    """p = p_i (1 - Q t/V_i)^-n."""
    parts = {"pump": jl.FlowSource("a", 1e-4), "accumulator": Accumulator("a", 1e-3, 1e7, 1.3)}
    times = np.linspace(0, 4, 21)
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), times, initial={"a.pressure": 1.5e7}, tolerance=1e-10)
    gas = 1e-3 * (1e7 / 1.5e7) ** (1 / 1.3)
    np.testing.assert_allclose(sim["a.pressure"], 1.5e7 * (1 - 1e-4 * times / gas) ** -1.3, rtol=1e-8)
    assert sim["a.pressure"][-1] > 3.5e7


def charged(accumulator, oil, times, initial, vessel=None, pump: Any = 0.0, **parts):
    """A simulated line with an accumulator and a pump at one node."""
    vessel = jl.Vessel(1e-3, 2e9) if vessel is None else vessel
    circuit = {"pump": jl.FlowSource("a", pump), "line": jl.Line("a", vessel), "accumulator": accumulator, **parts}
    return jl.simulate(jl.Circuit(oil, circuit), times, initial=initial, tolerance=1e-10)


def oil_mass(sim, accumulator, oil, vessel):
    """Of line and accumulator [kg]."""
    p = sim["a.pressure"]
    line = oil.density_at(p) * volume_at(vessel, oil, p)
    if isinstance(accumulator, Accumulator):
        return line + accumulator.oil_mass(oil, p)
    gas = sim["accumulator.gas_volume"], sim["accumulator.gas_temperature"]
    return line + accumulator.oil_mass(oil, *gas)


@pytest.mark.parametrize("name", ["accumulator", "nitrogen accumulator"])
def test_mass_is_conserved_over_a_cycle(name):
    """What is in line and accumulator changes by what was pumped in, in every part of a charge and discharge."""
    accumulator, vessel = PARTS[name], jl.Vessel(1e-3, 2e9)
    times = np.linspace(0, 1, 2001)
    sim = charged(accumulator, AIRY, times, {"a.pressure": 8e6}, vessel, jl.Sine(0.0, 5e-4, 1.0))
    flow = AIRY.density_at(sim["a.pressure"]) * 5e-4 * np.sin(2 * np.pi * times)
    pumped = np.cumsum(flow[:-2:2] + 4 * flow[1:-1:2] + flow[2::2]) * (times[1] - times[0]) / 3
    mass = oil_mass(sim, accumulator, AIRY, vessel)[::2]
    assert np.ptp(mass) > 0.1
    np.testing.assert_allclose(mass[1:] - mass[0], pumped, atol=3e-8 * np.ptp(mass))


def test_emptied_and_refilled():
    """Drained below its precharge it is empty, at no less than zero; no oil is lost there and back."""
    accumulator, vessel = PARTS["nitrogen accumulator"], jl.Vessel(1e-3, 2e9)
    other = {"valve": jl.Orifice("a", "b", 2e-5), "other": jl.Line("b", jl.Vessel(2.0))}

    def oil_after(initial):
        sim = charged(accumulator, AIRY, np.linspace(0, 3, 301), initial, vessel, **other)
        total = oil_mass(sim, accumulator, AIRY, vessel) + AIRY.density_at(sim["b.pressure"]) * 2.0
        assert np.ptp(total) < 1e-7 * 850 * 4e-4
        end = {name: sim[name][-1] for name in ("a.pressure", "accumulator.gas_volume", "accumulator.gas_temperature")}
        return 2e-3 - sim["accumulator.gas_volume"], end

    oil, end = oil_after({"a.pressure": 8e6, "b.pressure": 1e6})
    assert oil[0] > 4e-4 and np.all(oil > -1e-12) and oil[-1] < 1e-8
    assert end["a.pressure"] < 0.9 * 6e6
    oil, end = oil_after({**end, "b.pressure": 8e6})
    assert oil[0] < 1e-8 and oil[-1] > 4e-4
    assert end["a.pressure"] == pytest.approx(8e6, rel=5e-2)


@pytest.mark.parametrize("ratio", [1.3, 1.4])
def test_adiabatic_ideal_gas(ratio):
    """p V^gamma and T V^(gamma - 1) stay as they are, whatever comes and goes."""
    gas = IdealGas(heat_ratio=ratio)
    accumulator = NitrogenAccumulator("a", 1e-3, 1e7, 1e-9, np.inf, wall_temperature=300.0, gas=gas)
    sim = charged(accumulator, AIRY, np.linspace(0, 1, 51), {"a.pressure": 1.2e7}, pump=jl.Sine(0.0, 1e-3, 1.0))
    volume, temperature = sim["accumulator.gas_volume"], sim["accumulator.gas_temperature"]
    assert np.max(volume) > 1.5 * np.min(volume)
    pressure = np.asarray(accumulator.gas_pressure(volume, temperature))
    np.testing.assert_allclose(pressure * volume**ratio, pressure[0] * volume[0] ** ratio, rtol=1e-7)
    np.testing.assert_allclose(temperature * volume ** (ratio - 1), 300.0 * volume[0] ** (ratio - 1), rtol=1e-7)
    assert pressure[0] == pytest.approx(1.2e7, rel=1e-12)


def test_isothermal_ideal_gas():
    """tau -> 0: p V stays as it is, to within tau."""
    accumulator = NitrogenAccumulator("a", 1e-3, 1e7, 1e-9, 1e-4, gas=IdealGas())
    sim = charged(accumulator, AIRY, np.linspace(0, 1, 51), {"a.pressure": 1.2e7}, pump=jl.Sine(0.0, 1e-3, 1.0))
    volume, temperature = sim["accumulator.gas_volume"], sim["accumulator.gas_temperature"]
    pressure = np.asarray(accumulator.gas_pressure(volume, temperature))
    assert np.max(volume) > 1.5 * np.min(volume)
    np.testing.assert_allclose(pressure * volume, 1e7 * 1e-3, rtol=1e-3)
    np.testing.assert_allclose(temperature, 293.15, atol=0.2)


@pytest.mark.parametrize(
    ("pressure", "precharge", "ratio", "temperature"), [(1.05e7, 1e7, 0.5, 420.424), (2e7, 1e6, 2.0, 205.550)]
)
def test_adiabatic_nitrogen_as_a_reference_equation_of_state(pressure, precharge, ratio, temperature):
    """Temperature [K] on the isentrope from 293.15 K at half or twice the volume, by CoolProp 8.0.0."""
    accumulator = NitrogenAccumulator("a", 1e-2, precharge, 1e-8, np.inf)
    first = float(accumulator.start(Situation(ARTICLE, {"node": pressure}, {}, {}))["gas_volume"])
    pump, times = (1 - ratio) * first / 10.0, np.linspace(0, 12, 241)
    sim = charged(accumulator, ARTICLE, times, {"a.pressure": pressure}, jl.Vessel(1e-3), pump)
    order = np.argsort(sim["accumulator.gas_volume"])
    volumes, temperatures = sim["accumulator.gas_volume"][order], sim["accumulator.gas_temperature"][order]
    assert np.interp(ratio * first, volumes, temperatures) == pytest.approx(temperature, rel=8e-3)


@pytest.mark.parametrize("temperature", [200.0, 293.15, 360.0])
def test_gas_cools_to_its_wall(temperature):
    """T' = (T_w - T)/tau while the inlet is shut; the oil gives way by its own compressibility."""
    accumulator = NitrogenAccumulator("a", 1e-3, 1e7, 0.0, 2.0)
    state = {"gas_volume": 6e-4, "gas_temperature": temperature}
    for oil, share in ((ARTICLE, 1e-12), (AIRY, 0.02)):
        rate = accumulator.evaluate(Situation(oil, {"node": 2e7}, state, {})).rate
        assert float(rate["gas_temperature"]) == pytest.approx((293.15 - temperature) / 2.0, rel=share, abs=1e-12)
        assert np.sign(rate["gas_volume"]) == (0 if oil is ARTICLE else np.sign(293.15 - temperature))


def test_starts_in_equilibrium():
    accumulator = NitrogenAccumulator("a", 1e-3, 1e7, 1e-9, 5.0, 300.0, 300.0)

    @jax.jit
    def seen(p):
        start = accumulator.start(Situation(AIRY, {"node": p}, {}, {}))
        done = accumulator.evaluate(Situation(AIRY, {"node": p}, start, {}))
        return start["gas_volume"], start["gas_temperature"], done.rate["gas_volume"], done.flow["node"] / 850

    volume, _, rate, flow = seen(2e7)
    assert float(volume) == pytest.approx(1e-3 * 111.916 / 213.096, rel=1e-5)
    assert max(abs(rate), abs(flow)) < 1e-12 * 1e-9 * 2e7
    volume, temperature, rate, flow = seen(4e6)
    assert float(volume) == 1e-3 and float(temperature) == 300.0
    assert max(abs(rate), abs(flow)) < 1e-20
    slope = jax.jit(jax.grad(lambda p: seen(p)[0]))(2e7)
    assert float(slope) == pytest.approx(float(seen(2e7 + 1e3)[0] - seen(2e7 - 1e3)[0]) / 2e3, rel=1e-6)


def test_jacobian_of_an_accumulator_with_ideal_gas(monkeypatch):
    """At the points of all components, among which the other accumulators are."""
    monkeypatch.setitem(components.PARTS, "ideal gas", PARTS["adiabatic ideal gas"])
    components.test_jacobian_in_all_numbers_and_potentials("ideal gas")


@pytest.mark.parametrize("name", ["nitrogen accumulator", "adiabatic ideal gas"])
def test_jacobian_in_states_of_the_gas(name):
    """At full, empty, hot and cold, against differences."""
    part, scale = PARTS[name], {"gas_volume": 1e-3, "gas_temperature": 300.0}
    states = [(8e-4, 293.15), (5e-4, 250.0), (9.99e-4, 400.0), (1e-3, 293.15), (3e-4, 330.0)]

    def situation(p, volume, temperature):
        return Situation(AIRY, {"node": p}, {"gas_volume": volume, "gas_temperature": temperature}, {})

    _, restore = ravel_pytree((part, situation(1e6, 1e-3, 300.0)))
    function = jax.jit(lambda x: components.results(*restore(x)))
    jacobian = jax.jit(jax.jacfwd(lambda x: components.results(*restore(x))))
    for volume, temperature in states:
        balance = float(part.gas_pressure(volume, temperature))
        for p in (1e6, balance, 1.5e7):
            x = np.asarray(ravel_pytree((part, situation(p, volume, temperature)))[0])
            size = np.asarray(ravel_pytree((part, Situation(AIRY, {"node": 1e6}, scale, {})))[0])
            size = np.where(np.isinf(size), 1.0, np.where(size == 0.0, 1e-3, np.abs(size)))
            exact = np.asarray(jacobian(x))
            assert np.all(np.isfinite(exact))
            error = np.abs(exact - components.differences(function, x, 3e-4 * size)) * size
            assert np.all(error <= 1e-6 * np.max(np.abs(exact) * size, axis=1, keepdims=True)), (volume, p)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Accumulator("a", 10.0, 100.0), r"precharge_pressure must be .* 100 Pa: it is an absolute pressure"),
        (lambda: Accumulator("a", 20000.0, 1e7), r"volume must be .* got 20000 m.3: was it given in litres"),
        (lambda: Accumulator("a", 1e-3, 1e7, 1.2, 5.0), r"switch_width must be .* got 5: was it given in percent"),
        (lambda: NitrogenAccumulator("a", 1e-3, 1e7, 0.5, 1.0), r"conductance must be .* got 0.5 .*L/\(min bar\)"),
        (lambda: NitrogenAccumulator("a", 1e-3, 1e7, 1e-9, 0.0), r"thermal_time_constant must be .* got 0 s"),
        (lambda: NitrogenAccumulator("a", 1e-3, 1e7, 1e-9, 1.0, 20.0), r"wall_temperature .* 20 K: was .* Celsius"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
