"""Columns of numbers from files of measurements: CSV, Parquet, MAT, HDF5, TDMS and MDF4."""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.csv_layout import Layout, find_layout

MOST_TEXT_BYTES = 2_000_000_000
"""Largest text file that is read [bytes]: about 5e7 rows, far beyond what a fit can use."""

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")


@dataclasses.dataclass(frozen=True)
class Columns:
    """The columns of a file, by name, as they stand in it.

    Fields: values: name -> numbers, or texts where cells are no numbers, shape (rows,), pandas Series or arrays;
    units: name -> unit that the file states apart from the name; clocks: name -> column that holds its times, where
    columns were sampled apart; names: of all columns of the file, of which values may hold the wanted ones only;
    repeated: names that stand there more than once (the first is kept); notes: what was unusual, in words; layout: of
    a text file.
    """

    values: dict[str, Any]
    units: dict[str, str] = dataclasses.field(default_factory=dict)
    clocks: dict[str, str] = dataclasses.field(default_factory=dict)
    names: tuple[str, ...] = ()
    repeated: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    layout: Layout | None = None


def _need(module: str, path: Path):
    """An optional library. Raises ImportError that names the extra."""
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{path}: {path.suffix} files need {module.partition('.')[0]}: install it with "
            'python -m pip install "jaxlines[formats]"'
        ) from error


def _read_text(path: Path, wanted: Iterable[str] | None) -> Columns:
    """A text file of columns; only the wanted ones are kept, if given."""
    import pandas

    if path.stat().st_size > MOST_TEXT_BYTES:
        size = path.stat().st_size / 1e9
        raise ValueError(
            f"{path}: {size:.1f} GB of text is more than a fit can use: export the test alone, at the rate that it "
            "needs, or save it as Parquet, of which only the named columns are read"
        )
    layout = find_layout(path)
    names = list(layout.names)
    keep = [i for i, name in enumerate(names) if name and (wanted is None or name in set(wanted))]
    table = pandas.read_csv(
        path,
        sep=layout.delimiter,
        decimal=layout.decimal,
        thousands=layout.thousands,
        encoding=layout.encoding,
        header=None,
        names=range(len(names)),
        index_col=False,
        skiprows=layout.first_row,
        skipinitialspace=True,
        low_memory=False,
        on_bad_lines="error",
    )
    values = {names[i]: table[i] for i in reversed(keep)}
    units = {names[i]: layout.units[i] for i in keep if layout.units[i]}
    repeated = frozenset(name for name in names if name and names.count(name) > 1)
    values = dict(reversed(values.items()))
    every = tuple(name for name in names if name)
    return Columns(values, units, {}, every, repeated, layout.notes, layout)


def _read_parquet(path: Path, wanted: Iterable[str] | None) -> Columns:
    """A Parquet file."""
    import pandas
    import pyarrow.parquet as parquet

    names = [str(name) for name in parquet.read_schema(path).names if not str(name).startswith("__index_level_")]
    chosen = names if wanted is None else [name for name in names if name.strip() in set(wanted)]
    table = pandas.read_parquet(path, columns=chosen)
    return Columns({name.strip(): table[name] for name in chosen}, names=tuple(name.strip() for name in names))


def _flat_arrays(name: str, value, found: dict[str, np.ndarray], cut: str) -> None:
    """One-dimensional numbers of a (nested) MAT or HDF5 object, by names such as "run.p" or "data(:,2)"."""
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            _flat_arrays(f"{name}.{field}", getattr(value, field), found, cut)
        return
    array = np.asarray(value)
    if array.dtype.kind not in "fiub" or array.size < 2:
        return
    array = np.squeeze(array)
    if array.ndim == 1:
        found[name] = array
    elif array.ndim == 2:
        rows = array if array.shape[0] >= array.shape[1] else array.T
        for i in range(rows.shape[1]):
            found[f"{name}{cut.format(i + 1 if cut.startswith('(') else i)}"] = rows[:, i]


def _read_mat(path: Path, wanted: Iterable[str] | None) -> Columns:
    """A MAT file of versions 4 to 7 by SciPy; version 7.3 is HDF5."""
    import scipy.io

    found: dict[str, np.ndarray] = {}
    try:
        content = scipy.io.loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        return _read_hdf5(path, wanted)
    for name, value in content.items():
        if not name.startswith("__"):
            _flat_arrays(name, value, found, "(:,{})")
    return Columns(found, names=tuple(found))


