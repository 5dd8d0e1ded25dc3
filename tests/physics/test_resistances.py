"""Orifice in two regimes, minor loss, annular gap, measured tables: published numbers, closed forms, general laws."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from jax.flatten_util import ravel_pytree
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator
from test_components import OILS, POINTS, differences, results, situation, sizes

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.friction import minor_loss_drop
from jaxlines.physics.resistances import (
    AnnularLeak,
    MinorLoss,
    annular_leak_flow,
    minor_loss_flow,
    orifice_flow,
    regularised_root,
    soft_clip,
    transition_pressure,
    two_regime_root,
)
from jaxlines.physics.tables import CurveValve, TableValve, monotone_cubic

ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
MODELICA = Path(__file__).parents[2] / "../shared/reference/modelica_fluid/TestSharpEdgedOrifice.csv"
PARTS = {
    "two regimes": jl.Orifice("a", "b", 5e-6, transition=1e7, regularisation="two_regime"),
    "minor loss": MinorLoss("a", "b", 1.5, 1e-4),
    "annular leak": AnnularLeak("a", "b", 0.02, 1e-5, 0.03, 0.4),
    "curve valve": CurveValve("a", "b", 0.3, [0.0, 0.2, 0.5, 1.0], [1e-7, 1e-6, 4e-6, 9e-6]),
    "table valve": TableValve(
        "a", "b", 0.3, [0.0, 0.5, 1.0], [4.7e6, 1.1e7], [[1e-6, 2e-6], [5e-5, 1e-4], [1e-4, 3e-4]]
    ),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def seen(part, oil, point) -> Situation:
    """What a component sees at a point, with the states it has when filled with this oil."""
    state = {s.name: jnp.asarray(POINTS[point][2] * s.scale) for s in part.states_in(oil)}
    return situation(part, oil, point)._replace(state=state)


def check_derivatives(part, oil=OILS["with air"]):
    """Derivatives of all flows and rates in all numbers, against central differences, at every point."""
    _, restore = ravel_pytree((part, seen(part, oil, "generic")))
    function = jax.jit(lambda x: results(*restore(x)))
    jacobian = jax.jit(jax.jacfwd(lambda x: results(*restore(x))))
    largest = np.max([np.abs(results(part, seen(part, oil, point))) for point in POINTS], axis=0)
    for point in POINTS:
        at = seen(part, oil, point)
        size, at_size = sizes(part, at)
        at_size = at_size._replace(state={s.name: np.asarray(1e-3 * s.scale) for s in part.states_in(oil)})
        x, scale = np.asarray(ravel_pytree((part, at))[0]), np.asarray(ravel_pytree((size, at_size))[0])
        exact = np.asarray(jacobian(x))
        assert np.all(np.isfinite(exact)) and np.all(np.isfinite(function(x))), point
        error = np.abs(exact - differences(function, x, 1e-3 * scale)) * scale
        allowed = 1e-6 * np.max(np.abs(exact) * scale, axis=1) + 1e-12 * largest
        wrong = np.argwhere(error > np.broadcast_to(allowed[:, None], error.shape))
        assert not wrong.size, f"{point}: {wrong.tolist()}"


def check_conservation(part, oil=OILS["with air"]):
    """At every point the mass flows into the hydraulic nodes add up to nothing, and at the first some mass flows."""
    for point in POINTS:
        masses = [float(m) for m in part.evaluate(seen(part, oil, point)).flow.values()]
        assert abs(sum(masses)) <= 1e-14 * max(map(abs, masses)) + 1e-18
        assert point != "generic" or max(map(abs, masses)) > 1e-9


def check_batch(part, oil=OILS["with air"]):
    """All points at once, as arrays, give what each gives alone."""
    alone = [seen(part, oil, point) for point in POINTS]
    together = part.evaluate(jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v) for v in x]), *alone))
    for room, name in ((r, n) for r in ("flow", "rate") for n in getattr(together, r)):
        single = [getattr(part.evaluate(at), room)[name] for at in alone]
        np.testing.assert_allclose(
            getattr(together, room)[name], single, rtol=1e-13, atol=1e-15 * np.max(np.abs(single))
        )


def through(part, p_a, p_b, oil=ARTICLE, state=None):
    """Volume flow from a to b [m^3/s] at two pressures, in a fluid of constant density."""
    given = {name: getattr(part, name) for name in ("area", "opening", "command") if hasattr(part, name)}
    at = Situation(oil, {"a": p_a, "b": p_b}, state or {}, given)
    return np.asarray(part.evaluate(at).flow["b"]) / 850.0


@pytest.mark.parametrize("name", ["two regimes"])
def test_derivatives_and_conservation(name):
    check_derivatives(PARTS[name])
    check_conservation(PARTS[name])
    check_batch(PARTS[name])


def test_two_regimes_of_ellman_and_piche():
    """C_d 0.61, A 20 mm^2, rho 860, nu 30 mm^2/s, Re_cr 9.3: P_cr 7.948032 Pa, Q(1e4 Pa) = 5.883362e-5 m^3/s."""
    area, density, viscosity, reynolds = 20e-6, 860.0, 30e-6, 9.3
    diameter = np.sqrt(4 * area / np.pi)
    critical = transition_pressure(reynolds, density, viscosity, 0.61, diameter)
    assert critical == pytest.approx(7.948032, rel=1e-7)
    assert orifice_flow(area, 0.61, density, 1e4, 0.0, critical, two_regime_root) == pytest.approx(
        5.883362e-5, rel=1e-7
    )
    for share in (0.0, 0.3, 0.9, -0.5):
        laminar = 3 * area * viscosity * reynolds / (4 * diameter) * share * (3 - abs(share))
        flow = orifice_flow(area, 0.61, density, share * critical, 0.0, critical, two_regime_root)
        assert flow == pytest.approx(laminar, rel=1e-12)


def test_two_regimes_join_smoothly():
    slope, transition = jax.grad(two_regime_root), 50.0
    assert float(slope(0.0, transition)) == pytest.approx(1.5 / np.sqrt(transition), rel=1e-12)
    for x in (transition, -transition):
        inside, outside = slope(x * (1 - 1e-9), transition), slope(x * (1 + 1e-9), transition)
        assert float(inside) == pytest.approx(float(outside), rel=1e-8)
        assert float(outside) == pytest.approx(0.5 / np.sqrt(transition), rel=1e-8)
    assert two_regime_root(400.0, transition) == 20.0 and two_regime_root(-400.0, transition) == -20.0


def test_the_regularisations_agree_far_from_zero_and_on_the_host():
    x = np.array([-1e6, -2e4, 3e4, 5e6])
    np.testing.assert_allclose(regularised_root(x, 1e3), two_regime_root(x, 1e3), rtol=7e-4)
    assert isinstance(two_regime_root(x, 1e3), np.ndarray) and two_regime_root(x, 1e3).dtype == np.float64
    ours = [through(jl.Orifice("a", "b", 5e-6, regularisation=r), 9e6, 1e6) for r in ("fourth_root", "two_regime")]
    np.testing.assert_allclose(ours, 0.62 * 5e-6 * np.sqrt(2 * 8e6 / 850), rtol=1e-8)
    with pytest.raises(ValueError, match=r"regularisation must be one of fourth_root, two_regime, got 'sharp'"):
        jl.Orifice("a", "b", 5e-6, regularisation="sharp")


PRESSURES = st.floats(1e4, 4e7)


@settings(max_examples=30, deadline=None)
@given(PRESSURES, PRESSURES, st.sampled_from(sorted(PARTS)))
def test_resistances_are_passive_odd_and_monotone(p_a, p_b, name):
    part = PARTS[name]
    flow, back, more = through(part, p_a, p_b), through(part, p_b, p_a), through(part, p_a + 1e5, p_b)
    assert flow * (p_a - p_b) >= 0.0
    assert flow == -back
    assert more >= flow


def idelchik(share, ratio):
    """Loss coefficients of a bevelled orifice in a pipe, forwards and backwards, as in the Modelica Standard Library.

    Args: share of the diameters D_0/D_1; ratio of length and least diameter. (Idelchik, diagrams 4-14 and 4-13.)
    """
    closed = 1 - share
    k = 0.13 + 0.34 * 10 ** -(3.4 * ratio + 88.4 * ratio**2.3)
    forwards = (closed + 0.707 * closed**0.375) ** 2 / share**2
    return forwards, k * closed**0.75 + closed**2 + 2 * np.sqrt(k * closed**0.375) + closed


def test_minor_loss_against_modelica():
    """Pipe 100 mm, orifice 20 mm, oxygen at 20 C before and 80 C after it, from 0.1..2 bar to 1 bar."""
    if not MODELICA.exists():
        pytest.skip(f"the reference data {MODELICA.name} is not beside the project")
    rows = np.loadtxt(MODELICA, delimiter=",", skiprows=1)
    time, mass, p_b = rows[:, 0], -rows[:, 1], 1e5
    p_a = 0.1e5 + 0.19e5 * time
    forwards, backwards = idelchik(0.2, 0.25)
    loss, temperature = np.where(p_a > p_b, forwards, backwards), np.where(p_a > p_b, 293.15, 353.15)
    density = np.maximum(p_a, p_b) / (8.314462 / 0.0319988 * temperature)
    ours = density * minor_loss_flow(loss, np.pi / 4 * 0.1**2, density, p_a, p_b, 1.0)
    far = np.abs(p_a - p_b) > 3e3  # closer, the reference has a regularisation of its own
    assert np.count_nonzero(far) > 230
    np.testing.assert_allclose(ours[far], mass[far], rtol=2e-5)


def test_minor_loss_is_the_inverse_of_its_drop():
    loss = MinorLoss("a", "b", 2.5, 1e-4, transition=1.0)
    flow = through(loss, 3e5, 1e5)
    assert minor_loss_drop(2.5, 850.0, flow / 1e-4) == pytest.approx(2e5, rel=1e-9)
    assert flow == pytest.approx(1e-4 * np.sqrt(2 * 2e5 / (2.5 * 850.0)), rel=1e-9)


@pytest.mark.parametrize("eccentricity", [0.0, 0.5, 1.0])
def test_annular_leak_is_the_mean_of_plane_gaps(eccentricity):
    """Plane Poiseuille flow h^3 dp/(12 mu L) for each element of the circumference, added up."""
    diameter, gap, length, viscosity, drop = 0.02, 1e-5, 0.03, 0.025, 5e6

    def element(angle):
        return 0.5 * diameter * (gap * (1 + eccentricity * np.cos(angle))) ** 3 * drop / (12 * viscosity * length)

    whole = quad(element, 0, 2 * np.pi, epsabs=0, epsrel=1e-12)[0]
    flow = annular_leak_flow(diameter, gap, length, eccentricity, viscosity, drop)
    assert flow == pytest.approx(whole, rel=1e-11)
    leak = AnnularLeak("a", "b", diameter, gap, length, eccentricity)
    oil = jl.Oil(1.4e9, 850.0, viscosity / 850.0, mass="article")
    assert through(leak, 6e6, 1e6, oil) == pytest.approx(whole, rel=1e-11)


def test_a_volume_empties_through_an_annular_gap():
    leak = AnnularLeak("A", "T", 0.02, 2e-5, 0.03, 1.0)
    circuit = jl.Circuit(ARTICLE, {"tank": jl.Tank("T", 1e5), "leak": leak, "line": jl.Line("A", jl.Vessel(1e-3))})
    times = np.linspace(0.0, 1.0, 6)
    rate = np.pi * 0.02 * 8e-15 * 2.5 / (12 * 850.0 * 27.7e-6 * 0.03) * 1.379e9 / 1e-3
    sim = jl.simulate(circuit, times, initial={"A.pressure": 2e7}, tolerance=1e-10)
    assert 0.2 < rate < 5.0
    np.testing.assert_allclose(sim["A.pressure"], 1e5 + 1.99e7 * np.exp(-rate * times), rtol=1e-8)


@settings(max_examples=40, deadline=None)
@given(st.floats(-2.0, 3.0), st.floats(1e-4, 0.49))
def test_soft_clip(x, width):
    value, sharp = soft_clip(x, width), min(max(x, 0.0), 1.0)
    assert abs(value - sharp) <= width
    assert value == pytest.approx(1.0 - soft_clip(1.0 - x, width), abs=1e-12)
    assert soft_clip(x + 1e-3, width) >= value - 1e-15
    if x <= 0.0 or x >= 1.0:
        assert value == pytest.approx(sharp, rel=1e-14, abs=0.0) and float(jax.grad(soft_clip)(x, width)) == 0.0


def test_soft_clip_is_twice_differentiable():
    slope = jax.grad(soft_clip)
    for x in (0.0, 0.2, 0.8, 1.0):  # where its pieces meet
        before, after = (float(jax.grad(slope)(x + e, 0.1)) for e in (-1e-7, 1e-7))
        assert before == pytest.approx(after, abs=1e-4)
    assert float(slope(0.5, 0.1)) == pytest.approx(1.25)


KNOTS = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
MEASURED = np.array([0.0, 0.1, 0.15, 0.5, 0.5, 0.9])


def test_monotone_cubic_as_scipy_between_even_samples():
    """With even samples SciPy's weights are equal; the slopes at the ends are chosen differently."""
    x = np.linspace(0.2, 0.8, 61)
    expected = PchipInterpolator(KNOTS, MEASURED)(x)
    np.testing.assert_allclose(monotone_cubic(KNOTS, MEASURED, x), expected, atol=1e-14)
    np.testing.assert_allclose(jax.jit(monotone_cubic)(KNOTS, MEASURED, x), expected, atol=1e-14)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=8), st.sampled_from(["hold", "odd"]))
