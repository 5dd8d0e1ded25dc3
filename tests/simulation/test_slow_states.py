"""Walls that creep and air that takes time to dissolve: against closed forms, and mass conserved throughout."""

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.containers import volume_at
from jaxlines.physics.ladder import cut

STATIC, DYNAMIC, RELAXATION, LIQUID = 3e8, 8e8, 0.05, 1.5e9
HOSE = jl.ViscoelasticHose(2.0, 0.02, STATIC, DYNAMIC, RELAXATION)


def test_a_creeping_hose_relaxes():
    """Fluid pressed into a closed hose at once: p falls from dV/(V (1/K + 1/K_d)) to dV/(V (1/K + 1/K_s)) with the
    time constant tau (1/K + 1/K_d)/(1/K + 1/K_s)."""
    fast, slow = 1 / LIQUID + 1 / DYNAMIC, 1 / LIQUID + 1 / STATIC
    jump, times = 1e5, np.linspace(0.0, 0.3, 31)
    oil = jl.Oil(LIQUID, 870.0, mass="article")
    circuit = jl.Circuit(oil, {"hose": jl.Line("A", HOSE)})
    start = {"A.pressure": 101325.0 + jump, "hose.parts.0.delayed_strain": 0.0}
    sim = jl.simulate(circuit, times, initial=start, tolerance=1e-10)
    rest = jump * fast / slow
    expected = rest + (jump - rest) * np.exp(-times * slow / (RELAXATION * fast))
    np.testing.assert_allclose(sim["A.pressure"] - 101325.0, expected, rtol=1e-6)
    assert sim["hose.parts.0.delayed_strain"][-1] == pytest.approx(rest * (1 / STATIC - 1 / DYNAMIC), rel=1e-3)


def test_a_creeping_hose_starts_settled():
    oil = jl.Oil(LIQUID, 870.0)
    circuit = jl.Circuit(oil, {"hose": jl.Line("A", HOSE)})
    sim = jl.simulate(circuit, [0.0, 1.0], initial={"A.pressure": 5e6})
    np.testing.assert_allclose(sim["A.pressure"], 5e6, rtol=1e-6)


AIRS = {
    "free": jl.FreeAir(),
    "at equilibrium": jl.DissolvingAir(jl.PolynomialSolubility(2e6), "equilibrium"),
    "kinetic": jl.KineticAir(jl.LinearSolubility(2e6), release_time=0.05, absorption_time=0.5),
    "Henry, kinetic": jl.KineticAir(jl.HenrySolubility(), release_time=0.05, absorption_time=0.5),
}


def cycle(line, air, lowest, ends, end):
    """A line whose inlet is drawn down to a pressure through an orifice and brought back: mass in it, and fed to it."""
    oil = jl.Oil(LIQUID, 870.0, 30e-6, air_fraction=0.002, air=AIRS[air])
    pull = jl.Sampled([0.0, 0.2, 1.0, 1.3, end], [5e5, lowest, lowest, 5e5, 5e5], "cubic")
    parts = {"line": line, "pump": jl.PressureSource("P", pull), "valve": jl.Orifice("P", "A", 1e-4)}
    times = np.concatenate([np.linspace(0.0, 1.5, 15001), np.linspace(1.5, end, 2001)[1:]])
    circuit, start = jl.Circuit(oil, parts), dict.fromkeys(ends, 5e5)
    names = list(jl.simulate(circuit, [0.0, 1e-6], initial=start).outputs)
    sim = jl.simulate(circuit, times, initial=start, outputs=[*names, "valve.b.flow"], tolerance=1e-7, max_steps=10**6)
    fed = -oil.density_at(sim["A.pressure"]) * sim["valve.b.flow"]
    return sim, np.concatenate([[0.0], np.cumsum(0.5 * (fed[1:] + fed[:-1]) * np.diff(times))])


@pytest.mark.parametrize("air", AIRS)
def test_a_cycle_through_2_kpa_returns_to_its_starting_mass(air):
    """What went out of a hose came in again, whatever the air did meanwhile."""
    sim, total = cycle(jl.Line("A", [HOSE]), air, 2e2, ["A.pressure"], 12.0)
    mass = stored_mass(sim, None)
    lowest = 1e4 if "Henry" in air else 2e3  # saturated oil gives off far more gas than could be drawn out
    assert 0.0 < sim.lowest_pressure < lowest
    np.testing.assert_allclose(mass - mass[0], total, atol=1e-3 * float(np.ptp(mass)))  # the rest is quadrature
    assert mass[-1] == pytest.approx(mass[0], rel=2e-5)


def test_segments_with_slow_walls_and_slow_air_conserve_mass():
    line = jl.Line("A", HOSE, to="B", segments=3)
    sim, total = cycle(line, "kinetic", 3e4, ["A.pressure", "B.pressure"], 2.0)
    mass = stored_mass(sim, 3)
    assert sim.lowest_pressure < 1e5
    np.testing.assert_allclose(mass - mass[0], total, atol=1e-3 * float(np.ptp(mass)))  # the rest is quadrature


def stored_mass(sim, segments) -> np.ndarray:
    """Mass in the line, from what was saved [kg], shape (times,)."""
    oil, count = sim.circuit.fluid, 1 if segments is None else segments + 1

    def along(name, index):
        return np.stack([sim[f"line.{name}.{i}"] for i in index])

    if segments is None:
        pressures, shares, strain = sim["A.pressure"][None], np.ones(1), sim["line.parts.0.delayed_strain"][None]
        air = sim["line.undissolved_air"][None] if oil.air.kinetic else None
    else:
        pressures = np.concatenate([sim["A.pressure"][None], along("pressure", range(2)), sim["B.pressure"][None]])
        shares, strain = cut(segments, "pi").volumes, along("delayed_strain", range(count))
        air = along("undissolved_air", range(count)) if oil.air.kinetic else None
    volumes = volume_at(HOSE, oil, pressures, strain)  # pyright: ignore[reportArgumentType]
    return np.asarray(np.tensordot(shares, oil.density_at(pressures, air) * volumes, 1))
