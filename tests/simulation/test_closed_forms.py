"""Simulations against closed-form solutions and against another program's results."""

from pathlib import Path

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.containers import volume_at

HOPSAN = Path(__file__).parents[2] / "../shared/reference/hopsan"
ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")


def filling() -> jl.Circuit:
    """An orifice that fills a capacitance of K = 4.756e10 Pa/m^3 from 20 MPa."""
    line = jl.Line("A", jl.Vessel(1.379e9 / 4.756e10))
    orifice = jl.Orifice("P", "A", 5e-6, discharge_coefficient=0.61, transition=0.1)
    return jl.Circuit(ARTICLE, {"supply": jl.PressureSource("P", 20e6), "orifice": orifice, "line": line})


def test_filling_through_an_orifice():
    """sqrt(p_s - p) = sqrt(p_s - p_i) - K K_v t/2, with K_v = C_d A sqrt(2/rho); full at 1.239 s."""
    times = np.array([0.0, 0.01, 0.05, 0.1, 1.2, 1.3, 1.5])
    sim = jl.simulate(filling(), times, initial={"A.pressure": 1e6}, tolerance=1e-10)
    expected = [1e6, 1305469.4807, 2502592.3169, 3943296.9181]
    np.testing.assert_allclose(sim["A.pressure"][:4], expected, rtol=2e-8)
    constant = 0.61 * 5e-6 * np.sqrt(2 / 850.0)
    root = np.sqrt(19e6) - 4.756e10 * constant * 1.2 / 2
    assert sim["A.pressure"][4] == pytest.approx(20e6 - root**2, rel=1e-7)
    np.testing.assert_allclose(sim["A.pressure"][5:], 20e6, atol=1.0)


def test_gradient_of_filling():
    """dp/dK = K_v t sqrt(p_s - p), K = beta/V."""
    circuit, volume = filling(), 1.379e9 / 4.756e10

    def end(v):
        changed = circuit.replace({"line.volume": v})
        sim = jl.simulate(changed, [0.0, 0.1], initial={"A.pressure": 1e6}, outputs=["A.pressure"], tolerance=1e-10)
        return sim["A.pressure"][-1]

    with jax.enable_x64(True):
        slope = jax.grad(end)(volume)
    by_constant = 0.61 * 5e-6 * np.sqrt(2 / 850.0) * 0.1 * np.sqrt(20e6 - 3943296.9181)
    assert float(slope) == pytest.approx(-by_constant * 4.756e10 / volume, rel=1e-6)


def test_laminar_leak():
    leak = jl.LaminarLeak("A", "T", 1e-11)
    circuit = jl.Circuit(ARTICLE, {"tank": jl.Tank("T", 1e5), "leak": leak, "line": jl.Line("A", jl.Vessel(1.379e-3))})
    times = np.linspace(0, 0.5, 11)
    sim = jl.simulate(circuit, times, initial={"A.pressure": 2e7}, tolerance=1e-10)
    np.testing.assert_allclose(sim["A.pressure"], 1e5 + 1.99e7 * np.exp(-10 * times), rtol=1e-8)


def test_mass_is_conserved_with_air_and_elastic_walls():
    oil = jl.Oil(1.4e9, 850.0, air_fraction=0.03, polytropic_index=1.2, modulus_slope=8.0)
    vessels = {"high": jl.Vessel(2e-3, 5e8), "low": jl.Vessel(1e-3, 1e9)}
    lines = {name: jl.Line(node, vessels[name]) for name, node in (("high", "A"), ("low", "B"))}
    sim = jl.simulate(
        jl.Circuit(oil, {"valve": jl.Orifice("A", "B", 2e-6), **lines}),
        np.linspace(0, 0.3, 61),
        initial={"A.pressure": 1.5e7, "B.pressure": 1.5e5},
        outputs=["A.pressure", "B.pressure", "valve.b.flow"],
        tolerance=1e-10,
    )

    def mass(part, node):
        p = sim[f"{node}.pressure"]
        return oil.density_at(p) * volume_at(vessels[part], oil, p)

    total = mass("high", "A") + mass("low", "B")
    moved = mass("low", "B")[-1] - mass("low", "B")[0]
    assert moved > 0.01
    np.testing.assert_allclose(total, total[0], atol=1e-8 * moved)


def test_inflow_equals_the_change_of_mass():
    oil, vessel = jl.Oil(1.4e9, 850.0, air_fraction=0.05), jl.Vessel(1e-3, 3e8)
    circuit = jl.Circuit(oil, {"pump": jl.FlowSource("A", 2e-5), "line": jl.Line("A", vessel)})
    times = np.linspace(0, 3.0, 3001)
    sim = jl.simulate(circuit, times, initial={"A.pressure": 2e5}, tolerance=1e-10)
    p = sim["A.pressure"]
    flow = oil.density_at(p) * 2e-5
    simpson = np.sum(flow[:-2:2] + 4 * flow[1:-1:2] + flow[2::2]) * (times[1] - times[0]) / 3
    mass = oil.density_at(p) * volume_at(vessel, oil, p)
    assert p[-1] > 1e6
    assert mass[-1] - mass[0] == pytest.approx(simpson, rel=1e-9)


