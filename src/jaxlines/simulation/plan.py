"""A compiled circuit: what is static about it (the plan), its values, and its states as one vector.

Components of a kind (same class, same structure) are packed into one object of that class whose leaves have
the shape (count, [lanes]), so that `evaluate` runs once per kind, element by element. The plan is static and
hashable, so one program serves all values of a topology.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS, AbstractComponent, State
from jaxlines.physics.fields import AbstractSignal, driven_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation.wiring import FixedNode, Kind


class Quantity(NamedTuple):
    """Where a quantity is found: room, kind, name in it, its index; its unit.

    Rooms are "free" and "fixed" (nodes), "state", "port" (flows), "input" (external inputs and controllers' outputs).
    The index has the own axes of a state first and the member of the kind last.
    """

    room: str
    kind: int
    name: str
    index: tuple[int, ...]
    unit: str


class SensorPlan(NamedTuple):
    """Where a sensor finds the quantity it reads, and the one it subtracts.

    reading: its state, when it has a lag; delayed: whether it shows the past.
    """

    name: str
    read: Quantity
    subtracted: Quantity | None
    reading: Quantity | None
    delayed: bool


class Reading(NamedTuple):
    """What the members of a kind of controllers read into a field: a quantity each, or what a sensor shows.

    sensors: (member, sensor) for those that read through one.
    """

    field: str
    places: tuple[Quantity, ...]
    sensors: tuple[tuple[int, SensorPlan], ...]


class ControllerPlan(NamedTuple):
    """A kind of controllers, where its outputs are among the inputs, and what it reads."""

    kind: int
    sampled: bool
    outputs: tuple[int, ...]
    readings: tuple[Reading, ...]


class Incidence(NamedTuple):
    """Which terms are summed at each node.

    Terms are the members of (kind, port) pairs one after another; the position after the last stands for zero.
    Nodes with similar numbers of terms share a table (nodes, terms), so that one wide junction does not make a
    long row of every other; `order` finds each node among the rows of all tables.
    """

    ports: tuple[tuple[int, str], ...] = ()
    tables: tuple[tuple[tuple[int, ...], ...], ...] = ()
    order: tuple[int, ...] = ()


class Plan(NamedTuple):
    """The static description of a circuit.

    kinds: of components, in the order of `Values.kinds`, then one for every sensor with a lag, which has a state.
    """

    kinds: tuple[Kind, ...]
    free_nodes: tuple[tuple[str, str], ...]
    fixed_nodes: tuple[FixedNode, ...]
    signal_names: tuple[str, ...]
    controllers: tuple[ControllerPlan, ...] = ()
    sensors: tuple[SensorPlan, ...] = ()
    flow: Incidence = Incidence()
    capacity: Incidence = Incidence()


class Initial(eqx.Module):
    """Where potentials and states start, in SI.

    Potentials of the free nodes have the shape (nodes,), the states of each kind (own axes, count). A state that
    was not given is NaN and starts where its component says, which may depend on the potentials.
    """

    potentials: Any
    states: tuple[dict, ...]


class Values(eqx.Module):
    """All numbers of a circuit, packed by kind; `signals` are the external inputs in the order of their names."""

    fluid: Oil
    kinds: tuple[AbstractComponent, ...]
    signals: tuple[AbstractSignal, ...]
    sensors: dict[str, AbstractSensor]
    initial: Initial

    def every_signal(self) -> list[AbstractSignal]:
        """External inputs, and the signals that components have of their own (members side by side)."""
        own = [getattr(kind, field) for kind in self.kinds for field in driven_of(kind)]
        return [*self.signals, *(signal for signal in own if isinstance(signal, AbstractSignal))]


def initial_names(plan: Plan) -> dict[str, str]:
    """Names of all potentials and states that start somewhere, and their units."""
    names = {f"{node}.{DOMAINS[domain].potential}": DOMAINS[domain].unit for node, domain in plan.free_nodes}
    return names | {f"{m}.{s.name}": s.unit for kind in plan.kinds for s in kind.states for m in kind.members}


def scales(plan: Plan) -> np.ndarray:
    """Typical size of each potential and state in the order of `ravel`."""
    sizes = [DOMAINS[domain].scale for _, domain in plan.free_nodes]
    sizes += [s.scale for kind in plan.kinds for s in kind.states for _ in range(_size(kind, s))]
    return np.asarray(sizes)


def _size(kind: Kind, state: State) -> int:
    """How many numbers a state of a kind is."""
    return math.prod(state.shape) * len(kind.members)


def ravel(plan: Plan, potentials, states):
    """One vector of potentials and states, each divided by its typical size."""
    parts = [potentials] + [states[k][s.name] for k, kind in enumerate(plan.kinds) for s in kind.states]
    return jnp.concatenate([jnp.ravel(jnp.asarray(p)) for p in parts]) / scales(plan)


def unravel(plan: Plan, vector):
    """Potentials and states in SI from the scaled vector."""
    vector = vector * scales(plan)
    at = len(plan.free_nodes)
    potentials, states = vector[:at], []
    for kind in plan.kinds:
        block = {}
        for state in kind.states:
            size = _size(kind, state)
            block[state.name] = vector[at : at + size].reshape(*state.shape, len(kind.members))
            at += size
        states.append(block)
    return potentials, tuple(states)
