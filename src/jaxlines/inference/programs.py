"""The compiled programs of a fit: simulated channels of one recording, and their slopes by every parameter."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.fields import AbstractSignal, driven_of
from jaxlines.simulation.balance import imbalance
from jaxlines.simulation.integration import Method, integrate, integrate_with_sensitivities
from jaxlines.simulation.paths import leaf_paths
from jaxlines.simulation.plan import Initial, Plan, Values, unravel
from jaxlines.simulation.signals import Constant
from jaxlines.simulation.steady import solve_balance


class Place(NamedTuple):
    """Where a parameter acts: a leaf of `Values`, the index of the number in it (None: all of it), and how.

    mode: "set" to ratio * value; "scale" or "shift" the samples of an input by its gain or offset.
    """

    position: int
    member: Any
    ratio: float = 1.0
    mode: str = "set"


def bucket(size: int) -> int:
    """The next size of the form 2^k or 1.5 * 2^k, so that recordings of similar length share a program."""
    power = 2 ** math.ceil(math.log2(max(size, 16)))
    return 3 * power // 4 if size <= 3 * power // 4 else power


def place_numbers(values: Values, places: tuple[Place, ...], numbers) -> Values:
    """Values with parameters at their places; `numbers` may be traced, shape (places,)."""
    leaves, structure = jax.tree.flatten(values)
    for mode in ("set", "scale", "shift"):  # gain * sample + offset, in whatever order they were given
        for place, number in zip(places, numbers, strict=True):
            if place.mode != mode:
                continue
            leaf, number = jnp.asarray(leaves[place.position]), number * place.ratio
            if mode == "scale":
                leaf = leaf * number
            elif mode == "shift":
                leaf = leaf + number
            else:
                leaf = number + 0.0 * leaf if place.member is None else leaf.at[place.member].set(number)
            leaves[place.position] = leaf
    return jax.tree.unflatten(structure, leaves)


def _held(values: Values, time) -> Values:
    """Values with every signal held at its value at a time [s]."""
    signals = tuple(Constant(jnp.asarray(signal(time))) for signal in values.signals)
    kinds = list(values.kinds)
    for k, kind in enumerate(kinds):
        for field in driven_of(kind):
            signal = getattr(kind, field)
            if isinstance(signal, AbstractSignal):
                constant = Constant(jax.vmap(lambda own: own(time), in_axes=-1)(signal))
                kinds[k] = eqx.tree_at(lambda part, field=field: getattr(part, field), kinds[k], constant)
    return eqx.tree_at(lambda v: (v.signals, v.kinds), values, (signals, tuple(kinds)))


def steady_start(plan: Plan, values: Values, time) -> Values:
    """Values that start in the steady state of their inputs at a time [s]; NaN where there is none.

    Differentiable by the implicit function theorem, so that the start moves with the parameters.
    """
    y, linear = solve_balance(plan, (False,) * len(plan.free_nodes), _held(values, time))
    potentials, states = unravel(plan, jnp.where(jnp.max(imbalance(linear), initial=0.0) <= 1.0, y, jnp.nan))
    return eqx.tree_at(lambda v: v.initial, values, Initial(potentials, tuple(states)))


def prediction(plan, wanted, method, places, numbers, values, times, tolerance, steady=False):
    """Outputs (times, channels) and status for the numbers at some places."""
    values = place_numbers(values, places, numbers)
    if steady:
        values = steady_start(plan, values, times[0])
    found = integrate(plan, wanted, method, values, times, tolerance)
    return found.outputs, found.status


def sensitivity(plan, wanted, method, places, groups, numbers, sizes, values, times, tolerance, steady=False):
    """Outputs, d outputs / d parameters (times, channels, parameters) and status, by forward sensitivities.

    `groups` gives for each parameter the positions of the numbers that it drives, `sizes` a large change of it.
    """
    leaves, structure = jax.tree.flatten(place_numbers(values, places, numbers))
    touched = {place.position for place in places}
    if steady:
        touched |= {i for i, path in enumerate(leaf_paths(values)) if path.startswith("initial.")}
    order = sorted(touched)

    def rebuild(moved):
        return jax.tree.unflatten(structure, _replaced(leaves, order, moved))

    def move(shift):
        moved = numbers
        for parameter, members in enumerate(groups):
            moved = moved.at[np.asarray(members)].add(shift[parameter] * sizes[parameter])
        changed = place_numbers(values, places, moved)
        every = jax.tree.leaves(steady_start(plan, changed, times[0]) if steady else changed)
        return [every[position] for position in order]

    start = jnp.zeros(len(groups), numbers.dtype)
    slopes = [jnp.moveaxis(s, -1, 0) for s in jax.jacfwd(move)(start)]
    found, output_slopes = integrate_with_sensitivities(
        plan, wanted, method, rebuild, move(start), slopes, times, tolerance
    )
    return found.outputs, output_slopes / sizes, found.status


def _replaced(leaves: list, positions: list[int], new: list) -> list:
    """Leaves with those at some positions replaced."""
    given = dict(zip(positions, new, strict=True))
    return [given.get(position, leaf) for position, leaf in enumerate(leaves)]


def pulled_samples(plan, wanted, method: Method, places, numbers, values, times, tolerance, steady, names, weights):
    """For each weighting of the outputs its slopes by every sample of some inputs, by the adjoint of the solver.

    Args: names: of the inputs; weights, shape (weightings, times, channels). Returns: a list, one array
    (weightings, samples) an input.
    """
    wheres = [plan.signal_names.index(name) for name in names]

    def outputs(samples):
        moved = eqx.tree_at(lambda v: [v.signals[i].values for i in wheres], values, samples)
        return prediction(plan, wanted, method, places, numbers, moved, times, tolerance, steady)[0]

    _, pull = jax.vjp(outputs, [jnp.asarray(values.signals[i].values) for i in wheres])
    return jax.lax.map(lambda weight: pull(weight)[0], weights)


predict_program = jax.jit(prediction, static_argnums=(0, 1, 2, 3, 8))
sensitivity_program = jax.jit(sensitivity, static_argnums=(0, 1, 2, 3, 4, 10))
pulled_program = jax.jit(pulled_samples, static_argnums=(0, 1, 2, 3, 8, 9))
