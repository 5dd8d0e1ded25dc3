"""From a circuit to its plan and values, and where each of its numbers is found among them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS, State
from jaxlines.physics.fields import External, array_module
from jaxlines.physics.fluids import Oil
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.paths import leaf_paths
from jaxlines.simulation.plan import Initial, Plan, Values, initial_names
from jaxlines.simulation.vector_field import contributions, starting_point
from jaxlines.simulation.wiring import Wiring, anonymous, group_kinds, plan_fixed, plan_kind


def _stack(*leaves):
    """Leaves of the members of a kind, side by side along a last axis."""
    xp = array_module(*leaves)
    return xp.stack([xp.asarray(leaf) for leaf in leaves], axis=-1)


def _incidence(kinds, contributions: list[dict], num_nodes: int):
    """The (kind, port) pairs that contribute to free nodes, and for each node the positions of its terms.

    Positions count through the members of all those ports one after another; the position after the last
    stands for zero and pads the rows.
    """
    ports, rows, count = [], [[] for _ in range(num_nodes)], 0
    for k, kind in enumerate(kinds):
        for port in kind.ports:
            if port.name not in contributions[k] or port.fixed:
                continue
            ports.append((k, port.name))
            for member, node in enumerate(port.index):
                rows[node].append(count + member)
            count += len(port.index)
    width = max((len(row) for row in rows), default=0)
    return tuple(ports), tuple(tuple(row + [count] * (width - len(row))) for row in rows)


def _require_capacity(plan: Plan) -> None:
    """Raise for a node whose potential would change infinitely fast."""
    has = {i for k, port in plan.capacity_ports for p in plan.kinds[k].ports if p.name == port for i in p.index}
    for index, (node, domain) in enumerate(plan.free_nodes):
        if index not in has:
            remedy = {"hydraulic": "a Line (a Vessel is a plain volume), or a PressureSource"}.get(domain, "an Inertia")
            raise ValueError(
                f"{domain} node {node!r} has no capacity, so that its {DOMAINS[domain].potential} is undetermined: "
                f"attach {remedy}, or correct the name"
            )


def compile_circuit(circuit: Circuit, initial: dict | None = None, inputs: dict | None = None) -> tuple[Plan, Values]:
    """The static plan of a circuit and its values.

    Args: circuit; initial: name of a potential or state -> value in SI (others: atmospheric pressure, 0);
        inputs: name -> signal for the circuit's external inputs (all of them).
    Raises: ValueError for a node without capacity; KeyError for an unknown initial value.
    """
    wiring = Wiring(circuit)
    groups = group_kinds(circuit, wiring)
    kinds = [plan_kind(members, wiring, circuit.fluid) for members in groups]
    fixed = plan_fixed(circuit, wiring, kinds)
    free = tuple((name, wiring.nodes[name]) for name in wiring.free_names)
    packed = tuple(jax.tree.map(_stack, *(anonymous(part) for part in members.values())) for members in groups)
    signals = tuple((inputs or {})[s.name] if isinstance(s, External) else s for s in wiring.signals.values())
    names = tuple(key if isinstance(key, str) else ".".join(key) for key in wiring.signals)
    plan = Plan(tuple(kinds), free, fixed, names, (), (), (), ())
    start = initial_values(plan, circuit.fluid, initial or {})
    values = Values(circuit.fluid, packed, signals, circuit.sensors(), start)

    found = jax.eval_shape(lambda v: contributions(plan, v, 0.0, *starting_point(plan, v, 0.0)), values)
    flow_ports, flow_rows = _incidence(kinds, [c.flow for c in found], len(free))
    capacity_ports, capacity_rows = _incidence(kinds, [c.capacity for c in found], len(free))
    plan = plan._replace(
        flow_ports=flow_ports,
        flow_incidence=flow_rows,
        capacity_ports=capacity_ports,
        capacity_incidence=capacity_rows,
    )
    _require_capacity(plan)
    return plan, values


def initial_values(plan: Plan, fluid: Oil, given: dict) -> Initial:
    """Initial values by name; potentials not given start at atmospheric pressure and zero, states as NaN."""
    known = initial_names(plan)
    for name in given:
        if name not in known:
            raise KeyError(f"no state is called {name!r}; there are {', '.join(known)}")
    zero = 0.0 * fluid.atmospheric_pressure
    rest = {"hydraulic": fluid.atmospheric_pressure + zero}
    potentials = [given.get(f"{n}.{DOMAINS[d].potential}", rest.get(d, zero)) for n, d in plan.free_nodes]
    states = tuple(
        {
            s.name: _stack(*(_shaped(f"{m}.{s.name}", given.get(f"{m}.{s.name}", np.nan), s) for m in kind.members))
            for s in kind.states
        }
        for kind in plan.kinds
    )
    return Initial(_stack(*(np.asarray(0.0) + p for p in potentials)) if potentials else np.zeros(0), states)


def _shaped(name: str, value, state: State):
    """The initial value of a state with its own axes; one number stands for all of it."""
    shape, xp = np.shape(value), array_module(value)
    if shape not in ((), state.shape):
        raise ValueError(f"the initial value of {name!r} must be one number or have shape {state.shape}, got {shape}")
    return xp.broadcast_to(xp.asarray(value, dtype=float), state.shape)


Location = tuple[int, Any]
"""Position of a leaf among those of `Values`, and the index of the number in it (None: all of it)."""


def number_locations(plan: Plan, values: Values) -> dict[str, Location]:
    """Path of every number -> where it is, for setting it.

    Paths are those of the circuit, and "initial.A.pressure" for initial values.
    """
    known: dict[str, Location] = {}
    for position, path in enumerate(leaf_paths(values)):
        room, *rest = path.split(".")
        if room == "kinds":
            for member, name in enumerate(plan.kinds[int(rest[0])].members):
                known[".".join([name, *rest[1:]])] = (position, (..., member))
        elif room == "initial" and rest[0] == "potentials":
            for member, (node, domain) in enumerate(plan.free_nodes):
                known[f"initial.{node}.{DOMAINS[domain].potential}"] = (position, member)
        elif room == "initial":
            for member, name in enumerate(plan.kinds[int(rest[1])].members):
                known[f"initial.{name}.{'.'.join(rest[2:])}"] = (position, (..., member))
        elif room == "signals":
            known[".".join([plan.signal_names[int(rest[0])], *rest[1:]])] = (position, None)
        elif room in ("fluid", "sensors"):
            known[".".join(rest) if room == "sensors" else path] = (position, None)
    return known


def set_numbers(values: Values, locations, numbers) -> Values:
    """Values with other numbers at some locations; `numbers` may be traced, shape (locations,)."""
    leaves, structure = jax.tree.flatten(values)
    for (position, member), number in zip(locations, numbers, strict=True):
        leaf = jnp.asarray(leaves[position])
        leaves[position] = number + 0.0 * leaf if member is None else leaf.at[member].set(number)
    return jax.tree.unflatten(structure, leaves)
