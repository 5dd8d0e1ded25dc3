"""2/2 and 4/3 valves: Hopsan's record, rated points, laps and deadband, step responses, and a cylinder-like load."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from test_resistances import ARTICLE, check_batch, check_conservation, check_derivatives, through

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.valves import ProportionalValve43, Valve22, beyond_deadband

HOPSAN = Path(__file__).parents[2] / "../shared/reference/hopsan/Hydraulic22ValveTest.hvd"
LAPS: dict[str, Any] = {"lap_supply_a": 0.1, "lap_supply_b": 0.12, "lap_a_tank": -0.05, "lap_b_tank": 0.05}
GAINS: dict[str, Any] = {"gain_supply_a": 1.1, "gain_supply_b": 0.5, "gain_a_tank": 0.9, "gain_b_tank": 0.6}
PARTS = {
    "2/2": Valve22("a", "b", 0.7, 1e-5),
    "2/2 second order": Valve22("a", "b", 0.7, 1e-5, order="second", rate_limit=30.0),
    "4/3": ProportionalValve43("s", "t", "a", "b", 0.3, 1e-3, null_leakage=2e-12, deadband=0.05, **LAPS, **GAINS),
    "4/3 first order": ProportionalValve43("s", "t", "a", "b", 0.3, 1e-3, order="first", rate_limit=20.0),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", ["2/2 second order", "4/3 first order"])
def test_derivatives_and_conservation(name):
    check_derivatives(PARTS[name])
    check_conservation(PARTS[name])
    check_batch(PARTS[name])


def test_record_of_hopsan():
    """C_q 0.67, spool and stroke of 10 mm, all of the circumference, rho 890, 1 to 0.1 MPa, w 100 rad/s, zeta 1."""
    if not HOPSAN.exists():
        pytest.skip(f"the reference data {HOPSAN.name} is not beside the project")
    time, flow, stroke, command = np.loadtxt(HOPSAN, delimiter=",")[:, :4].T
    oil = jl.Oil(1.0e9, 890.0, 30e-6, mass="article")
    valve = Valve22("P", "T", "stroke", np.pi * 1e-4, 0.67, 100.0, width=1e-6, transition=1.0, order="second")
    parts = {"supply": jl.PressureSource("P", 1e6), "tank": jl.Tank("T", 1e5), "valve": valve}
    circuit = jl.Circuit(oil, parts)
    inputs = {"stroke": np.clip(command / 0.01, 0.0, 1.0)}
    outputs = ["valve.spool", "valve.a.flow"]
    sim = jl.simulate(circuit, time, inputs, initial={"valve.spool": 1.0}, outputs=outputs, max_step=0.01)
    np.testing.assert_allclose(sim["valve.a.flow"][0], 0.00946599, rtol=1e-6)
    np.testing.assert_allclose(sim["valve.spool"], stroke / 0.01, atol=1e-3)
    # Its flow meter is a time step of 1 ms late, in which the stroke moves by 1 % while the command ramps.
    np.testing.assert_allclose(sim["valve.a.flow"][1:], flow[1:], atol=0.0105 * 0.00946599)
    steady = (time > 2.0) & (time < 5.0) | (time > 6.5)
    np.testing.assert_allclose(sim["valve.a.flow"][steady], flow[steady], atol=1e-6 * 0.00946599)


def test_flow_of_the_2_2_valve_is_tight_when_closed():
    valve = Valve22("a", "b", 0.0, 1e-5)
    full = 0.62 * 1e-5 * np.sqrt(2 * 5e6 / 850.0)
    at = [float(through(valve, 6e6, 1e6, state={"spool": x})) for x in (-0.1, 0.0, 0.5, 1.0, 1.2)]
    np.testing.assert_allclose(at, [0.0, 0.0, 0.5 * full, full, full], rtol=2e-6)
    assert at[0] == at[1] == 0.0


def test_lag_of_the_2_2_valve():
    times = np.linspace(0.0, 0.1, 11)
    valve = Valve22("P", "T", jl.Step(0.0, 0.8, 0.02), 1e-5, natural_frequency=50.0)
    parts = {"supply": jl.PressureSource("P", 1e6), "tank": jl.Tank("T", 1e5), "valve": valve}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), times, tolerance=1e-10)
    expected = 0.8 * (1 - np.exp(-50.0 * np.maximum(times - 0.02, 0.0)))
    np.testing.assert_allclose(sim["valve.spool"], expected, atol=1e-9)


def test_2_2_valve_empties_a_volume_when_it_opens():
    """sqrt(p - p_t) falls linearly once the valve is open, at K C_d A sqrt(2/rho)/2."""
    valve = Valve22("A", "T", 1.0, 2e-6, natural_frequency=1e5, transition=1.0)
    parts = {"tank": jl.Tank("T", 1e5), "valve": valve, "line": jl.Line("A", jl.Vessel(1e-3))}
    times = np.array([0.0, 0.01, 0.03, 0.06])
    start = {"A.pressure": 2e7, "valve.spool": 1.0}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), times, initial=start, tolerance=1e-9)
    root = np.sqrt(1.99e7) - 1.379e12 * 0.62 * 2e-6 * np.sqrt(2 / 850.0) * times / 2
    assert root[-1] > 0.2 * root[0]
    np.testing.assert_allclose(sim["A.pressure"], 1e5 + root**2, rtol=1e-6)
    shut = jl.Circuit(ARTICLE, parts).replace({"valve.command": 0.0})
    kept = jl.simulate(shut, times, initial={"A.pressure": 2e7})
    np.testing.assert_array_equal(kept["A.pressure"], 2e7)


def flows(valve, spool, p_a=4.5e6, p_b=4.5e6):
    potential = {"supply": 8e6, "tank": 1e6, "a": p_a, "b": p_b}
    at = Situation(ARTICLE, potential, {"spool": spool, "spool_rate": 0.0}, {"command": 0.0})
    return {name: float(flow) / 850.0 for name, flow in valve.evaluate(at).flow.items()}


def proportional(**options):
    return ProportionalValve43("s", "t", "a", "b", 0.0, 1e-3, 7e6, underlap=1e-6, **options)


def test_rated_flow_and_gains_of_the_4_3_valve():
    for spool, sign in ((1.0, 1.0), (-1.0, -1.0)):
        flow = flows(proportional(**{k: abs(v) for k, v in LAPS.items()}), spool)
        np.testing.assert_allclose([flow["a"], flow["b"]], [sign * 1e-3, -sign * 1e-3], rtol=1e-5)
    forward, reverse = (flows(proportional(**GAINS), x) for x in (1.0, -1.0))
    np.testing.assert_allclose([forward["a"], forward["b"]], [1.1e-3, -0.6e-3], rtol=1e-5)
    np.testing.assert_allclose([reverse["a"], reverse["b"]], [-0.9e-3, 0.5e-3], rtol=1e-5)


def test_each_land_opens_after_its_lap():
    """supply -> a after 0.1, b -> tank after 0.05; a -> tank is open by 0.05 at null."""
    valve = proportional(**LAPS)
    assert flows(valve, 0.08)["a"] == pytest.approx(0.0, abs=1e-9)
    assert flows(valve, 0.08)["b"] == pytest.approx(-1e-3 * 0.03 / 0.95, rel=1e-4)
    assert flows(valve, 0.0)["a"] == pytest.approx(-1e-3 * 0.05 / 1.05, rel=1e-4)
    assert flows(valve, 0.0)["b"] == pytest.approx(0.0, abs=1e-9)
    assert flows(valve, -0.11)["b"] == pytest.approx(0.0, abs=1e-9)


def test_null_leakage_of_the_4_3_valve():
    flow = flows(proportional(**{k: 0.2 for k in LAPS}, null_leakage=3e-12), 0.0)
    assert flow["tank"] == pytest.approx(3e-12 * 7e6, rel=1e-3) and flow["a"] == 0.0


@settings(max_examples=50, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(0.0, 0.5), st.floats(1e-4, 0.05))
def test_deadband(command, deadband, width):
    left = beyond_deadband(command, deadband, width)
    sharp = np.sign(command) * max(abs(command) - deadband, 0.0) / (1.0 - deadband)
    assert left == -beyond_deadband(-command, deadband, width)
    assert left == pytest.approx(sharp, abs=width)
    if deadband > width and abs(command) < deadband - width:
        assert left == 0.0
    assert beyond_deadband(command, 0.0, width) == pytest.approx(command, abs=1e-15)
    assert beyond_deadband(1.0, deadband, width) == pytest.approx(1.0, rel=1e-12)


def test_4_3_valve_drives_a_loaded_motor_both_ways():
    """Steady speed D w = x Q_N sqrt((dp_PT - dp_load)/dp_N), at half stroke and against a load torque D dp_load."""
    oil = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")

    def settled(command):
        parts = {
            "supply": jl.PressureSource("P", 1.51e7),
            "tank": jl.Tank("T", 1e5),
            "valve": ProportionalValve43("P", "T", "A", "B", command, 1e-3, 7e6, underlap=1e-6, transition=10.0),
            "motor": jl.Motor("A", "B", "T", "shaft", 1e-4, 0.0),
            "load": jl.LoadTorque("shaft", -300.0 * np.sign(command)),
            "inertia": jl.Inertia("shaft", 0.5),
            "leak": jl.LaminarLeak("A", "B", 3e-11),
            "a": jl.Line("A", jl.Vessel(1e-3)),
            "b": jl.Line("B", jl.Vessel(1e-3)),
        }
        sim = jl.simulate(jl.Circuit(oil, parts), [0.0, 4.0], initial={"A.pressure": 7e6, "B.pressure": 7e6})
        return sim["shaft.speed"][-1], sim["A.pressure"][-1] - sim["B.pressure"][-1]

    for command in (0.5, -0.5):
        speed, drop = settled(command)
        through_valve = 0.5 * 1e-3 * np.sqrt((1.5e7 - 3e6) / 7e6)
        assert drop == pytest.approx(np.sign(command) * 3e6, rel=1e-4)
        assert speed == pytest.approx(np.sign(command) * (through_valve - 3e-11 * 3e6) / 1e-4, rel=1e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Valve22("a", "b", 50.0, 1e-5), "command must be .*was it given in percent"),
        (lambda: Valve22("a", "b", 0.5, 1e-5, order="zeroth"), "order must be 'first' or 'second', got 'zeroth'"),
        (lambda: proportional(order="zeroth"), "order must be 'first' or 'second'"),
        (lambda: proportional(lap_a_tank=5.0), "lap_a_tank must be .*was it given in percent"),
        (lambda: proportional(deadband=5.0), "deadband must be .*was it given in percent"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
