"""The external inputs of a circuit as signals, checked."""

from jaxlines.physics.fields import AbstractSignal, check_range, driven_of
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.signals import Constant, Sampled, Step, as_signal

_LEVELS = {Sampled: ("values",), Constant: ("value",), Step: ("before", "after")}
"""Fields of a signal that hold values which it takes."""


def bind_inputs(circuit: Circuit, inputs: dict | None, times) -> dict[str, AbstractSignal]:
    """The external inputs of a circuit as signals, checked: all there, none too many, values in range."""
    needed, inputs = circuit.external_inputs(), dict(inputs or {})
    missing, unknown = sorted(set(needed) - set(inputs)), sorted(set(inputs) - set(needed))
    if missing:
        component, field = needed[missing[0]][0]
        raise ValueError(
            f"the circuit needs an input {missing[0]!r} (it drives {component}.{field}); "
            f"given: {sorted(inputs) or 'none'}"
        )
    if unknown:
        raise ValueError(f"the circuit has no input {unknown[0]!r}; it has {sorted(needed) or 'none'}")
    bound = {name: as_signal(value, times) for name, value in inputs.items()}
    for name, places in needed.items():
        signal = bound[name]
        for component, field in places:
            metadata = driven_of(circuit.components[component])[field]
            for level in _LEVELS.get(type(signal), ()):
                check_range(f"input {name!r} ({component}.{field})", getattr(signal, level), metadata)
    return bound
