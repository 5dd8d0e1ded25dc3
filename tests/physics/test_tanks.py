"""Water systems: swings of levels and surges against closed forms, emptying, throttled shafts, mass."""

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.sensors import LevelSensor
from jaxlines.physics.tanks import OpenTank, SurgeShaft, depth_of_water, foot_pressure, gravity_capacity

G = 9.80665
WATER = jl.Oil(2.18e9, 998.2, 1e-6, mass="article")
REAL = jl.Oil(2.18e9, 998.2, 1e-6, air_fraction=1e-4)


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def run(fluid, parts, times, initial, tolerance=1e-10, **options):
    sim = jl.simulate(jl.Circuit(fluid, parts), times, initial=initial, tolerance=tolerance, **options)
    assert sim.status == "ok"
    return sim


def inertance(length, area):
    return 998.2 * length / area


def test_ten_metres_of_water():
    assert float(gravity_capacity(2.0)) == pytest.approx(0.20394324, rel=1e-7)
    assert float(foot_pressure(WATER, 10.0)) == pytest.approx(101325.0 + 97889.98, rel=1e-7)
    assert float(depth_of_water(WATER, foot_pressure(WATER, 7.3))) == pytest.approx(7.3, rel=1e-12)
    tank = OpenTank("a", 2.0, bottom=3.0)
    assert float(tank.level(WATER, tank.pressure_at(WATER, 12.5))) == pytest.approx(12.5, rel=1e-12)


@pytest.mark.parametrize(("area_1", "area_2"), [(0.01, 0.01), (0.5, 2.0)])
def test_u_tube(area_1, area_2):
    """w^2 = g A (1/A_1 + 1/A_2)/L; a U-tube of one section swings with 2 g/L."""
    length, area = 4.0, 0.01
    column = jl.FluidInertia("a", "b", inertance(length, area))
    parts = {"one": OpenTank("a", area_1), "other": OpenTank("b", area_2), "column": column}
    parts |= {"level": LevelSensor("a")}
    w = np.sqrt(G * area * (1 / area_1 + 1 / area_2) / length)
    if area_1 == area:
        assert w == pytest.approx(np.sqrt(2 * G / length), rel=1e-12)
    times = np.linspace(0.0, 4 * np.pi / w, 81)
    start = {"a.pressure": float(foot_pressure(WATER, 1.2)), "b.pressure": float(foot_pressure(WATER, 1.0))}
    sim = run(WATER, parts, times, start)
    share = (1 / area_1) / (1 / area_1 + 1 / area_2)
    depth = depth_of_water(WATER, sim["a.pressure"])
    np.testing.assert_allclose(depth, 1.2 - 0.2 * share * (1 - np.cos(w * times)), atol=1e-8)
    np.testing.assert_allclose(sim["column.volume_flow"], 0.2 * share * area_1 * w * np.sin(w * times), atol=1e-9)


RESERVOIR, TUNNEL, AREA, SHAFT = 50.0, 800.0, 10.0, 80.0


def surge(shaft):
    """The turbine closes: the flow of the tunnel, 20 m^3/s, goes up the shaft (reservoir 50 m above its foot)."""
    parts = {
        "reservoir": jl.PressureSource("r", float(foot_pressure(WATER, RESERVOIR))),
        "tunnel": jl.FluidInertia("r", "s", inertance(TUNNEL, AREA)),
        "shaft": shaft,
    }
    start = {"s.pressure": float(foot_pressure(WATER, RESERVOIR)), "tunnel.volume_flow": 20.0}
    return parts, start, np.linspace(0.0, 400.0, 801)


def test_surge_period_and_height():
    """T = 2 pi sqrt(L A_s/(g A_t)), z = Q_0 sqrt(L/(g A_t A_s)) sin(2 pi t/T) without friction."""
    parts, start, times = surge(OpenTank("s", SHAFT))
    sim = run(WATER, parts, times, start)
    period = 2 * np.pi * np.sqrt(TUNNEL * SHAFT / (G * AREA))
    height = 20.0 * np.sqrt(TUNNEL / (G * AREA * SHAFT))
    assert period == pytest.approx(160.5127, rel=1e-6) and height == pytest.approx(6.3866, rel=1e-5)
    rise = depth_of_water(WATER, sim["s.pressure"]) - RESERVOIR
    np.testing.assert_allclose(rise, height * np.sin(2 * np.pi * times / period), atol=1e-6)


