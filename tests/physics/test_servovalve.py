"""Servovalve: Merritt's coefficients, lands, laps, leakage, spools; and that its first form has kept its numbers."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from test_components import POINTS
from test_resistances import check_batch, check_conservation, check_derivatives

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.servovalve import lapped_opening, limited_rate

ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
EXTRAS: dict[str, Any] = {
    "lap": 0.05,
    "gain_supply_a": 0.9,
    "gain_b_tank": 1.2,
    "null_leakage": 3e-12,
    "rate_limit": 40.0,
}
PARTS = {
    "all extras": jl.Servovalve("s", "t", "a", "b", 0.3, 1e-3, **EXTRAS),
    "first order": jl.Servovalve("s", "t", "a", "b", 0.3, 1e-3, order="first", rate_limit=80.0),
    "sharp": jl.Servovalve("s", "t", "a", "b", 0.3, 1e-3, opening="sharp", lap=0.01),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def flows(valve, spool, supply, tank, p_a, p_b, oil=ARTICLE):
    """Volume flows into the nodes [m^3/s] in a fluid of constant density."""
    potential = {"supply": supply, "tank": tank, "a": p_a, "b": p_b}
    at = Situation(oil, potential, {"spool": spool, "spool_rate": 0.0}, {"command": 0.0})
    return {name: flow / oil.density for name, flow in valve.evaluate(at).flow.items()}


@pytest.mark.parametrize("name", PARTS)
def test_derivatives_and_conservation(name):
    check_derivatives(PARTS[name])
    check_conservation(PARTS[name])
    check_batch(PARTS[name])


@pytest.mark.parametrize("point", POINTS)
def test_the_valve_without_extras_has_the_numbers_of_its_first_form(point):
    """Equations written out: smooth opening, rated flow with the ratio of densities, spool of second order."""
    (supply, tank, p_a, p_b), _, spool = POINTS[point]
    oil = jl.Oil(1.4e9, 850.0, 30e-6, 0.01, 1.2, 6.0)
    valve = jl.Servovalve("s", "t", "a", "b", 0.3, 1e-3, natural_frequency=250.0, damping_ratio=0.7, underlap=0.02)

    def land(stroke, p_from, p_to):
        density, opening = oil.density_at(0.5 * (p_from + p_to)), 0.5 * (stroke + np.hypot(stroke, 0.02))
        root = (p_from - p_to) / ((p_from - p_to) ** 2 + 1e4**2) ** 0.25
        return density * opening * 1e-3 / np.sqrt(3.5e6) * np.sqrt(850.0 / density) * root

    potential = {"supply": supply, "tank": tank, "a": p_a, "b": p_b}
    at = Situation(oil, potential, {"spool": spool, "spool_rate": 7.0}, {"command": 0.3})
    done = valve.evaluate(at)
    into_a = land(spool, supply, p_a) - land(-spool, p_a, tank)
    into_b = land(-spool, supply, p_b) - land(spool, p_b, tank)
    assert float(done.flow["a"]) == pytest.approx(into_a, rel=1e-12, abs=1e-15)
    assert float(done.flow["b"]) == pytest.approx(into_b, rel=1e-12, abs=1e-15)
    expected = {"spool": 7.0, "spool_rate": 250.0**2 * (0.3 - spool) - 2 * 0.7 * 250.0 * 7.0}
    assert {k: float(v) for k, v in done.rate.items()} == pytest.approx(expected, rel=1e-13)


@settings(max_examples=40, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(4e5, 2.0e7), st.floats(4e5, 2.0e7))
def test_sharp_lands_are_those_of_the_benchmark_problem(spool, p_a, p_b):
    """flow = gain max(+-x, 0) dp/(dp^2 + 1e10)^(1/4), gain 1e-3/sqrt(7e6), supply 20.7 MPa, return 0.35 MPa."""
    valve = jl.Servovalve("s", "t", "a", "b", 0.0, 1e-3, 1.4e7, transition=1e5, opening="sharp", rated_density=850.0)

    def flow(drop, opening):
        return 1e-3 / np.sqrt(7e6) * opening * drop / np.sqrt(np.sqrt(drop * drop + 1e10))

    opening, closing = max(spool, 0.0), max(-spool, 0.0)
    ours = flows(valve, spool, 20.7e6, 0.35e6, p_a, p_b)
    assert float(ours["a"]) == pytest.approx(flow(20.7e6 - p_a, opening) - flow(p_a - 0.35e6, closing), rel=1e-12)
    assert float(ours["b"]) == pytest.approx(flow(20.7e6 - p_b, closing) - flow(p_b - 0.35e6, opening), rel=1e-12)


def test_coefficients_of_merritt():
    """K_q = Q_N/sqrt(dp_N) sqrt(p_s - p_L), K_c = Q_L/(2 (p_s - p_L)) for matched lands, p_A + p_B = p_s, p_T = 0."""
    valve = jl.Servovalve("s", "t", "a", "b", 0.0, 1e-3, underlap=1e-6, transition=1.0)

    def load_flow(x, p_load, supply=2e7):
        return flows(valve, x, supply, 0.0, 0.5 * (supply + p_load), 0.5 * (supply - p_load))["a"]

    for x, p_load in ((0.4, 6e6), (0.05, 0.0), (0.9, -5e6)):
        gain = 1e-3 / np.sqrt(7e6) * np.sqrt(2e7 - p_load)
        by_stroke, by_pressure = jax.grad(load_flow, (0, 1))(x, p_load)
        assert float(load_flow(x, p_load)) == pytest.approx(gain * x, rel=1e-6)
        assert float(by_stroke) == pytest.approx(gain, rel=1e-6)
        assert float(-by_pressure) == pytest.approx(gain * x / (2 * (2e7 - p_load)), rel=1e-6)
        assert float(-by_stroke / by_pressure) == pytest.approx(2 * (2e7 - p_load) / x, rel=1e-6)  # K_p


def test_unmatched_lands():
    valve = jl.Servovalve("s", "t", "a", "b", 0.0, 1e-3, underlap=1e-6, gain_supply_a=0.5, gain_a_tank=2.0)
    forward, reverse = (flows(valve, x, 8e6, 1e6, 4.5e6, 4.5e6) for x in (1.0, -1.0))
    assert float(forward["a"]) == pytest.approx(0.5e-3, rel=1e-5) and float(forward["b"]) == pytest.approx(
        -1e-3, rel=1e-5
    )
    assert float(reverse["a"]) == pytest.approx(-2e-3, rel=1e-5) and float(reverse["b"]) == pytest.approx(
        1e-3, rel=1e-5
    )


def test_overlap_is_a_deadband_and_full_stroke_passes_the_rated_flow():
    valve = jl.Servovalve("s", "t", "a", "b", 0.0, 1e-3, lap=0.1, opening="sharp")
    passing = [float(flows(valve, x, 8e6, 1e6, 4.5e6, 4.5e6)["a"]) for x in (0.0, 0.05, 0.1, 0.55, 1.0, -0.1, -1.0)]
    np.testing.assert_allclose(passing, [0, 0, 0, 0.5e-3, 1e-3, 0, -1e-3], rtol=1e-5, atol=1e-18)
    underlapped = jl.Servovalve("s", "t", "a", "b", 0.0, 1e-3, lap=-0.1, opening="sharp")
    centre = flows(underlapped, 0.0, 8e6, 1e6, 4.5e6, 4.5e6)
    assert float(centre["a"]) == 0.0 and float(centre["tank"]) == pytest.approx(2 * 1e-3 * 0.1 / 1.1, rel=1e-5)
    assert lapped_opening(0.3, -0.1, 0.01, "sharp") == pytest.approx(0.4 / 1.1)


def test_null_leakage_is_the_flow_at_null_with_closed_ports():
    """Lands in two pairs in series: G dp altogether, with the ports at the mean pressure."""
    valve = jl.Servovalve("P", "T", "A", "B", 0.0, 1e-3, opening="sharp", null_leakage=3e-12)
    flow = flows(valve, 0.0, 2.01e7, 1e5, 1.01e7, 1.01e7)
    assert float(flow["tank"]) == pytest.approx(3e-12 * 2e7, rel=1e-12)
    assert float(flow["a"]) == float(flow["b"]) == 0.0


def spool(times, command, **options):
    """Stroke of the spool over time after a command."""
    ends = {"supply": jl.PressureSource("P", 1e7), "tank": jl.Tank("T")}
    lines = {node: jl.Line(node.upper(), jl.Vessel(1e-2)) for node in ("a", "b")}
    valve = jl.Servovalve("P", "T", "A", "B", command, 1e-4, **options)
    circuit = jl.Circuit(ARTICLE, {**ends, "valve": valve, **lines})
    return jl.simulate(circuit, times, tolerance=1e-10, outputs=["valve.spool"])["valve.spool"]


def test_spool_of_first_order():
    times = np.linspace(0.0, 0.05, 11)
    expected = 0.5 * (1 - np.exp(-100.0 * times))
    np.testing.assert_allclose(spool(times, 0.5, natural_frequency=100.0, order="first"), expected, atol=1e-9)


@pytest.mark.parametrize("order", ["first", "second"])
def test_rate_limit(order):
    """A large step runs at the limit until it is near; a small one does not feel it."""
    times = np.linspace(0.0, 0.2, 41)
    fast = {"natural_frequency": 400.0, "damping_ratio": 1.0, "order": order}
    stroke = spool(times, 1.0, rate_limit=8.0, **fast)
    speed = np.diff(stroke) / np.diff(times)
    running = (stroke[:-1] > 0.15) & (stroke[1:] < 0.8)
    assert np.count_nonzero(running) > 10
    np.testing.assert_allclose(speed[running], 8.0, rtol=5e-3)
    assert speed.max() <= 8.0 and stroke[-1] == pytest.approx(1.0, abs=1e-6)
    small = spool(times, 1e-3, rate_limit=8.0, **fast)
    np.testing.assert_allclose(small, spool(times, 1e-3, **fast), atol=1e-7)


def test_limited_rate():
    assert limited_rate(5.0, np.inf) == 5.0 and limited_rate(-3.0, np.inf) == -3.0
    assert limited_rate(8.0, 8.0) == pytest.approx(8.0 / 2**0.25)
    assert abs(limited_rate(1e6, 8.0)) <= 8.0 and limited_rate(-1e6, 8.0) == -limited_rate(1e6, 8.0)
    slopes = jax.vmap(jax.grad(limited_rate, (0, 1)), (0, None))(jnp.array([0.0, 5.0, 1e4]), jnp.inf)
    np.testing.assert_array_equal(slopes, [[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": "third"}, r"order must be 'first' or 'second', got 'third'"),
        ({"opening": "hard"}, r"opening must be 'smooth' or 'sharp', got 'hard'"),
        ({"lap": 5.0}, "lap must be .*was it given in percent"),
        ({"rate_limit": 0.0}, "rate_limit must be .*infinite means none"),
    ],
)
def test_wrong_choices_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        jl.Servovalve("s", "t", "a", "b", 0.0, 1e-3, **options)