def test_monotone_cubic_never_overshoots(rises, ends):
    ys, xs = np.cumsum([0.0, *rises]), np.cumsum([0.0, *(1.0 + np.arange(len(rises)) % 3)])
    x = np.linspace(xs[0], xs[-1], 101)
    values = monotone_cubic(xs, ys, x, ends)
    assert np.all(np.diff(values) >= -1e-12)
    np.testing.assert_allclose(monotone_cubic(xs, ys, xs, ends), ys, atol=1e-12)
    assert monotone_cubic(xs, ys, xs[-1] + 1.0, ends) >= ys[-1]
    assert monotone_cubic(xs, ys, -1.0, "hold") == 0.0


def test_table_of_an_orifice_reproduces_it():
    openings, drops = np.linspace(0.0, 1.0, 6), np.array([0.05, 0.2, 0.5, 1.0, 2.0, 4.0, 7.0, 12.0, 20.0]) * 1e6
    flows = 0.62 * 2e-5 * openings[:, None] * np.sqrt(2 * drops / 850.0)
    for opening, p_a, tolerance in ((0.6, 4.1e6, 1e-12), (0.35, 3.1e6, 5e-3), (0.9, 15e6, 5e-3)):
        valve = TableValve("a", "b", opening, openings, drops, flows)
        expected = 0.62 * 2e-5 * opening * np.sqrt(2 * (p_a - 1e5) / 850.0)
        assert through(valve, p_a, 1e5) == pytest.approx(expected, rel=tolerance)
        assert through(valve, 1e5, p_a) == pytest.approx(-expected, rel=tolerance)
    lighter = jl.Oil(1.379e9, 425.0, mass="article")
    assert 2 * through(valve, 4e6, 1e5) / 2 == pytest.approx(
        2 * through(valve, 4e6, 1e5, lighter) / np.sqrt(2), rel=1e-9
    )


