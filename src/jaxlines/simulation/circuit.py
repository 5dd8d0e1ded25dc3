"""A circuit: named components attached to named nodes, filled with one fluid."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxlines.physics.component import DOMAINS, AbstractComponent, Situation
from jaxlines.physics.controllers import AbstractController
from jaxlines.physics.fields import HYDRAULIC, ROTATIONAL, External, as_number, check_range, driven_of, ports_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.lines import Line
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation.circuit_table import circuit_table
from jaxlines.simulation.loops import controller_levels
from jaxlines.simulation.paths import leaf_paths, resolve


class Circuit(eqx.Module):
    """Components and sensors by name, and the fluid.

    Args: fluid; components: name -> component or sensor. Nodes exist by being named at a port.
    Raises: TypeError for what is no component; ValueError when a node is used in two domains, is set by
        two sources, or when a name is taken twice or has a dot in it, or when a node has no
        capacity, or when controllers form an algebraic loop.
    `print(circuit)` shows it as a table.
    """

    fluid: Oil
    components: dict[str, AbstractComponent | AbstractSensor]

    def __check_init__(self):
        if not isinstance(self.fluid, Oil):
            raise TypeError(f"the first argument of a Circuit is its fluid, got {type(self.fluid).__name__}")
        for name, component in self.components.items():
            if not isinstance(component, AbstractComponent | AbstractSensor):
                raise TypeError(f"{name!r} must be a component or a sensor, got {type(component).__name__}")
            if not name or name in ("fluid", "initial") or any(c in name for c in ".[]"):
                raise ValueError(f"{name!r} is no name for a component: no dots, no brackets, not fluid, not initial")
        clash = set(self.components) & set(self.nodes())
        if clash:
            raise ValueError(f"{sorted(clash)[0]!r} is both a node and a component: give one of them another name")
        _require_capacity(self)
        controller_levels(self.components)

    def __str__(self) -> str:
        return circuit_table(self.fluid, self.components)

    def parts(self) -> dict[str, AbstractComponent]:
        """The components that are no sensors."""
        return {name: part for name, part in self.components.items() if isinstance(part, AbstractComponent)}

    def sensors(self) -> dict[str, AbstractSensor]:
        """The sensors."""
        return {name: part for name, part in self.components.items() if isinstance(part, AbstractSensor)}

    def nodes(self) -> dict[str, str]:
        """Node name -> domain, in the order in which components name them."""
        nodes: dict[str, str] = {}
        for name, part in self.parts().items():
            for port, domain in ports_of(part).items():
                node = getattr(part, port)
                if nodes.setdefault(node, domain) != domain:
                    raise ValueError(f"node {node!r} is {nodes[node]}, but {name}.{port} needs a {domain} node")
        return nodes

    def fixed_nodes(self) -> dict[str, tuple[str, str]]:
        """Node name -> (component, driven field) that sets its potential."""
        fixed: dict[str, tuple[str, str]] = {}
        for name, part in self.parts().items():
            for port, field in part.sets().items():
                node = getattr(part, port)
                if node in fixed:
                    raise ValueError(f"the pressure of node {node!r} is set by both {fixed[node][0]!r} and {name!r}")
                fixed[node] = (name, field)
        return fixed

    def external_inputs(self) -> dict[str, list[tuple[str, str]]]:
        """Name of each input to be given -> the (component, field) pairs that it drives; controllers are none."""
        inputs: dict[str, list[tuple[str, str]]] = {}
        for name, part in self.parts().items():
            for field in driven_of(part):
                value = getattr(part, field)
                if isinstance(value, External) and not isinstance(self.components.get(value.name), AbstractController):
                    inputs.setdefault(value.name, []).append((name, field))
        return inputs

    def paths(self) -> list[str]:
        """The path of every number in the circuit, such as "fluid.air_fraction" or "line.parts.0.volume"."""
        return list(self._leaves())

    def _leaves(self) -> dict[str, int]:
        """Path -> position among the leaves of this circuit."""
        paths = [path.removeprefix("components.") for path in leaf_paths(self)]
        return {path: position for position, path in enumerate(paths)}

    def __getitem__(self, path: str):
        """The number at a path."""
        leaves = self._leaves()
        return jax.tree.leaves(self)[leaves[resolve(path, leaves)]]

    def replace(self, changes: dict, *, check: bool = True) -> "Circuit":
        """A copy with other numbers at some paths: `circuit.replace({"fluid.air_fraction": 0.01})`.

        Values may be traced by JAX. Raises: KeyError for an unknown path, ValueError for a concrete number
        outside its range (unless `check` is off).
        """
        positions = self._leaves()
        leaves, structure = jax.tree.flatten(self)
        for name, value in changes.items():
            path, number = resolve(name, positions), as_number(value)
            metadata = field_metadata(self, path)
            if metadata and check:
                check_range(path, number, metadata)
            leaves[positions[path]] = number
        changed = jax.tree.unflatten(structure, leaves)
        # JAX sorts the names; in their own order the changed circuit runs on the same compiled program.
        return Circuit(changed.fluid, {name: changed.components[name] for name in self.components})


REMEDIES = {HYDRAULIC: "a Line (a Vessel is a plain volume), or a PressureSource", ROTATIONAL: "an Inertia"}
"""What to attach to a node without capacity, by domain; elsewhere a Mass."""


def _require_capacity(circuit: Circuit) -> None:
    """Raise for a node to which nothing adds capacity, so that its potential would change infinitely fast."""
    fixed, attached, parts = circuit.fixed_nodes(), {}, circuit.parts()
    for name, part in parts.items():
        for port in ports_of(part):
            attached.setdefault(getattr(part, port), []).append((name, port))
    for node, places in attached.items():
        if node in fixed or any(port in _capacity_ports(circuit.fluid, parts[name]) for name, port in places):
            continue
        domain, ports = circuit.nodes()[node], [f"{name}.{port}" for name, port in places]
        raise ValueError(
            f"{domain} node {node!r} has no capacity, so that its {DOMAINS[domain].potential} is undetermined: attach "
            f"{REMEDIES.get(domain, 'a Mass')}, or correct the name; attached to it: {', '.join(ports)}"
        )


_CAPACITY_PORTS: dict[Any, frozenset[str]] = {}
# What adds capacity where follows from the structure of component and fluid alone, and a circuit is made anew for
# every change of a number.


def _capacity_ports(fluid: Oil, part: AbstractComponent) -> frozenset[str]:
    """The ports at which a component adds capacity to its node, without computing anything."""
    if isinstance(part, Line) and part.to is not None:  # its number of segments may not be chosen yet
        return frozenset({"node", "to"} if part.model == "pi" else ())
    key = jax.tree.structure((fluid, part))
    if key not in _CAPACITY_PORTS:

        def capacity(fluid, part):
            at_ports = {name: jnp.asarray(1.0) for name in ports_of(part)}
            states = {state.name: jnp.ones(state.shape) for state in part.states_in(fluid)}
            return part.evaluate(Situation(fluid, at_ports, states, dict.fromkeys(driven_of(part), 1.0))).capacity

        _CAPACITY_PORTS[key] = frozenset(eqx.filter_eval_shape(capacity, fluid, part))
    return _CAPACITY_PORTS[key]


def field_metadata(circuit: Circuit, path: str) -> dict:
    """Unit, range and slip of the number at a full path; empty where none is declared."""
    owner_name, *words = path.split(".")
    owner: Any = circuit.fluid if owner_name == "fluid" else circuit.components[owner_name]
    driven: dict = {}
    for word in words[:-1]:
        if word.isdigit():
            owner = owner[int(word)]
            continue
        driven = driven or driven_of(owner).get(word, {})
        owner = getattr(owner, word)
    metadata = {f.name: dict(f.metadata) for f in dataclasses.fields(owner)}.get(words[-1], {})
    if metadata.get("unit") == "1" and driven:
        return driven  # a number of a signal has the unit and the range of what the signal drives
    return metadata if "unit" in metadata else {}
