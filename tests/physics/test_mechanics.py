"""Masses, springs, friction, stops, backlash and gears: closed forms, and that none of them ever creates energy."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.mechanics import (
    Damper,
    Force,
    Mass,
    Position,
    RotaryDamper,
    RotarySpring,
    SlidingFriction,
    Spring,
    stribeck_friction,
)
from jaxlines.physics.stops import (
    Backlash,
    EndStop,
    Gear,
    RotaryBacklash,
    RotaryEndStop,
    contact_force,
    dead_zone,
    engagement,
)

OIL = jl.Oil(1e9, 870.0, mass="article")


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def run(parts, times, initial=None, tolerance=1e-10, **inputs):
    sim = jl.simulate(jl.Circuit(OIL, parts), times, inputs, initial=initial or {}, tolerance=tolerance)
    assert sim.status == "ok"
    return sim


LINEAR = {
    "translational": (Mass("m", 2.0), Force("m", 5.0), Spring("m", 800.0), Damper("m", 8.0), "m.velocity", "extension"),
    "rotational": (
        jl.Inertia("m", 2.0),
        jl.LoadTorque("m", 5.0),
        RotarySpring("m", 800.0),
        RotaryDamper("m", 8.0),
        "m.speed",
        "twist",
    ),
}


@pytest.mark.parametrize("domain", LINEAR)
def test_step_response_of_mass_spring_and_damper(domain):
    """x = F/k (1 - e^(-z w t) (cos w_d t + z/sqrt(1 - z^2) sin w_d t)), w = sqrt(k/m) = 20, z = 0.1."""
    mass, force, spring, damper, velocity, state = LINEAR[domain]
    times = np.linspace(0.0, 1.5, 151)
    sim = run({"mass": mass, "force": force, "spring": spring, "damper": damper}, times)
    w, z = 20.0, 0.1
    wd = w * np.sqrt(1 - z * z)
    x = 5.0 / 800.0 * (1 - np.exp(-z * w * times) * (np.cos(wd * times) + z * w / wd * np.sin(wd * times)))
    v = 5.0 / 800.0 * np.exp(-z * w * times) * w * w / wd * np.sin(wd * times)
    np.testing.assert_allclose(sim[f"spring.{state}"], x, atol=1e-10)
    np.testing.assert_allclose(sim[velocity], v, atol=1e-9)


def test_two_masses_on_a_spring():
    """Momentum is kept; they swing with w^2 = k (1/m_1 + 1/m_2) about their common velocity."""
    parts = {"one": Mass("a", 2.0), "other": Mass("b", 3.0), "spring": Spring("a", 1200.0, to="b"), "x": Position("a")}
    times = np.linspace(0.0, 1.0, 101)
    sim = run(parts, times, {"a.velocity": 1.0})
    w = np.sqrt(1200.0 * (1 / 2 + 1 / 3))
    np.testing.assert_allclose(2 * sim["a.velocity"] + 3 * sim["b.velocity"], 2.0, rtol=1e-9)
    np.testing.assert_allclose(sim["a.velocity"] - sim["b.velocity"], np.cos(w * times), atol=1e-7)
    np.testing.assert_allclose(sim["x.position"], 0.4 * times + 0.6 / w * np.sin(w * times), atol=1e-8)


def test_a_preloaded_spring_pulls_back():
    flow = Spring("m", 1e3, 7.0).evaluate(Situation(OIL, {"m": 0.0, "node": 0.0}, {"extension": 0.01}, {})).flow
    assert float(flow["node"]) == pytest.approx(-17.0)


def test_coasting_against_dry_friction():
    """v = v_0 - F_c t/m while it slides; it stops after m v_0/F_c and m v_0^2/(2 F_c), and stays."""
    parts = {"mass": Mass("m", 4.0), "guide": SlidingFriction("m", 20.0, friction_speed=1e-4), "x": Position("m")}
    times = np.linspace(0.0, 0.4, 41)
    sim = run(parts, times, {"m.velocity": 1.0}, tolerance=1e-9)
    np.testing.assert_allclose(sim["m.velocity"], np.maximum(1.0 - 5.0 * times, 0.0), atol=2e-4)
    assert sim["x.position"][-1] == pytest.approx(0.1, abs=1e-6)


def test_a_load_below_coulomb_friction_only_creeps():
    """atanh(F/F_c) = v/v_0."""
    parts = {"mass": Mass("m", 1.0), "guide": SlidingFriction("m", 20.0, friction_speed=1e-3), "load": Force("m", 10.0)}
    sim = run(parts, np.linspace(0.0, 1.0, 11))
    assert sim["m.velocity"][-1] == pytest.approx(1e-3 * np.arctanh(0.5), rel=1e-6)


def test_stribeck_curve():
    def friction(v):
        return float(stribeck_friction(v, 100.0, 60.0, 50.0, 0.01, 1e-5))

    assert friction(1e-4) == pytest.approx(160.0, rel=1e-3)
    assert friction(0.01) == pytest.approx(100.0 + 60.0 / np.e + 0.5, rel=1e-9)
    assert friction(0.1) == pytest.approx(105.0, rel=1e-9)
    assert friction(-0.1) == -friction(0.1) and friction(0.0) == 0.0


POSITIVE = st.floats(1e-3, 1e3)
ANY = st.floats(-10.0, 10.0, allow_subnormal=False)


@given(v=ANY, coulomb=POSITIVE, excess=POSITIVE, viscous=POSITIVE, stribeck=POSITIVE, width=POSITIVE)
@settings(max_examples=100, deadline=None)
def test_friction_is_odd_and_never_gives_energy(v, coulomb, excess, viscous, stribeck, width):
    force = stribeck_friction(v, coulomb, excess, viscous, stribeck, width)
    assert force * v >= 0.0 and force == -stribeck_friction(-v, coulomb, excess, viscous, stribeck, width)
    assert abs(force) <= coulomb + excess + viscous * abs(v) + 1e-9


@given(x=ANY, v=ANY, stiffness=POSITIVE, damping=POSITIVE, width=POSITIVE)
@settings(max_examples=200, deadline=None)
def test_a_stop_pushes_and_its_damping_resists(x, v, stiffness, damping, width):
    force = float(contact_force(x, v, stiffness, damping, width))
    at_rest = float(contact_force(x, 0.0, stiffness, damping, width))
    assert force >= 0.0 and (force - at_rest) * v >= -1e-12 * abs(force * v)
    if x <= -width:
        assert force == 0.0
    if x >= width:
        assert at_rest == pytest.approx(stiffness * x, rel=1e-12)


def test_deep_in_contact_a_stop_is_a_spring_and_a_damper():
    for v in (-0.05, -0.01, 0.01, 0.1):
        force = float(contact_force(1e-3, v, 1e7, 1e4, 1e-6))
        assert force == pytest.approx(1e4 + 1e4 * v, abs=0.03 * 1e4 * abs(v) + 3.0)
    # At x = w with c v/(2 k w) = 1/2, by hand: k w ln(1 + 53.59815 * 7.389056)/4; halfway in, s = 3 w/16.
    assert float(contact_force(1e-3, 1.0, 1e6, 1e3, 1e-3)) == pytest.approx(1496.009, rel=1e-6)
    assert float(contact_force(0.0, 0.0, 1e6, 1e3, 1e-3)) == pytest.approx(187.5, rel=1e-9)
    assert 0.0 <= float(contact_force(1e-4, -1.0, 1e7, 1e4, 1e-6)) < 1.0  # where spring and damper would pull


SLOPE = jax.jit(jax.grad(lambda x, gap, width: dead_zone(x, gap, width)))


@given(x=ANY, gap=st.floats(0.0, 5.0), width=st.floats(1e-3, 5.0), step=st.floats(0.0, 1.0))
@settings(max_examples=200, deadline=None)
def test_dead_zone_is_odd_and_monotone(x, gap, width, step):
    z = float(dead_zone(x, gap, width))
    assert z == pytest.approx(-float(dead_zone(-x, gap, width)), abs=1e-15)
    assert float(dead_zone(x + step, gap, width)) >= z - 1e-12
    assert float(engagement(x, gap, width)) == pytest.approx(float(SLOPE(x, gap, width)), abs=1e-9)
    assert float(dead_zone(x, 0.0, width)) == pytest.approx(x, abs=1e-12 * max(1.0, width))
    if abs(x) >= gap + width and gap >= width:
        assert z == pytest.approx(np.sign(x) * (abs(x) - gap), abs=1e-12)
    if abs(x) <= gap - width:
        assert z == 0.0


CYCLED = {
    "end stop": lambda k, c, w: EndStop("m", -0.5, 0.6, k, c, w),
    "rotary end stop": lambda k, c, w: RotaryEndStop("m", -0.5, 0.6, k, c, w),
    "backlash": lambda k, c, w: Backlash("m", 0.9, k, c, w),
    "rotary backlash": lambda k, c, w: RotaryBacklash("m", 0.0, k, c, w),
}


@pytest.mark.parametrize("name", CYCLED)
@given(k=POSITIVE, c=st.floats(0.0, 1e3), w=st.floats(1e-2, 0.4), frequency=st.floats(0.1, 20.0))
@settings(max_examples=25, deadline=None)
def test_no_cycle_creates_energy(name, k, c, w, frequency):
    """Work done on the part over a closed, uneven path; without damping it gives back all."""
    phase = np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    x = 0.8 * np.sin(phase) + 0.3 * np.cos(2 * phase)
    v = frequency * (0.8 * np.cos(phase) - 0.6 * np.sin(2 * phase))

    def work(part):
        power = np.asarray(part.resistance(x, v)) * v
        return power.mean() / frequency, np.abs(power).mean() / frequency

    done, moved = work(CYCLED[name](k, c, w))
    elastic, _ = work(CYCLED[name](k, 0.0, w))
    assert done >= -1e-6 * moved
    assert abs(elastic) <= 1e-6 * k


def test_bouncing_off_a_stop():
    """Without damping it leaves as it came, after pi sqrt(m/k); with damping slower."""
    times = np.linspace(0.0, 0.4, 401)

    def velocity(damping):
        stop = EndStop("m", upper=0.1, stiffness=1e6, damping=damping, width=1e-6)
        return run({"mass": Mass("m", 10.0), "stop": stop}, times, {"m.velocity": 1.0}, tolerance=1e-9)

    sim = velocity(0.0)
    contact = np.pi * np.sqrt(10.0 / 1e6)
    inside = (times > 0.1) & (times < 0.1 + contact)
    expected = np.where(times <= 0.1, 1.0, np.where(inside, np.cos(np.sqrt(1e5) * (times - 0.1)), -1.0))
    np.testing.assert_allclose(sim["m.velocity"], expected, atol=2e-4)
    assert sim["m.velocity"][-1] == pytest.approx(-1.0, abs=1e-7)
    assert sim["stop.position"].max() == pytest.approx(0.1 + np.sqrt(10.0 / 1e6), rel=1e-3)
    damped = velocity(1e3)["m.velocity"][-1]
    assert -0.75 < damped < -0.5  # linear theory without separation, z = 0.158: exp(-pi z/sqrt(1 - z^2)) = 0.605


def test_free_flight_in_the_play():
    """Inside the play the mass keeps its velocity; then it swings on the tooth and comes back."""
    play = Backlash("m", 0.02, 1e5, width=1e-6)
    times = np.linspace(0.0, 0.06, 61)
    sim = run({"mass": Mass("m", 10.0), "play": play}, times, {"m.velocity": 1.0})
    np.testing.assert_allclose(sim["m.velocity"][times < 0.0099], 1.0, rtol=1e-9)
    on_tooth = (times > 0.0101) & (times < 0.01 + np.pi / 100.0)
    np.testing.assert_allclose(sim["m.velocity"][on_tooth], np.cos(100.0 * (times[on_tooth] - 0.01)), atol=2e-4)
    assert sim["m.velocity"][-1] == pytest.approx(-1.0, abs=1e-7)


def geared(gear, torque=3.0, other=0.0):
    drive = {"J1": jl.Inertia("a", 0.02), "T1": jl.LoadTorque("a", torque)}
    return drive | {"gear": gear, "J2": jl.Inertia("b", 5.0), "T2": jl.LoadTorque("b", other)}


@pytest.mark.parametrize("efficiency", [1.0, 0.9])
@pytest.mark.parametrize("ratio", [10.0, -10.0])
def test_gear_ratio_and_efficiency(ratio, efficiency):
    """w_a' = (T_1 + T_2/(i eta))/(J_1 + J_2/(i^2 eta)) while a drives, w_b = w_a/i."""
    gear = Gear("a", "b", ratio, 1e6, 4e3, efficiency=efficiency, loss_power=1e-3)
    load = -np.sign(ratio) * 10.0
    sim = run(geared(gear, other=load), np.linspace(0.0, 2.0, 21), tolerance=1e-9)
    rate = (3.0 + load / (ratio * efficiency)) / (0.02 + 5.0 / (ratio**2 * efficiency))
    assert sim["a.speed"][20] - sim["a.speed"][10] == pytest.approx(rate, rel=1e-6)  # in one second
    np.testing.assert_allclose(sim["b.speed"][5:], sim["a.speed"][5:] / ratio, rtol=1e-5)


