"""Motors: piston ripple against its Fourier series, Wilson's losses at their rated point, natural frequency, power."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.machine_losses import WilsonLosses, wilson_slip, wilson_torque
from jaxlines.physics.motors import BentAxisMotor, Motor, commutated_lever

ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
# The axial motor of these tests: A 5 cm^2, R 60 mm, gamma 0.6 rad.
PER_PISTON = 5e-4 * 0.06 * np.sin(0.6)


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def bent_axis(pistons=7, width=0.05, **options):
    return BentAxisMotor("a", "b", "c", "shaft", 5e-4, 0.06, 0.6, pistons, width, **options)


def test_the_plain_motor_by_hand():
    motor = Motor("a", "b", "c", "shaft", 1e-4, 5e-12, 2e-12, 2.0, 0.03, 5.0)
    at = Situation(ARTICLE, {"a": 9e6, "b": 5e6, "case": 4e6, "shaft": 3.0}, {}, {})
    flow = {port: float(f) for port, f in motor.evaluate(at).flow.items()}
    assert flow["a"] / 850 == pytest.approx(-(3e-4 + 5e-12 * 4e6 + 2e-12 * 5e6), rel=1e-12)
    assert flow["b"] / 850 == pytest.approx(3e-4 + 5e-12 * 4e6 - 2e-12 * 1e6, rel=1e-12)
    assert flow["case"] / 850 == pytest.approx(2e-12 * 6e6, rel=1e-12)
    assert flow["shaft"] == pytest.approx(400.0 - 6.0 - (0.03 * 1e-4 * 7e6 + 5.0), rel=1e-12)


def test_wilson_at_the_rated_point():
    """A pump of 1.2e-4 m^3/rad with 0.9 and 0.9 at 10 MPa, 2000 rpm, 0.04 Pa s: slip 0.1 D w, torque 1.11 D p."""
    speed = 2000 * 2 * np.pi / 60
    losses = WilsonLosses.from_efficiencies(0.9, 0.9, 10e6, speed, 0.04)
    assert float(losses.slip_coefficient) == pytest.approx(0.1 * 0.04 * 209.4395 / 10e6, rel=1e-6)
    assert float(losses.slip(1.2e-4, 10e6, 0.04)) == pytest.approx(2.513274e-3, rel=1e-6)
    assert float(losses.torque(1.2e-4, 10e6, speed, 0.04)) == pytest.approx(133.3333, rel=1e-6)
    # Half of the friction dry: the same at the rated point, half of it at a tenth of the speed and more.
    dry = WilsonLosses.from_efficiencies(0.9, 0.9, 10e6, speed, 0.04, dry_coefficient=0.5 / 9)
    assert float(dry.torque(1.2e-4, 10e6, speed, 0.04)) == pytest.approx(133.3333, rel=1e-6)
    assert float(dry.torque(1.2e-4, 10e6, 0.1 * speed, 0.04)) == pytest.approx(133.3333 * 0.55, rel=1e-6)
    with pytest.raises(ValueError, match=r"dry_coefficient must not exceed 1/mechanical - 1 = 0.111111, got 0.2"):
        WilsonLosses.from_efficiencies(0.9, 0.9, 10e6, speed, 0.04, dry_coefficient=0.2)


def test_a_motor_with_wilson_losses_slips_and_rubs():
    """The viscosity of the fluid, 27.7e-6 * 850, enters both."""
    plain, lossy = (Motor("a", "b", "c", "s", 1e-4, 0.0, losses=x) for x in (None, WilsonLosses(1e-8, 1e5, 0.03)))
    at = Situation(ARTICLE, {"a": 9e6, "b": 5e6, "case": 1e5, "shaft": 30.0}, {}, {})
    more = {port: float(lossy.evaluate(at).flow[port] - plain.evaluate(at).flow[port]) for port in ("a", "shaft")}
    viscosity = 27.7e-6 * 850
    assert more["a"] / 850 == pytest.approx(-1e-8 * 1e-4 * 4e6 / viscosity, rel=1e-9)
    assert more["shaft"] == pytest.approx(-(1e5 * viscosity * 1e-4 * 30.0 + 0.03 * 400.0), rel=1e-9)


FACTOR = st.floats(0.0, 10.0)


@given(drop=st.floats(-3e7, 3e7), speed=st.floats(-300, 300), viscous=FACTOR, dry=FACTOR, slip=FACTOR)
@settings(max_examples=100, deadline=None)
def test_wilson_never_gives_energy(drop, speed, viscous, dry, slip):
    torque = wilson_torque(1e5 * viscous, 0.1 * dry, 1e-4, drop, speed, 0.03, 0.1, 1e5)
    assert float(torque) * speed >= 0.0 and wilson_slip(1e-8 * slip, 1e-4, drop, 0.03) * drop >= 0.0


@pytest.mark.parametrize("pistons", [3, 4, 7, 8, 9])
def test_ripple_has_its_fourier_series(pistons):
    """D(theta)/mean = 1 + sum_k 2 (-1)^(k+1)/((m k)^2 - 1) cos(m k theta), m = 2N for odd N, N for even N,

    where theta = 0 with a piston at its fastest: the series of |cos| over its own period, shifted for even N/2."""
    angles = np.linspace(0.0, 2 * np.pi, 5040, endpoint=False)
    levers = np.asarray(commutated_lever(angles, pistons, 1e-3))
    spectrum = 2 * np.abs(np.fft.rfft(levers)) / len(angles)
    mean = 0.5 * spectrum[0]
    assert mean == pytest.approx(pistons / np.pi, rel=1e-5)
    order = 2 * pistons if pistons % 2 else pistons
    for k in (1, 2, 3):
        assert spectrum[order * k] / mean == pytest.approx(2 / ((order * k) ** 2 - 1), rel=2e-3)
    others = np.delete(spectrum[: 4 * order], [order * k for k in range(4)])
    assert np.max(others) < 1e-5 * mean


def test_ripple_of_seven_pistons_from_peak_to_peak():
    """Between them 2N times a revolution: (pi/2N)/sin(pi/2N) and (pi/2N)/tan(pi/2N) of the mean."""
    motor, angles = bent_axis(width=1e-3), np.linspace(0.0, 2 * np.pi, 14001)
    share = np.asarray(motor.displacement_at(angles)) / float(motor.displacement())
    assert float(motor.displacement()) == pytest.approx(7 * PER_PISTON / np.pi, rel=1e-12)
    assert share.max() == pytest.approx((np.pi / 14) / np.sin(np.pi / 14), rel=1e-5)
    assert share.min() == pytest.approx((np.pi / 14) / np.tan(np.pi / 14), rel=1e-3)


@pytest.mark.parametrize("width", [0.02, 0.1, 0.2])
def test_commutation_takes_a_little_of_the_mean(width):
    mean = quad(lambda x: float(commutated_lever(x, 9, width)), 0.0, 2 * np.pi / 9)[0] * 9 / (2 * np.pi)
    assert mean == pytest.approx(9 / np.pi * (1 - (np.pi * width) ** 2 / 24), rel=width**4)


@pytest.mark.parametrize("pistons", [7, 8])
def test_torque_is_the_sum_over_the_pistons(pistons):
    """T = sum A R P_i sin(gamma) cos(theta_i) with the pressure of each piston, away from commutation."""
    motor = bent_axis(pistons, 1e-3, internal_leakage=0.0)
    for angle in (0.05, 1.0, 2.3, 4.0, -7.7):
        at = Situation(ARTICLE, {"a": 9e6, "b": 5e6, "case": 1e5, "shaft": 3.0}, {"angle": angle}, {})
        turned = angle + 2 * np.pi * np.arange(pistons) / pistons
        pressures = np.where(np.cos(turned) > 0, 9e6, 5e6)
        flow = motor.evaluate(at).flow
        assert float(flow["shaft"]) == pytest.approx(np.sum(PER_PISTON * pressures * np.cos(turned)), rel=1e-9)
        taken = np.sum(np.where(np.cos(turned) > 0, 1.0, 0.0) * PER_PISTON * np.cos(turned) * 3.0)
        assert float(flow["a"]) / 850 == pytest.approx(-taken, rel=1e-9)


@given(angle=st.floats(-50, 50), speed=st.floats(-100, 100), drop=st.floats(-2e7, 2e7), width=st.floats(1e-3, 1.0))
@settings(max_examples=100, deadline=None)
def test_without_losses_power_is_passed_on(angle, speed, drop, width):
    motor = bent_axis(9, width, internal_leakage=0.0)
    at = Situation(ARTICLE, {"a": 2.1e7 + drop, "b": 2.1e7, "case": 1e5, "shaft": speed}, {"angle": angle}, {})
    flow = motor.evaluate(at).flow
    hydraulic = -float(flow["a"]) / 850 * drop
    assert float(flow["shaft"]) * speed == pytest.approx(hydraulic, rel=1e-12, abs=1e-9)


def test_a_bent_axis_motor_runs_up():
    """Kinetic energy is pressure difference times the volume displaced: J w^2/2 = dp int_0^theta D."""
    motor = bent_axis(7, 0.05, internal_leakage=0.0)
    parts = {"high": jl.PressureSource("a", 1.1e7), "low": jl.PressureSource("b", 1e6), "case": jl.Tank("c")}
    parts |= {"motor": motor, "load": jl.Inertia("shaft", 2.0)}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), np.linspace(0.0, 0.5, 26), tolerance=1e-9)
    assert sim.status == "ok" and sim["motor.angle"][-1] > 2 * np.pi
    for i in (5, 15, 25):
        displaced = quad(lambda x: float(motor.displacement_at(x)), 0.0, sim["motor.angle"][i], limit=400)[0]
        assert sim["shaft.speed"][i] == pytest.approx(np.sqrt(2 * 1e7 * displaced / 2.0), rel=1e-7)
    mean = 7 / np.pi * PER_PISTON * (1 - (0.05 * np.pi) ** 2 / 24)
    assert sim["shaft.speed"][-1] == pytest.approx(mean * 1e7 / 2.0 * 0.5, rel=5e-3)


def test_natural_frequency_of_a_motor_and_its_lines():
    """w_h = sqrt(4 K D^2/(V_t J)), damping (C/D) sqrt(K J/V_t) + (B/4D) sqrt(V_t/(K J)) (Merritt); here with all of it.

    p = p_a - p_b obeys p'' + 2 z w_h p' + (w_h^2 + 4 K C B/(V_t J)) p = 0.
    """
    displacement, inertia, volume, leak, viscous, modulus = 1e-4, 40.0, 2e-3, 2e-12, 30.0, 1.379e9
    motor = Motor("a", "b", "c", "shaft", displacement, leak, 0.0, viscous)
    parts = {"A": jl.Line("a", jl.Vessel(volume / 2)), "B": jl.Line("b", jl.Vessel(volume / 2)), "case": jl.Tank("c")}
    parts |= {"motor": motor, "load": jl.Inertia("shaft", inertia)}
    times = np.linspace(0.0, 0.6, 121)
    start = {"a.pressure": 6e6, "b.pressure": 4e6}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), times, initial=start, tolerance=1e-10)
    hydraulic = np.sqrt(4 * modulus * displacement**2 / (volume * inertia))
    stiff, mass = modulus / volume, modulus * inertia / volume
    damping = leak / displacement * np.sqrt(mass) + viscous / (4 * displacement) / np.sqrt(mass)
    assert 2 * damping * hydraulic == pytest.approx(4 * stiff * leak + viscous / inertia, rel=1e-12)
    decay, total = damping * hydraulic, hydraulic**2 + 4 * stiff * leak * viscous / inertia
    wd = np.sqrt(total - decay**2)
    first = -4 * stiff * leak * 2e6  # rate of the pressure difference at the start
    ringing = np.cos(wd * times) + (first / 2e6 + decay) / wd * np.sin(wd * times)
    assert wd * 0.6 > 4 * np.pi
    np.testing.assert_allclose(
        sim["a.pressure"] - sim["b.pressure"], 2e6 * np.exp(-decay * times) * ringing, atol=2e6 * 1e-7
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: bent_axis(2), "pistons must be a whole number of at least 3, got 2"),
        (lambda: BentAxisMotor("a", "b", "c", "s", 5e-4, 0.06, 35.0), "bend_angle must be .* got 35.*in degrees"),
        (lambda: WilsonLosses(dry_coefficient=3.0), "dry_coefficient must be .* got 3: was it given in percent"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
