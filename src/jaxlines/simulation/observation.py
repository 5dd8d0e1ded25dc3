"""What can be seen of a circuit while it runs: potentials, states, flows through ports, sensors."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxlines.physics.component import DOMAINS
from jaxlines.physics.sensors import PressureSensor
from jaxlines.simulation.assembly import Plan, Values, fixed_potentials, situations
from jaxlines.simulation.circuit import Circuit


class Quantity(NamedTuple):
    """Where a quantity is found: room ("free", "fixed", "state", "port"), kind, name in it, member; its unit."""

    room: str
    kind: int
    name: str
    index: int
    unit: str


def quantities(plan: Plan) -> dict[str, Quantity]:
    """Every quantity of a circuit by name, such as "A.pressure", "valve.spool" or "leak.a.flow"."""
    known = {}
    for index, (node, domain) in enumerate(plan.free_nodes):
        known[f"{node}.{DOMAINS[domain].potential}"] = Quantity("free", -1, "", index, DOMAINS[domain].unit)
    for index, node in enumerate(plan.fixed_nodes):
        name = f"{node.name}.{DOMAINS[node.domain].potential}"
        known[name] = Quantity("fixed", -1, "", index, DOMAINS[node.domain].unit)
    for k, kind in enumerate(plan.kinds):
        for index, member in enumerate(kind.members):
            for state in kind.states:
                known[f"{member}.{state.name}"] = Quantity("state", k, state.name, index, state.unit)
            for port in kind.ports:
                domain = DOMAINS[port.domain]
                known[f"{member}.{port.name}.{domain.flow}"] = Quantity("port", k, port.name, index, domain.flow_unit)
    return known


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


def observe(plan: Plan, values: Values, wanted: tuple[str, ...], t, potentials, states):
    """The wanted quantities and sensors at one instant, shape (wanted, [lanes])."""
    known, seen, shown = quantities(plan), situations(plan, values, t, potentials, states), []
    signals = jnp.stack([jnp.asarray(s(t)) for s in values.signals]) if values.signals else jnp.zeros(0)
    fixed = fixed_potentials(plan, values, signals)
    for name in wanted:
        sensor = values.sensors.get(name)
        where = known[sensor.quantity_read() if sensor else name]
        if where.room == "port":
            port = next(p for p in plan.kinds[where.kind].ports if p.name == where.name)
            value = _port_flow(values.kinds[where.kind], seen[where.kind], port)[where.index]
        else:
            room = {"free": potentials, "fixed": fixed}.get(where.room)
            value = (states[where.kind][where.name] if room is None else room)[where.index]
        shown.append(sensor.read(value, values.fluid) if sensor else value)
    return jnp.stack(shown)


def is_gauge(circuit: Circuit, name: str) -> bool:
    """Whether an output is a gauge pressure."""
    sensor = circuit.components.get(name)
    return isinstance(sensor, PressureSensor) and sensor.reference == "gauge"
