"""Several recordings in two tables: conditions, one row a recording, and measurements, one row a sample.

In the spirit of PEtab (Schmiester and others, "PEtab - Interoperable specification of parameter estimation problems in
systems biology", PLoS Comput. Biol. 17, 2021), with units: conditions say theirs in the headings, "line.length [m]";
measurements in a column `unit`. CSV with commas, or tabs where the file is called .tsv.
"""

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxlines.edge.naming import names_of
from jaxlines.edge.reading import column_and_unit, read_recording
from jaxlines.edge.units import base_unit, conversion, is_pressure
from jaxlines.edge.writing import write_whole
from jaxlines.inference.problem import number_metadata
from jaxlines.inference.recording import Recording
from jaxlines.physics.fields import ATMOSPHERE
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.observation import is_gauge
from jaxlines.simulation.paths import resolve

NAME, FILE = "name", "file"
_MEASUREMENTS = ("recording", "channel", "unit", "time [s]", "value")
NOISE = "noise"


class ConditionRow(NamedTuple):
    """A recording in a table of conditions: its name, its file (None without one), path -> value in SI."""

    name: str
    file: Path | None
    conditions: dict[str, float]


def _separator(path: Path) -> str:
    return "\t" if path.suffix.lower() == ".tsv" else ","


def _read_table(path: Path, needed: Sequence[str]):
    """A table as texts. Raises FileNotFoundError, or ValueError for a column that is missing."""
    import pandas

    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    table = pandas.read_csv(path, sep=_separator(path), dtype=str, keep_default_na=False, skipinitialspace=True)
    table.columns = [str(column).strip() for column in table.columns]
    for column in needed:
        if column not in table.columns:
            raise ValueError(f"{path}: no column {column!r}; the file has {', '.join(map(repr, table.columns))}")
    return table


def _number(text: str, where: str) -> float:
    """A number from a cell. Raises ValueError that says where."""
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"{where}: {text!r} is no number (decimals take a point; the unit stands apart)") from error


