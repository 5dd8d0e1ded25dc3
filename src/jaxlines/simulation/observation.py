"""What can be seen of a circuit while it runs: potentials, states, flows through ports, sensors."""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS
from jaxlines.physics.sensors import PressureSensor
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.vector_field import fixed_potentials, situations


class Quantity(NamedTuple):
    """Where a quantity is found: room ("free", "fixed", "state", "port"), kind, name in it, its index; its unit.

    The index has the own axes of a state first and the member of the kind last.
    """

    room: str
    kind: int
    name: str
    index: tuple[int, ...]
    unit: str


def quantities(plan: Plan) -> dict[str, Quantity]:
    """Every quantity of a circuit by name, such as "A.pressure", "valve.spool", "leak.a.flow" or "line.pressure.3"."""
    known = {}
    for index, (node, domain) in enumerate(plan.free_nodes):
        known[f"{node}.{DOMAINS[domain].potential}"] = Quantity("free", -1, "", (index,), DOMAINS[domain].unit)
    for index, node in enumerate(plan.fixed_nodes):
        name = f"{node.name}.{DOMAINS[node.domain].potential}"
        known[name] = Quantity("fixed", -1, "", (index,), DOMAINS[node.domain].unit)
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


def shown_by_default(plan: Plan) -> list[str]:
    """Potentials and states, without those that are tables (the memory of frequency-dependent friction)."""
    return [n for n, q in quantities(plan).items() if q.room != "port" and len(q.index) < 3]


def sensor_units(circuit: Circuit, plan: Plan) -> dict[str, str]:
    """Unit of what each sensor shows. Raises ValueError for a sensor that reads nothing that exists."""
    known, units = quantities(plan), {}
    for name, sensor in circuit.sensors().items():
        read = sensor.quantity_read()
        if read not in known:
            near = [q for q in known if q.rsplit(".", 1)[-1] == read.rsplit(".", 1)[-1]]
            raise ValueError(
                f"sensor {name!r} reads {read!r}, which the circuit does not have; it has {', '.join(near)}"
            )
        units[name] = known[read].unit
    return units


def _port_flow(packed, at, port):
    """Flow into the component at a port: volume flow at the port's density, torque or force."""
    flow = packed.evaluate(at).flow.get(port.name)
    if flow is None:
        return 0.0 * at.potential[port.name]
    return -flow / at.fluid.density_at(at.potential[port.name]) if port.domain == "hydraulic" else -flow


def _room(plan: Plan, values: Values, where: Quantity, seen, fixed, potentials, states):
    """The array that holds a quantity, its index last but for lanes."""
    if where.room == "port":
        port = next(p for p in plan.kinds[where.kind].ports if p.name == where.name)
        return _port_flow(values.kinds[where.kind], seen[where.kind], port)
    if where.room == "state":
        return states[where.kind][where.name]
    return potentials if where.room == "free" else fixed


def observe(plan: Plan, values: Values, wanted: tuple[str, ...], t, potentials, states):
    """The wanted quantities and sensors at one instant, shape (wanted, [lanes])."""
    known, seen = quantities(plan), situations(plan, values, t, potentials, states)
    signals = jnp.stack([jnp.asarray(s(t)) for s in values.signals]) if values.signals else jnp.zeros(0)
    fixed = fixed_potentials(plan, values, signals)
    sensors = {i: values.sensors[name] for i, name in enumerate(wanted) if name in values.sensors}
    places = [known[sensors[i].quantity_read() if i in sensors else name] for i, name in enumerate(wanted)]
    # One gather from all rooms together: a wave line has hundreds of quantities, and a slice each compiles slowly.
    rooms, flat, at, size = {}, [], [], 0
    for where in places:
        room = (where.room, where.kind, where.name)
        if room not in rooms:
            array = jnp.asarray(_room(plan, values, where, seen, fixed, potentials, states))
            own = array.shape[: len(where.index)]
            flat.append(array.reshape(-1, *array.shape[len(own) :]))
            rooms[room], size = (size, own), size + math.prod(own)
        offset, own = rooms[room]
        at.append(offset + int(np.ravel_multi_index(where.index, own)))
    shown = jnp.concatenate(flat)[np.asarray(at)]
    for i, sensor in sensors.items():
        shown = shown.at[i].set(sensor.read(shown[i], values.fluid))
    return shown


def is_gauge(circuit: Circuit, name: str) -> bool:
    """Whether an output is a gauge pressure."""
    sensor = circuit.components.get(name)
    return isinstance(sensor, PressureSensor) and sensor.reference == "gauge"
