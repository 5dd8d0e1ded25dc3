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
from jaxlines.physics.fields import AbstractSignal
from jaxlines.physics.fluids import Oil
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation.wiring import FixedNode, Kind


class Plan(NamedTuple):
    """The static description of a circuit."""

    kinds: tuple[Kind, ...]
    free_nodes: tuple[tuple[str, str], ...]
    fixed_nodes: tuple[FixedNode, ...]
    signal_names: tuple[str, ...]
    flow_ports: tuple[tuple[int, str], ...]
    flow_incidence: tuple[tuple[int, ...], ...]
    capacity_ports: tuple[tuple[int, str], ...]
    capacity_incidence: tuple[tuple[int, ...], ...]


class Initial(eqx.Module):
    """Where potentials and states start, in SI.

    Potentials of the free nodes have the shape (nodes,), the states of each kind (own axes, count). A state that
    was not given is NaN and starts where its component says, which may depend on the potentials.
    """

    potentials: Any
    states: tuple[dict, ...]


class Values(eqx.Module):
    """All numbers of a circuit, packed by kind."""

    fluid: Oil
    kinds: tuple[AbstractComponent, ...]
    signals: tuple[AbstractSignal, ...]
    sensors: dict[str, AbstractSensor]
    initial: Initial


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
