"""The Jacobian of a circuit's vector field in every lane: pattern, derivatives along few directions, linear systems."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.elimination import Elimination, Entries, plan_elimination
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.sparsity import colours, jacobian_pattern
from jaxlines.simulation.vector_field import rates


class Structure(NamedTuple):
    """What is known of the Jacobian beforehand: its entries, the colour of every column, how systems are solved."""

    rows: np.ndarray
    columns: np.ndarray
    colour: np.ndarray
    elimination: Elimination

    def directions(self, t, state) -> tuple[Any, Any]:
        """The directions in which the field is differentiated: one for every colour, then time; a leading axis each."""
        leaves, tree = jax.tree.flatten(state)
        count = self.colour.max(initial=-1) + 1
        marks = np.append(self.colour[None, :] == np.arange(count)[:, None], np.zeros((1, len(self.colour))), axis=0)
        ends = np.cumsum([math.prod(leaf.shape[:-1]) for leaf in leaves])[:-1]
        parts = [
            jnp.broadcast_to(jnp.asarray(part.reshape(-1, *leaf.shape[:-1], 1), leaf.dtype), (len(part), *leaf.shape))
            for part, leaf in zip(np.split(marks, ends, axis=1), leaves, strict=True)
        ]
        return jnp.asarray(np.arange(count + 1) == count, t.dtype), jax.tree.unflatten(tree, parts)


def field_like(field, plan: Plan, values: Values, t, state):
    """The rates of a state by a vector field, each shaped as its state is (a rate may be the same in all lanes)."""
    found = field(plan, values, t, *state)
    return jax.tree.map(lambda f, y: jnp.broadcast_to(f, y.shape) if y.size else jnp.zeros_like(y), found, state)


def _one_lane(tree, lanes: int):
    """Shapes of the leaves for one of several lanes. What only happens to be as long is cut too, which does no harm."""

    def first(x):
        shape = jnp.shape(x)
        return jax.ShapeDtypeStruct((*shape[:-1], 1) if shape[-1:] == (lanes,) else shape, jnp.result_type(x))

    return jax.tree.map(first, tree)


def structure_of(plan: Plan, values: Values, state) -> Structure:
    """The structure of the Jacobian of a circuit, found once for all numbers. Values and state may be traced."""
    lanes = jax.tree.leaves(state)[0].shape[-1]
    shapes, tree = jax.tree.flatten(_one_lane(values, lanes))
    leaves, state_tree = jax.tree.flatten(_one_lane(state, lanes))
    return _structure(plan, tree, tuple(shapes), state_tree, tuple(leaves))


@functools.lru_cache(maxsize=32)
def _structure(plan: Plan, tree, shapes: tuple, state_tree, leaves: tuple) -> Structure:
    """See `structure_of`: trees and the shapes of their leaves."""
    values, state = jax.tree.unflatten(tree, shapes), jax.tree.unflatten(state_tree, leaves)
    time = jax.ShapeDtypeStruct((), leaves[0].dtype)
    pattern = jacobian_pattern(lambda y, values, t: field_like(rates, plan, values, t, y), state, values, time)
    rows, columns = np.nonzero(pattern)
    return Structure(rows, columns, colours(pattern), plan_elimination(pattern))


def entries_of(structure: Structure, compressed) -> Entries:
    """The entries of the Jacobian from the field's derivatives along the seeds."""
    leaves = jax.tree.leaves(compressed)
    index = [(k, own) for k, leaf in enumerate(leaves) for own in np.ndindex(leaf.shape[1:-1])]
    colour = structure.colour[structure.columns]

    def get(k: int):
        leaf, own = index[structure.rows[k]]
        return leaves[leaf][(int(colour[k]), *own)]

    def take(numbers: np.ndarray):
        flat = _written([leaf.reshape(-1, leaf.shape[-1]) for leaf in leaves], spare=1)
        # Leaf by leaf, colour by colour, number by number.
        sizes = np.asarray([math.prod(leaf.shape[1:-1]) for leaf in leaves])
        size = np.repeat(sizes, sizes)[structure.rows]
        first = np.repeat(np.cumsum(sizes) - sizes, sizes)[structure.rows]
        places = len(leaves[0]) * first + colour * size + structure.rows - first
        return flat[np.append(places, len(flat) - 1)[numbers]]

    return Entries(structure.rows, structure.columns, get, take)


def _written(parts: list, spare: int = 0):
    """Arrays (rows, lanes) below each other, with spare rows of zeros at the end.

    Each is written into its place: a concatenation would be worked out anew, number by number, wherever it is used.
    """
    whole = jnp.zeros((sum(len(part) for part in parts) + spare, parts[0].shape[-1]), parts[0].dtype)
    begin = 0
    for part in parts:
        whole = jax.lax.dynamic_update_slice(whole, part, (begin, 0))
        begin += len(part)
    return whole


def solved(elimination: Elimination, factors, right):
    """The solution of the systems for a right-hand side that looks like a state."""
    leaves, tree = jax.tree.flatten(right)
    sizes = [math.prod(leaf.shape[:-1]) for leaf in leaves]
    ends = np.cumsum(sizes)
    if elimination.by_rows:
        rows = [leaf[own] for leaf in leaves for own in np.ndindex(leaf.shape[:-1])]
        found = elimination.solve(factors, rows)
        parts = [found[end - size : end] for size, end in zip(sizes, ends, strict=True)]
        parts = [part[0] if len(part) == 1 else jnp.stack(part) if part else jnp.zeros(0) for part in parts]
    else:
        found = elimination.solve(factors, _written([leaf.reshape(-1, leaf.shape[-1]) for leaf in leaves]))
        parts = [found[end - size : end] for size, end in zip(sizes, ends, strict=True)]
    return jax.tree.unflatten(tree, [p.reshape(leaf.shape) for p, leaf in zip(parts, leaves, strict=True)])
