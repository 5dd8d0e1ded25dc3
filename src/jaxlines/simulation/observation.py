"""What can be seen of a circuit while it runs: potentials, states, flows through ports, inputs, sensors."""

from jaxlines.physics.sensors import PressureSensor
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.quantities import pick, quantities
from jaxlines.simulation.vector_field import array_of, look, shown_by


def shown_by_default(plan: Plan) -> list[str]:
    """Potentials, states and controllers' outputs, without tables (the memory of frequency-dependent friction)."""
    sensors = {f"{sensor.name}.reading" for sensor in plan.sensors}
    return [n for n, q in quantities(plan).items() if q.room != "port" and len(q.index) < 3 and n not in sensors]


def sensor_units(circuit: Circuit, plan: Plan) -> dict[str, str]:
    """Unit of what each sensor shows."""
    sensors = circuit.sensors()
    return {sensor.name: sensors[sensor.name].unit(sensor.read.unit) for sensor in plan.sensors}


def observe(plan: Plan, values: Values, wanted: tuple[str, ...], t, potentials, states):
    """The wanted quantities and sensors at one instant, shape (wanted, [lanes]); sensors without their delays."""
    known, sensors = quantities(plan), {sensor.name: sensor for sensor in plan.sensors}
    sight = look(plan, values, t, potentials, states)
    find = array_of(sight, potentials, states, lambda k: values.kinds[k].evaluate(sight.seen[k]).flow)
    places = [sensors[name].read if name in sensors else known[name] for name in wanted]
    shown = pick(places, find)
    for i, name in enumerate(wanted):
        if name in sensors:
            shown = shown.at[i].set(shown_by(values, sensors[name], find)[0])
    return shown


def is_gauge(circuit: Circuit, name: str) -> bool:
    """Whether an output is a gauge pressure."""
    sensor = circuit.components.get(name)
    return isinstance(sensor, PressureSensor) and sensor.reference == "gauge"