def _converter(unit: str, where: str, atmospheric_pressure: float):
    """Factor and offset that take numbers of a unit to SI, and the SI unit; pressures are levels or differences."""
    try:
        target = base_unit(unit)
        factor, offset = conversion(
            unit,
            target,
            level=is_pressure(unit) and unit.endswith(("_a", "_g")),
            atmospheric_pressure=atmospheric_pressure,
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return factor, offset, target


def read_conditions(path, *, atmospheric_pressure: float = ATMOSPHERE) -> list[ConditionRow]:
    """Read a table of conditions: a column `name`, perhaps `file`, and a column a number, such as "line.length [m]".

    Args: path: files in it are relative to its folder; atmospheric_pressure: zero of gauge pressures [Pa].
    Returns: the rows, values in SI; an empty cell is no condition.
    Raises: FileNotFoundError; ValueError that names file, row and remedy.
    """
    path = Path(path)
    table, rows = _read_table(path, [NAME]), []
    specs = {column: column_and_unit(column, str(path)) for column in table.columns if column not in (NAME, FILE)}
    units = {c: _converter(spec.unit, f"{path}: column {c!r}", atmospheric_pressure) for c, spec in specs.items()}
    for number, cells in enumerate(table.to_dict("records"), start=1):
        name, conditions = str(cells[NAME]).strip(), {}
        if not name:
            raise ValueError(f"{path}: row {number} has no name")
        for column in specs:
            text, (factor, offset, _) = str(cells[column]).strip(), units[column]
            if text:
                condition = column.rpartition("[")[0].strip()
                conditions[condition] = factor * _number(text, f"{path}: row {number}, column {column!r}") + offset
        file = str(cells.get(FILE, "")).strip()
        rows.append(ConditionRow(name, path.parent / file if file else None, conditions))
    names = [row.name for row in rows]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{path}: two rows are called {name!r}: give each recording its own name")
    return rows


def read_measurements(path, *, atmospheric_pressure: float = ATMOSPHERE) -> list[Recording]:
    """Read a long table of measurements: recording, channel, unit, time [s], value, perhaps noise (standard deviation).

    A channel that has no row at a time at which another has one misses a sample there. Noise is in the unit of the
    value; gauge pressures become absolute, so that what a gauge sensor shows stands as a difference, "bar". Raises:
    FileNotFoundError; ValueError that names file, row and remedy.
    """
    path = Path(path)
    table = _read_table(path, _MEASUREMENTS)
    recordings = []
    for name, rows in table.groupby("recording", sort=False):
        where = f"{path}: recording {name!r}"
        stamps = np.array([_number(text, f"{where}, time") for text in rows["time [s]"]])
        times, place = np.unique(stamps, return_inverse=True)
        channels, noise = {}, {}
        for channel in dict.fromkeys(rows["channel"]):
            own = (rows["channel"] == channel).to_numpy()
            part, at, here = rows[own], place[own], f"{where}, channel {channel!r}"
            units = set(part["unit"])
            if len(units) > 1:
                raise ValueError(f"{here} has several units: {', '.join(sorted(units))}")
            if np.unique(at).size < at.size:
                raise ValueError(f"{here} has two values at one time: is it a repetition? Give it its own recording")
            factor, offset, _ = _converter(units.pop(), here, atmospheric_pressure)
            channels[channel] = np.full(times.size, np.nan)
            channels[channel][at] = factor * np.array([_number(text, here) for text in part["value"]]) + offset
            if NOISE in part and any(text.strip() for text in part[NOISE]):
                noise[channel] = np.full(times.size, np.nan)
                levels = [_number(text, f"{here}, noise") if text.strip() else np.nan for text in part[NOISE]]
                noise[channel][at] = factor * np.array(levels)
        recordings.append(Recording(times, channels, name=str(name), noise=noise))
    return recordings


def read_recordings(
    conditions,
    *,
    measurements=None,
    time=None,
    channels: dict | None = None,
    units=None,
    atmospheric_pressure=ATMOSPHERE,
) -> list[Recording]:
    """Recordings with their conditions, ready for `fit`.

    Args:
        conditions: the table of conditions, one row a recording.
        measurements: a long table of measurements with these recordings; else each row names its file, which is read
            with `time` and `channels` as by `read_recording` (the same columns in every file).
        units, atmospheric_pressure: as for `read_recording`.
    Raises: FileNotFoundError; ValueError that names file, row and remedy.
    """
    rows = read_conditions(conditions, atmospheric_pressure=atmospheric_pressure)
    if measurements is not None:
        found = {r.name: r for r in read_measurements(measurements, atmospheric_pressure=atmospheric_pressure)}
        missing = [row.name for row in rows if row.name not in found]
        if missing:
            raise ValueError(f"{measurements}: there is no recording {missing[0]!r}; it has {', '.join(found)}")
        return [_under(found[row.name], row) for row in rows]
    recordings = []
    for row in rows:
        if row.file is None or time is None or channels is None:
            raise ValueError(
                f"{conditions}: {row.name!r} has no measurements: name its `file` with time and channels, or give a "
                "table of measurements"
            )
        numbers = {"atmospheric_pressure": atmospheric_pressure, "units": units}
        read = read_recording(row.file, time=time, channels=channels, name=row.name, **numbers)
        recordings.append(_under(read, row))
    return recordings


def _under(recording: Recording, row: ConditionRow) -> Recording:
    """A recording under the conditions of its row."""
    return dataclasses.replace(recording, conditions=row.conditions)


def _write(path: Path, columns: dict) -> Path:
    """A table as text, numbers with every digit; written whole or not at all."""
    import pandas

    buffer = io.StringIO()
    pandas.DataFrame(columns).to_csv(buffer, index=False, sep=_separator(path), lineterminator="\n")
    return write_whole(path, buffer.getvalue())


def _written(metadata: dict) -> str:
    """The SI unit of a number as it is written: pressures that are levels say that they are absolute."""
    unit = metadata.get("unit", "1")
    return "Pa_a" if unit == "Pa" and metadata.get("level") else unit


def write_conditions(path, recordings: Sequence[Recording], circuit: Circuit, files: Sequence[str] = ()) -> Path:
    """Write the conditions of recordings in SI, one row each; `files`: a name for each, relative to the table.

    Raises: KeyError for a condition that is no number of the circuit; OSError.
    """
    path, known = Path(path), circuit.paths()
    columns: dict[str, list] = {NAME: [recording.name for recording in recordings]}
    if files:
        columns[FILE] = list(files)
    for condition in dict.fromkeys(c for recording in recordings for c in recording.conditions):
        metadata = {"unit": "Pa", "level": True} if condition.startswith("initial.") else {}
        if not metadata or not condition.endswith(".pressure"):
            full = condition if condition.startswith("initial.") else resolve(condition, known)
            metadata = number_metadata(circuit, full)
        values = [recording.conditions.get(condition) for recording in recordings]
        columns[f"{condition} [{_written(metadata)}]"] = ["" if v is None else repr(float(v)) for v in values]
    return _write(path, columns)


def write_measurements(path, recordings: Sequence[Recording], circuit: Circuit) -> Path:
    """Write recordings as one long table in SI: a row for each usable sample. Raises: KeyError, OSError."""
    names = names_of(circuit)
    known = {**names.outputs, **names.inputs}
    columns: dict[str, list] = {key: [] for key in (*_MEASUREMENTS, NOISE)}
    for recording in recordings:
        for channel, values in recording.channels.items():
            metadata = known[resolve(channel, known, "output or input")]
            unit = metadata["unit"] if is_gauge(circuit, channel) else _written(metadata)
            good = recording.mask[channel]
            level = recording.noise.get(channel, np.full(values.shape, np.nan))[good]
            count = int(good.sum())
            columns["recording"] += [recording.name] * count
            columns["channel"] += [channel] * count
            columns["unit"] += [unit] * count
            columns["time [s]"] += [repr(float(t)) for t in recording.times[good]]
            columns["value"] += [repr(float(v)) for v in values[good]]
            columns[NOISE] += ["" if np.isnan(sd) else repr(float(sd)) for sd in level]
    return _write(Path(path), columns)
