"""Every quantity of a compiled circuit by name, and where it is found."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS
from jaxlines.simulation.plan import Plan, Quantity


@functools.lru_cache(maxsize=32)
def quantities(plan: Plan) -> dict[str, Quantity]:
    """Every quantity of a circuit by name, such as "A.pressure", "valve.spool", "leak.a.flow" or "line.pressure.3"."""
    known = {}
    for index, (node, domain) in enumerate(plan.free_nodes):
        known[f"{node}.{DOMAINS[domain].potential}"] = Quantity("free", -1, "", (index,), DOMAINS[domain].unit)
    for index, node in enumerate(plan.fixed_nodes):
        name = f"{node.name}.{DOMAINS[node.domain].potential}"
        known[name] = Quantity("fixed", -1, "", (index,), DOMAINS[node.domain].unit)
    for controller in plan.controllers:
        for owner, index in zip(plan.kinds[controller.kind].members, controller.outputs, strict=True):
            known[f"{owner}.output"] = Quantity("input", -1, "", (index,), "1")
    for k, kind in enumerate(plan.kinds):
        for member, owner in enumerate(kind.members):
            for state in kind.states:
                for own in np.ndindex(state.shape):
                    name = ".".join([owner, state.name, *map(str, own)])
                    known[name] = Quantity("state", k, state.name, (*own, member), state.unit)
            for port in kind.ports:
                domain = DOMAINS[port.domain]
                known[f"{owner}.{port.name}.{domain.flow}"] = Quantity(
                    "port", k, port.name, (member,), domain.flow_unit
                )
    return known


FEW = 4
"""Up to so many members, slices of an array are faster than a gather."""


def take(array, index: Sequence[int]):
    """Entries of an array along its first axis."""
    return jnp.stack([array[i] for i in index]) if len(index) <= FEW else array[np.asarray(index)]


class Room(NamedTuple):
    """Quantities that lie in one array: where it begins among all, and the shape of its index."""

    offset: int
    shape: tuple[int, ...]


def pick(places: Sequence[Quantity], array_of: Callable[[Quantity], Any]):
    """The values of some quantities, shape (places, [lanes]).

    Args: places; array_of: gives the array that holds a quantity, its index first, the member last but for lanes.
    One gather from all rooms together: a wave line has hundreds of quantities, and a slice each compiles slowly.
    """
    rooms: dict[tuple, Room] = {}
    flat, at, size = [], [], 0
    for place in places:
        key = (place.room, place.kind, place.name)
        if key not in rooms:
            array = jnp.asarray(array_of(place))
            own = array.shape[: len(place.index)]
            flat.append(array.reshape(-1, *array.shape[len(own) :]))
            rooms[key], size = Room(size, own), size + math.prod(own)
        room, position = rooms[key], 0
        for index, length in zip(place.index, room.shape, strict=True):
            position = position * length + index
        at.append(room.offset + position)
    lanes = jnp.broadcast_shapes(*(array.shape[1:] for array in flat))
    return jnp.concatenate([jnp.broadcast_to(array, (array.shape[0], *lanes)) for array in flat])[np.asarray(at)]
