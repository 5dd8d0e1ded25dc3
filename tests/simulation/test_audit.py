"""Audits against balances worked out by hand: mass, momentum and energy of nodes, components and circuits."""

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.containers import volume_at
from jaxlines.physics.controllers import SampledController
from jaxlines.simulation.audit import audit
from jaxlines.simulation.ledger import GAUSS, KRONROD, NODES, inner_nodes, integrate_nodes, panel_times, slopes_at_nodes

ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
AIRY = jl.Oil(1.4e9, 850.0, 30e-6, 0.02, modulus_slope=6.0)


def test_rules_of_integration_and_slopes():
    """Kronrod's rule is exact to degree 22, Gauss's to 13, slopes to 16."""
    np.testing.assert_allclose([KRONROD.sum(), GAUSS.sum()], 2.0, rtol=1e-14)
    for degree in range(0, 23, 2):
        assert KRONROD @ NODES**degree == pytest.approx(2.0 / (degree + 1), rel=1e-13)
        assert degree > 12 or GAUSS @ NODES**degree == pytest.approx(2.0 / (degree + 1), rel=1e-13)
    edges = np.array([0.0, 0.4, 0.5, 1.3])
    times = panel_times(edges)
    assert np.all(np.diff(times) > 0) and times.size == 3 * 16 + 1
    np.testing.assert_allclose(slopes_at_nodes(edges, times**16), 16 * inner_nodes(times) ** 15, rtol=1e-10, atol=1e-11)
    found = integrate_nodes(edges, inner_nodes(np.sqrt(times)))
    true = abs(found.value - 2.0 / 3.0 * 1.3**1.5)
    assert 1e-7 < true < found.error < 1e-2


def filling(fluid, flow, tolerance):
    """A pump, a flow [m^3/s] or signal, that fills an elastic vessel from 2 bar."""
    line = jl.Line("A", jl.Vessel(1e-3, 5e8))
    circuit = jl.Circuit(fluid, {"pump": jl.FlowSource("A", flow), "line": line})
    times = np.linspace(0.0, 2.0, 4001)
    return jl.simulate(circuit, times, initial={"A.pressure": 2e5}, tolerance=tolerance), line


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_the_error_of_a_node_is_what_it_is_by_hand(tolerance):
    """Mass by the density of the end less the integral of rho Q by Simpson's rule over 4000 intervals."""
    sim, line = filling(AIRY, 2e-5, tolerance)
    p = sim["A.pressure"]
    rate = AIRY.density_at(p) * 2e-5
    received = np.sum(rate[:-2:2] + 4 * rate[1:-1:2] + rate[2::2]) * 5e-4 / 3
    mass = AIRY.density_at(p) * volume_at(line.parts[0], AIRY, p)
    done = audit(sim, tolerance=tolerance)
    (node,) = done.nodes
    assert done.deviation < 1e-9
    assert node.stored == pytest.approx(mass[-1] - mass[0], rel=1e-9)
    assert abs(node.error) > 1e-10 and node.audit_error < 0.3 * abs(node.error)
    assert node.error == pytest.approx(mass[-1] - mass[0] - received, rel=0.05)
    assert done.mass.error == pytest.approx(node.error, rel=1e-3)
    assert done.supplied == {"pump": pytest.approx(received, rel=1e-4)}


def test_errors_follow_the_tolerance_over_a_jump():
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        sim, _ = filling(AIRY, jl.Step(1e-6, 2e-5, 0.77777), tolerance)
        done = audit(sim, tolerance=tolerance)
        assert done.worst().relative_error < 3 * tolerance
        errors.append(abs(done.nodes[0].error) + done.nodes[0].audit_error)
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


@pytest.mark.slow
def test_slow_states_and_segments_keep_their_mass():
    """A hose that creeps, air that dissolves slowly, a line in segments, an accumulator: mass from states alone."""
    oil = jl.Oil(1.4e9, 850.0, 30e-6, 0.01, air=jl.KineticAir(jl.PolynomialSolubility(), 0.1, 5.0))
    hose = jl.ViscoelasticHose(2.0, 0.02, 3e8, 8e8, 0.05)
    parts = {
        "pump": jl.FlowSource("A", jl.Sine(1e-5, 2e-5, 3.0)),
        "hose": jl.Line("A", [hose, jl.Vessel(1e-4)]),
        "pipe": jl.Line("A", hose, to="B", segments=3),
        "end": jl.Line("B", jl.Vessel(2e-4)),
        "gas": jl.NitrogenAccumulator("B", 1e-3, 5e6, 1e-9, 5.0),
    }
    start = {"A.pressure": 6e6, "B.pressure": 6e6}
    sim = jl.simulate(jl.Circuit(oil, parts), np.linspace(0.0, 0.5, 51), initial=start, tolerance=1e-8)
    done = audit(sim, tolerance=1e-8)
    assert {b.name for b in done.contents} == {"mass in hose", "mass in pipe", "mass in end", "mass in gas"}
    assert all(b.relative_error < 1e-7 for b in [*done.nodes, *done.contents, done.mass])
    moved = done.supplied["pump"]
    assert moved > 3e-3 and set(done.supplied) == {"pump"}
    assert sum(b.stored for b in done.contents) == pytest.approx(moved, rel=1e-7)
    assert done.mass.stored == pytest.approx(moved, rel=1e-7)
    assert done.deviation < 1e-9


