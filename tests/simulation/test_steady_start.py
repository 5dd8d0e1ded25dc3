"""A simulation that starts from its steady state."""

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.catalogue.dsn70m_axis import antenna_axis


def leaking_volume() -> jl.Circuit:
    oil = jl.Oil(1.4e9, 870.0, 30e-6, mass="article")
    line, tank = jl.Line("A", jl.Vessel(1e-3)), jl.Tank("T", 1e5)
    parts = {"supply": jl.PressureSource("P", "p"), "in": jl.LaminarLeak("P", "A", 1e-11), "line": line}
    return jl.Circuit(oil, parts | {"out": jl.LaminarLeak("A", "T", 3e-11), "tank": tank})


def test_it_starts_where_the_first_inputs_lead():
    """Two leaks divide the pressure 1 : 3 until the supply steps."""
    times = np.array([0.0, 0.4, 10.0])
    sim = jl.simulate(leaking_volume(), times, {"p": jl.Step(1e7, 2e7, 0.5)}, initial="steady")
    expected = [1e5 + 0.25 * (1e7 - 1e5), 1e5 + 0.25 * (1e7 - 1e5), 1e5 + 0.25 * (2e7 - 1e5)]
    np.testing.assert_allclose(sim["A.pressure"], expected, rtol=1e-6)


def test_its_gradient():
    def start(conductance):
        circuit = leaking_volume().replace({"out.conductance": conductance})
        return jl.simulate(circuit, [0.0, 1e-6], {"p": 1e7}, initial="steady")["A.pressure"][0]

    with jax.enable_x64(True):
        slope = float(jax.grad(start)(3e-11))
    assert slope == pytest.approx(-9.9e6 * 1e-11 / (4e-11) ** 2, rel=1e-6)  # d/dG of G_in/(G_in + G)


def test_a_whole_axis_stays_at_rest():
    sim = jl.simulate(antenna_axis("azimuth"), [0.0, 1.0, 5.0], {"rate": 0.0}, initial="steady")
    assert np.ptp(sim["A.pressure"]) < 10.0 and np.max(np.abs(sim["axis.speed"])) < 1e-9
    assert 1e6 < sim["A.pressure"][0] < 1e7


def test_another_word_is_refused():
    with pytest.raises(ValueError, match="initial must be a table of start values or \"steady\", got 'rest'"):
        jl.simulate(leaking_volume(), [0.0, 1.0], {"p": 1e7}, initial="rest")
