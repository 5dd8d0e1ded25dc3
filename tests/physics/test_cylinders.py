"""Cylinders: another program's run, natural frequencies, balance of force and mass, end stops."""

from pathlib import Path

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.cylinders import DoubleRodCylinder, RotaryActuator, SingleRodCylinder, piston_area
from jaxlines.physics.mechanics import Force, Mass

HOPSAN = Path(__file__).parents[2] / "../shared/reference/hopsan/HydraulicCylinderQTest.hvd"
ARTICLE = jl.Oil(1.379e9, 850.0, mass="article")
AIRY = jl.Oil(1.4e9, 850.0, air_fraction=0.02, modulus_slope=8.0)
KINETIC = jl.Oil(1.4e9, 850.0, air_fraction=0.01, air=jl.KineticAir(jl.PolynomialSolubility(), 0.1, 5.0))
FRICTION = (100.0, 200.0, 90.0)


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def run(fluid, parts, times, initial, tolerance=1e-10, inputs=None):
    sim = jl.simulate(jl.Circuit(fluid, parts), times, inputs or {}, initial=initial, tolerance=tolerance)
    assert sim.status == "ok"
    return sim


@pytest.fixture(scope="module")
def pushed():
    """Hopsan's test: 10 and 9 MPa on 10 cm^2 push 1000 kg against 100 N, from 0.2 m into the stop at 0.4 m."""
    cylinder = DoubleRodCylinder("a", "b", "rod", 1e-3, 0.4, 3e-4, 3e-4, stop_damping=2e6, stop_width=1e-6)
    parts = {"high": jl.PressureSource("a", 1e7), "low": jl.PressureSource("b", 9e6), "cylinder": cylinder}
    parts |= {"load": Mass("rod", 1000.0), "force": Force("rod", -100.0)}
    return run(jl.Oil(1e9, 870.0, mass="article"), parts, np.linspace(0, 1, 1001), {"cylinder.position": 0.2}, 1e-8)


def test_a_pushed_mass_moves_by_newton_and_ends_at_the_stop(pushed):
    times = pushed.times[pushed.times < 0.66]
    np.testing.assert_allclose(pushed["cylinder.position"][: len(times)], 0.2 + 0.45 * times**2, atol=1e-8)
    rest = pushed["cylinder.position"][pushed.times > 0.95]
    np.testing.assert_allclose(rest, 0.4 + 900.0 / 1e8, atol=1e-8)  # the force over the stop's stiffness
    assert np.all(np.diff(pushed["cylinder.position"])[pushed.times[1:] < 0.66] > 0.0)


def test_against_hopsan(pushed):
    """Its three cylinders, of transmission lines of 1 ms, run 2 to 6 ms behind; its own tolerance is 1 %."""
    if not HOPSAN.exists():
        pytest.skip(f"the reference data {HOPSAN.name} is not beside the project")
    table = np.loadtxt(HOPSAN, delimiter=",")
    for column in (1, 2, 3):
        position = np.interp(table[:, 0], pushed.times, pushed["cylinder.position"])
        np.testing.assert_allclose(position, table[:, column], rtol=0.01)
    moving, stopped = table[:, 0] < 0.65, table[:, 0] > 0.72
    velocity = np.interp(table[:, 0], pushed.times, pushed["rod.velocity"])
    np.testing.assert_allclose(velocity[moving], table[moving, 4], atol=3e-3)
    for column in (4, 5, 6):
        np.testing.assert_allclose(velocity[moving], table[moving, column], atol=0.01)
        np.testing.assert_allclose(velocity[stopped], table[stopped, column], atol=2e-3)


SWINGING = {
    "double rod, middle": (DoubleRodCylinder("a", "b", "x", 2e-3, 0.4, 1e-4, 1e-4), (2e-3, 2e-3), 0.2),
    "double rod, near an end": (DoubleRodCylinder("a", "b", "x", 2e-3, 0.4, 1e-4, 1e-4), (2e-3, 2e-3), 0.05),
    "single rod": (SingleRodCylinder("a", "b", "x", 2e-3, 1e-3, 0.4, 1e-4, 2e-4), (2e-3, 1e-3), 0.1),
    "rotary": (RotaryActuator("a", "b", "x", 2e-3, 2.0, 1e-4, 1e-4), (2e-3, 2e-3), 1.5),
}


@pytest.mark.parametrize("case", SWINGING)
def test_natural_frequency(case):
    """w^2 = (K/m)(A_a^2/V_a + A_b^2/V_b); in the middle of a double-rod cylinder 4 K A^2/(V_t m) (Merritt)."""
    cylinder, (area_a, area_b), start = SWINGING[case]
    volume_a = float(cylinder.dead_volume_a) + area_a * start
    volume_b = float(cylinder.dead_volume_b) + area_b * (float(cylinder.stroke) - start)
    w = np.sqrt(1.379e9 / 500.0 * (area_a**2 / volume_a + area_b**2 / volume_b))
    if case == "double rod, middle":
        assert w == pytest.approx(np.sqrt(4 * 1.379e9 * 2e-3**2 / (1e-3 * 500.0)))
    moved, load = ("angle", jl.Inertia("x", 500.0)) if case == "rotary" else ("position", Mass("x", 500.0))
    speed = "x.speed" if case == "rotary" else "x.velocity"
    times = np.linspace(0.0, 6 * np.pi / w, 121)
    initial = {f"cylinder.{moved}": start, speed: 1e-5, "a.pressure": 5e6}
    # At rest: the forces of both chambers over atmosphere balance.
    initial["b.pressure"] = 101325.0 + (5e6 - 101325.0) * area_a / area_b
    sim = run(ARTICLE, {"cylinder": cylinder, "load": load}, times, initial)
    np.testing.assert_allclose(sim[speed], 1e-5 * np.cos(w * times), atol=1e-5 * 2e-4)


