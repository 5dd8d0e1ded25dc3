"""Sparse elimination in many lanes against dense solvers; the pattern of a Jacobian against dense Jacobians."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import jaxlines as jl
from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.elimination import (
    Entries,
    chain_elimination,
    chain_order,
    dense_elimination,
    elimination_order,
    plan_elimination,
    rows_elimination,
)
from jaxlines.simulation.jacobian import field_like
from jaxlines.simulation.sparsity import colours, jacobian_pattern
from jaxlines.simulation.vector_field import rates, starting_point


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def chain_pattern(size: int, order=None) -> np.ndarray:
    """Each unknown with two neighbours on each side, in an order of one's own."""
    order = np.arange(size) if order is None else order
    pattern = np.zeros((size, size), dtype=bool)
    for i, j in itertools.product(range(size), repeat=2):
        pattern[order[i], order[j]] = abs(i - j) <= 2
    return pattern


def entries_of(pattern, matrices) -> Entries:
    """The entries of matrices (lanes, size, size)."""
    rows, columns = np.nonzero(pattern)
    values = jnp.asarray(matrices[:, rows, columns].T)
    padded = jnp.concatenate([values, jnp.zeros((1, values.shape[1]))])
    return Entries(rows, columns, lambda k: values[k], lambda numbers: padded[numbers])


def random_systems(pattern, lanes: int = 3, seed: int = 0):
    random = np.random.default_rng(seed)
    jacobians = np.where(pattern, random.normal(size=(lanes, *pattern.shape)), 0.0)
    return jacobians, random.normal(size=(lanes, len(pattern)))


def solved(elimination, pattern, jacobians, right, diagonal):
    given = right.T
    factors = elimination.factor(entries_of(pattern, jacobians), diagonal)
    found = elimination.solve(factors, list(jnp.asarray(given)) if elimination.by_rows else jnp.asarray(given))
    return np.stack(found, axis=-1) if elimination.by_rows else np.asarray(found).T


SHUFFLED = chain_pattern(11, np.random.default_rng(1).permutation(11))


@pytest.mark.parametrize("method", ["rows", "chain", "dense"])
def test_against_dense_solver(method):
    """Any order of the unknowns, and one that fills the last block only in part."""
    made = {
        "rows": lambda: rows_elimination(11, elimination_order(SHUFFLED)),
        "chain": lambda: chain_elimination(chain_order(SHUFFLED)),
        "dense": lambda: dense_elimination(11),
    }[method]()
    jacobians, right = random_systems(SHUFFLED)
    exact = np.linalg.solve(12.0 * np.eye(11) - jacobians, right[..., None])[..., 0]
    np.testing.assert_allclose(solved(made, SHUFFLED, jacobians, right, 12.0), exact, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("method", ["rows", "chain"])
def test_a_zero_pivot_fails_its_lane_only(method):
    made = rows_elimination(11, elimination_order(SHUFFLED)) if method == "rows" else None
    made = made or chain_elimination(chain_order(SHUFFLED))
    jacobians, right = random_systems(SHUFFLED)
    expected = solved(made, SHUFFLED, jacobians, right, 12.0)
    jacobians[1] = 12.0 * np.eye(11)
    found = solved(made, SHUFFLED, jacobians, right, 12.0)
    assert not np.isfinite(found[1]).any()
    np.testing.assert_array_equal(found[[0, 2]], expected[[0, 2]])


def test_orders_fill_in_little_and_methods_fit_the_pattern():
    arrow = np.eye(30, dtype=bool)
    arrow[0], arrow[:, 0] = True, True  # eliminated first, the hub would fill everything
    assert sum(len(p.below) * len(p.right) for p in elimination_order(arrow)) == 29
    assert chain_order(chain_pattern(40, np.random.default_rng(2).permutation(40))).order.shape == (20, 2)
    full = np.ones((12, 12), dtype=bool)
    assert plan_elimination(full).method == "rows" and plan_elimination(SHUFFLED).method == "rows"
    assert plan_elimination(chain_pattern(83)).method == "chain"
    assert plan_elimination(np.ones((30, 30), dtype=bool)).method == "dense"
    assert plan_elimination(arrow).method == "rows"


def test_both_branches_of_a_choice_count():
    def function(x):
        a = jnp.where(x[0] > 0.0, x[1], x[2])
        b = jnp.maximum(x[3], 1e9)
        c = jax.lax.cond(x[0] > 0.0, lambda: x[4], lambda: 2.0 * x[5])
        d = x[jnp.asarray([5, 1])].sum()
        e, _ = jax.lax.scan(lambda carry, y: (carry + y, None), 0.0, x[:2])
        return jnp.stack([a, b, c, d, e, 0.0 * x[0] + 1.0, jnp.where(x[1] > 0, 1.0, 0.0)])

    found = jacobian_pattern(function, jnp.zeros(6))
    wanted = [[1, 2], [3], [4, 5], [1, 5], [0, 1], [0], []]
    assert [list(np.flatnonzero(row)) for row in found] == wanted


def test_colours_hold_every_entry_apart():
    pattern = np.random.default_rng(3).uniform(size=(30, 30)) < 0.08
    colour = colours(pattern)
    for row in pattern:
        assert len(set(colour[row])) == row.sum()
    assert colours(chain_pattern(60)).max() + 1 == 5


def oil(**other):
    return jl.Oil(1.4e9, 850.0, 30e-6, air_fraction=0.01, **other)


CIRCUITS = {
    "line": {
        "source": jl.FlowSource("A", 1e-4),
        "line": jl.Line("A", jl.Pipe(5.0, 0.02, 0.026), to="B", segments=5, model="T", weights=jl.TrikhaWeights()),
        "a": jl.Line("A", jl.Vessel(1e-4)),
        "b": jl.Line("B", jl.Vessel(1e-4)),
        "leak": jl.LaminarLeak("B", "T", 1e-11),
        "tank": jl.Tank("T", 1e5),
    },
    "axis": {
        "supply": jl.PressureSource("P", 2e7),
        "tank": jl.Tank("T", 1e5),
        "valve": jl.Servovalve("P", "T", "A", "B", 0.3, 1e-3, 14e6, natural_frequency=250.0),
        "a": jl.Line("A", jl.Vessel(1e-4)),
        "b": jl.Line("B", jl.Vessel(1e-4)),
        "motor": jl.Motor("A", "B", "T", "shaft", 1e-4, 5e-12, 0.0, 2.0),
        "inertia": jl.Inertia("shaft", 0.4),
    },
}


@pytest.mark.parametrize("name", ["line", pytest.param("axis", marks=pytest.mark.slow)])
def test_pattern_never_misses_an_entry(name):
    """Against dense Jacobians at states of every sign and size."""
    plan, values = compile_circuit(jl.Circuit(oil(), CIRCUITS[name]))
    state = starting_point(plan, values, 0.0)
    pattern = jacobian_pattern(lambda y: field_like(rates, plan, values, 0.0, y), state)
    vector, restore = ravel_pytree(state)
    field = jax.jit(jax.jacfwd(lambda v: ravel_pytree(rates(plan, values, 0.0, *restore(v)))[0]))
    random, seen = np.random.default_rng(0), np.zeros_like(pattern)
    for _ in range(20):
        noise = random.normal(size=vector.shape) * 10.0 ** random.uniform(-6, 0, vector.shape)
        seen |= np.asarray(field(vector * random.uniform(0.5, 50.0, vector.shape) + noise)) != 0.0
    assert not np.any(seen & ~pattern)
    assert seen.sum() >= 0.8 * pattern.sum()  # and has few that never occur
    assert pattern.sum() < pattern.size