def _read_hdf5(path: Path, wanted: Iterable[str] | None) -> Columns:
    """An HDF5 file: every data set by its path, its unit from an attribute `unit` or `units`."""
    h5py = _need("h5py", path)
    found: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    passed_over: list[str] = []
    needed = None if wanted is None else {name.partition("[")[0] for name in wanted}

    def visit(name: str, item) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        if needed is not None and name not in needed:
            passed_over.append(name)
            return
        before = set(found)
        _flat_arrays(name, item[()], found, "[:,{}]")
        unit = item.attrs.get("units", item.attrs.get("unit", ""))
        unit = unit.decode() if isinstance(unit, bytes) else str(unit)
        units.update({column: unit for column in set(found) - before if unit})

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return Columns(found, units, names=(*found, *passed_over))


def _read_tdms(path: Path, wanted: Iterable[str] | None) -> Columns:
    """A TDMS file: "group/channel", and "group/time" where a waveform states its increment."""
    nptdms = _need("nptdms", path)
    found: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    passed_over: list[str] = []
    needed = None if wanted is None else set(wanted)
    with nptdms.TdmsFile.open(str(path)) as file:
        for channel in (channel for group in file.groups() for channel in group.channels()):
            name, group = f"{channel.group_name}/{channel.name}", channel.group_name
            clocked = bool(channel.properties.get("wf_increment"))
            if needed is not None and name not in needed and not (clocked and f"{group}/time" in needed):
                passed_over.append(name)
                continue
            values = channel[:]
            if values.size < 2:
                continue
            found[name] = values
            unit = str(channel.properties.get("unit_string", channel.properties.get("NI_UnitDescription", "")))
            units |= {name: unit} if unit else {}
            if clocked:
                step, offset = channel.properties["wf_increment"], channel.properties.get("wf_start_offset", 0.0)
                times = offset + step * np.arange(values.size)
                clock = f"{group}/time"
                if clock in found and not np.array_equal(found[clock], times):
                    clock = f"{name}/time"
                found[clock], units[clock], clocks[name] = times, "s", clock
    return Columns(found, units, clocks, (*found, *passed_over))


def _read_mdf(path: Path, wanted: Iterable[str] | None) -> Columns:
    """An MDF file: channels by name; "time", or "time of GROUP" where groups were sampled apart."""
    asammdf = _need("asammdf", path)
    found: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    with asammdf.MDF(str(path)) as file:
        for group, content in enumerate(file.groups):
            clock = "time" if len(file.groups) == 1 else f"time of group {group}"
            for index in range(len(content.channels)):
                signal = file.get(group=group, index=index)
                if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub" or signal.samples.size < 2:
                    continue
                if index == file.masters_db.get(group):
                    continue
                found[clock], units[clock] = np.asarray(signal.timestamps, dtype=float), "s"
                name = signal.name if signal.name not in found else f"{signal.name} (group {group})"
                found[name], clocks[name] = signal.samples, clock
                units |= {name: signal.unit} if signal.unit else {}
    return Columns(found, units, clocks, tuple(found))


_READERS: dict[str, Callable[[Path, Iterable[str] | None], Columns]] = {
    **dict.fromkeys(TEXT_SUFFIXES, _read_text),
    ".parquet": _read_parquet,
    ".mat": _read_mat,
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), _read_hdf5),
    ".tdms": _read_tdms,
    **dict.fromkeys((".mf4", ".mdf"), _read_mdf),
}


def read_columns(path: Path, wanted: Iterable[str] | None = None) -> Columns:
    """The columns of a file of measurements.

    Args:
        path: .csv, .tsv, .txt, .dat, .asc (delimiter, decimal sign, headings and a row of units are found), .parquet,
            .mat, .h5, .hdf5, .tdms, .mf4.
        wanted: the columns that are needed, where a format can leave out others.
    Returns: `Columns`, not yet in SI.
    Raises: FileNotFoundError; ImportError that names the extra; ValueError naming the file and the remedy.
    """
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        known = ", ".join(_READERS)
        raise ValueError(f"{path}: recordings are read from {known} files, not {path.suffix or 'this one'!r}")
    if not path.is_file():
        where = "is a folder" if path.is_dir() else "no such file"
        raise FileNotFoundError(f"{path}: {where} (a relative path of a study counts from the study file)")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    try:
        columns = _READERS[suffix](path, wanted)
    except ImportError:
        raise
    except Exception as error:  # the libraries raise many kinds for a damaged file
        text = str(error).split("\n")[0]
        if isinstance(error, ValueError) and text.startswith(str(path)):
            raise
        raise ValueError(f"{path}: cannot be read as {suffix[1:]} ({text or type(error).__name__})") from error
    if not columns.names:
        raise ValueError(f"{path}: cannot be read as {suffix[1:]} (there are no columns of numbers in it)")
    return columns
