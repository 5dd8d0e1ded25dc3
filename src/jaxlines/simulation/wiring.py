"""How a circuit is wired: components grouped into kinds, their ports and inputs as indices."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxlines.physics.component import AbstractComponent, State
from jaxlines.physics.controllers import reads_of
from jaxlines.physics.fields import External, driven_of, ports_of
from jaxlines.physics.fluids import Oil
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.loops import controller_levels


class PortPlan(NamedTuple):
    """Where a port of a kind is attached: indices into the free or the fixed nodes, one per member."""

    name: str
    domain: str
    fixed: bool
    index: tuple[int, ...]


class Kind(NamedTuple):
    """Components that are evaluated together.

    `signals`: driven field -> for each member the index of its input among external inputs and controllers; other
    driven fields hold numbers, or signals of the members' own.
    """

    members: tuple[str, ...]
    ports: tuple[PortPlan, ...]
    signals: tuple[tuple[str, tuple[int, ...]], ...]
    states: tuple[State, ...]


class FixedNode(NamedTuple):
    """A node whose potential is given by a driven field of a member of a kind."""

    name: str
    domain: str
    kind: int
    field: str
    member: int


def _copy_with(module, changes: dict):
    """A copy of a module with some fields set, without conversion or checks."""
    new = object.__new__(type(module))
    for field in dataclasses.fields(module):
        object.__setattr__(new, field.name, changes.get(field.name, getattr(module, field.name)))
    return new


def anonymous(component: AbstractComponent) -> AbstractComponent:
    """The component without the names of nodes, inputs and readings: what members of a kind have in common."""
    blank: dict = dict.fromkeys([*ports_of(component), *reads_of(component)], "")
    blank |= {f: None for f in driven_of(component) if isinstance(getattr(component, f), External)}
    return _copy_with(component, blank)


class Wiring:
    """Nodes and inputs of a circuit as indices.

    Inputs are numbered: external ones first, by name, then controllers, each after those that it listens to.
    """

    def __init__(self, circuit: Circuit):
        self.nodes = circuit.nodes()
        self.fixed = circuit.fixed_nodes()
        self.free_names = [name for name in self.nodes if name not in self.fixed]
        self.fixed_names = [name for name in self.nodes if name in self.fixed]
        self.free_index = {name: i for i, name in enumerate(self.free_names)}
        self.fixed_index = {name: i for i, name in enumerate(self.fixed_names)}
        self.levels = controller_levels(circuit.components)
        self.input_names = [name for name in circuit.external_inputs() if name not in self.levels]
        self.input_index = {name: i for i, name in enumerate([*self.input_names, *self.levels])}

    def port(self, component, port: str) -> tuple[bool, int]:
        """Whether the node at a port is fixed, and its index."""
        node = getattr(component, port)
        return (True, self.fixed_index[node]) if node in self.fixed else (False, self.free_index[node])


def group_kinds(circuit: Circuit, wiring: Wiring) -> list[dict[str, AbstractComponent]]:
    """Components grouped into kinds, in the order of first appearance."""
    groups: dict[Any, dict[str, AbstractComponent]] = {}
    for name, part in circuit.parts().items():
        fixed = tuple(getattr(part, port) in wiring.fixed for port in ports_of(part))
        leaves, structure = jax.tree.flatten(anonymous(part))
        key = (structure, fixed, tuple(np.shape(leaf) for leaf in leaves), wiring.levels.get(name))
        groups.setdefault(key, {})[name] = part
    return list(groups.values())


def plan_kind(members: dict[str, AbstractComponent], wiring: Wiring, fluid: Oil) -> Kind:
    """Attach the ports and the inputs of a kind."""
    first = next(iter(members.values()))
    ports = []
    for port, domain in ports_of(first).items():
        places = [wiring.port(part, port) for part in members.values()]
        ports.append(PortPlan(port, domain, places[0][0], tuple(index for _, index in places)))
    listening = [field for field in driven_of(first) if isinstance(getattr(first, field), External)]
    signals = [(f, tuple(wiring.input_index[getattr(m, f).name] for m in members.values())) for f in listening]
    return Kind(tuple(members), tuple(ports), tuple(signals), first.states_in(fluid))


def plan_fixed(wiring: Wiring, kinds: list[Kind]) -> tuple[FixedNode, ...]:
    """Where the potential of each fixed node comes from."""
    place = {name: (k, member) for k, kind in enumerate(kinds) for member, name in enumerate(kind.members)}
    owners = [(node, *wiring.fixed[node]) for node in wiring.fixed_names]
    return tuple(
        FixedNode(node, wiring.nodes[node], place[owner][0], field, place[owner][1]) for node, owner, field in owners
    )