def test_driven_backwards_a_gear_loses_as_much():
    """w_b' = (T_2 + i T_1/eta)/(J_2 + i^2 J_1/eta) while b drives: a gets eta of its power."""
    gear = Gear("a", "b", 10.0, 1e6, 4e3, efficiency=0.8, loss_power=1e-3)
    sim = run(geared(gear, torque=-1.0, other=40.0), np.linspace(0.0, 2.0, 21), tolerance=1e-9)
    rate = (40.0 - 10.0 / 0.8) / (5.0 + 0.02 * 100.0 / 0.8)
    assert sim["b.speed"][20] - sim["b.speed"][10] == pytest.approx(rate, rel=1e-6)  # in one second


def test_torsional_swing_of_a_gear():
    """w^2 = k (1/J_2 + 1/(i^2 J_1)), k seen at shaft b."""
    gear = Gear("a", "b", 4.0, 2e4)
    times = np.linspace(0.0, 0.2, 201)
    sim = run(geared(gear, torque=0.0), times, {"b.speed": 0.01})
    w = np.sqrt(2e4 * (1 / 5.0 + 1 / (16 * 0.02)))
    np.testing.assert_allclose(sim["gear.twist"], -0.01 / w * np.sin(w * times), atol=1e-10)
    momentum = 4.0 * 0.02 * sim["a.speed"] + 5.0 * sim["b.speed"]
    np.testing.assert_allclose(momentum, 0.05, rtol=1e-8)