def test_inertia_resistance_and_capacitance_ring():
    """p = p_s - (p_s - p_0) e^(-z w t) (cos w_d t + z/sqrt(1 - z^2) sin w_d t)."""
    inertance, resistance, volume = 1e7, 3e8, 1e-3
    column = jl.FluidInertia("P", "A", inertance, resistance)
    supply = jl.PressureSource("P", 6e6)
    circuit = jl.Circuit(ARTICLE, {"supply": supply, "column": column, "line": jl.Line("A", jl.Vessel(volume))})
    times = np.linspace(0, 0.2, 101)
    sim = jl.simulate(circuit, times, initial={"A.pressure": 5e6}, tolerance=1e-10)
    compliance = volume / 1.379e9
    w, z = 1 / np.sqrt(inertance * compliance), 0.5 * resistance * np.sqrt(compliance / inertance)
    wd = w * np.sqrt(1 - z * z)
    ringing = np.exp(-z * w * times) * (np.cos(wd * times) + z * w / wd * np.sin(wd * times))
    assert 0.01 < z < 0.5 and wd * 0.2 > 6 * np.pi
    np.testing.assert_allclose(sim["A.pressure"], 6e6 - 1e6 * ringing, rtol=1e-8)


def test_spool_step_response():
    w, z = 250.0, 0.7
    valve = jl.Servovalve("P", "T", "A", "B", "spool", 1e-4, natural_frequency=w, damping_ratio=z)
    ends = {"supply": jl.PressureSource("P", 1e7), "tank": jl.Tank("T")}
    lines = {"a": jl.Line("A", jl.Vessel(1e-2)), "b": jl.Line("B", jl.Vessel(1e-2))}
    times = np.linspace(0, 0.05, 51)
    jump = 0.01037  # between two saved times
    inputs = {"spool": jl.Step(0.0, 0.5, jump)}
    sim = jl.simulate(jl.Circuit(ARTICLE, {**ends, "valve": valve, **lines}), times, inputs, tolerance=1e-10)
    t, wd = np.maximum(times - jump, 0.0), w * np.sqrt(1 - z * z)
    expected = 0.5 * (1 - np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t)))
    np.testing.assert_allclose(sim["valve.spool"], expected, atol=1e-9)


def test_a_step_between_two_times_is_met_exactly():
    """With a constant modulus the pressure is a ramp from the jump on: dp/dt = K Q."""
    source = jl.FlowSource("A", jl.Step(0.0, 1e-4, 0.033333))
    circuit = jl.Circuit(ARTICLE, {"pump": source, "line": jl.Line("A", jl.Vessel(1e-3))})
    times = np.linspace(0, 0.1, 11)
    sim = jl.simulate(circuit, times)
    expected = 101325.0 + 1.379e12 * 1e-4 * np.maximum(times - 0.033333, 0)
    np.testing.assert_allclose(sim["A.pressure"], expected, rtol=1e-11)
    assert sim.num_steps < 40


# Blow-down of 1 litre, beta 1e9 Pa, from 200 bar to a tank at 1 bar, computed by Hopsan (commit 0c3995e).
TURBULENT = {0.005: 13479800.0, 0.0125: 6118136.0, 0.02: 1658846.0}
LAMINAR = {0.05: 12169960.0, 0.1: 7420801.0, 0.2: 2793172.0, 0.5: 234085.1}


def blow_down(outlet) -> jl.Circuit:
    oil = jl.Oil(1e9, 870.0, mass="article")
    return jl.Circuit(oil, {"tank": jl.Tank("T", 1e5), "out": outlet, "volume": jl.Line("A", jl.Vessel(1e-3))})


@pytest.fixture(scope="module")
def orifice() -> jl.Circuit:
    return blow_down(jl.Orifice("A", "T", 1e-5, discharge_coefficient=0.67, transition=10.0))


@pytest.fixture(scope="module")
def leak() -> jl.Circuit:
    return blow_down(jl.LaminarLeak("A", "T", 1e-11))


def pressure(circuit, times):
    return jl.simulate(circuit, times, initial={"A.pressure": 2e7}, tolerance=1e-9)["A.pressure"]


def test_blow_down_as_hopsan(orifice, leak):
    np.testing.assert_allclose(pressure(leak, [0.0, *LAMINAR])[1:], list(LAMINAR.values()), rtol=1e-6)
    np.testing.assert_allclose(pressure(orifice, [0.0, *TURBULENT])[1:], list(TURBULENT.values()), rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "file", "tolerance"),
    [
        ("leak", "hop5l_volume_laminar_orifice_decay.csv", 1e-6),
        ("orifice", "hop5_volume_turbulent_orifice_blowdown.csv", 1e-4),
    ],
)
def test_whole_record_of_hopsan(name, file, tolerance, request):
    if not (HOPSAN / file).exists():
        pytest.skip(f"the reference data {file} is not beside the project")
    table = np.loadtxt(HOPSAN / file, delimiter=",", skiprows=1)
    ours = pressure(request.getfixturevalue(name), table[:, 0])
    error = np.abs(ours - table[:, 1]) / table[:, 1]
    assert np.max(error[table[:, 1] > 1.02e5]) < tolerance
    np.testing.assert_allclose(ours, table[:, 1], rtol=2e-3)


def test_an_emptied_volume_stays_at_the_tank_with_a_finite_gradient(orifice):
    after = pressure(orifice, [0.0, 0.028, 0.1, 1.0])
    np.testing.assert_allclose(after[2:], 1e5, rtol=1e-6)

    def end(area):
        changed = orifice.replace({"out.area": area})
        sim = jl.simulate(changed, [0.0, 0.05, 0.1], initial={"A.pressure": 2e7}, outputs=["A.pressure"])
        return sim["A.pressure"][1]

    with jax.enable_x64(True):
        slope = float(jax.grad(end)(1e-5))
    assert np.isfinite(slope)
    assert abs(slope) * 1e-5 < 1.0  # a change of 100 % moves the pressure by less than 1 Pa