def test_mass_energy_and_the_article():
    """Blow-down from p_0 to p_1 through a leak to p_t, volume conserved: V dp = -K Q dt.

    The leak takes up V/(2 K) ((p_0 - p_t)^2 - (p_1 - p_t)^2). The real density makes of it an inflow of
    2 V rho(p_atm) exp((p + p_t)/2 - p_atm)/K) between p_0 and p_1.
    """
    parts = {"tank": jl.Tank("T", 1e5), "leak": jl.LaminarLeak("A", "T", 1e-11), "line": jl.Line("A", jl.Vessel(1e-3))}
    times = np.linspace(0.0, 0.1, 11)
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), times, initial={"A.pressure": 2e7}, tolerance=1e-9)
    done, end = audit(sim, tolerance=1e-9), sim["A.pressure"][-1]
    assert done.nodes[0].stored == pytest.approx(850.0 * 1e-3 * (end - 2e7) / 1.379e9, rel=1e-9)
    assert done.nodes[0].relative_error < 1e-8 and done.energy.relative_error < 1e-8
    assert done.delivered["leak"] == pytest.approx(-1e-3 / 2.758e9 * ((2e7 - 1e5) ** 2 - (end - 1e5) ** 2), rel=1e-7)
    assert done.supplied["tank"] == pytest.approx(done.nodes[0].received, rel=1e-12)

    def density(p):
        return 850.0 * np.exp((p - 101325.0) / 1.379e9)

    (true,) = done.true
    assert true.stored == pytest.approx(1e-3 * (density(end) - density(2e7)), rel=1e-7)
    received = 2e-3 * (density(0.5 * (end + 1e5)) - density(0.5 * (2e7 + 1e5)))
    assert true.received == pytest.approx(received, rel=1e-7)
    assert true.relative_error > 1e-3
    assert 'mass is not conserved with mass="article"' in str(done)
    conserved = jl.simulate(jl.Circuit(AIRY, parts), times, initial={"A.pressure": 2e7}, tolerance=1e-9)
    assert audit(conserved, tolerance=1e-9).true == ()


def test_momentum_and_energy_of_a_shaft():
    """J w = T t; kinetic energy J w^2/2 is the load's work."""
    circuit = jl.Circuit(ARTICLE, {"inertia": jl.Inertia("shaft", 40.0), "load": jl.LoadTorque("shaft", jl.Sine(8.0))})
    sim = jl.simulate(circuit, np.linspace(0.0, 0.25, 6), tolerance=1e-9)
    done, speed = audit(sim, tolerance=1e-9), sim["shaft.speed"][-1]
    (node,) = done.nodes
    assert node.unit == "N*m*s" and node.received == pytest.approx(8.0 * 0.25 + 1 / (2 * np.pi), rel=1e-9)
    assert node.stored == pytest.approx(40.0 * speed, rel=1e-9)
    assert done.delivered["load"] == pytest.approx(20.0 * speed**2, rel=1e-7)
    assert done.energy.stored == pytest.approx(20.0 * speed**2, rel=1e-9)
    assert "momentum at shaft: stored 2.15915 N*m*s" in done.sentences()[0]


def test_a_sampled_loop_balances_between_its_instants():
    parts = {
        "inertia": jl.Inertia("shaft", 2.0),
        "damper": jl.RotaryDamper("shaft", 4.0),
        "drive": jl.LoadTorque("shaft", "loop"),
        "loop": SampledController("shaft.speed", 0.03, 1.5, 10.0, 30.0),
    }
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), np.linspace(0.0, 0.5, 6), tolerance=1e-8)
    done = audit(sim, tolerance=1e-8)
    assert done.deviation < 1e-9
    assert done.worst().relative_error < 1e-8 and done.worst().audit_error < 1e-8
    assert done.nodes[0].stored == pytest.approx(2.0 * sim["shaft.speed"][-1], rel=1e-9)
    assert done.delivered["damper"] < -1.0


def test_a_start_that_was_not_saved_must_be_given():
    line: dict = {
        "pump": jl.FlowSource("A", 1e-5),
        "line": jl.Line("A", jl.Vessel(1e-3)),
        "drain": jl.LaminarLeak("A", "T", 1e-12),
    }
    circuit = jl.Circuit(AIRY, {**line, "tank": jl.Tank("T")})
    sim = jl.simulate(circuit, [0.0, 0.1], initial={"A.pressure": 3e5}, outputs=["drain.a.flow"])
    with pytest.raises(ValueError, match=r"the start value of A\.pressure, which was not saved"):
        audit(sim)
    assert audit(sim, initial={"A.pressure": 3e5}).deviation == 0.0
