"""What a fit needs, from the tables [recording] and [fit] of a study: recording, noise, parameters, and checks."""

import dataclasses
from pathlib import Path

import numpy as np

from jaxlines.edge.building import Builder, StudyError
from jaxlines.edge.naming import Names, at, look_up, path_metadata
from jaxlines.edge.reading import MIN_SAMPLES, read_recording
from jaxlines.edge.tables import FitTable, RecordingTable
from jaxlines.inference.curves import check_derived
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.problem import check_parameters, recorded_inputs
from jaxlines.inference.recording import Recording
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.observation import is_gauge


def study_recording(table: RecordingTable, folder: Path, circuit: Circuit, names: Names, builder: Builder) -> Recording:
    """The recording of a study; the pressures of gauge sensors are gauge again."""
    known, where, atmosphere = {**names.outputs, **names.inputs}, "recording.channels", builder.atmospheric_pressure
    units = {channel: look_up(channel, known, where, "output or input")["unit"] for channel in table.channels}
    with at("recording"):
        recording = read_recording(
            folder / table.file, time=table.time, channels=table.channels, atmospheric_pressure=atmosphere, units=units
        )
    channels = {
        name: values - atmosphere if is_gauge(circuit, name) else values for name, values in recording.channels.items()
    }
    recording = dataclasses.replace(recording, channels=channels)
    if table.window is None:
        return recording
    start, stop = (builder.number(end, {"unit": "s"}, "recording.window") for end in table.window)
    return _window(recording, start, stop)


def _window(recording: Recording, start: float, stop: float) -> Recording:
    """A piece of a recording [s]. Raises StudyError when too little of it is left."""
    piece = (recording.times >= start) & (recording.times <= stop)
    if piece.sum() < MIN_SAMPLES:
        span = f"{recording.times[0]:g} s to {recording.times[-1]:g} s"
        raise StudyError(
            f"recording.window: {piece.sum()} samples lie between {start:g} s and {stop:g} s, which is less than "
            f"{MIN_SAMPLES}; the recording goes from {span}"
        )
    return recording.window(start, stop)


def study_noise(given: dict, names: Names, builder: Builder) -> dict[str, float]:
    """Standard deviations of the noise in SI."""
    noise = {}
    for name, value in given.items():
        metadata = {**look_up(name, names.outputs, "recording.noise", "output"), "level": False}
        noise[name] = builder.number(value, metadata, f"recording.noise.{name}")
    return noise


def _first_guess(path: str, bounds, circuit: Circuit, initial: dict) -> float | None:
    """The number of the file, from which a fit starts; None where it is not inside the bounds."""
    owner, _, name = path.partition(".")
    guess = initial.get(name) if owner == "initial" else circuit[path]
    if guess is None or isinstance(guess, str) or np.ndim(guess) > 0:
        return None
    return float(guess) if bounds[0] < guess < bounds[1] else None


def study_parameters(table: FitTable, circuit: Circuit, names: Names, initial: dict, builder: Builder):
    """Free and known parameters in SI."""
    free, known = [], []
    for i, entry in enumerate(table.free):
        where = f"fit.free.{i}"
        metadata = [path_metadata(circuit, names, path, where) for path in entry.path]
        if len({m["unit"] for m in metadata}) > 1:
            raise StudyError(f"{where}: {', '.join(entry.path)} have different units: they cannot share a value")
        low, high = (builder.number(bound, metadata[0], f"{where}.bounds") for bound in entry.bounds)
        start = _first_guess(entry.path[0], (low, high), circuit, initial)
        if entry.start is not None:
            start = builder.number(entry.start, metadata[0], f"{where}.start")
        path = entry.path[0] if len(entry.path) == 1 else tuple(entry.path)
        unit = metadata[0]["unit"]
        with at(where if unit == "1" else f"{where} (numbers in {unit})"):
            free.append(Free(path, (low, high), start, entry.transform, entry.name))
    for i, entry in enumerate(table.known):
        where = f"fit.known.{i}"
        metadata = {**path_metadata(circuit, names, entry.path, where), "level": False}
        sd = builder.number(entry.sd, metadata, f"{where}.sd")
        with at(where):
            known.append(Known(entry.path, sd))
    with at("fit"):
        check_parameters(circuit, free, known, names.numbers)
    return tuple(free), tuple(known)


def check_fit(circuit: Circuit, recording: Recording | None, names: Names, derived: list[str]) -> None:
    """Raise StudyError for what would stop a fit."""
    with at("fit.derived"):
        for name in derived:
            check_derived(circuit, name)
    if recording is None:
        return
    with at("recording"):
        recorded_inputs(circuit, recording, "linear")
    for name, values in recording.channels.items():
        if name in names.outputs and np.ptp(values[recording.mask[name]]) == 0.0:
            raise StudyError(
                f"recording.channels: {name!r} is constant, so that nothing can be fitted to it: is the channel dead? "
                "Name another column or leave it out"
            )
