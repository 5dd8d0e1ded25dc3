"""What a simulation says about its lines: the flows into them, and the signals that drive them."""

import jax
import numpy as np

from jaxlines.physics.component import DOMAINS, Situation
from jaxlines.physics.fields import AbstractSignal, External, driven_of, ports_of
from jaxlines.physics.lines import Line
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.signals import Sampled
from jaxlines.simulation.validity import lines_to_check
from jaxlines.simulation.wave_validity import wave_lines


def _values(signal: AbstractSignal, times) -> np.ndarray:
    """A signal at many times, as one compiled program."""
    return np.asarray(jax.jit(jax.vmap(signal))(times))


def _seen_by(name: str, part, fluid, times, outputs, inputs) -> Situation:
    """What a component saw at the saved times. Raises ValueError when something of it was not saved."""
    potentials = {p: f"{getattr(part, p)}.{DOMAINS[d].potential}" for p, d in ports_of(part).items()}
    states = {state.name: f"{name}.{state.name}" for state in part.states_in(fluid)}
    given = {field: getattr(part, field) for field in driven_of(part)}
    followed = {f: v.name for f, v in given.items() if isinstance(v, External) and v.name not in inputs}
    followed = {field: f"{controller}.output" for field, controller in followed.items()}
    missing = [q for q in (*potentials.values(), *states.values(), *followed.values()) if q not in outputs]
    if missing:
        raise ValueError(
            f"the validity check needs {', '.join(missing)}, which was not saved: "
            "simulate without `outputs`, or name it there"
        )
    for field, value in given.items():
        if field in followed:
            given[field] = np.asarray(outputs[followed[field]])
        elif isinstance(value, AbstractSignal):
            given[field] = _values(inputs[value.name] if isinstance(value, External) else value, times)
    at_ports = {p: np.asarray(outputs[q]) for p, q in potentials.items()}
    return Situation(fluid, at_ports, {s: np.asarray(outputs[q]) for s, q in states.items()}, given)


def line_flows(circuit: Circuit, times, outputs, inputs) -> dict[str, np.ndarray]:
    """For each lumped line to check the sum of the volume flows into its node at the saved times [m^3/s].

    Inlets only, so that fluid on its way through counts once; lines that share a node get the same flow. For each
    segmented line the flows along it, shape (columns, times).
    """
    nodes = {line.node for line in lines_to_check(circuit).values()}
    inflow = dict.fromkeys(nodes, np.zeros(len(times)))
    for name, part in circuit.parts().items():
        attached = {p: getattr(part, p) for p in ports_of(part) if getattr(part, p) in nodes}
        if isinstance(part, Line):
            if part.to is not None:
                _add_wave_line(inflow, name, part, outputs)
            continue
        if not attached:
            continue
        at = _seen_by(name, part, circuit.fluid, times, outputs, inputs)
        mass = part.evaluate(at).flow
        for port, node in attached.items():
            density = circuit.fluid.density_at(at.potential[port])
            inflow[node] = inflow[node] + np.maximum(np.asarray(mass.get(port, 0.0)) / density, 0.0)
    flows = {name: inflow[line.node] for name, line in lines_to_check(circuit).items()}
    return flows | {name: column_flows(name, line, outputs) for name, line in wave_lines(circuit).items()}


def column_flows(name: str, line: Line, outputs) -> np.ndarray:
    """Volume flows along a segmented line at the saved times [m^3/s], shape (columns, times)."""
    columns = line.ladder().cut.columns.size
    missing = [i for i in range(columns) if f"{name}.volume_flow.{i}" not in outputs]
    if missing:
        raise ValueError(
            f"the validity check needs {name}.volume_flow.{missing[0]}, which was not saved: "
            "simulate without `outputs`, or name it there"
        )
    return np.stack([np.asarray(outputs[f"{name}.volume_flow.{i}"]) for i in range(columns)])


def _add_wave_line(inflow: dict, name: str, line: Line, outputs) -> None:
    """Add what a segmented line feeds into the nodes at its ends, which its flows say."""
    flows = column_flows(name, line, outputs)
    for node, feed in ((line.node, -flows[0]), (line.to, flows[-1])):
        if node in inflow:
            inflow[node] = inflow[node] + np.maximum(feed, 0.0)


def signal_records(circuit: Circuit, times, inputs) -> dict[str, tuple]:
    """Every signal that drives the circuit, as (times, values) within the simulated time."""
    signals: dict[str, AbstractSignal] = dict(inputs)
    for name, part in circuit.parts().items():
        values = {f"{name}.{field}": getattr(part, field) for field in driven_of(part)}
        signals |= {k: v for k, v in values.items() if isinstance(v, AbstractSignal) and not isinstance(v, External)}
    grid, records = np.linspace(times[0], times[-1], 8192), {}
    for name, signal in signals.items():
        if isinstance(signal, Sampled):
            shown = signal.times + signal.delay
            keep = (shown >= times[0]) & (shown <= times[-1])
            records[name] = (shown[keep], signal.values[keep])
        else:
            records[name] = (grid, _values(signal, grid))
    return records