@pytest.mark.parametrize("fluid", [AIRY, KINETIC], ids=["free air", "air that dissolves slowly"])
def test_mass_is_conserved(fluid):
    """A closed cylinder, pulled to and fro, that leaks from side to side."""
    cylinder = SingleRodCylinder("a", "b", "rod", 2e-3, 1.2e-3, 0.3, 1e-4, 1e-4, leakage=2e-11, mass=50.0)
    parts = {"cylinder": cylinder, "force": Force("rod", jl.Sine(2e4, 3.0))}
    times = np.linspace(0.0, 0.6, 61)
    start = {"cylinder.position": 0.15, "a.pressure": 1e6, "b.pressure": 3e6}
    sim = run(fluid, parts, times, start)
    volumes = cylinder.volumes(sim["cylinder.position"])
    masses = []
    for side, volume in zip("ab", volumes, strict=True):
        air = sim[f"cylinder.undissolved_air_{side}"] if fluid.air.kinetic else None
        masses.append(np.asarray(fluid.density_at(sim[f"{side}.pressure"], air) * volume))
    assert np.ptp(masses[0]) > 1e-3 and np.ptp(sim["cylinder.position"]) > 0.005
    assert np.ptp(sim["a.pressure"]) > 9e5
    np.testing.assert_allclose(masses[0] + masses[1], masses[0][0] + masses[1][0], atol=1e-9 * masses[0][0])


def test_inflow_equals_the_change_of_mass():
    """A pump fills side a while the piston moves from end to end: what it delivers is there."""
    cylinder = DoubleRodCylinder("a", "b", "rod", 2e-3, 0.2, 5e-5, 5e-5, mass=30.0, viscous_friction=2e3)
    parts = {"pump": jl.FlowSource("a", 3e-4), "tank": jl.Tank("b"), "cylinder": cylinder}
    times = np.linspace(0.0, 1.0, 2001)
    sim = run(AIRY, parts, times, {"cylinder.position": 0.02, "a.pressure": 1e5})
    density = np.asarray(AIRY.density_at(sim["a.pressure"]))
    mass = density * cylinder.volumes(sim["cylinder.position"])[0]
    flow = density * 3e-4
    simpson = np.sum(flow[:-2:2] + 4 * flow[1:-1:2] + flow[2::2]) * (times[1] - times[0]) / 3
    assert sim["cylinder.position"][-1] > 0.16
    assert mass[-1] - mass[0] == pytest.approx(simpson, rel=1e-7)


def test_steady_extension():
    """v = Q/A_a; p_a A_a = F + F_c + B v + (p_b A_b) over atmosphere; the leak takes its share of the flow."""
    area_a, area_b = piston_area(0.063), piston_area(0.063, 0.036)
    assert area_a == pytest.approx(3.11725e-3, rel=1e-5) and area_b == pytest.approx(2.09937e-3, rel=1e-5)
    cylinder = SingleRodCylinder(
        *("a", "b", "rod"), area_a, area_b, 1.0, leakage=1e-12, mass=100.0, coulomb_friction=300.0, viscous_friction=2e3
    )
    parts = {"pump": jl.FlowSource("a", 5e-4), "back": jl.PressureSource("b", 1e6), "cylinder": cylinder}
    parts |= {"load": Force("rod", -2e4)}
    start = {"cylinder.position": 0.1, "a.pressure": 7e6}
    sim = run(ARTICLE, parts, np.linspace(0.0, 3.0, 31), start, tolerance=1e-8)
    p, v = sim["a.pressure"][-1], sim["rod.velocity"][-1]
    assert v == pytest.approx((5e-4 - 1e-12 * (p - 1e6)) / area_a, rel=1e-6)
    force = 2e4 + 300.0 + 2e3 * v + (1e6 - 101325.0) * area_b
    assert p - 101325.0 == pytest.approx(force / area_a, rel=1e-6)


def test_a_vane_turns_from_stop_to_stop():
    """It stops at its angle, D (p_a - p_b)/k into the stop, and the stop gives no energy back."""
    vane = RotaryActuator("a", "b", "shaft", 1e-4, 1.5, moment_of_inertia=0.5, viscous_friction=50.0, stop_width=1e-4)
    parts = {"pump": jl.PressureSource("a", jl.Step(6e6, 1e6, 1.0)), "tank": jl.PressureSource("b", 1e6), "vane": vane}
    times = np.linspace(0.0, 1.0, 201)
    sim = run(ARTICLE, parts, times, {}, tolerance=1e-8)
    assert sim["vane.angle"][100] == pytest.approx(1.5 + 500.0 / 1e6, abs=1e-6)
    assert sim["shaft.speed"][times < 0.14].max() == pytest.approx(10.0, rel=0.01)  # 500 N m over the damping
    assert np.all(sim["shaft.speed"] > -0.2) and sim["vane.angle"].max() < 1.5 + 0.01


def test_a_cylinder_without_mass_needs_one():
    cylinder = DoubleRodCylinder("a", "b", "rod", 1e-3, 0.4)
    with pytest.raises(ValueError, match="translational node 'rod' has no capacity"):
        jl.simulate(jl.Circuit(ARTICLE, {"cylinder": cylinder}), [0.0, 0.1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SingleRodCylinder("a", "b", "rod", 1e-3, 2e-3, 0.4), "area_b must not exceed area_a, got 0.002 and"),
        (lambda: DoubleRodCylinder("a", "b", "rod", 1e-3, 400.0), "stroke must be .* got 400 m: was it given in mm"),
        (lambda: DoubleRodCylinder("a", "b", "rod", 1e-3, 0.4, -1e-4), "dead_volume_a must be .* got -0.0001"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
