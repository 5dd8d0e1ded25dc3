"""What sensors and controllers of a circuit read, found among its quantities."""

import numpy as np

from jaxlines.physics.component import DOMAINS
from jaxlines.physics.controllers import AbstractController, AbstractSampledController, reads_of
from jaxlines.physics.fields import External, is_concrete
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.plan import ControllerPlan, Plan, Quantity, Reading, SensorPlan
from jaxlines.simulation.quantities import quantities
from jaxlines.simulation.wiring import Kind, Wiring


def with_sensors(circuit: Circuit, plan: Plan) -> Plan:
    """The plan with its sensors, and a kind for each that has a lag. Raises ValueError for one that reads nothing."""
    known, kinds, planned = quantities(plan), list(plan.kinds), []
    for name, sensor in circuit.sensors().items():
        read, other = _read(known, name, sensor.quantity_read()), sensor.quantity_subtracted()
        subtracted = None if other is None else _read(known, name, other)
        states, reading = sensor.lag_states(sensor.unit(read.unit), _scale(plan, read)), None
        if states:
            reading = Quantity("state", len(kinds), states[0].name, (0,), states[0].unit)
            kinds.append(Kind((name,), (), (), states))
        planned.append(SensorPlan(name, read, subtracted, reading, _is_delayed(sensor)))
    return plan._replace(kinds=tuple(kinds), sensors=tuple(planned))


def _is_delayed(sensor: AbstractSensor) -> bool:
    """Whether a sensor shows the past: unless its delay is known to be zero."""
    return not is_concrete(sensor.delay) or bool(np.any(np.asarray(sensor.delay)))


def _scale(plan: Plan, place: Quantity) -> float:
    """Typical size of a quantity."""
    if place.room == "state":
        return next(s.scale for s in plan.kinds[place.kind].states if s.name == place.name)
    return next((d.scale for d in DOMAINS.values() if d.unit == place.unit), 1e-4 if place.unit == "m^3/s" else 1.0)


def _read(known: dict[str, Quantity], name: str, read: str) -> Quantity:
    """Where the quantity is that a sensor reads."""
    if read not in known:
        near = [q for q in known if q.rsplit(".", 1)[-1] == read.rsplit(".", 1)[-1]]
        raise ValueError(f"sensor {name!r} reads {read!r}, which the circuit does not have; it has {', '.join(near)}")
    return known[read]


def plan_controllers(circuit: Circuit, plan: Plan, wiring: Wiring) -> tuple[ControllerPlan, ...]:
    """The kinds of controllers, each after those that it listens to. Raises ValueError for what cannot be read."""
    planned = []
    for k, kind in enumerate(plan.kinds):
        members = {name: circuit.components[name] for name in kind.members}
        first = members[kind.members[0]]
        if isinstance(first, AbstractController):
            outputs = tuple(wiring.input_index[name] for name in members)
            fields = [(field, {n: reads_of(part)[field] for n, part in members.items()}) for field in reads_of(first)]
            readings = tuple(_reading(circuit, plan, field, names) for field, names in fields)
            planned.append(ControllerPlan(k, isinstance(first, AbstractSampledController), outputs, readings))
    return tuple(sorted(planned, key=lambda p: wiring.levels[plan.kinds[p.kind].members[0]]))


def _reading(circuit: Circuit, plan: Plan, field: str, names: dict[str, str]) -> Reading:
    """Where the members of a kind find what they read into a field; `names` by member."""
    sensors, places, through = {s.name: s for s in plan.sensors}, [], []
    for member, (owner, name) in enumerate(names.items()):
        reader, sensor = f"{owner}.{field}", sensors.get(name)
        if sensor is None:
            places.append(_readable(circuit, plan, reader, name, quantities(plan).get(name)))
            continue
        if sensor.delayed:
            raise ValueError(f"{reader} reads {name!r}, which has a delay: a controller reads what is there now")
        for place in [sensor.reading or sensor.read, sensor.subtracted]:
            if place is not None:
                _readable(circuit, plan, reader, name, place)
        places.append(sensor.reading or sensor.read)
        through.append((member, sensor))
    return Reading(field, tuple(places), tuple(through))


def _readable(circuit: Circuit, plan: Plan, reader: str, name: str, place: Quantity | None) -> Quantity:
    """A quantity that a controller may read: one that does not depend on its output at the same instant."""
    if place is None or place.room in ("port", "input"):
        known, last = quantities(plan), name.rsplit(".", 1)[-1]
        near = [q for q, p in known.items() if p.room not in ("port", "input") and q.rsplit(".", 1)[-1] == last]
        why = "which the circuit does not have" if place is None else "which depends on inputs at the same instant"
        raise ValueError(
            f"{reader} reads {name!r}, {why}: a controller reads potentials, states, and sensors that "
            f"show those or have a lag; near: {', '.join(near[:8]) or 'none'}"
        )
    if place.room == "fixed":
        node = plan.fixed_nodes[place.index[0]]
        owner = plan.kinds[node.kind].members[node.member]
        value = getattr(circuit.components[owner], node.field)
        if isinstance(value, External) and isinstance(circuit.components.get(value.name), AbstractController):
            raise ValueError(f"{reader} reads {name!r}, which the controller {value.name!r} sets at the same instant")
    return place
