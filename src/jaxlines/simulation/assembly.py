"""From a circuit to arrays: what is static (the plan) and what are values, and the vector field over both.

Components of a kind (same class, same structure) are packed into one object of that class whose leaves have
the shape (count, [lanes]); `evaluate` then runs once per kind, element by element. The plan is static and
hashable, so one program serves all values of a topology.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS, AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import AbstractSignal, External, array_module, driven_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.paths import leaf_paths
from jaxlines.simulation.wiring import FixedNode, Kind, Wiring, anonymous, group_kinds, plan_fixed, plan_kind


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
    """Potentials of the free nodes, shape (nodes,), and the states of each kind, shape (count,) each, in SI."""

    potentials: Any
    states: tuple[dict, ...]


class Values(eqx.Module):
    """All numbers of a circuit, packed by kind."""

    fluid: Oil
    kinds: tuple[AbstractComponent, ...]
    signals: tuple[AbstractSignal, ...]
    sensors: dict[str, AbstractSensor]
    initial: Initial


def _stack(*leaves):
    """Leaves of the members of a kind, side by side."""
    xp = array_module(*leaves)
    return xp.stack([xp.asarray(leaf) for leaf in leaves])


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
    kinds = [plan_kind(members, wiring) for members in groups]
    fixed = plan_fixed(circuit, wiring, kinds)
    free = tuple((name, wiring.nodes[name]) for name in wiring.free_names)
    packed = tuple(jax.tree.map(_stack, *(anonymous(part) for part in members.values())) for members in groups)
    signals = tuple((inputs or {})[s.name] if isinstance(s, External) else s for s in wiring.signals.values())
    names = tuple(key if isinstance(key, str) else ".".join(key) for key in wiring.signals)
    plan = Plan(tuple(kinds), free, fixed, names, (), (), (), ())
    start = initial_values(plan, circuit.fluid, initial or {})
    values = Values(circuit.fluid, packed, signals, circuit.sensors(), start)

    found = jax.eval_shape(lambda v: _contributions(plan, v, 0.0, v.initial.potentials, v.initial.states), values)
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


def initial_names(plan: Plan) -> list[str]:
    """Names of all potentials and states that start somewhere."""
    names = [f"{node}.{DOMAINS[domain].potential}" for node, domain in plan.free_nodes]
    return names + [f"{m}.{s.name}" for kind in plan.kinds for s in kind.states for m in kind.members]


def initial_values(plan: Plan, fluid: Oil, given: dict) -> Initial:
    """Initial values by name, atmospheric pressure and zero elsewhere."""
    known = initial_names(plan)
    for name in given:
        if name not in known:
            raise KeyError(f"no state is called {name!r}; there are {', '.join(known)}")
    zero = 0.0 * fluid.atmospheric_pressure
    rest = {"hydraulic": fluid.atmospheric_pressure + zero}
    potentials = [given.get(f"{n}.{DOMAINS[d].potential}", rest.get(d, zero)) for n, d in plan.free_nodes]
    states = tuple(
        {
            s.name: _stack(*(np.asarray(0.0) + given.get(f"{m}.{s.name}", 0.0) for m in kind.members))
            for s in kind.states
        }
        for kind in plan.kinds
    )
    return Initial(_stack(*(np.asarray(0.0) + p for p in potentials)) if potentials else np.zeros(0), states)


def fixed_potentials(plan: Plan, values: Values, signals):
    """Potentials of the fixed nodes, shape (fixed nodes, [lanes])."""
    given = [
        signals[node.index] if node.kind < 0 else getattr(values.kinds[node.kind], node.field)[node.index]
        for node in plan.fixed_nodes
    ]
    return jnp.stack([jnp.asarray(p) for p in given]) if given else jnp.zeros(0)


def _situation(plan: Plan, values: Values, k: int, t_signals, fixed, potentials, states) -> Situation:
    """What the members of kind k see."""
    kind, packed = plan.kinds[k], values.kinds[k]
    at_ports = {p.name: (fixed if p.fixed else potentials)[np.asarray(p.index)] for p in kind.ports}
    given = {field: getattr(packed, field) for field in driven_of(packed)}
    given |= {field: t_signals[np.asarray(index)] for field, index in kind.signals}
    return Situation(values.fluid, at_ports, states[k], given)


def situations(plan: Plan, values: Values, t, potentials, states) -> list[Situation]:
    """What the members of every kind see at time t."""
    t_signals = jnp.stack([jnp.asarray(s(t)) for s in values.signals]) if values.signals else jnp.zeros(0)
    fixed = fixed_potentials(plan, values, t_signals)
    return [_situation(plan, values, k, t_signals, fixed, potentials, states) for k in range(len(plan.kinds))]


def _contributions(plan: Plan, values: Values, t, potentials, states) -> list[Contribution]:
    """What every kind does to its nodes and states at time t."""
    seen = situations(plan, values, t, potentials, states)
    return [packed.evaluate(at) for packed, at in zip(values.kinds, seen, strict=True)]


def _gather(terms: list, incidence):
    """Sum of the terms of each node, by padded positions, shape (nodes, [lanes])."""
    flat = jnp.concatenate([*terms, jnp.zeros_like(terms[0][:1])])
    return flat[np.asarray(incidence)].sum(axis=1)


def rates(plan: Plan, values: Values, t, potentials, states) -> tuple[Any, tuple[dict, ...]]:
    """The vector field: rates of the potentials, flow / capacity, and of the states of each kind, in SI."""
    done = _contributions(plan, values, t, potentials, states)
    state_rates = tuple(c.rate for c in done)
    if not plan.free_nodes:
        return jnp.zeros(0), state_rates
    capacity = _gather([done[k].capacity[port] for k, port in plan.capacity_ports], plan.capacity_incidence)
    if not plan.flow_ports:
        return jnp.zeros_like(capacity), state_rates
    flow = _gather([done[k].flow[port] for k, port in plan.flow_ports], plan.flow_incidence)
    return flow / capacity, state_rates


def scales(plan: Plan) -> np.ndarray:
    """Typical size of each potential and state in the order of `ravel`."""
    sizes = [DOMAINS[domain].scale for _, domain in plan.free_nodes]
    return np.asarray(sizes + [s.scale for kind in plan.kinds for s in kind.states for _ in kind.members])


def ravel(plan: Plan, potentials, states):
    """One vector of potentials and states, each divided by its typical size."""
    parts = [potentials] + [states[k][s.name] for k, kind in enumerate(plan.kinds) for s in kind.states]
    return jnp.concatenate([jnp.asarray(p) for p in parts]) / scales(plan)


def unravel(plan: Plan, vector):
    """Potentials and states in SI from the scaled vector."""
    vector = vector * scales(plan)
    at = len(plan.free_nodes)
    potentials, states = vector[:at], []
    for kind in plan.kinds:
        block = {}
        for state in kind.states:
            block[state.name] = vector[at : at + len(kind.members)]
            at += len(kind.members)
        states.append(block)
    return potentials, tuple(states)


def number_locations(plan: Plan, values: Values) -> dict[str, tuple[int, int | None]]:
    """Path of every number -> (position among the leaves of `values`, member or None), for setting it.

    Paths are those of the circuit, and "initial.A.pressure" for initial values.
    """
    known: dict[str, tuple[int, int | None]] = {}
    for position, path in enumerate(leaf_paths(values)):
        room, *rest = path.split(".")
        if room == "kinds":
            for member, name in enumerate(plan.kinds[int(rest[0])].members):
                known[".".join([name, *rest[1:]])] = (position, member)
        elif room == "initial" and rest[0] == "potentials":
            for member, (node, domain) in enumerate(plan.free_nodes):
                known[f"initial.{node}.{DOMAINS[domain].potential}"] = (position, member)
        elif room == "initial":
            for member, name in enumerate(plan.kinds[int(rest[1])].members):
                known[f"initial.{name}.{rest[2]}"] = (position, member)
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