def test_curve_valve_by_its_kv():
    """K_v = 1: 1 m^3/h of water (1000 kg/m^3) at 1 bar."""
    water = jl.Oil(2.2e9, 1000.0, 1e-6, mass="article")
    valve = CurveValve("a", "b", 1.0, [0.0, 0.5, 1.0], [0.0, 1e-5, 1.964e-5], transition=1.0)
    assert through(valve, 2e5, 1e5, water) * 850.0 / 1000.0 == pytest.approx(1 / 3600, rel=2e-4)


def test_table_valve_in_a_circuit():
    """A table that is proportional to the pressure difference empties a volume exponentially, at the set opening."""
    drops = np.array([1e6, 3e6, 8e6, 30e6])
    valve = TableValve("A", "T", "opening", [0.0, 0.5, 1.0], drops, np.array([[0.0], [1e-11], [4e-11]]) * drops)
    circuit = jl.Circuit(
        ARTICLE, {"tank": jl.Tank("T", 1e5), "valve": valve, "line": jl.Line("A", jl.Vessel(1.379e-3))}
    )
    times = np.linspace(0.0, 0.5, 6)
    start = {"A.pressure": 2e7}
    sim = jl.simulate(circuit, times, {"opening": 0.5}, initial=start, tolerance=1e-10)
    np.testing.assert_allclose(sim["A.pressure"], 1e5 + 1.99e7 * np.exp(-10 * times), rtol=1e-8)
    closed = jl.simulate(circuit, times, {"opening": 0.0}, initial=start, tolerance=1e-10)
    np.testing.assert_allclose(closed["A.pressure"], 2e7, rtol=1e-12)


