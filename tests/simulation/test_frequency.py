"""Impedances of lines: exact numbers, closed forms, passivity, derivatives, and a fit of a measured impedance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.containers import Hose, ViscoelasticHose, capacity
from jaxlines.physics.distributed import characteristic_impedance
from jaxlines.physics.weighting import KagawaWeights
from jaxlines.simulation.frequency import (
    chain,
    closed_end,
    constant_pressure_end,
    impedance_end,
    impedance_matrix,
    input_impedance,
    line_matrix,
    orifice_impedance,
    pressure_ratio,
    transfer_impedance,
    vessel_capacitance,
    volume_end,
    volume_matrix,
)

OIL = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
# A hose whose wall makes the effective modulus 1.3211e9 Pa, that of the antennas' 2-in pipe.
WALL = 1.0 / (1.0 / 1.3211e9 - 1.0 / 1.379e9)
LINE = Hose(20.83, 2 * 0.0214249, WALL)
SPEED, IMPEDANCE = 1246.6897345, 734834993.05


def test_exact_line_of_pipe_and_oil():
    """Pressure ratio, closed and open impedance at two frequencies, from cosh G, Zc sinh G, sinh G/Zc (mpmath)."""
    matrix = line_matrix(LINE, OIL, 5e6, [10.0, 14.96])
    assert isinstance(matrix, np.ndarray) and matrix.shape == (2, 2, 2) and matrix.dtype == np.complex128
    cosh = np.array([0.477808045 + 0.0211158355j, -0.02784969316 + 0.02915486834j])
    series = np.array([23404553.42 + 659713715.3j, 13037941.64 + 748032183.5j])
    shunt = np.array([-1.0922269e-11 + 1.170037399e-9j, -2.546557735e-11 + 1.336496483e-9j])
    np.testing.assert_allclose(pressure_ratio(matrix, closed_end()), 1 / cosh, rtol=1e-8)
    np.testing.assert_allclose(input_impedance(matrix, closed_end()), cosh / shunt, rtol=1e-8)
    np.testing.assert_allclose(input_impedance(matrix, constant_pressure_end()), series / cosh, rtol=1e-8)
    np.testing.assert_allclose(transfer_impedance(matrix, closed_end()), 1 / shunt, rtol=1e-8)
    assert abs(pressure_ratio(matrix, closed_end())[1]) == pytest.approx(24.802279, rel=1e-7)


def test_lossless_line_closed_at_its_end():
    """-j Z0 cot(kL); its ratio to the impedance of the capacitance alone is kL cot(kL)."""
    phases = np.array([0.17303, 0.38537, 0.54228, 0.75931, 1.16556])
    f = phases * SPEED / (2 * np.pi * 20.83)
    z = input_impedance(line_matrix(LINE, OIL, 5e6, f, friction="none"), closed_end())
    np.testing.assert_allclose(z, -1j * IMPEDANCE / np.tan(phases), rtol=1e-9)
    lumped = input_impedance(volume_matrix(vessel_capacitance(LINE, OIL, 5e6), f), closed_end())
    np.testing.assert_allclose(1 - z / lumped, [0.01, 0.05, 0.1, 0.2, 0.5], rtol=1e-4)


def test_a_matched_end_reflects_nothing():
    f = np.array([3.0, 30.0, 300.0])
    matched = characteristic_impedance(2j * np.pi * f, 2 * 0.0214249, 850.0, 27.7e-6, 1.3211e9)
    z = input_impedance(line_matrix(LINE, OIL, 5e6, f), impedance_end(matched))
    np.testing.assert_allclose(z, matched, rtol=1e-9)


def test_lines_in_series():
    f = np.geomspace(1.0, 200.0, 30)
    parts = [line_matrix(Hose(length, LINE.inner_diameter, WALL), OIL, 5e6, f) for length in (5.0, 15.83)]
    whole = line_matrix(LINE, OIL, 5e6, f)
    np.testing.assert_allclose(chain(*parts), whole, rtol=1e-10, atol=1e-22)
    end = volume_end(1e-12, f)
    np.testing.assert_allclose(
        input_impedance(chain(whole, volume_matrix(1e-12, f)), closed_end()), input_impedance(whole, end), rtol=1e-12
    )
    half = line_matrix(Hose(5.0, 0.5 * LINE.inner_diameter, WALL), OIL, 5e6, f)
    there, back = chain(whole, half), chain(half, whole)  # a passage turned around swaps the diagonal
    np.testing.assert_allclose(there[:, 0, 0], back[:, 1, 1], rtol=1e-12)
    np.testing.assert_allclose(there[:, 0, 1], back[:, 0, 1], rtol=1e-12)


def test_slow_oscillation_sees_resistances():
    """At zero frequency: Hagen-Poiseuille plus the slope of the orifice, Q = K sqrt(dp)."""
    flow, drop = 2e-4, 3e5
    slope = ((flow + 1e-8) ** 2 - (flow - 1e-8) ** 2) / flow**2 * drop / 2e-8
    assert orifice_impedance(drop, flow) == pytest.approx(slope, rel=1e-9)
    resistance = 128 * 850 * 27.7e-6 * 20.83 / (np.pi * LINE.inner_diameter**4)
    end = impedance_end(orifice_impedance(drop, flow))
    for friction in (None, "steady", KagawaWeights()):
        z = input_impedance(line_matrix(LINE, OIL, 5e6, [0.0], friction=friction), end)
        assert z[0] == pytest.approx(resistance + slope, rel=1e-9)
    between = chain(line_matrix(LINE, OIL, 5e6, 0.0), impedance_matrix(slope))
    assert input_impedance(between, constant_pressure_end()) == pytest.approx(resistance + slope, rel=1e-12)


def test_capacity_and_density_are_those_at_the_pressure():
    """A slow closed line takes up V(p)/K_eff(p), the capacity that the simulator gives it, with air and a soft wall."""
    oil = jl.Oil(1.5e9, 870.0, 46e-6, 0.01, 1.2, 9.0)
    pipe, hose = jl.Pipe(12.8, 0.04285, 0.06032), Hose(2.0, 0.02, 2e8)
    for part, p in ((pipe, 3e5), (hose, 3e5), (hose, 2e7)):
        z = input_impedance(line_matrix(part, oil, p, 1e-4), closed_end())
        assert 1 / (2j * np.pi * 1e-4 * z) == pytest.approx(capacity(part, oil, p) / oil.density_at(p), rel=1e-6)
    soft, stiff = (line_matrix(pipe, oil, p, 1.0, segments=1)[1, 0].imag for p in (3e5, 2e7))
    assert soft > 5 * stiff


def test_ladders_approach_the_exact_line():
    f = np.linspace(1.0, 40.0, 40)
    exact = line_matrix(LINE, OIL, 5e6, f, friction="steady")
    errors = [np.max(np.abs(line_matrix(LINE, OIL, 5e6, f, segments=n)[:, 0, 0] - exact[:, 0, 0])) for n in (20, 40)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.01)
    weighted = line_matrix(LINE, OIL, 5e6, f, segments=80, friction=KagawaWeights(), model="T")
    assert np.max(np.abs(weighted[:, 0, 0] - line_matrix(LINE, OIL, 5e6, f)[:, 0, 0])) < 0.01


def test_a_wall_that_creeps():
    """Static modulus when slow, dynamic when fast; it damps between."""
    hose = ViscoelasticHose(3.0, 0.02, 2e8, 6e8, 0.05)

    def compliance(f):  # in the T model, the lower left entry is the admittance of the volume
        matrix = line_matrix(hose, OIL, 1e6, f, segments=1, model="T")
        return matrix[1, 0] / (2j * np.pi * f)

    volume = np.pi / 4 * 0.02**2 * 3.0
    slow, fast = compliance(1e-3), compliance(1e3)
    assert slow == pytest.approx(volume * (1 / 2e8 + 1 / 1.379e9), rel=1e-3)
    assert fast.real == pytest.approx(volume * (1 / 6e8 + 1 / 1.379e9), rel=1e-3)
    assert compliance(3.0).imag < -0.2 * compliance(3.0).real


def some_end(name, size, f):
    ends = {"closed": closed_end(), "open": constant_pressure_end(), "resistance": impedance_end(size * 1e9)}
    return ends[name] if name in ends else volume_end(size * 1e-12, f)


@settings(max_examples=80, deadline=None)
@given(
    parts=st.lists(st.tuples(st.floats(0.1, 30.0), st.floats(3e-3, 0.05), st.booleans()), min_size=1, max_size=3),
    friction=st.sampled_from(["none", "steady", "distributed", KagawaWeights()]),
    segments=st.one_of(st.none(), st.integers(1, 30)),
    model=st.sampled_from(["pi", "T"]),
    end=st.sampled_from(["closed", "open", "resistance", "volume"]),
    size=st.floats(0.01, 100.0),
    frequency=st.floats(0.5, 400.0),
)
def test_lines_are_passive(parts, friction, segments, model, end, size, frequency):
    """Whatever stands at the far end, a line takes energy in: Re Z >= 0."""
    oil = jl.Oil(1.4e9, 850.0, 60e-6, 0.005)
    conduits = [
        ViscoelasticHose(length, bore, 3e8, 8e8, 0.02) if soft else jl.Pipe(length, bore, 2 * bore)
        for length, bore, soft in parts
    ]
    matrices = [
        line_matrix(c, oil, 2e6, frequency, friction=friction, segments=segments, model=model) for c in conduits
    ]
    matrix = chain(*matrices)
    z = input_impedance(matrix, some_end(end, size, frequency))
    # Rounding of the real part grows with the size of the entries and of z itself.
    condition = np.max(np.abs(matrix[..., 0, 0])) ** 2 + np.abs(matrix[0, 1] * matrix[1, 0]) + 1
    assert z.real >= -1e-13 * condition * abs(z)


def changed(x):
    """Closed-end impedance of a pipe and a hose for (bulk modulus, viscosity, air, length, wall modulus)."""
    oil = jl.Oil(x[0], 850.0, x[1], x[2], modulus_slope=8.0)
    f = np.array([0.5, 7.0, 40.0, 170.0])
    pipes = [line_matrix(jl.Pipe(x[3], 0.012, 0.016), oil, 4e6, f), line_matrix(Hose(0.8, 0.012, x[4]), oil, 4e6, f)]
    return input_impedance(chain(*pipes), volume_end(vessel_capacitance(jl.Vessel(1e-3), oil, 4e6), f))


def test_derivatives():
    x = np.array([1.5e9, 40e-6, 0.005, 3.0, 4e8])
    with jax.enable_x64(True):
        exact = jax.jit(jax.jacfwd(changed))(jnp.asarray(x))
        loudness = jax.jit(jax.grad(lambda x: jnp.sum(jnp.log(jnp.abs(changed(x))))))(jnp.asarray(x))
    for i, h in enumerate(1e-4 * x):
        step = h * np.eye(5)[i]
        near, far = (changed(x + k * step) - changed(x - k * step) for k in (1, 2))
        difference = (8 * near - far) / (12 * h)
        np.testing.assert_allclose(exact[:, i], difference, rtol=1e-6)
        assert loudness[i] == pytest.approx(np.sum((difference / changed(x)).real), rel=1e-6)


def test_bulk_modulus_and_viscosity_from_a_measured_impedance():
    """|Z| of a closed 6 m pipe with 1 % noise; from 30 % off back to within three standard deviations."""
    f, pipe, truth = np.linspace(5.0, 250.0, 120), jl.Pipe(6.0, 0.012, 0.016), np.array([1.45e9, 46e-6])

    def model(x):
        z = input_impedance(line_matrix(pipe, jl.Oil(x[0], 850.0, x[1]), 5e6, f), closed_end())
        return jnp.log(jnp.abs(z))

    noise = 0.01 * np.random.default_rng(7).standard_normal(f.size)
    with jax.enable_x64(True):
        measured = np.asarray(model(truth)) + noise
        residual = jax.jit(lambda y: (model(y * truth) - measured) / 0.01)
        jacobian = jax.jit(jax.jacfwd(residual))
        start = np.array([0.7, 1.3])
        found = least_squares(residual, start, jac=jacobian)  # pyright: ignore[reportArgumentType]
    deviation = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    assert found.success and 0.7 * f.size < 2 * found.cost < 1.4 * f.size
    assert np.all(np.abs(found.x - 1.0) < 3 * deviation)
    assert deviation[0] < 1e-3 and deviation[1] < 0.02


@pytest.mark.parametrize("weights", [None, KagawaWeights(6)])
@pytest.mark.parametrize("model", ["pi", "T"])
def test_ladder_is_the_segmented_line_of_the_simulator(model, weights):
    """The simulator's line linearised about rest by automatic differentiation, its states solved for s."""
    line = jl.Line("a", LINE, to="b", segments=4, model=model, weights=weights)
    names = {state.name: state.shape for state in line.states_in(OIL)}
    sizes = [int(np.prod(shape)) for shape in names.values()]

    def response(x, ends):
        pieces = jnp.split(x, np.cumsum(sizes)[:-1])
        state = {name: piece.reshape(shape) for (name, shape), piece in zip(names.items(), pieces, strict=True)}
        done = line.evaluate(Situation(OIL, {"node": ends[0], "to": ends[1]}, state, {}))
        stored = [done.capacity.get(port, 0.0) for port in ("node", "to")]
        flow = jnp.stack([-done.flow["node"], done.flow["to"]]) / 850.0
        return jnp.concatenate([done.rate[name].reshape(-1) for name in names]), flow, jnp.stack(stored) / 850.0

    with jax.enable_x64(True):
        rest = jnp.concatenate([jnp.full(n, 5e6 * (name == "pressure")) for n, name in zip(sizes, names, strict=True)])
        ends = jnp.full(2, 5e6)
        slopes = jax.jit(jax.jacfwd(lambda x, p: response(x, p)[:2], (0, 1)))(rest, ends)
        capacities = np.asarray(response(rest, ends)[2])
    (rate_x, rate_p), (flow_x, _) = jax.tree.map(np.asarray, slopes)
    for f in (0.3, 11.0, 60.0):
        s = 2j * np.pi * f
        states = np.linalg.solve(s * np.eye(rest.size) - rate_x, rate_p)
        flows = flow_x @ states + s * np.diag(capacities * [1.0, -1.0])  # into the line at 1, out of it at 2
        matrix = line_matrix(LINE, OIL, 5e6, f, segments=4, model=model, friction=weights)
        pressure, flow = matrix @ np.stack([np.array([0.0, 1.0]), flows[1]])
        np.testing.assert_allclose(pressure, [1.0, 0.0], atol=1e-10)
        np.testing.assert_allclose(flow, flows[0], rtol=1e-9)


def test_traced_in_float32_is_refused():
    with pytest.raises(RuntimeError, match="enable_x64"):
        jax.jit(lambda p: line_matrix(LINE, OIL, p, [1.0]))(5e6)


def test_wrong_calls():
    with pytest.raises(TypeError, match="needs a pipe or hose, got Vessel: a vessel is volume_matrix"):
        line_matrix(jl.Vessel(1e-3), OIL, 5e6, [1.0])  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"pressure must be .* got -100000 Pa: pressures are absolute"):
        line_matrix(LINE, OIL, -1e5, [1.0])
    with pytest.raises(ValueError, match="frequencies must be"):
        line_matrix(LINE, OIL, 5e6, [-1.0])
    with pytest.raises(ValueError, match="friction must be one of"):
        line_matrix(LINE, OIL, 5e6, [1.0], friction="turbulent")  # pyright: ignore[reportArgumentType]
