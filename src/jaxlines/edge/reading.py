"""Recordings from files of measurements: units to SI, gauge to absolute, and what looks wrong said in words."""

import difflib
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxlines.edge.formats import Columns, read_columns
from jaxlines.edge.recording_checks import (
    MIN_SAMPLES as MIN_SAMPLES,
    channel_warnings,
    check_times,
    heading_warnings,
    pressure_warnings,
    time_warnings,
)
from jaxlines.edge.resampling import new_grid, resample_channel
from jaxlines.edge.time_stamps import TIME_STAMP, seconds_of_stamps
from jaxlines.edge.units import base_unit, conversion, is_pressure, si
from jaxlines.inference.recording import Recording
from jaxlines.physics.fields import ATMOSPHERE

ROW_NUMBER = "#"
RATE = "rate"
EVERY = "every "
_SCALED = re.compile(r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)\s+(\S.*)")
_NAME_WITH_UNIT = re.compile(r"(.*\S)?\s*\[([^\[\]]+)\]\s*")


class ColumnSpec(NamedTuple):
    """A column, the unit it is read in, and a third word: "rate" of a channel, "every 10 ms" of the time, or ""."""

    column: str
    unit: str
    third: str = ""


def column_and_unit(spec, where: str) -> ColumnSpec:
    """Column and unit from "p_line [bar_g]", from ("p_line", "bar_g"), or with a third word ("V", "mL", "rate").

    Raises: ValueError when there is no unit.
    """
    words = isinstance(spec, tuple | list) and all(isinstance(word, str) for word in spec)
    if words and len(spec) in (2, 3):
        return ColumnSpec(*(str(word) for word in spec))
    match = _NAME_WITH_UNIT.fullmatch(spec) if isinstance(spec, str) else None
    if match is None:
        raise ValueError(
            f'{where}: column {spec!r} has no unit: use a name with its unit in brackets such as "p [bar_g]", '
            'or name and unit apart, ("p", "bar_g")'
        )
    return ColumnSpec(match[0].strip(), match[2].strip())


def _find_column(columns: Columns, column: str, path: Path):
    """A column by name. Raises ValueError that suggests near names."""
    name = column.strip()
    if name in columns.repeated:
        raise ValueError(f"{path}: column {name!r} is there more than once: rename one of them")
    if name in columns.values:
        return columns.values[name]
    near = difflib.get_close_matches(name, columns.names, n=3, cutoff=0.4) or list(columns.names[:8])
    raise ValueError(f"{path}: no column {name!r}; the file has {', '.join(map(repr, near)) or 'no column of numbers'}")


def _numbers(series, column: str, path: Path) -> np.ndarray:
    """A column as float64, NaN where cells are empty. Raises ValueError for cells that are no numbers."""
    import pandas

    series = pandas.Series(series)
    if pandas.api.types.is_bool_dtype(series) or pandas.api.types.is_datetime64_any_dtype(series):
        stamps = f': read it as ("{column}", "{TIME_STAMP}")' if series.dtype.kind == "M" else ""
        raise ValueError(f"{path}: column {column!r} holds {series.dtype}, not numbers{stamps}")
    numbers = pandas.Series(pandas.to_numeric(series, errors="coerce"))
    wrong = pandas.Series(series[numbers.isna() & series.notna()])
    if len(wrong):
        cell, row = str(wrong.iloc[0]), int(wrong.index[0]) + 1
        remedy = "leave the cell empty where the sample is missing"
        if re.fullmatch(r"\s*[+-]?\d+,\d+\s*", cell):
            remedy = "decimals take a point, not a comma"
        elif re.search(r"\d:\d\d", cell):
            remedy = f'is it a time stamp? Read it as ("{column}", "{TIME_STAMP}")'
        elif row == 1:
            remedy = "one row of headings and one of units are read: is this another one?"
        raise ValueError(f"{path}: column {column!r}, data row {row}: {cell!r} is no number: {remedy}")
    return numbers.to_numpy(dtype=np.float64, na_value=np.nan)


def _to_si(values, unit: str, target: str | None, where: str, atmospheric_pressure: float):
    """Values in SI, and the SI unit. Pressures must say absolute or gauge; "40 bar_g" is what one in the file means."""
    scaled = _SCALED.fullmatch(unit)
    scale, unit = (float(scaled[1]), scaled[2]) if scaled else (1.0, unit)
    try:
        target = base_unit(unit) if target is None else target
        level = is_pressure(unit) or None
        factor, offset = conversion(unit, target, level=level, atmospheric_pressure=atmospheric_pressure)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return scale * factor * values + offset, target


def _times(columns: Columns, spec: ColumnSpec, rows: int, path: Path) -> np.ndarray:
    """Times [s] from a column of numbers or time stamps, or from the number of the row and a step."""
    column, unit, _ = spec
    where = f"{path}: column {column!r}"
    if column == ROW_NUMBER:
        try:
            return si(unit, "s") * np.arange(rows)
        except ValueError as error:
            raise ValueError(f'{path}: time from row numbers, ("{ROW_NUMBER}", "1 ms"): {error}') from error
    raw = _find_column(columns, column, path)
    if unit.partition(" ")[0] == TIME_STAMP:
        return seconds_of_stamps(raw, unit.partition(" ")[2], where)
    return _to_si(_numbers(raw, column, path), unit, "s", where, ATMOSPHERE)[0]


