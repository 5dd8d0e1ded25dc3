"""From a circuit to its plan and values, and where each of its numbers is found among them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS, State
from jaxlines.physics.fields import array_module
from jaxlines.physics.fluids import Oil
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.paths import leaf_paths
from jaxlines.simulation.plan import Incidence, Initial, Plan, Values, initial_names
from jaxlines.simulation.reading import plan_controllers, with_sensors
from jaxlines.simulation.vector_field import contributions, starting_point
from jaxlines.simulation.wiring import Wiring, anonymous, group_kinds, plan_fixed, plan_kind


def _stack(*leaves):
    """Leaves of the members of a kind, side by side along a last axis."""
    given = [i for i, leaf in enumerate(leaves) if isinstance(leaf, jax.Array)]
    if len(given) == len(leaves):
        return jnp.stack(leaves, axis=-1)
    # Numbers of the host are stacked there: each of a thousand members would be an operation of the program.
    host = np.stack([np.zeros(np.shape(x)) if isinstance(x, jax.Array) else np.asarray(x) for x in leaves], axis=-1)
    return jnp.asarray(host).at[..., np.asarray(given)].set(_stack(*(leaves[i] for i in given))) if given else host


def _incidence(kinds, contributions: list[dict], num_nodes: int) -> Incidence:
    """Which members of which ports contribute to each free node."""
    ports, rows, count = [], [[] for _ in range(num_nodes)], 0
    for k, kind in enumerate(kinds):
        for port in kind.ports:
            if port.name not in contributions[k] or port.fixed:
                continue
            ports.append((k, port.name))
            for member, node in enumerate(port.index):
                rows[node].append(count + member)
            count += len(port.index)
    return Incidence(tuple(ports), *_tables(rows, count))


def _tables(rows: list[list[int]], padding: int):
    """Rows of similar length padded to tables, and where each row is among those of all tables.

    A small table is the fastest; in large ones lengths differ by a factor of four at most.
    """
    lengths = [max(len(row), 1) for row in rows]
    bounds = [max(lengths, default=1)]
    if len(rows) * bounds[0] > 1000:
        for length in sorted(set(lengths), reverse=True):
            bounds += [length] if 4 * length < bounds[-1] else []
    widths = [min(bound for bound in bounds if bound >= length) for length in lengths]
    order = sorted(range(len(rows)), key=lambda node: -widths[node])
    tables = [
        tuple(tuple(rows[n] + [padding] * (bound - len(rows[n]))) for n in order if widths[n] == bound)
        for bound in bounds
    ]
    return tuple(tables), tuple(int(place) for place in np.argsort(order))


def compile_circuit(circuit: Circuit, initial: dict | None = None, inputs: dict | None = None) -> tuple[Plan, Values]:
    """The static plan of a circuit and its values.

    Args: circuit; initial: name of a potential or state -> value in SI (others: atmospheric pressure, 0);
        inputs: name -> signal for the circuit's external inputs (all of them).
    Raises: ValueError for an algebraic loop of controllers or a controller that reads what
        it cannot; KeyError for an unknown initial value.
    """
    wiring = Wiring(circuit)
    groups = group_kinds(circuit, wiring)
    kinds = [plan_kind(members, wiring, circuit.fluid) for members in groups]
    free = tuple((name, wiring.nodes[name]) for name in wiring.free_names)
    packed = tuple(jax.tree.map(_stack, *(anonymous(part) for part in members.values())) for members in groups)
    signals = tuple((inputs or {})[name] for name in wiring.input_names)
    plan = Plan(tuple(kinds), free, plan_fixed(wiring, kinds), tuple(wiring.input_names))
    plan = with_sensors(circuit, plan)
    plan = plan._replace(controllers=plan_controllers(circuit, plan, wiring))
    start = initial_values(plan, circuit.fluid, initial or {})
    values = Values(circuit.fluid, packed, signals, circuit.sensors(), start)

    found = jax.eval_shape(lambda v: contributions(plan, v, 0.0, *starting_point(plan, v, 0.0)), values)
    flow, capacity = [c.flow for c in found], [c.capacity for c in found]
    plan = plan._replace(flow=_incidence(kinds, flow, len(free)), capacity=_incidence(kinds, capacity, len(free)))
    return plan, values


def initial_values(plan: Plan, fluid: Oil, given: dict) -> Initial:
    """Initial values by name; potentials not given start at atmospheric pressure and zero, states as NaN."""
    known = initial_names(plan)
    for name in given:
        if name not in known:
            raise KeyError(f"no state is called {name!r}; there are {', '.join(known)}")
    names = [f"{node}.{DOMAINS[domain].potential}" for node, domain in plan.free_nodes]
    hydraulic = np.asarray([float(domain == "hydraulic") for _, domain in plan.free_nodes])
    potentials = np.zeros(0)
    if names:
        told = _stack(*(given.get(name, 0.0) for name in names))
        rest, is_told = hydraulic * fluid.atmospheric_pressure, np.asarray([name in given for name in names])
        potentials = array_module(told, rest).where(is_told, told, rest)
    states = tuple(
        {
            s.name: _stack(*(_shaped(f"{m}.{s.name}", given.get(f"{m}.{s.name}", np.nan), s) for m in kind.members))
            for s in kind.states
        }
        for kind in plan.kinds
    )
    return Initial(potentials, states)


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
