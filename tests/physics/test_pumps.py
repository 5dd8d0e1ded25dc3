"""Pumps: Wilson's losses from a rated point, ripple of pistons, compensator, circuits calculated by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import root_scalar
from test_resistances import check_batch, check_conservation, check_derivatives

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.machine_losses import WilsonLosses
from jaxlines.physics.pressure_valves import ReliefValve
from jaxlines.physics.pumps import PressureCompensatedPump, Pump, kinematic_ripple, loss_flow

# The pump of a public library's example: D 1.2e-4 m^3/rad, efficiencies 0.9 at 10 MPa, 2000 rpm and 0.04 Pa s.
SPEED = 2000 * 2 * np.pi / 60
LOSSES = WilsonLosses.from_efficiencies(0.9, 0.9, 1e7, SPEED, 0.04)
OIL = jl.Oil(1.4e9, 870.0, 0.04 / 870.0, mass="article")
PUMP = Pump("inlet", "outlet", 1.2e-4, SPEED, LOSSES)
PARTS = {
    "pump": PUMP,
    "pump with ripple": Pump("i", "o", 1.2e-4, 100.0, LOSSES, ripple_amplitudes=[0.01, -0.03], pistons=7),
    "compensated pump": PressureCompensatedPump("i", "o", 1e-5, 150.0, 2e6, 7e6, losses=LOSSES),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def delivered(pump, p_inlet, p_outlet, speed=SPEED, **state):
    """Volume flow into the outlet [m^3/s] in a fluid of constant density."""
    at = Situation(OIL, {"inlet": p_inlet, "outlet": p_outlet}, state, {"speed": speed})
    return np.asarray(pump.evaluate(at).flow["outlet"]) / 870.0


@pytest.mark.parametrize("name", ["pump with ripple"])
def test_derivatives_and_conservation(name):
    check_derivatives(PARTS[name])
    check_conservation(PARTS[name])
    check_batch(PARTS[name])


def test_the_rated_point_has_the_rated_efficiencies():
    assert delivered(PUMP, 1e5, 1.01e7) == pytest.approx(0.9 * 1.2e-4 * SPEED, rel=1e-12)
    assert PUMP.torque(OIL, 1e5, 1.01e7, SPEED) == pytest.approx(1.2e-4 * 1e7 / 0.9, rel=1e-12)
    assert LOSSES.slip_coefficient == pytest.approx(8.37758e-8, rel=1e-6)
    assert LOSSES.viscous_coefficient == pytest.approx(1.326291e5, rel=1e-6)


def test_losses_elsewhere():
    """Slip goes with pressure over viscosity, whatever the speed; drag with viscosity times speed."""
    lost = 0.1 * 1.2e-4 * SPEED
    assert delivered(PUMP, 1e5, 1e5) == pytest.approx(1.2e-4 * SPEED, rel=1e-12)
    assert delivered(PUMP, 1e5, 5.1e6, 0.5 * SPEED) == pytest.approx(0.5 * 1.2e-4 * SPEED - 0.5 * lost, rel=1e-12)
    thin = jl.Oil(1.4e9, 870.0, 0.02 / 870.0, mass="article")
    assert loss_flow(PUMP, thin, 1e5, 1.01e7) == pytest.approx(2 * lost, rel=1e-12)
    drag = PUMP.torque(thin, 1e5, 1e5, 3 * SPEED)
    assert drag == pytest.approx(1.5 * 1.2e-4 * 1e7 * (1 / 0.9 - 1), rel=1e-12)


def test_an_ideal_pump_fills_at_the_density_of_its_inlet():
    oil = jl.Oil(1.4e9, 870.0, air_fraction=0.05)
    at = Situation(oil, {"inlet": 1e5, "outlet": 2e7}, {}, {"speed": 100.0})
    flow = Pump("i", "o", 1e-5, 100.0).evaluate(at).flow
    assert float(flow["outlet"]) == pytest.approx(1e-3 * oil.density_at(1e5), rel=1e-12)
    assert flow["inlet"] == -flow["outlet"]


@settings(max_examples=40, deadline=None)
@given(st.floats(1e4, 2e6), st.floats(0.0, 4e7), st.floats(1.0, 400.0), st.floats(0.5, 1.0), st.floats(0.5, 1.0))
def test_no_more_power_comes_out_than_goes_in(p_inlet, rise, speed, volumetric, mechanical):
    pump = Pump("i", "o", 5e-5, speed, WilsonLosses.from_efficiencies(volumetric, mechanical, 1e7, 157.0, 0.03))
    hydraulic = delivered(pump, p_inlet, p_inlet + rise, speed) * rise
    shaft = pump.torque(OIL, p_inlet, p_inlet + rise, speed) * speed
    assert hydraulic <= shaft * (1 + 1e-12) + 1e-9


@pytest.mark.parametrize("pistons", [7, 8, 9])
def test_ripple_is_that_of_half_sines(pistons):
    angle = 2.0 * np.pi * np.arange(8192) / 8192
    strokes = np.sin(angle[:, None] + 2 * np.pi * np.arange(pistons) / pistons)
    flow = np.sum(np.maximum(strokes, 0.0), axis=1) * np.pi / pistons
    harmonics = 2.0 * np.fft.rfft(flow).real[pistons * np.arange(1, 7)] / 8192
    np.testing.assert_allclose(kinematic_ripple(pistons, 6), harmonics, atol=1e-7)
    pump = Pump("i", "o", 1e-5, 100.0, ripple_amplitudes=kinematic_ripple(pistons, 60), pistons=pistons)
    np.testing.assert_allclose(pump.ripple(angle), flow, atol=1e-3)
    assert np.ptp(flow) == pytest.approx(0.0152, abs=2e-4) if pistons == 9 else np.ptp(flow) > 0.02


def test_ripple_rings_a_volume_at_the_piston_frequency():
    """Against a volume that is fed at the mean flow: p = p0 + K D w a sin(N w t)/(N w), K = beta/V."""
    pump = Pump("T", "A", 1e-5, 150.0, ripple_amplitudes=[0.05], pistons=7)
    parts = {
        "tank": jl.Tank("T"),
        "pump": pump,
        "out": jl.FlowSource("A", -1.5e-3),
        "line": jl.Line("A", jl.Vessel(1e-3)),
    }
    times = np.linspace(0.0, 0.02, 81)
    sim = jl.simulate(jl.Circuit(OIL, parts), times, initial={"A.pressure": 1e7}, tolerance=1e-10)
    rate = 7 * 150.0
    expected = 1e7 + 1.4e12 * 1.5e-3 * 0.05 * np.sin(rate * times) / rate
    np.testing.assert_allclose(sim["A.pressure"], expected, atol=1.0)
    np.testing.assert_allclose(sim["pump.angle"], 150.0 * times, atol=1e-8)


def test_pump_and_relief_valve_settle_where_a_hand_calculation_says():
    """D w - C_s D dp/mu = Q_N sqrt(dp/p_full) (r - 0.1)/0.8, with r = (dp - p_set)/(p_full - p_set)."""
    relief = ReliefValve("P", "T", 2e-3, set_pressure=1.5e7, full_flow_pressure=1.65e7, rated_density=870.0)
    pump = Pump("T", "P", 1e-5, 150.0, WilsonLosses.from_efficiencies(0.92, 0.93, 1e7, SPEED, 0.04))
    parts = {"tank": jl.Tank("T", 1e5), "pump": pump, "relief": relief, "line": jl.Line("P", jl.Vessel(1e-3))}
    slip = 0.08 * 1e-5 * SPEED / 1e7

    def surplus(rise):
        opening = ((rise - 1.5e7) / 1.5e6 - 0.1) / 0.8
        return 1e-5 * 150.0 - slip * rise - 2e-3 * np.sqrt(rise / 1.65e7) * opening

    rise = root_scalar(surplus, bracket=(1.52e7, 1.64e7), xtol=1e-3).root
    sim = jl.simulate(jl.Circuit(OIL, parts), [0.0, 1.0, 2.0], initial={"P.pressure": 1e5}, tolerance=1e-9)
    assert 0.2 < (rise - 1.5e7) / 1.5e6 < 0.8
    assert sim["P.pressure"][-1] == pytest.approx(1e5 + rise, rel=1e-6)


def compensated(**changes):
    given = {"dead_head_pressure": 2e7, "losses": LOSSES} | changes
    return PressureCompensatedPump("inlet", "outlet", 1e-5, SPEED, 1.8e7, **given)


def test_compensator_between_cut_off_and_dead_head():
    pump = compensated()
    assert pump.steady_swash(1.7e7) == 1.0 and pump.steady_swash(2.1e7) == 0.0
    assert pump.steady_swash(1.9e7) == pytest.approx(0.5)
    assert pump.steady_swash(1.85e7) == pytest.approx(1 - 0.15 / 0.8)  # straight between the rounded ends
    slope = jax.vmap(jax.grad(pump.steady_swash))(jnp.array([1e7, 1.75e7, 1.9e7, 2.1e7, 3e7]))
    np.testing.assert_allclose(slope * 2e6, [0.0, 0.0, -1.25, 0.0, 0.0], atol=1e-12)
    lost = 0.1 * 1e-5 * SPEED / 1e7
    assert delivered(pump, 1e5, 2.11e7, swash=0.0) == pytest.approx(-lost * 2.1e7, rel=1e-12)
    assert delivered(pump, 1e5, 1.01e7, swash=1.0) == pytest.approx(0.9 * 1e-5 * SPEED, rel=1e-12)


def test_swash_plate_lags():
    """At constant pressures alpha goes to its steady value as exp(-t/tau)."""
    pump = compensated(time_constant=0.05)
    parts = {"low": jl.Tank("inlet", 1e5), "pump": pump, "high": jl.PressureSource("outlet", 1e5 + 1.9e7)}
    times = np.linspace(0.0, 0.2, 9)
    sim = jl.simulate(jl.Circuit(OIL, parts), times, initial={"pump.swash": 1.0}, tolerance=1e-10)
    np.testing.assert_allclose(sim["pump.swash"], 0.5 + 0.5 * np.exp(-times / 0.05), atol=1e-8)
    rest = jl.simulate(jl.Circuit(OIL, parts), times)
    np.testing.assert_allclose(rest["pump.swash"], 0.5, atol=1e-9)  # it starts at its steady value


def test_compensated_pump_holds_pressure_against_a_load():
    """Into an orifice: full flow while the pressure is below the cut-off, then between cut-off and dead head."""

    def settled(area):
        parts = {
            "tank": jl.Tank("inlet", 1e5),
            "pump": compensated(losses=WilsonLosses()),
            "load": jl.Orifice("outlet", "inlet", area, transition=1.0),
            "line": jl.Line("outlet", jl.Vessel(1e-3)),
        }
        sim = jl.simulate(jl.Circuit(OIL, parts), [0.0, 1.0], initial={"outlet.pressure": 1e6}, tolerance=1e-9)
        return sim["outlet.pressure"][-1] - 1e5

    full = 1e-5 * SPEED
    wide = 2e-5
    assert settled(wide) == pytest.approx(870.0 / 2 * (full / (0.62 * wide)) ** 2, rel=1e-6)
    for narrow in (1.3e-5, 4e-6):
        assert 1.8e7 < settled(narrow) < 2e7
    half = 0.5 * full / (0.62 * np.sqrt(2 * 1.9e7 / 870.0))  # passes half the flow at the middle of the band
    assert settled(half) == pytest.approx(1.9e7, rel=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: compensated(dead_head_pressure=1e7), "dead_head_pressure must be above cut_off_pressure.*swapped"),
        (lambda: Pump("i", "o", 1e-5, 1e4), "speed must be .*was it given in rpm"),
        (lambda: Pump("i", "o", 28.0, 100.0), "displacement must be .*was it given in cm.3/rev"),
        (lambda: Pump("i", "o", 1e-5, 100.0, pistons=0), "pistons must be a number above zero, got 0"),
        (lambda: Pump("i", "o", 1e-5, 100.0, ripple_amplitudes=0.1), "ripple_amplitudes must be a list"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
