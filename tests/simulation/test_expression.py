"""Functions taken apart into single numbers: the same values and derivatives as JAX, on lanes of numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlines.simulation.evaluation import boundary, evaluate, layer_by_layer, layers, put_down
from jaxlines.simulation.expression import Graph
from tests.physics.test_components import OILS, PARTS, oils_for, results, situation

LANES = 2


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def on_lanes(function, arguments: list[np.ndarray], direction: list[np.ndarray] | None = None):
    """A function of arrays evaluated through a graph; arguments and results have an axis of lanes at the end."""
    graph, known, nodes = Graph(), {}, []
    for k, argument in enumerate(arguments):
        block = np.empty(argument.shape[:-1], dtype=object)
        for index in np.ndindex(block.shape):
            block[index] = graph.input((k, index), argument.dtype, True)
            known[block[index]] = jnp.asarray(argument[index])
        nodes.append(block)
    shapes = [jax.ShapeDtypeStruct(a.shape[:-1], a.dtype) for a in arguments]
    if direction is None:
        found = graph.outputs(jax.make_jaxpr(function)(*shapes), *nodes)
    else:
        pushed = jax.make_jaxpr(lambda p, d: jax.jvp(function, p, d)[1])(tuple(shapes), tuple(shapes))
        found = graph.outputs(pushed, *nodes, *map(graph.constants, direction))
    return [
        np.stack([np.broadcast_to(v, LANES) for v in evaluate(list(array.ravel()), known)]).reshape(*array.shape, LANES)
        for array in found
        if array.size
    ]


def lane_by_lane(function, arguments, direction=None):
    """The same by JAX, one lane after the other."""

    def one(lane):
        given = tuple(a[..., lane] for a in arguments)
        return function(*given) if direction is None else jax.jvp(function, given, tuple(direction))[1]

    rows = [[r for r in jax.tree.leaves(one(lane)) if r.size] for lane in range(LANES)]
    return [np.stack(row, axis=-1) for row in zip(*rows, strict=True)]


def gather(x, y):
    return jnp.concatenate([x[jnp.array([2, 0])], y[:1]]) * jnp.stack([y[1], x[1], x[2]])


def branches(x, y):
    return jnp.where(x > 0.5, jnp.tanh(x), y[0] * x), jnp.max(x), jnp.sum(x * x), jnp.prod(y)


def roots(x, y):
    return y[0] / jnp.sqrt(x), x[0] / jnp.sqrt(jnp.sqrt(1.0 + y * y)), jax.lax.rsqrt(x), 0.0 * x + 1.0 * y[0]


def tables(x, y):
    return (
        jnp.interp(x, jnp.array([0.0, 0.5, 2.0]), jnp.array([1.0, 3.0, 2.0])),
        jnp.asarray(y).at[1].set(x[0]),
        jnp.sort(x),
    )


def linear(x, y):
    return jnp.array([[1.0, 2.0, 0.0], [0.5, 0.0, 1.0]]) @ x, jax.lax.fori_loop(0, 3, lambda i, a: a * x[0], y)


@pytest.mark.parametrize("function", [gather, branches, roots, tables, linear])
def test_operations(function):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.1, 1.5, (3, LANES)), rng.uniform(0.1, 1.5, (2, LANES))

    def flat(x, y):
        return jax.tree.leaves(function(x, y))

    for found, exact in zip(on_lanes(flat, [x, y]), lane_by_lane(flat, [x, y]), strict=True):
        np.testing.assert_allclose(found, exact, rtol=1e-13, atol=1e-15)
    direction = [np.array([1.0, 0.0, -2.0]), np.array([0.0, 1.0])]
    pushed = on_lanes(flat, [x, y], direction)
    for found, exact in zip(pushed, lane_by_lane(flat, [x, y], direction), strict=True):
        np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", PARTS)
def test_every_component(name):
    """Contributions and their derivatives in the potentials at three points."""
    part = PARTS[name]
    oil = OILS[oils_for(part)[0]]
    points = [situation(part, oil, point) for point in ("generic", "saturated")]
    leaves, structure = jax.tree.flatten(points[0])
    lanes = [np.stack(row, axis=-1) for row in zip(*(jax.tree.leaves(p) for p in points), strict=True)]

    def contributions(*leaves):
        return jax.tree.leaves(results(part, jax.tree.unflatten(structure, leaves)))

    for found, exact in zip(on_lanes(contributions, lanes), lane_by_lane(contributions, lanes), strict=True):
        np.testing.assert_allclose(found, exact, rtol=1e-11, atol=1e-300)
    direction = [np.full(np.shape(leaf), 0.5) for leaf in leaves]
    pushed = on_lanes(contributions, lanes, direction)
    for found, exact in zip(pushed, lane_by_lane(contributions, lanes, direction), strict=True):
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-12 * np.abs(exact).max(initial=1e-30))


def test_structural_zeros_and_what_does_not_move():
    """A derivative keeps only what depends on the direction; what does not change in time is told apart."""
    graph = Graph()
    fixed, moving = graph.input(("column", 0), np.float64, False), graph.input("y", np.float64, True)
    jaxpr = jax.make_jaxpr(lambda a, y: jnp.exp(a) / (1.0 + a) * y)(0.5, 0.5)
    (found,) = graph.outputs(jaxpr, np.array(fixed, dtype=object), np.array(moving, dtype=object))
    once = boundary([found.item()])
    assert len(once) == 1 and not once[0].moving  # exp(a)/(1 + a), in one array
    known = dict(zip(once, evaluate(once, {fixed: 0.5}), strict=True))
    value = evaluate([found.item()], {moving: jnp.asarray(2.0)} | known)
    np.testing.assert_allclose(value[0], np.exp(0.5) / 1.5 * 2.0)
    pushed = jax.make_jaxpr(lambda a, y, da, dy: jax.jvp(lambda a, y: a * a + y, (a, y), (da, dy))[1])(*[0.5] * 4)
    one = [np.array(graph.constant(x, np.float64), dtype=object) for x in (0.0, 1.0)]
    (slope,) = graph.outputs(pushed, np.array(fixed, dtype=object), np.array(moving, dtype=object), *one)
    assert slope.item().is_constant(1.0)


def several(x, y):
    """Three results that share a root and a power."""
    root, power = 1.0 / jnp.sqrt(jnp.sqrt(1.0 + x * x)), jnp.exp(-1.3 * jnp.log(2.0 + y))
    return root * power, root + power * x, root - 3.0 * power


def test_layers():
    """What several results need is computed first, and once: the root and the power, not what is made of them."""
    graph = Graph()
    names = [graph.input(("state", k), np.float64, True) for k in range(2)]
    jaxpr = jax.make_jaxpr(several)(0.5, 0.5)
    nodes = [array.item() for array in graph.outputs(jaxpr, *(np.array(name, dtype=object) for name in names))]
    found = layers(nodes)
    assert {node.primitive.name for layer in found for node in layer} == {"inverse_fourth_root", "exp2"}
    numbers = (np.linspace(0.1, 2.0, 8), np.linspace(3.0, -1.0, 8))

    @jax.jit
    def in_layers(x, y):
        known = layer_by_layer(found, dict(zip(names, (x, y), strict=True)), x[0] > 0.0)
        return evaluate(nodes, known)

    for value, exact in zip(in_layers(*numbers), several(*numbers), strict=True):
        np.testing.assert_allclose(value, exact, rtol=1e-14)


def test_results_put_down_in_an_array():
    """Numbers and lanes go into the rows of an array; a branch that is not taken leaves it as it is."""
    room = jnp.full((2, 4), 7.0)
    lanes = jnp.arange(4.0)
    fill = jax.jit(lambda always, room: put_down(always, lambda: (lanes, 3.0), room))
    np.testing.assert_array_equal(fill(True, room), [[0.0, 1.0, 2.0, 3.0], [3.0] * 4])
    np.testing.assert_array_equal(fill(False, room), room)
