"""How a circuit is wired: components grouped into kinds, their ports and signals as indices."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxlines.physics.component import AbstractComponent, State
from jaxlines.physics.fields import AbstractSignal, External, driven_of, ports_of
from jaxlines.physics.fluids import Oil
from jaxlines.simulation.circuit import Circuit


class PortPlan(NamedTuple):
    """Where a port of a kind is attached: indices into the free or the fixed nodes, one per member."""

    name: str
    domain: str
    fixed: bool
    index: tuple[int, ...]


class Kind(NamedTuple):
    """Components that are evaluated together."""

    members: tuple[str, ...]
    ports: tuple[PortPlan, ...]
    signals: tuple[tuple[str, tuple[int, ...]], ...]
    states: tuple[State, ...]


class FixedNode(NamedTuple):
    """A node whose potential is given: by a signal (kind < 0: index is the signal's), or by a packed leaf."""

    name: str
    domain: str
    kind: int
    field: str
    index: int


def _copy_with(module, changes: dict):
    """A copy of a module with some fields set, without conversion or checks."""
    new = object.__new__(type(module))
    for field in dataclasses.fields(module):
        object.__setattr__(new, field.name, changes.get(field.name, getattr(module, field.name)))
    return new


def anonymous(component: AbstractComponent) -> AbstractComponent:
    """The component without node names and signals: what members of a kind have in common."""
    blank: dict = dict.fromkeys(ports_of(component), "")
    blank |= {f: None for f in driven_of(component) if isinstance(getattr(component, f), AbstractSignal)}
    return _copy_with(component, blank)


class Wiring:
    """Collects nodes and signals of a circuit while its kinds are planned."""

    def __init__(self, circuit: Circuit):
        self.fixed = circuit.fixed_nodes()
        nodes = circuit.nodes()
        self.free_names = [name for name in nodes if name not in self.fixed]
        self.fixed_names = [name for name in nodes if name in self.fixed]
        self.nodes = nodes
        self.signals: dict[Any, AbstractSignal] = {}

    def port(self, component, port: str) -> tuple[bool, int]:
        """Whether the node at a port is fixed, and its index."""
        node = getattr(component, port)
        return (True, self.fixed_names.index(node)) if node in self.fixed else (False, self.free_names.index(node))

    def signal(self, owner: str, field: str, signal: AbstractSignal) -> int:
        """Index of a signal; external inputs of one name are one signal."""
        key = signal.name if isinstance(signal, External) else (owner, field)
        self.signals.setdefault(key, signal)
        return list(self.signals).index(key)


def group_kinds(circuit: Circuit, wiring: Wiring) -> list[dict[str, AbstractComponent]]:
    """Components grouped into kinds, in the order of first appearance."""
    groups: dict[Any, dict[str, AbstractComponent]] = {}
    for name, part in circuit.parts().items():
        fixed = tuple(wiring.port(part, port)[0] for port in ports_of(part))
        shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(anonymous(part)))
        key = (jax.tree.structure(anonymous(part)), fixed, shapes)
        groups.setdefault(key, {})[name] = part
    return list(groups.values())


def plan_kind(members: dict[str, AbstractComponent], wiring: Wiring, fluid: Oil) -> Kind:
    """Attach the ports and the signals of a kind."""
    first = next(iter(members.values()))
    ports = []
    for port, domain in ports_of(first).items():
        places = [wiring.port(part, port) for part in members.values()]
        ports.append(PortPlan(port, domain, places[0][0], tuple(index for _, index in places)))
    signals = []
    for field in driven_of(first):
        if isinstance(getattr(first, field), AbstractSignal):
            index = tuple(wiring.signal(name, field, getattr(part, field)) for name, part in members.items())
            signals.append((field, index))
    return Kind(tuple(members), tuple(ports), tuple(signals), first.states_in(fluid))


def plan_fixed(circuit: Circuit, wiring: Wiring, kinds: list[Kind]) -> tuple[FixedNode, ...]:
    """Where the potential of each fixed node comes from."""
    fixed = []
    for node in wiring.fixed_names:
        owner, field = wiring.fixed[node]
        value = getattr(circuit.components[owner], field)
        if isinstance(value, AbstractSignal):
            place = (-1, wiring.signal(owner, field, value))
        else:
            kind = next(k for k, kind in enumerate(kinds) if owner in kind.members)
            place = (kind, kinds[kind].members.index(owner))
        fixed.append(FixedNode(node, wiring.nodes[node], place[0], field, place[1]))
    return tuple(fixed)