def _channel(columns: Columns, spec: ColumnSpec, times, target, where: str, path: Path, atmosphere: float):
    """A channel in SI, and its unit; a rate by central differences of the column over time."""
    raw = _numbers(_find_column(columns, spec.column, path), spec.column, path)
    if spec.third not in ("", RATE):
        raise ValueError(f'{where}: the third word of a channel can be "{RATE}", got {spec.third!r}')
    if raw.shape != times.shape:
        raise ValueError(
            f"{where} has {raw.size} samples, the time has {times.size}: they were sampled apart: name the time of its "
            'own group, or ask for a common step by a third word of the time, ("time", "s", "every 1 ms")'
        )
    unit = spec.unit if spec.third != RATE else f"{spec.unit}/s"
    if spec.third == RATE:
        # The differences telescope: integrated again they give the column back, averaged over a step.
        raw = np.gradient(raw, times)
    values, si_unit = _to_si(raw, unit, target, where, atmosphere)
    return np.where(np.isfinite(values), values, np.nan), si_unit


def _clock(columns: Columns, spec: ColumnSpec, time: ColumnSpec, times, path: Path) -> np.ndarray:
    """The times [s] of a channel: those of the recording, or of its own group where columns were sampled apart."""
    own = columns.clocks.get(spec.column)
    if not time.third or own is None or own == time.column:
        return times
    return np.asarray(columns.values[own], dtype=float)


def _step(spec: ColumnSpec, where: str) -> float | None:
    """The step that is asked for by the third word of the time [s]."""
    if not spec.third:
        return None
    if not spec.third.startswith(EVERY):
        raise ValueError(f'{where}: the third word of the time can be "every 10 ms", got {spec.third!r}')
    return si(spec.third.removeprefix(EVERY), "s")


def read_recording(
    path, *, time, channels: dict, atmospheric_pressure: float = ATMOSPHERE, name: str | None = None, units=None
) -> Recording:
    """Read a recording from a file of measurements: CSV and other text, Parquet, MAT, HDF5, TDMS, MDF4.

    Main arguments:
        path: the file. Delimiter, decimal sign, headings and a row of units of a text are found.
        time: time column with its unit in brackets, "t [s]", or the pair ("t", "ms"). Time stamps take the unit
            "timestamp", or "timestamp %d.%m.%Y %H:%M:%S.%f", and count from the first. ("#", "1 ms") numbers the
            rows. A third word asks for another step: ("t", "s", "every 10 ms"), low-pass filtered before.
        channels: name in the circuit -> column, such as {"A.pressure": "p_line [bar_g]", "flow": ("q", "L/min")}.
            Pressures say absolute or gauge: bar_a, bar_g, psi_a, ... ("V", "mL", "rate") is the rate of change.
            A unit with a number is what one in the file means: ("u", "40 bar_g") of volts.

    Other arguments:
        atmospheric_pressure: zero of the gauge pressures [Pa].
        name: how to call the recording in messages (default: the file's name).
        units: name -> SI unit that a channel must have (default: the SI unit of its kind).

    Returns: a `Recording` in SI and absolute pressure; missing samples are masked; odd things are in `warnings`.
    Raises: FileNotFoundError; ImportError that names the extra for a format; ValueError naming file, column and remedy.
    """
    path, units = Path(path), units or {}
    clock = column_and_unit(time, f"{path}: time")
    specs = {channel: column_and_unit(spec, f"{path}: {channel}") for channel, spec in channels.items()}
    step = _step(clock, f"{path}: time")
    columns = read_columns(path, {clock.column, *(spec.column for spec in specs.values())})
    rows = max((len(values) for values in columns.values.values()), default=0)
    times = _times(columns, clock, rows, path)
    check_times(times, f"{path}: time column {clock.column!r}")
    warnings = [*columns.notes, *time_warnings(times, clock.unit)]
    grid = times if step is None else new_grid(float(times[0]), float(times[-1]), step)
    read = {}
    for channel, spec in specs.items():
        where = f"{path}: column {spec.column!r}"
        own = _clock(columns, spec, clock, times, path)
        values, si_unit = _channel(columns, spec, own, units.get(channel), where, path, atmospheric_pressure)
        warnings += heading_warnings(spec.column, columns.units.get(spec.column, ""), spec.unit, path, channel)
        if np.all(np.isnan(values)):
            raise ValueError(f"{where} has no number in it")
        warnings += channel_warnings(values, f"{channel} ({spec.column})", si_unit)
        if si_unit == "Pa":
            warnings += pressure_warnings(values, where, spec.unit, atmospheric_pressure)
        read[channel] = values if step is None else resample_channel(own, values, grid)
    if step is not None:
        warnings.append(f"resampled to a step of {step:.4g} s, low-pass filtered before")
    return Recording(grid, read, name=name or path.name, warnings=tuple(warnings))
