"""Recordings from CSV and Parquet files: units to SI, gauge to absolute, and what looks wrong said in words."""

import difflib
import functools
import re
from pathlib import Path

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.edge.units import base_unit, conversion, is_pressure, split_level
from jaxlines.inference.recording import Recording
from jaxlines.physics.fields import ATMOSPHERE

MIN_SAMPLES = 10
_NAME_WITH_UNIT = re.compile(r"(.*\S)?\s*\[([^\[\]]+)\]\s*")


def column_and_unit(spec, where: str) -> tuple[str, str]:
    """Column name and unit from "p_line [bar_g]", or from the pair ("p_line", "bar_g").

    Raises: ValueError when there is no unit.
    """
    if isinstance(spec, tuple | list) and len(spec) == 2 and all(isinstance(word, str) for word in spec):
        return str(spec[0]), str(spec[1])
    match = _NAME_WITH_UNIT.fullmatch(spec) if isinstance(spec, str) else None
    if match is None:
        raise ValueError(
            f'{where}: column {spec!r} has no unit: use a name with its unit in brackets such as "p [bar_g]", '
            'or name and unit apart, ("p", "bar_g")'
        )
    return match[0], match[2].strip()


def _read_table(path: Path):
    """A data frame from a .csv or .parquet file. Raises ValueError naming the file and the remedy."""
    import pandas

    readers = {".csv": functools.partial(pandas.read_csv, low_memory=False), ".parquet": pandas.read_parquet}
    if path.suffix.lower() not in readers:
        raise ValueError(f"{path}: recordings are read from .csv and .parquet files, not {path.suffix or 'this one'!r}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file (a relative path of a study counts from the study file)")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    try:
        table = readers[path.suffix.lower()](path)
    except (pandas.errors.ParserError, pandas.errors.EmptyDataError, UnicodeDecodeError, OSError, ValueError) as error:
        reason = "it is not UTF-8: save it so" if isinstance(error, UnicodeDecodeError) else str(error).split("\n")[0]
        raise ValueError(f"{path}: cannot be read as {path.suffix[1:]} ({reason})") from error
    return table.rename(columns=lambda name: str(name).strip())


def _find_column(table, column: str, path: Path):
    """A column by name. Raises ValueError that suggests near names."""
    if column.strip() in table.columns:
        return table[column.strip()]
    near = difflib.get_close_matches(column, table.columns, n=3, cutoff=0.4) or list(table.columns[:8])
    hint = ""
    if len(table.columns) == 1:
        mark = next((label for sign, label in ((";", ";"), ("\t", "tabs")) if sign in table.columns[0]), "; or tabs")
        hint = f": are columns separated by {mark} instead of a comma? Save it with commas, and points in decimals"
    raise ValueError(f"{path}: no column {column!r}; the file has {', '.join(map(repr, near))}{hint}")


def _numbers(series, column: str, path: Path) -> np.ndarray:
    """A column as float64, NaN where cells are empty. Raises ValueError for cells that are no numbers."""
    import pandas

    if series.ndim != 1:
        raise ValueError(f"{path}: column {column!r} is there more than once: rename one of them")
    if pandas.api.types.is_bool_dtype(series) or pandas.api.types.is_datetime64_any_dtype(series):
        raise ValueError(f"{path}: column {column!r} holds {series.dtype}, not numbers")
    numbers = pandas.Series(pandas.to_numeric(series, errors="coerce"))
    wrong = series[numbers.isna() & series.notna()]
    if len(wrong):
        cell = str(wrong.iloc[0])
        row = int(wrong.index[0]) + 1
        remedy = "leave the cell empty where the sample is missing"
        if re.fullmatch(r"\s*[+-]?\d+,\d+\s*", cell):
            remedy = "decimals take a point, not a comma"
        elif row == 1:
            remedy = "one row of headings is read: is this a second one?"
        raise ValueError(f"{path}: column {column!r}, data row {row}: {cell!r} is no number: {remedy}")
    return numbers.to_numpy(dtype=np.float64, na_value=np.nan)


def _to_si(values, unit: str, target: str | None, where: str, atmospheric_pressure: float):
    """Values in SI, and the SI unit. Pressures must say absolute or gauge."""
    try:
        target = base_unit(unit) if target is None else target
        level = is_pressure(unit) or None
        factor, offset = conversion(unit, target, level=level, atmospheric_pressure=atmospheric_pressure)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return factor * values + offset, target


def _check_times(times, column: str, path: Path) -> None:
    """Enough samples, no holes, increasing."""
    where = f"{path}: time column {column!r}"
    if times.size < MIN_SAMPLES:
        raise ValueError(f"{path}: {times.size} samples; a recording needs {MIN_SAMPLES} or more")
    if not np.all(np.isfinite(times)):
        raise ValueError(f"{where} is empty or not finite in data row {int(np.argmin(np.isfinite(times))) + 1}")
    steps = np.diff(times)
    if not np.all(steps > 0):
        row = int(np.argmin(steps > 0)) + 2
        repeated = steps[row - 2] == 0
        slip = (
            "is the time rounded too far, or a row repeated?"
            if repeated
            else "are rows out of order, or two runs in one file?"
        )
        raise ValueError(
            f"{where} does not increase in data row {row} ({times[row - 2]:g} s, then {times[row - 1]:g} s): {slip}"
        )


