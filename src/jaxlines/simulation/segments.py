"""How many segments a wave line needs: from its wave speed and the highest frequency that drives the circuit."""

import dataclasses
import math
import warnings
from collections.abc import Iterable

import numpy as np

from jaxlines.physics.fields import AbstractSignal, External
from jaxlines.physics.lines import Line
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.line_records import signal_records
from jaxlines.simulation.precision import computing_in, is_traced
from jaxlines.simulation.validity import spectral_edge

PER_WAVELENGTH = 20.0
"""Segments per wavelength: waves of the highest frequency run 0.41 % too slow."""

FEWEST, MOST = 8, 200
# Eight segments put the line's own first resonance within 0.16 %, whatever drives it.


def undecided_lines(circuit: Circuit) -> dict[str, Line]:
    """The lines between two nodes whose number of segments is "auto", by name."""
    lines = {name: part for name, part in circuit.parts().items() if isinstance(part, Line)}
    return {name: line for name, line in lines.items() if line.to is not None and line.segments == "auto"}


def choose_segments(
    circuit: Circuit,
    times,
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    highest_frequency: float | None = None,
    per_wavelength: float = PER_WAVELENGTH,
    variants: Iterable[tuple[Circuit, dict]] = (),
) -> Circuit:
    """The circuit with a number in place of every `segments="auto"`: N = per_wavelength f L/c, 8 to 200.

    Args:
        circuit; times [s] and inputs as for `simulate`; initial: start values, for the pressures at the ends.
        highest_frequency: f that must be right [Hz]; by default the frequency below which 99 % of the power of
            every input lies. A step has content without end: give f where one matters.
        per_wavelength: segments per wavelength at f; 20 makes waves 0.41 % too slow.
        variants: (circuit, initial) pairs with other numbers; the slowest waves of all of them count.
    Raises: ValueError when the numbers are traced by JAX. Warns when 200 segments are not enough.
    """
    undecided = undecided_lines(circuit)
    if not undecided:
        return circuit
    if is_traced(circuit, inputs, initial):
        raise ValueError(
            f'segments="auto" of {next(iter(undecided))!r} cannot be chosen while JAX traces the circuit: '
            "call circuit = jaxlines.choose_segments(circuit, times, inputs) first, outside"
        )
    if highest_frequency is None:
        with computing_in("float64"):
            records = signal_records(circuit, np.asarray(times, dtype=float), inputs or {})
        highest_frequency = max((spectral_edge(*record) for record in records.values()), default=0.0)
    chosen = {}
    for name in undecided:
        cases = [(circuit, initial or {}), *variants]
        trip = max(_travel_time(c, name, start, inputs or {}, times) for c, start in cases)
        needed = math.ceil(per_wavelength * highest_frequency * trip)
        if needed > MOST:
            warnings.warn(
                f"{name}: {needed} segments would be needed for {highest_frequency:.3g} Hz (a wave takes {trip:.3g} s "
                f"from end to end at its slowest), {MOST} are used: give segments, or a lower highest_frequency",
                stacklevel=3,
            )
        chosen[name] = min(max(needed, FEWEST), MOST)
    return with_segments(circuit, chosen)


def with_segments(circuit: Circuit, segments: dict[str, int]) -> Circuit:
    """A copy of a circuit in which some lines have another number of segments."""
    parts = dict(circuit.components)
    for name, number in segments.items():
        parts[name] = dataclasses.replace(parts[name], segments=number)  # pyright: ignore[reportCallIssue]
    return Circuit(circuit.fluid, parts)


def _travel_time(circuit: Circuit, name: str, initial: dict, inputs: dict, times) -> float:
    """Time of a wave from end to end at the lower start pressure of the two ends [s]."""
    line = circuit.components[name]
    assert isinstance(line, Line) and line.to is not None
    pressure = min(_start_pressure(circuit, node, initial, inputs, times) for node in (line.node, line.to))
    return 0.5 * float(line.round_trip_time(circuit.fluid, pressure))


def _start_pressure(circuit: Circuit, node: str, initial: dict, inputs: dict, times) -> float:
    """The pressure at which a node starts [Pa]."""
    if node not in circuit.fixed_nodes():
        return float(initial.get(f"{node}.pressure", circuit.fluid.atmospheric_pressure))
    owner, field = circuit.fixed_nodes()[node]
    value = getattr(circuit.components[owner], field)
    if isinstance(value, External):  # a controller's output is known only once the circuit runs
        value = inputs.get(value.name, circuit.fluid.atmospheric_pressure)
    if isinstance(value, AbstractSignal):
        with computing_in("float64"):
            value = value(np.asarray(times, dtype=float)[0])
    return float(np.asarray(value))
