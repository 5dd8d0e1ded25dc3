"""The linearly implicit scheme: order, stability, stiff circuits against an adaptive solver, lanes, derivatives."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.simulation.assembly import compile_circuit, number_locations
from jaxlines.simulation.graded_steps import graded_grid, graded_steps, trial_of
from jaxlines.simulation.jacobian import structure_of
from jaxlines.simulation.rosenbrock import RODASP, integrate
from jaxlines.simulation.vector_field import rates, starting_point

TIMES = np.linspace(0.0, 0.2, 21)
COMMAND = 0.5 * np.sign(np.sin(20.0 * TIMES + 0.3)) * (0.3 + 0.7 * np.abs(np.sin(50.0 * TIMES)))


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def with_lanes(values, lanes: int, **changes):
    """Values with lanes last. changes: function of the values' leaves by path, for leaves that differ."""
    found = []
    for keys, leaf in jax.tree_util.tree_flatten_with_path(values)[0]:
        path = jax.tree_util.keystr(keys, simple=True, separator=".")
        leaf = np.asarray(leaf)
        leaf = leaf[..., None] if path.startswith(("kinds", "initial")) else leaf
        factor = changes.get(path.replace(".", "_"))
        found.append(leaf if factor is None else leaf * np.broadcast_to(factor, (lanes,)))
    return jax.tree.unflatten(jax.tree.structure(values), found)


def start_of(plan, values, lanes: int, t=0.0):
    state = starting_point(plan, values, t)
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (*jnp.shape(x)[:-1], lanes)), state)


def even_grid(times, steps: int):
    return np.stack([np.linspace(a, b, steps + 1) for a, b in itertools.pairwise(times)])


def natural(scheme):
    """alpha_ij, beta_ij and the weights b of the scheme and of the embedded one, from the coefficients used."""
    size = len(scheme.times)
    gammas = np.linalg.inv(np.eye(size) / scheme.gamma - scheme.couplings)
    alpha = scheme.stages @ gammas
    embedded = scheme.stages[-1]
    return alpha, alpha + gammas, (embedded + np.eye(size)[-1]) @ gammas, embedded @ gammas


def test_order_conditions():
    """Hairer and Wanner, Solving Ordinary Differential Equations II, table IV.7.1."""
    alpha, beta, weights, embedded = natural(RODASP)
    a, b = alpha.sum(axis=1), beta.sum(axis=1)
    np.testing.assert_allclose(a, RODASP.times, atol=1e-13)
    np.testing.assert_allclose((beta - alpha).sum(axis=1), RODASP.drift, atol=1e-13)

    def conditions(w):
        third = [w.sum() - 1, w @ b - 1 / 2, w @ a**2 - 1 / 3, w @ beta @ b - 1 / 6]
        return third, [
            w @ a**3 - 1 / 4,
            w @ (a * (alpha @ b)) - 1 / 8,
            w @ beta @ a**2 - 1 / 12,
            w @ beta @ beta @ b - 1 / 24,
        ]

    np.testing.assert_allclose(np.concatenate(conditions(weights)), 0.0, atol=1e-12)
    np.testing.assert_allclose(conditions(embedded)[0], 0.0, atol=1e-12)
    assert np.max(np.abs(conditions(embedded)[1])) > 1e-3


def test_stable_on_the_left_half_plane_and_gone_at_infinity():
    _, beta, weights, embedded = natural(RODASP)
    one, eye = np.ones(6), np.eye(6)
    for w in (weights, embedded):
        for z in 1j * np.logspace(-2, 4, 200):
            assert abs(1.0 + z * w @ np.linalg.solve(eye - z * beta, one)) < 1.0 + 1e-9
        assert abs(1.0 - w @ np.linalg.solve(beta, one)) < 1e-12


def one_volume():
    """One node, one state."""
    oil = jl.Oil(1e9, 850.0, 30e-6, mass="article")
    parts = {
        "volume": jl.Line("A", jl.Vessel(1e-3)),
        "leak": jl.LaminarLeak("A", "T", 1e-11),
        "tank": jl.Tank("T", 1e5),
    }
    return jl.Circuit(oil, parts)


