"""A circuit's line as simulated against the exact one, over frequency."""

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.integration import _field
from jaxlines.simulation.plan import ravel
from jaxlines.simulation.vector_field import starting_point

OIL = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
PIPE = jl.Pipe(20.83, 0.0428498, 0.060325, youngs_modulus=2.0684e11, poissons_ratio=0.25)
FREQUENCIES = np.array([0.1, 1.65, 3.67, 5.17, 7.23, 11.1])


def circuit(line: jl.Line, **others) -> jl.Circuit:
    return jl.Circuit(OIL, {"line": line, **others})


def test_capacitance_against_the_distributed_line():
    """Error of the lumped line, kL cot(kL) - 1: 1, 5, 10, 20 and 50 % at 1.65, 3.67, 5.17, 7.23 and 11.1 Hz."""
    found = jl.line_response(circuit(jl.Line("A", PIPE)), "line", FREQUENCIES, pressure=5e6)
    # The exact line's friction adds up to 2 %.
    np.testing.assert_allclose(np.abs(found.exact / found.simulated)[1:], [0.99, 0.95, 0.90, 0.80, 0.5], atol=0.025)
    assert found.highest_frequency(0.12) == pytest.approx(5.17)


def test_segments_come_close():
    """30 segments with Kagawa's weights, and how much worse they are with steady friction alone."""
    end = {"end": jl.LaminarLeak("B", "T", 1e-12), "tank": jl.Tank("T")}
    frequencies = np.linspace(1.0, 50.0, 200)

    def response(weights):
        line = jl.Line("A", PIPE, to="B", segments=30, weights=weights)
        return jl.line_response(circuit(line, **end), "line", frequencies, pressure=5e6, end=1e12)

    found, steady = response(jl.KagawaWeights()), response(None)
    away = np.abs(found.exact) > 0.1 * np.median(np.abs(found.exact))  # not in the sharp minima
    assert np.max(found.error[away]) < 0.05
    assert np.max(steady.error[away]) > 10 * np.max(found.error[away])


def test_simulated_equations_have_this_response():
    """The vector field of the circuit, linearised at rest, driven by a flow into A."""
    line = jl.Line("A", jl.Pipe(20.83, 0.04, 0.06), to="B", segments=6, weights=jl.TrikhaWeights())
    built = circuit(line, source=jl.FlowSource("A", 0.0))
    with jax.enable_x64(True):
        plan, values = compile_circuit(built, {"A.pressure": 5e6, "B.pressure": 5e6})
        state = ravel(plan, *starting_point(plan, values, 0.0))
        matrix = np.asarray(jax.jacfwd(lambda y: _field(plan, 0.0, y, values))(state))
    capacity = float(line.evaluate(_at_rest(line)).capacity["node"])
    push = np.zeros(state.size)
    push[0] = 850.0 / capacity / 1e6  # a flow of 1 m^3/s into A, pressures scaled by 1e6 Pa
    frequencies = np.array([1.0, 10.0, 25.0])
    found = jl.line_response(built, "line", frequencies, pressure=5e6)
    for frequency, impedance in zip(frequencies, found.simulated, strict=True):
        swing = np.linalg.solve(2j * np.pi * frequency * np.eye(state.size) - matrix, push)
        assert abs(1e6 * swing[0] / impedance - 1.0) < 1e-7


def _at_rest(line: jl.Line):
    states = {s.name: np.zeros(s.shape) for s in line.states_in(OIL)}
    states["pressure"] = np.full(states["pressure"].shape, 5e6)
    return Situation(OIL, {"node": np.asarray(5e6), "to": np.asarray(5e6)}, states, {})


def test_parts_in_series_and_the_picture():
    parts = [jl.Hose(2.0, 0.02, 5e8), PIPE, jl.Vessel(1e-3)]
    found = jl.line_response(circuit(jl.Line("A", parts, 22.83)), "line", np.geomspace(0.1, 100, 50), pressure=5e6)
    assert abs(found.exact[0] / found.simulated[0] - 1) < 0.1  # slow: the sum of all capacitances
    upper, lower = jl.plot_line_response(found)
    assert len(upper.lines) == len(lower.lines) == 2 and "line" in upper.get_title()


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("lin", {}, KeyError, "no component 'lin'; it has line, leak"),
        ("leak", {}, TypeError, "'leak' is a LaminarLeak, and only a Line"),
        ("line", {"frequencies": [0.0, 1.0]}, ValueError, "frequencies must be .* got 0 Hz"),
        ("line", {"pressure": -1.0}, ValueError, "pressure must be .* pressures are absolute"),
    ],
)
def test_wrong_calls(name, options, error, message):
    built = circuit(jl.Line("A", PIPE), leak=jl.LaminarLeak("A", "T", 1e-12), tank=jl.Tank("T"))
    with pytest.raises(error, match=message):
        jl.line_response(built, name, options.get("frequencies", FREQUENCIES), pressure=options.get("pressure", 5e6))