def _time_warnings(times, unit: str) -> list[str]:
    """What is odd about the times."""
    steps, found = np.diff(times), []
    step = float(np.median(steps))
    gaps = np.flatnonzero(steps > 5.0 * step)
    if gaps.size:
        first = gaps[0]
        more = f" and {gaps.size - 1} more" if gaps.size > 1 else ""
        found.append(
            f"time: gap of {steps[first]:.3g} s after {times[first]:g} s{more} (the usual step is {step:.3g} s)"
        )
    if unit == "s" and step >= 1.0 and times[-1] - times[0] > 1000.0:
        found.append(f"time: the usual step is {step:g} s: are these milliseconds?")
    if unit == "ms" and step < 1e-6:
        found.append(f"time: the usual step is {step:g} s: are these seconds?")
    return found


def _check_pressure(values, where: str, unit: str) -> list[str]:
    """Raise for absolute pressures below zero; note those that look like another unit."""
    bare, suffix = split_level(unit)
    lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
    if lowest < 0:
        slip = f"is it gauge ({bare}_g)?" if suffix == "a" else "is the zero of the sensor wrong?"
        raise ValueError(f"{where}: absolute pressure falls to {lowest:.4g} Pa, below zero: {slip}")
    if highest > 2e8:
        return [f"{where}: rises to {highest / 1e5:.4g} bar: is it kPa or psi, not {bare}?"]
    return []


def _channel_warnings(values, where: str, si_unit: str) -> list[str]:
    """What is odd about a channel in SI: missing samples, dead, clipped."""
    unit, factor = readable_unit(si_unit, float(np.nanmax(np.abs(values))))
    finite, found = values[np.isfinite(values)], []
    if finite.size < values.size:
        missing = values.size - finite.size
        found.append(f"{where}: {missing} of {values.size} samples are missing and are left out")
    low, high = finite.min(), finite.max()
    if low == high:
        return [*found, f"{where}: constant at {low * factor:g} {unit}: is the channel dead?"]
    for extreme, word in ((low, "lowest"), (high, "highest")):
        at = np.concatenate([[False], finite == extreme, [False]])
        edges = np.flatnonzero(np.diff(at.astype(int)))
        longest = int((edges[1::2] - edges[::2]).max())
        # A rest state also repeats; a clipped signal stays at its extreme in a run and comes back.
        if at.sum() >= max(5, 0.01 * finite.size) and longest >= 3:
            share = 100.0 * at.sum() / finite.size
            found.append(
                f"{where}: {share:.2g} % of the samples sit exactly at the {word} value "
                f"{extreme * factor:.6g} {unit}: clipped?"
            )
    return found


def read_recording(
    path, *, time, channels: dict, atmospheric_pressure: float = ATMOSPHERE, name: str | None = None, units=None
) -> Recording:
    """Read a recording from a .csv or .parquet file.

    Main arguments:
        path: the file.
        time: time column with its unit in brackets, "t [s]", or the pair ("t", "ms").
        channels: name in the circuit -> column, such as {"A.pressure": "p_line [bar_g]", "flow": ("q", "L/min")}.
            Pressures say absolute or gauge: bar_a, bar_g, psi_a, ...

    Other arguments:
        atmospheric_pressure: zero of the gauge pressures [Pa].
        name: how to call the recording in messages (default: the file's name).
        units: name -> SI unit that a channel must have (default: the SI unit of its kind).

    Returns: a `Recording` in SI and absolute pressure; missing samples are masked; odd things are in `warnings`.
    Raises: FileNotFoundError; ValueError naming file, column and remedy.
    """
    path, units = Path(path), units or {}
    table = _read_table(path)
    time_column, time_unit = column_and_unit(time, f"{path}: time")
    raw = _numbers(_find_column(table, time_column, path), time_column, path)
    times, _ = _to_si(raw, time_unit, "s", f"{path}: column {time_column!r}", atmospheric_pressure)
    _check_times(times, time_column, path)
    read, warnings = {}, _time_warnings(times, time_unit)
    for channel, spec in channels.items():
        column, unit = column_and_unit(spec, f"{path}: {channel}")
        where = f"{path}: column {column!r}"
        raw = _numbers(_find_column(table, column, path), column, path)
        values, si_unit = _to_si(raw, unit, units.get(channel), where, atmospheric_pressure)
        values = np.where(np.isfinite(values), values, np.nan)
        if np.all(np.isnan(values)):
            raise ValueError(f"{where} has no number in it")
        warnings += _channel_warnings(values, f"{channel} ({column})", si_unit)
        if si_unit == "Pa":
            warnings += _check_pressure(values, where, unit)
        read[channel] = values
    return Recording(times, read, name=name or path.name, warnings=tuple(warnings))
