"""Programs of the implicit engine that are driven from the host: single steps, and what is known of the Jacobian."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.block_field import BlockField
from jaxlines.simulation.ensemble_program import LaneProgram, block_field
from jaxlines.simulation.jacobian import Structure, structure_of
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.rosenbrock import relative_error, step


def implicit_start(program: LaneProgram, values: Values, columns, t):
    """The state of lanes at the start [s], (potentials, states), lanes last."""
    field = block_field(program, values, columns, t)
    return field.tree(field.start())


def implicit_trial(program: LaneProgram, values: Values, columns, t, h, state):
    """The state of lanes after a step of the implicit engine from t to t + h [s], and the relative error estimate of
    each lane, infinite where it is not finite. See `graded_steps`."""
    held, rate = block_field(program, values, columns, t).implicit(t)
    new, error = step(program.plan, held, t, h, state, rate)
    size = relative_error(program.plan, new, error)
    return new, jnp.where(jnp.isfinite(size), size, jnp.inf)


def implicit_outputs(program: LaneProgram, values: Values, columns, t, state):
    """All observed outputs of lanes in a state at time t [s], (observed, lanes)."""
    field = block_field(program, values, columns, t)
    return field.outputs(field.signals(t), tuple(jax.tree.leaves(state)))


def state_rates(program: LaneProgram, values: Values, columns, t, state):
    """The rates of a state of lanes at time t [s], each shaped as its state."""
    field = block_field(program, values, columns, t)
    found = field.rates(field.signals(t), tuple(jax.tree.leaves(state)))
    return jax.tree.unflatten(jax.tree.structure(state), found)


def implicit_structure(program: LaneProgram, values: Values, precision: str) -> Structure:
    """What is known of the Jacobian of a circuit: pattern, colours, how its systems are solved. On the host."""
    leaves, tree = jax.tree.flatten(values)
    columns = []
    for (place, own), *_ in program.places:
        shape = np.shape(leaves[place] if own is None else np.asarray(leaves[place])[own])
        columns.append(jax.ShapeDtypeStruct((*shape, 1), precision))
    shapes = tuple(jax.ShapeDtypeStruct(np.shape(leaf), precision) for leaf in leaves)
    with computing_in(precision):
        return _structure(program.plan, program.places, program.observed, tree, shapes, tuple(columns))


@functools.lru_cache(maxsize=32)
def _structure(plan: Plan, places, observed: tuple[str, ...], tree, shapes: tuple, columns: tuple) -> Structure:
    found = []

    def look(values, columns, t):
        field = BlockField(plan, values, places, observed, columns, t)
        found.append(structure_of(plan, field.implicit(t)[0], field.tree(field.start())))

    time = jax.ShapeDtypeStruct((), columns[0].dtype)
    jax.eval_shape(look, jax.tree.unflatten(tree, shapes), columns, time)
    return found[0]