def test_a_throttle_damps_the_surge_and_the_level_is_a_state():
    """With the loss k Q^2 [m] of the throttle the first rise obeys d(Q^2)/dz + 2 b k Q^2 = -2 b z, b = g A_t A_s/L.

    So Q^2 = (Q_0^2 - 1/(2 b k^2)) e^(-2 b k z) + 1/(2 b k^2) - z/k, and the crest is where that is zero.
    """
    shaft = SurgeShaft("s", SHAFT, throttle_area=2.0, discharge_coefficient=0.7, bottom=100.0)
    parts, start, times = surge(shaft)
    parts |= {"foot": OpenTank("s", 0.05)}  # a little room below the throttle
    start |= {"shaft.level": 100.0 + RESERVOIR}
    sim = run(WATER, parts, times, start, 1e-7, solver=jl.implicit())
    k, b = 1 / (2 * G * (0.7 * 2.0) ** 2), G * AREA * SHAFT / TUNNEL
    start_square, limit = 20.0**2, 1 / (2 * b * k * k)
    levels = np.linspace(0.0, 7.0, 70001)
    crest = levels[np.argmin(np.abs((start_square - limit) * np.exp(-2 * b * k * levels) + limit - levels / k))]
    assert 2.0 < crest < 6.0
    rise = sim["shaft.level"] - 100.0 - RESERVOIR
    assert rise.max() == pytest.approx(crest, rel=2e-3)
    assert np.abs(rise[times > 200]).max() < 0.6 * rise.max()


def test_a_shaft_starts_in_balance():
    shaft = SurgeShaft("s", 2.0, 0.1, bottom=3.0)
    sim = run(WATER, {"shaft": shaft, "foot": OpenTank("s", 1.0)}, [0.0, 1.0], {"s.pressure": 2e5})
    np.testing.assert_allclose(sim["shaft.level"], 3.0 + (2e5 - 101325.0) / (998.2 * G), rtol=1e-9)


def test_a_tank_empties_through_a_hole():
    """sqrt(h) = sqrt(h_0) - C_d A_o sqrt(g/2) t/A (Torricelli)."""
    hole = jl.Orifice("a", "t", 1e-4, discharge_coefficient=0.6, transition=1e-2)
    parts = {"tank": OpenTank("a", 0.2), "hole": hole, "outside": jl.Tank("t")}
    times = np.linspace(0.0, 1200.0, 13)
    sim = run(WATER, parts, times, {"a.pressure": float(foot_pressure(WATER, 2.0))})
    root = np.sqrt(2.0) - 0.6 * 1e-4 * np.sqrt(G / 2) * times / 0.2
    np.testing.assert_allclose(depth_of_water(WATER, sim["a.pressure"]), root**2, rtol=1e-8)


def test_water_is_conserved():
    """From a tank through a throttle into a shaft, with compressible water: A p/g and rho A z hold all of it."""
    shaft = SurgeShaft("b", 3.0, 0.02, bottom=1.0)
    column = jl.FluidInertia("a", "b", inertance(30.0, 0.05), 1e3)
    parts = {"tank": OpenTank("a", 2.0), "column": column, "shaft": shaft, "foot": OpenTank("b", 0.01)}
    start = {"a.pressure": 1.9e5, "b.pressure": 1.5e5, "shaft.level": 3.0}
    sim = run(REAL, parts, np.linspace(0.0, 60.0, 61), start)
    density = float(REAL.density_at(101325.0))
    held = density * 3.0 * (sim["shaft.level"] - 1.0)
    held = held + (2.0 * (sim["a.pressure"] - 101325.0) + 0.01 * (sim["b.pressure"] - 101325.0)) / G
    assert np.ptp(sim["shaft.level"]) > 1.0
    np.testing.assert_allclose(held, held[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: OpenTank("a", 0.0), "area must be .* got 0 m.2: was it given in cm"),
        (lambda: SurgeShaft("a", 2.0, -0.1), "throttle_area must be .* got -0.1"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
