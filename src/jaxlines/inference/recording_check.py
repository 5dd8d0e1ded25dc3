"""A recording beside a simulation of its circuit, before any fit: what is wrong with it?"""

import numpy as np

from jaxlines.inference.problem import conditioned, recorded_inputs
from jaxlines.inference.recording import Recording
from jaxlines.inference.recording_faults import Fault, find_faults
from jaxlines.inference.start_values import measured_starts
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.simulate import simulate


def check_recording(
    circuit: Circuit,
    recording: Recording,
    *,
    initial: dict | str | None = None,
    interpolation: str = "linear",
    solver=None,
    tolerance: float = 1e-6,
) -> tuple[Fault, ...]:
    """What looks wrong with a recording: swapped units, dead or stuck channels, jumps and uneven steps of time.

    The circuit, with its present numbers, is simulated with the recorded inputs; its numbers need not be right, but
    should be within a factor of two. A start value that the recording gives is taken from it, as in a fit, which
    hides a wrong zero but not a wrong unit of what moves.

    Args: circuit; recording; initial, interpolation, solver, tolerance: as in `fit`.
    Returns: the faults, each with its kind, channel, gravity and a text that says what to do; empty when there is none.
    Raises: ValueError or KeyError for a recording that does not belong to the circuit.
    """
    own, start = conditioned(circuit, recording, initial)
    if isinstance(start, dict):
        start, _ = measured_starts(own, recording, (), start)
    inputs = recorded_inputs(own, recording, interpolation)
    outputs = [name for name in recording.channels if name not in inputs]
    found = simulate(
        own, recording.times, inputs, initial=start, outputs=outputs, solver=solver, tolerance=tolerance, throw=False
    )
    shown = {name: np.asarray(found[name]) for name in outputs}
    return tuple(find_faults(recording, shown, {name: found.units[name] for name in outputs}))
