"""What a fit needs, from the tables [recording] and [fit] of a study: recording, noise, parameters, and checks."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.building import Builder, StudyError
from jaxlines.edge.experiment_tables import ConditionRow, read_conditions
from jaxlines.edge.naming import Names, at, look_up, path_metadata
from jaxlines.edge.reading import MIN_SAMPLES, read_recording
from jaxlines.edge.tables import FitTable, FreeTable, RecordingTable
from jaxlines.inference.curves import check_derived
from jaxlines.inference.distributions import LogNormal, LogUniform, Normal, Truncated, Uniform
from jaxlines.inference.input_noise import InputNoise
from jaxlines.inference.noise import Noise
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.priors import Prior
from jaxlines.inference.problem import check_parameters, recorded_inputs
from jaxlines.inference.recording import Recording
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.observation import is_gauge


def study_recordings(
    table: RecordingTable, folder: Path, circuit: Circuit, names: Names, builder: Builder
) -> tuple[Recording, ...]:
    """The recordings of a study under their conditions; the pressures of gauge sensors are gauge again."""
    rows = _rows(table, folder, circuit, builder)
    return tuple(_recording(table, row, circuit, names, builder) for row in rows)


def _rows(table: RecordingTable, folder: Path, circuit: Circuit, builder: Builder) -> list[ConditionRow]:
    """Name, file and conditions of every recording."""
    files = [folder / name for name in ([table.file] if table.file else table.files)]
    if table.file and table.files:
        raise StudyError("recording: give `file` or `files`, not both")
    if not table.conditions:
        if not files:
            raise StudyError("recording: 'file' is missing")
        return [ConditionRow(path.name, path, {}) for path in files]
    with at("recording.conditions"):
        rows = read_conditions(folder / table.conditions, atmospheric_pressure=builder.atmospheric_pressure)
    if files and len(files) != len(rows):
        raise StudyError(f"recording: {len(files)} files for {len(rows)} rows of {table.conditions}")
    rows = [row._replace(file=path) for row, path in zip(rows, files, strict=True)] if files else rows
    for row in rows:
        if row.file is None:
            raise StudyError(
                f"recording.conditions: {table.conditions}: {row.name!r} names no file: add a column `file`"
            )
        with at(f"recording.conditions: {row.name}"):
            circuit.replace({path: v for path, v in row.conditions.items() if not path.startswith("initial.")})
    return rows


def _recording(table: RecordingTable, row: ConditionRow, circuit: Circuit, names: Names, builder: Builder) -> Recording:
    """One recording of a study."""
    known, where, atmosphere = {**names.outputs, **names.inputs}, "recording.channels", builder.atmospheric_pressure
    units = {channel: look_up(channel, known, where, "output or input")["unit"] for channel in table.channels}
    with at("recording"):
        assert row.file is not None
        recording = read_recording(
            row.file, time=table.time, channels=table.channels, atmospheric_pressure=atmosphere, units=units
        )
    channels = {
        name: values - atmosphere if is_gauge(circuit, name) else values for name, values in recording.channels.items()
    }
    recording = dataclasses.replace(recording, channels=channels, name=row.name, conditions=row.conditions)
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


ESTIMATED = "estimated"


def _parts(given: dict, parts: tuple[str, ...]) -> dict[str, dict]:
    """Flat keys "A.pressure.relative" as name -> part -> value; a bare name gives its first part."""
    found: dict[str, dict] = {}
    for key, value in given.items():
        name, _, part = key.rpartition(".")
        name, part = (name, part) if part in parts and name else (key, parts[0])
        found.setdefault(name, {})[part] = value
    return found


def study_noise(given: dict, names: Names, builder: Builder, table: str = "recording.noise") -> dict[str, Any]:
    """Noise of channels in SI: a number, or a `Noise` where part of it is relative or estimated; table: of the file."""
    noise: dict[str, Any] = {}
    for name, parts in _parts(given, ("absolute", "relative")).items():
        where = f"{table}.{name}"
        metadata = {**look_up(name, names.outputs, table, "output"), "level": False}
        units = {"absolute": metadata, "relative": {"unit": "1"}}
        levels = {
            part: None if value == ESTIMATED else builder.number(value, units[part], where)
            for part, value in parts.items()
        }
        with at(where):
            plain = set(levels) == {"absolute"} and levels["absolute"] is not None
            noise[name] = levels["absolute"] if plain else Noise(**levels)
    return noise


def study_input_noise(given: dict, names: Names, builder: Builder) -> dict[str, InputNoise]:
    """Noise of recorded inputs in SI."""
    noise = {}
    for name, parts in _parts(given, ("white", "gain", "offset")).items():
        where = f"fit.input_noise.{name}"
        metadata = {**look_up(name, names.inputs, "fit.input_noise", "input"), "level": False}
        units = {"white": metadata, "gain": {"unit": "1"}, "offset": metadata}
        with at(where):
            noise[name] = InputNoise(**{part: builder.number(v, units[part], where) for part, v in parts.items()})
    return noise


_PRIORS: dict[str, tuple[type, tuple[str, ...]]] = {
    "normal": (Normal, ("mean", "sd")),
    "log_normal": (LogNormal, ("median", "spread")),
    "uniform": (Uniform, ("low", "high")),
    "log_uniform": (LogUniform, ("low", "high")),
}


def _prior(table: dict, metadata: dict, builder: Builder, where: str) -> Prior | None:
    """A prior from its table, such as { normal = { mean = "1.4 GPa", sd = "0.1 GPa" } }."""
    if not table:
        return None
    kinds = [key for key in table if key not in ("low", "high")]
    if len(kinds) != 1 or kinds[0] not in _PRIORS or not isinstance(table[kinds[0]], dict):
        found = kinds[0] if kinds else "nothing"
        raise StudyError(f"{where}: expected one of {', '.join(_PRIORS)} with its numbers, got {found!r}")
    kind, fields = _PRIORS[kinds[0]]
    numbers = table[kinds[0]]
    if set(numbers) != set(fields):
        raise StudyError(f"{where}.{kinds[0]}: it needs {' and '.join(fields)}, got {', '.join(numbers) or 'nothing'}")
    units = {"sd": {**metadata, "level": False}, "spread": {"unit": "1"}}
    given = {key: builder.number(v, units.get(key, metadata), f"{where}.{key}") for key, v in numbers.items()}
    ends = {key: builder.number(table[key], metadata, f"{where}.{key}") for key in ("low", "high") if key in table}
    with at(where):
        distribution = kind(**given)
        return Prior(Truncated(distribution, **ends) if ends else distribution)


def _first_guess(path: str, bounds, circuit: Circuit, initial: dict) -> float | None:
    """The number of the file, from which a fit starts; None where it is not inside the bounds."""
    owner, _, name = path.partition(".")
    if owner not in ("initial", "fluid", *circuit.components):
        return None  # of a recorded input
    guess = initial.get(name) if owner == "initial" else circuit[path]
    if guess is None or isinstance(guess, str) or np.ndim(guess) > 0:
        return None
    return float(guess) if bounds[0] < guess < bounds[1] else None


def _more(entry: FreeTable, metadata: dict, builder: Builder, where: str) -> dict[str, Any]:
    """Ratios, prior and whether local."""
    ratios = None if entry.ratios is None else tuple(entry.ratios)
    return {
        "ratios": ratios,
        "local": entry.local,
        "prior": _prior(entry.prior, metadata, builder, f"{where}.prior"),
    }


def study_fit_options(table: FitTable, names: Names, builder: Builder) -> dict[str, Any]:
    """Further arguments of `fit`; those that were not given are left to it."""
    options = table.model_dump(include={"derived", "starts", "seed"})
    options |= table.model_dump(include={"sampling", "windows", "loss", "loss_scale", "check"}, exclude_defaults=True)
    noise = study_input_noise(table.input_noise, names, builder)
    return options | ({"input_noise": noise} if noise else {})


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
        more = _more(entry, metadata[0], builder, where)
        with at(where if unit == "1" else f"{where} (numbers in {unit})"):
            free.append(Free(path, (low, high), start, entry.transform, entry.name, **more))
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