SPEEDS, RATIO = st.tuples(ANY, ANY), st.sampled_from([-7.0, 0.3, 50.0])


@given(speeds=SPEEDS, twist=ANY, ratio=RATIO, efficiency=st.floats(0.1, 1.0), gap=POSITIVE)
@settings(max_examples=200, deadline=None)
def test_a_gear_never_gives_more_than_it_gets(speeds, twist, ratio, efficiency, gap):
    """Power into both shafts and into the teeth is never positive."""
    gear, (w_a, w_b) = Gear("a", "b", ratio, 100.0, 3.0, 1e-3 * gap, 1e-2, efficiency), speeds
    done = gear.evaluate(Situation(OIL, {"a": w_a, "b": w_b}, {"twist": twist}, {}))
    stored = 100.0 * dead_zone(twist, 0.5e-3 * gap, 1e-2) * done.rate["twist"]
    powers = [float(p) for p in (done.flow["a"] * w_a, done.flow["b"] * w_b, stored)]
    assert sum(powers) <= 1e-12 * sum(map(abs, powers))


def test_play_of_a_gear_is_lost_motion():
    """Turning shaft a by half the play, seen at b, moves nothing; beyond it the load follows."""
    gear = Gear("a", "b", 10.0, 1e5, 100.0, backlash=0.02, width=1e-4)
    parts = {"gear": gear, "J1": jl.Inertia("a", 1.0), "J2": jl.Inertia("b", 1e-3)}
    sim = run(parts, np.linspace(0.0, 0.2, 21), {"a.speed": 1.0}, tolerance=1e-9)
    assert np.all(sim["b.speed"][sim.times < 0.098] == 0.0)  # half the play at a: 0.1 rad
    assert sim["b.speed"][-1] == pytest.approx(0.1, rel=0.05)


def test_the_ground_is_where_no_node_is_named():
    alone = SlidingFriction("m", 20.0).evaluate(Situation(OIL, {"node": 1.0}, {}, {})).flow
    assert set(alone) == {"node"} and float(alone["node"]) == pytest.approx(-20.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: EndStop("m", 0.5, 0.1), "lower must be below upper, got 0.5 and 0.1: were they swapped"),
        (lambda: Gear("a", "b", 0.0, 1e6), "ratio must not be 0"),
        (lambda: Gear("a", "b", 10.0, 1e6, efficiency=95.0), "efficiency must be .* got 95: was it given in percent"),
        (lambda: Spring("m", -5.0), "stiffness must be .* got -5 N/m"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
