"""Simpler expressions: fewer divisions, the same values."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlines.simulation.evaluation import evaluate
from jaxlines.simulation.expression import Graph


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def simplified(function, *numbers):
    """The node of a function of moving numbers, its value, and how often each operation is in it."""
    graph = Graph()
    names = [graph.input(("state", k), np.float64, True) for k in range(len(numbers))]
    jaxpr = jax.make_jaxpr(function)(*numbers)
    node = graph.outputs(jaxpr, *(np.array(name, dtype=object) for name in names))[0].item()
    (value,) = evaluate([node], dict(zip(names, map(jnp.asarray, numbers), strict=True)))
    seen, stack = {}, [node]
    while stack:
        one = stack.pop()
        if one not in seen:
            seen[one] = one.primitive.name if one.primitive else ""
            stack.extend(one.args)
    return node, float(value), collections.Counter(seen.values())


@pytest.mark.parametrize(
    ("function", "divisions"),
    [
        (lambda x, y, z: x / z + y / z, 1),
        (lambda x, y, z: 1.0 / (1.0 / x) + y, 0),
        (lambda x, y, z: (x / z) / (y / z), 2),  # the reciprocals of z cancel
        (lambda x, y, z: y / jnp.sqrt(jnp.sqrt(x)), 1),
        (lambda x, y, z: (x * y) / (x * z) * x, 1),
        (lambda x, y, z: y * x**-2 + z / x, 1),
        (lambda x, y, z: x / jnp.where(y > z, 2.0, 4.0), 0),
    ],
)
def test_divisions(function, divisions):
    numbers = (1.7, 0.6, 2.9)
    _, value, count = simplified(function, *numbers)
    assert count["div"] <= divisions
    np.testing.assert_allclose(value, function(*numbers), rtol=4e-16)


def test_products_and_sums():
    node, value, count = simplified(lambda x, y: jnp.sqrt(x) * y * jnp.sqrt(x) / y, 3.7, 0.3)
    assert count == {"": 1} and node.name == ("state", 0) and value == 3.7
    _, value, count = simplified(lambda x, y: x * y + (2.0 * y + x * y) + 3.0 * (x * y), 3.7, 0.3)
    assert count["mul"] <= 3  # x y, once: 5 x y + 2 y
    np.testing.assert_allclose(value, 5 * 3.7 * 0.3 + 2 * 0.3, rtol=4e-16)


def test_what_stays_the_same_is_put_together():
    """(a x) (b (c y)) with x and y moving is (a b c) (x y): one product a stage beside x y."""
    graph = Graph()
    fixed = [graph.input(("column", k), np.float64, False) for k in range(3)]
    moving = [graph.input(("state", k), np.float64, True) for k in range(2)]
    jaxpr = jax.make_jaxpr(lambda a, b, c, x, y: (a * x) * (b * (c * y)))(*[1.0] * 5)
    node = graph.outputs(jaxpr, *(np.array(n, dtype=object) for n in (*fixed, *moving)))[0].item()
    factor, rest = node.args
    assert not factor.moving and set(rest.args) == set(moving)