def test_fourth_order_where_time_and_state_meet():
    """y' = -2 t y^2, y(0) = 1: y = 1/(1 + t^2)."""
    plan, values = compile_circuit(one_volume(), {"A.pressure": 1.0})
    values = with_lanes(values, 1)

    def field(plan, values, t, potentials, states):
        return -2.0 * t * potentials**2, states

    run = jax.jit(lambda grid: integrate(plan, values, grid, start_of(plan, values, 1), field)[0][0][-1, 0, 0])
    errors = [abs(float(run(even_grid([0.0, 0.5, 1.0], n))) - 0.5) for n in (2, 4, 8, 16)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[-1] < 1e-7 and orders[-1] == pytest.approx(4.0, abs=0.2)


def test_order_is_kept_where_the_forcing_of_a_stiff_state_varies():
    """Prothero and Robinson: y' = -1e6 (y - sin t) + cos t, y = sin t; Kutta's order would be 2 here."""
    plan, values = compile_circuit(one_volume(), {"A.pressure": 0.0})
    values = with_lanes(values, 1)

    def field(plan, values, t, potentials, states):
        return -1e6 * (potentials - jnp.sin(t)) + jnp.cos(t), states

    run = jax.jit(lambda grid: integrate(plan, values, grid, start_of(plan, values, 1), field)[0][0][-1, 0, 0])
    errors = [abs(float(run(even_grid([0.0, 1.0], n))) - np.sin(1.0)) for n in (2, 4)]
    assert errors[0] < 1e-6 and errors[1] < errors[0] / 6.0


def test_a_leak_through_a_jump_in_the_inflow():
    """dp/dt = K/V (Q - G p), Q from 0 to 1e-4 m^3/s at 0.1 s: exponentials; the jump is on the end of a step."""
    oil = jl.Oil(1e9, 850.0, 30e-6, mass="article")
    volume = jl.Line("A", jl.Vessel(1e-3))
    parts = {"volume": volume, "leak": jl.LaminarLeak("A", "T", 1e-11), "tank": jl.Tank("T", 0.0)}
    inflow = jl.Step(0.0, 1e-4, 0.1)
    circuit = jl.Circuit(oil, {**parts, "source": jl.FlowSource("A", "flow")})
    plan, values = compile_circuit(circuit, {"A.pressure": 5e6}, {"flow": inflow})
    values, times = with_lanes(values, 1), np.array([0.0, 0.1, 0.2])
    run = jax.jit(lambda grid: integrate(plan, values, grid, start_of(plan, values, 1)))
    (saved, _), error = run(even_grid(times, 16))
    before = 5e6 * np.exp(-10.0 * 0.1)
    exact = [before, 1e7 + (before - 1e7) * np.exp(-10.0 * 0.1)]
    np.testing.assert_allclose(saved[:, 0, 0], exact, rtol=1e-6)
    assert 0.0 < float(error[0]) < 1e-2


def two_volumes():
    """Two volumes of 1e-6 m^3 behind a throttle that a command opens: two stiff states."""
    oil = jl.Oil(1.29e9, 850.0, 30e-6, air_fraction=0.003, polytropic_index=1.2)
    parts = {
        "supply": jl.PressureSource("P", 20.7e6),
        "tank": jl.Tank("T", 0.35e6),
        "valve": jl.Orifice("P", "A", "area"),
        "volume_a": jl.Line("A", jl.Vessel(1e-6)),
        "between": jl.LaminarLeak("A", "B", 1e-10),
        "volume_b": jl.Line("B", jl.Vessel(1e-6)),
        "leak": jl.LaminarLeak("B", "T", 1e-11),
    }
    return jl.Circuit(oil, parts)


def axis():
    """A servovalve, two volumes of 1e-6 m^3 and a motor with inertia: five states, some of them 1e5 times faster."""
    oil = jl.Oil(1.29e9, 850.0, 30e-6, air_fraction=0.003, polytropic_index=1.2)
    parts = {
        "supply": jl.PressureSource("P", 20.7e6),
        "return": jl.Tank("T", 0.35e6),
        "valve": jl.Servovalve("P", "T", "A", "B", "spool", 1e-3, 14e6, natural_frequency=250.0, transition=1e5),
        "line_a": jl.Line("A", jl.Vessel(1e-6)),
        "line_b": jl.Line("B", jl.Vessel(1e-6)),
        "motor": jl.Motor("A", "B", "T", "shaft", 1e-4, 5e-12, 0.0, 2.0),
        "inertia": jl.Inertia("shaft", 0.4),
    }
    return jl.Circuit(oil, parts)


def wave_line():
    """A line of 40 segments that a valve feeds and a leak drains: 83 states."""
    parts = {
        "supply": jl.PressureSource("P", 20.7e6),
        "tank": jl.Tank("T", 0.35e6),
        "valve": jl.Valve22("P", "A", "opening", 2e-5, natural_frequency=250.0, order="second"),
        "line": jl.Line("A", jl.Pipe(20.0, 0.02, 0.026), to="C", segments=40),
        "vessel": jl.Line("C", jl.Vessel(1e-3)),
        "leak": jl.LaminarLeak("C", "T", 4e-11),
    }
    return jl.Circuit(jl.Oil(1.29e9, 850.0, 30e-6, air_fraction=0.003), parts)


START = {"A.pressure": 10e6, "B.pressure": 10e6}
MODULI = np.array([1.0, 0.8, 1.1, 0.9])


class Driven:
    """A circuit compiled once for four lanes with different moduli, and steps that suit it."""

    def __init__(self, circuit, initial, inputs, tolerance=1e-4):
        with jax.enable_x64(True):
            self.plan, single = compile_circuit(circuit, initial, inputs)
            self.nodes = [name for name, _ in self.plan.free_nodes]
            self.values = with_lanes(single, 4, fluid_bulk_modulus=MODULI)
            self.start = start_of(self.plan, self.values, 4)
            self.steps = graded_steps(trial_of(self.plan, self.values), TIMES, self.start, tolerance)
            grid = graded_grid(TIMES, self.steps.times)[1:]
            self.run = jax.jit(lambda v, start: integrate(self.plan, v, grid, start))
            self.saved, self.error = self.run(self.values, self.start)

    def pressure(self, node: str, lane: int = 0):
        return self.saved[0][:, self.nodes.index(node), lane]


@pytest.fixture(scope="module")
def driven():
    return Driven(two_volumes(), START, {"area": jl.Sampled(TIMES, 2e-6 * np.abs(COMMAND))})


@pytest.mark.slow
def test_stiff_axis_against_an_adaptive_solver():
    inputs = {"spool": jl.Sampled(TIMES, COMMAND)}
    driven = Driven(axis(), START, inputs)
    sim = jl.simulate(axis(), TIMES, inputs, initial=START, solver=jl.implicit(), tolerance=1e-9)
    for name in ("A", "B"):
        np.testing.assert_allclose(driven.pressure(name), sim[f"{name}.pressure"][1:], atol=1e3)
    assert driven.steps.count < 400


@pytest.mark.slow
def test_wave_line_against_an_adaptive_solver():
    inputs, initial = {"opening": jl.Sampled(TIMES, np.abs(COMMAND))}, {"A.pressure": 5e6, "C.pressure": 5e6}
    driven = Driven(wave_line(), initial, inputs)
    assert structure_of(driven.plan, driven.values, driven.start).elimination.method == "chain"
    sim = jl.simulate(wave_line(), TIMES, inputs, initial=initial, solver=jl.implicit(), tolerance=1e-7)
    assert np.ptp(sim["C.pressure"]) > 2e5
    np.testing.assert_allclose(driven.pressure("C"), sim["C.pressure"][1:], atol=2e3)


def test_stiff_volumes_against_an_adaptive_solver(driven):
    """The numbers are those of SciPy's Radau with relative tolerance 1e-10."""
    from scipy.integrate import solve_ivp

    plan, single = compile_circuit(two_volumes(), START, {"area": jl.Sampled(TIMES, 2e-6 * np.abs(COMMAND))})
    field = jax.jit(lambda t, y: rates(plan, single, t, y, starting_point(plan, single, 0.0)[1])[0])
    y = np.asarray(start_of(plan, with_lanes(single, 1), 1)[0][:, 0])
    for k in range(3):
        y = solve_ivp(field, TIMES[k : k + 2], y, "Radau", rtol=1e-10, atol=1e-2).y[:, -1]
        np.testing.assert_allclose(driven.saved[0][k, :, 0], y, atol=500.0)


def test_steps_are_short_only_where_it_moves(driven):
    steps, lengths = driven.steps, np.diff(driven.steps.times)
    assert steps.times[0] == TIMES[0] and steps.times[-1] == TIMES[-1] and np.all(lengths > 0.0)
    assert set(TIMES) <= set(steps.times) and lengths.max() > 50 * lengths.min()
    np.testing.assert_array_equal(TIMES[steps.interval] <= steps.times[:-1], True)
    np.testing.assert_array_equal(steps.times[1:] <= TIMES[steps.interval + 1], True)


def test_a_pilot_that_cannot_go_on_says_where():
    def trial(t, h, state):
        return state, 0.0 if t + h < 0.5 else np.inf

    with pytest.raises(RuntimeError, match=r"stopped at 0\.\d+ s: a step of .* is still too long"):
        graded_steps(trial, [0.0, 1.0], None, 1e-3)
    with pytest.raises(RuntimeError, match="3 steps are not enough"):
        graded_steps(trial, [0.0, 1.0], None, 1e-3, max_steps=3)


def test_lanes_do_not_meet(driven):
    """A lane that fails, and the order of lanes, change no bit of another lane."""
    broken = jax.tree.map(lambda x: x, driven.start)
    broken = (broken[0].at[:, 1].set(jnp.nan), broken[1])
    saved, error = driven.run(driven.values, broken)
    assert not np.isfinite(error[1]) and not np.isfinite(saved[0][-1, 0, 1])
    kept = [0, 2, 3]
    np.testing.assert_array_equal(saved[0][..., kept], driven.saved[0][..., kept])
    np.testing.assert_array_equal(error[np.asarray(kept)], driven.error[np.asarray(kept)])
    order = np.array([2, 0, 3, 1])
    turned = jax.tree.map(lambda x: x[order] if np.shape(x) == (4,) else x, driven.values)
    saved, error = driven.run(turned, driven.start)
    np.testing.assert_array_equal(saved[0], driven.saved[0][..., order])


@pytest.fixture(scope="module")
def last_pressure():
    """The last pressure behind an orifice, (lanes,), by what the modulus and the orifice are multiplied by."""
    oil = jl.Oil(1.4e9, 850.0, 30e-6, air_fraction=0.005)
    parts = {"source": jl.PressureSource("P", 1e7), "volume": jl.Line("A", jl.Vessel(1e-6)), "tank": jl.Tank("T", 1e5)}
    parts |= {"in": jl.Orifice("P", "A", 1e-6), "out": jl.LaminarLeak("A", "T", 1e-11)}
    with jax.enable_x64(True):
        plan, single = compile_circuit(jl.Circuit(oil, parts), {"A.pressure": 1e6})
    values, grid = with_lanes(single, 2), even_grid([0.0, 1e-4], 50)
    places = number_locations(plan, values)
    positions = [places["fluid.bulk_modulus"][0], places["in.area"][0]]

    def last(factors):
        leaves, structure = jax.tree.flatten(jax.tree.map(lambda x: np.asarray(x, factors.dtype), values))
        for position, factor in zip(positions, factors, strict=True):
            leaves[position] = leaves[position] * factor * jnp.array([1.0, 1.5])
        changed = jax.tree.unflatten(structure, leaves)
        return integrate(plan, changed, grid.astype(factors.dtype), start_of(plan, changed, 2))[0][0][-1, 0]

    return last


def test_derivatives_against_finite_differences_and_single_precision(last_pressure):
    point, width, value = jnp.ones(2), 1e-5, jax.jit(last_pressure)
    steps = width * np.eye(2)
    differences = np.stack([(value(point + e) - value(point - e)) / (2 * width) for e in steps], axis=-1)
    forward = jax.jit(lambda way: jax.jvp(last_pressure, (point,), (way,))[1])(jnp.array([1.0, -0.5]))
    np.testing.assert_allclose(forward, differences @ [1.0, -0.5], rtol=1e-5)
    assert np.min(np.abs(differences)) > 1e4
    exact = np.asarray(value(point))
    assert np.all((exact > 4e6) & (exact < 1e7))
    with jax.enable_x64(False):
        single = jax.jit(last_pressure)(jnp.ones(2))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, exact, rtol=2e-6)


@pytest.mark.slow
def test_reverse_derivatives_are_the_forward_ones(last_pressure):
    reverse = jax.jit(jax.grad(lambda f: last_pressure(f)[1]))(jnp.ones(2))
    np.testing.assert_allclose(reverse, jax.jit(jax.jacfwd(last_pressure))(jnp.ones(2))[1], rtol=1e-10)
