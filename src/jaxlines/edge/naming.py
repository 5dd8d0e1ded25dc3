"""What the circuit of a study can be asked for and given, by name and with units."""

import contextlib
from typing import NamedTuple

import numpy as np

from jaxlines.edge.building import StudyError, suggest
from jaxlines.physics.fields import driven_of
from jaxlines.simulation.assembly import compile_circuit, number_locations
from jaxlines.simulation.circuit import Circuit, field_metadata
from jaxlines.simulation.observation import quantities, sensor_units, shown_by_default
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.plan import initial_names
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.segments import FEWEST, undecided_lines, with_segments
from jaxlines.simulation.signals import Constant

OF_RECORDED = ("gain", "offset", "delay")
"""Numbers of a recorded input that a fit can free."""


class Names(NamedTuple):
    """Outputs, inputs and initial values: name -> metadata; observed: outputs that every simulation keeps.

    numbers: the paths of all numbers that a fit can free.
    """

    outputs: dict[str, dict]
    inputs: dict[str, dict]
    initial: dict[str, dict]
    observed: tuple[str, ...]
    numbers: tuple[str, ...]


@contextlib.contextmanager
def at(place: str):
    """Errors inside become a StudyError that names the place."""
    try:
        yield
    except (ValueError, TypeError, KeyError, OSError) as error:
        text = str(error.args[0]) if isinstance(error, KeyError) else str(error)
        raise StudyError(f"{place}: {text}" if place else text) from error


def names_of(circuit: Circuit) -> Names:
    """The names of a circuit. Raises ValueError for one that cannot be simulated."""
    inputs = {
        name: driven_of(circuit.components[places[0][0]])[places[0][1]]
        for name, places in circuit.external_inputs().items()
    }
    with computing_in("float64"):
        # The names of a line do not depend on how many segments it will have.
        settled = with_segments(circuit, dict.fromkeys(undecided_lines(circuit), FEWEST))
        plan, values = compile_circuit(settled, None, {name: Constant(np.asarray(0.0)) for name in inputs})
        known, sensors = quantities(plan), sensor_units(circuit, plan)
        numbers = (*number_locations(plan, values), *(f"{name}.{word}" for name in inputs for word in OF_RECORDED))
    units = {name: q.unit for name, q in known.items()} | sensors
    outputs = {name: {"unit": unit, "level": unit == "Pa"} for name, unit in units.items()}
    observed = shown_by_default(plan)
    initial = {name: {"unit": unit, "level": unit == "Pa"} for name, unit in initial_names(plan).items()}
    return Names(outputs, inputs, initial, (*observed, *sensors), numbers)


def look_up(name: str, known: dict[str, dict], where: str, what: str) -> dict:
    """The metadata of a name. Raises StudyError that suggests near names."""
    if name not in known:
        raise StudyError(f"{where}: no {what} is called {name!r}, {suggest(name, known)}")
    return known[name]


def path_metadata(circuit: Circuit, names: Names, path: str, where: str) -> dict:
    """Unit of the number at a path, and whether it is a pressure level (an amplitude is a difference)."""
    if path.startswith("initial."):
        name = path.removeprefix("initial.")
        source = circuit.fixed_nodes().get(name.removesuffix(".pressure"))
        if source is not None:
            raise StudyError(f"{where}: {name!r} is given by {source[0]!r}, so that it has no initial value")
        return look_up(name, names.initial, where, "initial value")
    owner, _, word = path.partition(".")
    if owner in names.inputs and owner not in circuit.components and word in OF_RECORDED:
        return {"gain": {"unit": "1"}, "delay": {"unit": "s"}}.get(word, {**names.inputs[owner], "level": False})
    with at(where):
        full = resolve(path, circuit.paths())
    metadata = field_metadata(circuit, full)
    if not metadata:
        raise StudyError(f"{where}: {path!r} has no declared unit, so that it cannot be free or uncertain")
    return {**metadata, "level": metadata.get("level") and not full.endswith(".amplitude")}
