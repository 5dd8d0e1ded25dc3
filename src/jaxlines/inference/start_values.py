"""Start values taken from what a recording shows first."""

from typing import NamedTuple

import numpy as np

from jaxlines.inference.recording import Recording
from jaxlines.simulation.circuit import Circuit


class MeasuredStart(NamedTuple):
    """A start value taken from the first usable sample of a channel; gain: of the sensor that shows it."""

    name: str
    channel: str
    value: float
    gain: float


def measured_start(circuit: Circuit, recording: Recording, name: str) -> MeasuredStart | None:
    """The start value of a quantity from the channel that shows it, or from a sensor that reads it."""
    shown = {name: (0.0, 1.0)}
    for sensor_name, sensor in circuit.sensors().items():
        if sensor.quantity_read() == name and sensor.quantity_subtracted() is None:
            zero, slope = float(sensor.read(0.0, circuit.fluid)), float(sensor.slope(circuit.fluid))
            shown[sensor_name] = (zero, slope)
    for channel, (zero, slope) in shown.items():
        if channel in recording.channels and recording.mask[channel].any() and slope != 0.0:
            first = float(recording.channels[channel][np.argmax(recording.mask[channel])])
            return MeasuredStart(name, channel, (first - zero) / slope, slope)
    return None


def measured_starts(circuit: Circuit, recording: Recording, free, initial: dict) -> tuple[dict, list[MeasuredStart]]:
    """Start pressures taken from a recording, where they are neither free nor given.

    Raises: ValueError for one that is to be "measured" and that no usable channel shows.
    """
    initial, starts = dict(initial), []
    taken = {path for parameter in free for path in parameter.paths}
    for node, domain in circuit.nodes().items():
        name = f"{node}.pressure"
        wanted = initial.get(name) == "measured"
        implied = name not in initial and f"initial.{name}" not in taken
        if domain != "hydraulic" or node in circuit.fixed_nodes() or not (wanted or implied):
            continue
        start = measured_start(circuit, recording, name)
        if start is not None:
            initial[name] = start.value
            starts.append(start)
        elif wanted:
            raise ValueError(f'initial {name} cannot be "measured": the recording has no usable channel that shows it')
    return initial, starts
