"""Check, relief, counterbalance and reducing valves: rated points, saturation, lag, and at work in a circuit."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import root_scalar
from test_resistances import ARTICLE, check_batch, check_conservation, check_derivatives, through

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.pressure_valves import (
    CheckValve,
    CounterbalanceValve,
    ReducingValve,
    ReliefValve,
    pressure_opening,
)

RELIEF = ReliefValve("a", "b", 1e-3, 3e6, 8e6)
PARTS = {
    "check": CheckValve("a", "b", 1e-3, 3e6, 8e6),
    "check with a poppet": CheckValve("a", "b", 1e-3, 1e5, 8e5, time_constant=3e-3),
    "relief": RELIEF,
    "counterbalance": CounterbalanceValve("a", "b", "p", 1e-3, 3e6, 8e6, pilot_ratio=1.0),
    "reducing": ReducingValve("a", "b", "d", 1e-3, 6.1e6, 4e6),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", ["check with a poppet"])
def test_derivatives_and_conservation(name):
    check_derivatives(PARTS[name])
    check_conservation(PARTS[name]) if name != "check with a poppet" else None
    check_batch(PARTS[name])


def test_opening_follows_the_published_straight_line():
    """clip((p - p_set)/(p_full - p_set), 0, 1) as the rounding goes to nothing; exact at both ends always."""
    p = np.linspace(1e6, 5e6, 81)
    sharp = np.clip((p - 2e6) / 2e6, 0.0, 1.0)
    np.testing.assert_allclose(pressure_opening(p, 2e6, 4e6, 1e-6), sharp, atol=2e-6)
    np.testing.assert_allclose(pressure_opening(p, 2e6, 4e6, 0.1), sharp, atol=0.1)
    ends = pressure_opening(np.array([1e6, 2e6, 3e6, 4e6, 5e6]), 2e6, 4e6, 0.1)
    np.testing.assert_allclose(ends, [0, 0, 0.5, 1, 1], atol=1e-15)


@pytest.mark.parametrize("name", ["check", "check with a poppet", "relief", "counterbalance", "reducing"])
def test_saturated_valves_have_the_gradients_of_closed_and_open_ones(name):
    """Closed: steady opening and its slope are exactly zero; open: it is 1 and does not move."""
    part = PARTS[name]

    def opening(p):
        if isinstance(part, CounterbalanceValve):
            return part.steady_opening(p, 1e5, 1e5)
        return 1.0 - part.steady_opening(p) if isinstance(part, ReducingValve) else part.steady_opening(p)

    shut, wide = opening(jnp.array(5e4)), opening(jnp.array(3e7))
    assert float(shut) == pytest.approx(0.0, abs=1e-15) and float(jax.grad(opening)(5e4)) == 0.0
    assert float(wide) == pytest.approx(1.0, abs=1e-15)
    assert float(jax.grad(opening)(3e7)) == 0.0
    middle = float(jax.grad(opening)(5.5e6 if "poppet" not in name else 4.5e5))
    assert middle > 1e-8


def test_rated_points_and_tightness():
    valve = ReliefValve("a", "b", 1e-3, set_pressure=2e7, full_flow_pressure=2.1e7)
    opening = {rise: valve.steady_opening(rise) for rise in (1e7, 1.999e7, 2.05e7, 2.1e7, 3e7)}
    expected = [0.0, 0.0, 0.5, 1.0, 1.0]
    np.testing.assert_allclose(list(opening.values()), expected, atol=1e-15)
    assert through(valve, 2.11e7, 1e5, state={"opening": opening[2.1e7]}) == pytest.approx(1e-3, rel=1e-6)
    assert through(valve, 2.01e7, 1e5, state={"opening": opening[1.999e7]}) == 0.0
    check = CheckValve("a", "b", 1e-3, 0.5e5, 2e5, transition=10.0)
    assert through(check, 3e5, 1e5) == pytest.approx(1e-3, rel=1e-6)
    assert through(check, 1.5e5, 1e5) == 0.0 and through(check, 1e5, 9e6) == 0.0
    lighter = jl.Oil(1.379e9, 425.0, mass="article")
    assert through(check, 3e5, 1e5, lighter) == pytest.approx(1e-3 / np.sqrt(2), rel=1e-6)  # as mass flow over 850


@settings(max_examples=40, deadline=None)
@given(st.floats(1e4, 3e7), st.floats(1e4, 3e7), st.floats(0.0, 1.0))
def test_pressure_valves_are_passive_and_check_valves_one_way(p_a, p_b, opening):
    assert through(RELIEF, p_a, p_b, state={"opening": opening}) * (p_a - p_b) >= 0.0
    forward, more = through(PARTS["check"], p_a, p_b), through(PARTS["check"], p_a + 1e5, p_b)
    assert forward >= 0.0 and more >= forward
    if p_a - p_b <= 3e6:
        assert forward == 0.0


def test_openings_lag():
    """At constant pressures x goes to its steady value as exp(-t/tau)."""
    ends = {"high": jl.PressureSource("a", 1e7 + 1e5), "low": jl.Tank("b", 1e5), "pilot": jl.PressureSource("p", 1e5)}
    valves = {
        "relief": ReliefValve("a", "b", 1e-3, 9e6, 11e6, time_constant=0.02),
        "check": CheckValve("a", "b", 1e-3, 9e6, 11e6, time_constant=0.02),
        "hold": CounterbalanceValve("a", "b", "p", 1e-3, 9e6, 11e6, time_constant=0.02),
        "reduce": ReducingValve("b", "a", "b", 1e-3, 11e6, 2e6, time_constant=0.02),
    }
    times = np.linspace(0.0, 0.1, 6)
    circuit, start = jl.Circuit(ARTICLE, {**ends, **valves}), {f"{name}.opening": 0.0 for name in valves}
    sim = jl.simulate(circuit, times, initial=start, tolerance=1e-10)
    rest = jl.simulate(circuit, times)
    for name in valves:
        np.testing.assert_allclose(sim[f"{name}.opening"], 0.5 * (1 - np.exp(-times / 0.02)), atol=1e-8)
        np.testing.assert_allclose(rest[f"{name}.opening"], 0.5, atol=1e-9)


@pytest.mark.parametrize("flow", [2e-4, 5e-4, 8e-4])
def test_relief_valve_limits_the_pressure_to_set_and_override(flow):
    relief = ReliefValve("P", "T", 1e-3, 2e7, 2.1e7, rated_density=850.0)
    parts = {"pump": jl.FlowSource("P", flow), "relief": relief, "tank": jl.Tank("T", 1e5)}
    circuit = jl.Circuit(ARTICLE, {**parts, "line": jl.Line("P", jl.Vessel(5e-3))})
    times = np.linspace(0.0, 2.0, 201)
    sim = jl.simulate(circuit, times, initial={"P.pressure": 1e6}, tolerance=1e-9)

    def surplus(rise):  # in the straight part of the opening
        return flow - 1e-3 * np.sqrt(rise / 2.1e7) * ((rise - 2e7) / 1e6 - 0.1) / 0.8

    rise = root_scalar(surplus, bracket=(2.01e7, 2.1e7), xtol=1e-2).root
    assert sim["P.pressure"][-1] == pytest.approx(1e5 + rise, rel=1e-6)
    assert sim["P.pressure"].max() < 1e5 + 2.3e7
    before = sim["P.pressure"] < 1.9e7  # tight until it opens: dp/dt = K Q
    ramp = 1e6 + 1.379e9 / 5e-3 * flow * times
    np.testing.assert_allclose(sim["P.pressure"][before], ramp[before], rtol=1e-8)


def test_gradient_of_the_relieved_pressure():
    """A higher set pressure, with p_full moved along, lifts the pressure by nearly the same amount."""

    def settled(offset):
        relief = ReliefValve("P", "T", 1e-3, 2e7 + offset, 2.1e7 + offset)
        parts = {"pump": jl.FlowSource("P", 5e-4), "relief": relief, "tank": jl.Tank("T", 1e5)}
        circuit = jl.Circuit(ARTICLE, {**parts, "line": jl.Line("P", jl.Vessel(5e-3))})
        options: dict[str, Any] = {
            "initial": {"P.pressure": 2.04e7},
            "max_step": 0.01,
            "gradient": "forward",
            "tolerance": 1e-9,
        }
        return jl.simulate(circuit, [0.0, 0.3], outputs=["P.pressure"], **options)["P.pressure"][-1]

    slope, step = float(jax.jacfwd(settled)(0.0)), 1e3
    assert slope == pytest.approx((settled(step) - settled(-step)) / (2 * step), rel=1e-5)
    assert slope == pytest.approx(1.0, rel=0.01)


def test_check_valve_rectifies():
    """A volume behind it is filled to the peak less the cracking pressure and is not emptied again."""
    source = jl.PressureSource("S", jl.Sine(mean=5e6, amplitude=3e6, frequency=2.0))
    check = CheckValve("S", "A", 1e-3, 2e5, 4e5, time_constant=1e-3)
    circuit = jl.Circuit(ARTICLE, {"source": source, "check": check, "line": jl.Line("A", jl.Vessel(1e-3))})
    times = np.linspace(0.0, 2.0, 401)
    sim = jl.simulate(circuit, times, initial={"A.pressure": 1e5}, tolerance=1e-8)
    assert sim["A.pressure"][-1] == pytest.approx(8e6 - 2e5, abs=1e5)
    filled = sim["A.pressure"][times > 0.6]
    assert np.ptp(filled) < 1e5


def reduced(supply, demand):
    """Outlet pressure and opening behind a reducing valve for 6 MPa, at a supply pressure and a flow that is drawn."""
    valve = ReducingValve("S", "A", "T", 1e-3, 6e6, 5e5)
    parts = {"supply": jl.PressureSource("S", supply), "tank": jl.Tank("T", 1e5), "valve": valve}
    parts |= {"demand": jl.FlowSource("A", -demand), "line": jl.Line("A", jl.Vessel(2e-3))}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), [0.0, 1.0, 2.0], initial={"A.pressure": 1e6}, tolerance=1e-9)
    return sim["A.pressure"][-1] - 1e5, sim["valve.opening"][-1]


@pytest.mark.parametrize("supply", [9e6, 2e7])
def test_reducing_valve_holds_its_outlet(supply):
    """Within its band below the set pressure, whatever supply and flow; where the flow through the opening is drawn."""
    for demand in (1e-4, 5e-4):
        held, opening = reduced(supply, demand)
        assert 5.5e6 < held < 6e6
        passed = opening * 1e-3 * np.sqrt((supply - held - 1e5) / 1e6)
        assert passed == pytest.approx(demand, rel=1e-5)
        assert opening == pytest.approx(((6e6 - held) / 5e5 - 0.1) / 0.8, abs=1e-6) or opening < 0.125


def test_reducing_valve_is_fully_open_when_the_supply_is_too_low():
    held, opening = reduced(4e6, 1e-3)
    assert opening == pytest.approx(1.0, abs=1e-12)
    assert held == pytest.approx(4e6 - 1e5 - 1e6, rel=1e-4)  # the rated pressure drop at the rated flow


def lowering(pilot):
    """A load of 12 MPa on a volume, held by a counterbalance valve, with a pilot pressure."""
    valve = CounterbalanceValve("L", "T", "pilot", 5e-4, 1.6e7, 1.8e7, pilot_ratio=4.0)
    parts = {"tank": jl.Tank("T", 1e5), "pilot line": jl.PressureSource("pilot", pilot), "valve": valve}
    parts |= {"load": jl.Line("L", jl.Vessel(0.05))}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), np.linspace(0, 3, 11), initial={"L.pressure": 1.21e7}, tolerance=1e-9)
    return sim["L.pressure"]


def test_counterbalance_valve_holds_a_load_until_it_is_piloted():
    """It opens where p_load + 4 p_pilot - 5 p_tank passes 16 MPa: with 12 MPa of load at 1 MPa of pilot."""
    np.testing.assert_array_equal(lowering(1e5), 1.21e7)
    np.testing.assert_array_equal(lowering(1e5 + 0.99e6), 1.21e7)
    open_wide = lowering(1e5 + 5e6)
    assert open_wide[1] < 6e6 and open_wide[-1] == pytest.approx(1e5, rel=0.01)
    partly = lowering(1e5 + 1.6e6)  # falls until the load is 16 - 4 * 1.6 = 9.6 MPa, where the valve closes again
    assert partly[-1] == pytest.approx(1e5 + 9.6e6, rel=0.01)
    assert np.all(np.diff(partly) <= 0.0)


def test_back_pressure_closes_a_counterbalance_valve():
    valve = CounterbalanceValve("a", "b", "p", 5e-4, 1.6e7, 1.8e7, pilot_ratio=4.0)
    assert valve.steady_opening(1.7e7, 0.0, 0.0) == pytest.approx(0.5)
    assert valve.steady_opening(1.7e7 + 5e5, 1e5, 0.0) == pytest.approx(0.5)  # (1 + R) times the back pressure
    assert valve.steady_opening(1.3e7, 0.0, 1e6) == pytest.approx(0.5)


def test_a_counterbalance_valve_takes_no_pilot_flow():
    at = Situation(ARTICLE, {"a": 1e7, "b": 1e5, "pilot": 3e6}, {"opening": 0.5}, {})
    assert set(PARTS["counterbalance"].evaluate(at).flow) == {"a", "b"}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ReliefValve("a", "b", 1e-3, 2e7, 1.9e7), "full_flow_pressure must be above set_pressure.*swapped"),
        (lambda: CheckValve("a", "b", 1e-3, 2e5, 1e5), "full_opening_pressure must be above cracking_pressure"),
        (
            lambda: CounterbalanceValve("a", "b", "p", 1e-3, 2e7, 2e7),
            "full_opening_pressure must be above set_pressure",
        ),
        (lambda: ReliefValve("a", "b", 60.0, 2e7, 2.1e7), "rated_flow must be .*was it given in L/min"),
        (lambda: ReducingValve("a", "b", "d", 1e-3, 6e6, 5.0), "pressure_band must be .*was it given in bar"),
        (lambda: ReliefValve("a", "b", 1e-3, 2e7, 2.1e7, width=5.0), "width must be .*was it given in percent"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