def test_tables_of_several_valves_stay_apart():
    """Valves of one kind are evaluated together; each empties its own volume at its own rate."""
    drops, rates = np.array([1e6, 3e6, 8e6, 30e6]), {"A": 1e-11, "B": 3e-11, "C": 2e-12}
    parts: dict[str, Any] = {"tank": jl.Tank("T", 1e5)}
    for node, conductance in rates.items():
        flows = np.array([[0.0], [2 * conductance]]) * drops
        parts["valve " + node] = TableValve(node, "T", 0.5, [0.0, 1.0], drops, flows)
        parts["line " + node] = jl.Line(node, jl.Vessel(1.379e-3))
    times = np.linspace(0.0, 0.2, 3)
    start = {f"{node}.pressure": 2e7 for node in rates}
    sim = jl.simulate(jl.Circuit(ARTICLE, parts), times, initial=start, tolerance=1e-10)
    for node, conductance in rates.items():
        decay = np.exp(-conductance * 1e12 * times)
        np.testing.assert_allclose(sim[f"{node}.pressure"], 1e5 + 1.99e7 * decay, rtol=1e-7)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: CurveValve("a", "b", 0.5, [0.0, 0.5, 0.4], [0, 1e-6, 2e-6]),
            r"openings .* must increase.* number 2 \(0.4",
        ),
        (lambda: CurveValve("a", "b", 0.5, [0.0, 1.0], [0, 1e-6, 2e-6]), r"flow_areas .* shape \(2,\).*got \(3,\)"),
        (lambda: CurveValve("a", "b", 0.5, [1.0], [1e-6]), r"openings .* two or more numbers, got shape \(1,\)"),
        (
            lambda: TableValve("a", "b", 0.5, [0, 1], [1e6, 2e6], [[0, 0]]),
            r"flows .* \(2, 2\) \(a row for each opening",
        ),
        (lambda: TableValve("a", "b", 0.5, [0, 1], [1e6, 2e6], [[0, 0], [2e-4, 1e-4]]), "must not fall.* in row 1"),
        (
            lambda: TableValve("a", "b", 0.5, [0, 1], [0.0, 2e6], [[0, 0], [0, 1e-4]]),
            "pressure_drops must be .* above zero",
        ),
        (lambda: AnnularLeak("a", "b", 0.02, 0.02, 0.03), "clearance must be .*was it given in micrometres"),
        (lambda: MinorLoss("a", "b", 0.0, 1e-4), "loss_coefficient must be"),
    ],
)
def test_wrong_tables_and_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
