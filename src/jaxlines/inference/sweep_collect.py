"""From the chunks of a sweep to its table, statistics, bands and sensitivities, in bounded memory."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.inference import samplers
from jaxlines.inference.propagation import Linear
from jaxlines.inference.sensitivity_indices import (
    Sensitivity,
    derivative_based,
    morris_effects,
    shapley_effects,
    sobol_indices,
    tornado,
)
from jaxlines.inference.sketch import COARSE, Moments, QuantileSketch
from jaxlines.inference.statistics import Accumulator, Band, Summary, band
from jaxlines.inference.sweep_store import PARQUET, ROW_GROUP, SweepStore, write_over
from jaxlines.inference.sweep_workers import derivative_column

_PARTS = ("codes", "counts", "low", "high", "mean", "squares", "count")
SCATTER = 100_000
"""Lanes of which whole rows are held in memory, for tornado, scatter and the error of linearising."""


@dataclasses.dataclass(frozen=True)
class Collected:
    """What the lanes of a sweep say.

    Fields: count of lanes that are there; failed: status code -> lanes; summaries: reduction -> `Summary`; bands:
    output -> `Band`; sensitivities: reduction -> list of `Sensitivity`; linear: reduction -> `Linear`; rows: the first
    lanes (column -> values); worst: reduction -> column -> values of its largest lanes; kept: output -> series of the
    first lanes, shape (lanes, times); notes, in words.
    """

    count: int
    failed: dict[int, int]
    summaries: dict[str, Summary]
    bands: dict[str, Band]
    sensitivities: dict[str, list[Sensitivity]]
    linear: dict[str, Linear]
    rows: dict[str, np.ndarray]
    worst: dict[str, dict[str, np.ndarray]]
    kept: dict[str, np.ndarray]
    notes: tuple[str, ...]


def nothing(reason: str) -> Collected:
    """What no lanes say, with the reason why there are none."""
    return Collected(0, {}, {}, {}, {}, {}, {}, {}, {}, (reason,))


def blocks(store: SweepStore) -> Iterator[dict[str, np.ndarray]]:
    """The table in blocks of ROW_GROUP rows whatever the chunks, so that sums do not depend on them, up to the first
    gap."""
    held: list[dict[str, np.ndarray]] = []
    size = position = 0
    for piece, columns in store.tables():
        if piece.start != position:
            break
        position = piece.stop
        held.append(columns)
        size += len(columns["index"])
        while size >= ROW_GROUP:
            whole = _joined(held)
            yield {name: values[:ROW_GROUP] for name, values in whole.items()}
            held, size = [{name: values[ROW_GROUP:] for name, values in whole.items()}], size - ROW_GROUP
    if size:
        yield _joined(held)


def _joined(pieces: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def collect(store: SweepStore, write: bool = True) -> Collected:
    """Statistics of the lanes that are there, without a gap, from the first on.

    Args: store, which knows the thresholds and quantiles that were asked for; write: table.parquet and bands.parquet,
        the same bytes however the sweep was cut and computed.
    Raises: ValueError when there are no lanes; OSError for a chunk that is damaged.
    """
    content, asked = store.content, store.asked()
    thresholds, probabilities = asked["thresholds"], tuple(asked["quantiles"])
    prepared = store.prepared()
    if prepared is None or not store.done() or store.done()[0].start != 0:
        raise ValueError(f"{store.folder}: no lane has been computed yet")
    gathered = _Gathered(content, prepared["scales"], thresholds, probabilities)
    if write:
        write_over(store.folder / "table.parquet", lambda path: gathered.write(store, path))
    else:
        for block in blocks(store):
            gathered.add(block)
    bands, kept = _bands(store, prepared["scales"], gathered, probabilities) if content["outputs"] else ({}, {})
    if write and bands:
        write_over(store.folder / "bands.parquet", lambda path: _write_bands(bands, path))
    return gathered.collected(store, bands, kept, _linear(store))


class _Gathered:
    """What one pass over the table gathers."""

    def __init__(self, content, scales, thresholds, probabilities):
        self.content, self.count, self.failed = content, 0, {}
        self.accumulators = {
            name: Accumulator(name, content["units"].get(name, "1"), scales[name]["centre"][0], scales[name]["unit"][0],
                              thresholds.get(name, ()), probabilities)
            for name in content["reductions"]
        }  # fmt: skip
        self.held: list[dict[str, np.ndarray]] = []
        self.extremes: dict[int, dict[str, float]] = {}

    def add(self, block: dict[str, np.ndarray]) -> None:
        """Add a block of the table."""
        good = block["status"] == 0
        for code, number in zip(*np.unique(block["status"][~good], return_counts=True), strict=True):
            self.failed[int(code)] = self.failed.get(int(code), 0) + int(number)
        for name, accumulator in self.accumulators.items():
            accumulator.add(block["index"], block[name], good & np.isfinite(block[name]))
        wanted = {i for a in self.accumulators.values() for i, _ in (*a.largest, *a.smallest)}
        first = int(block["index"][0])
        for index in wanted - set(self.extremes):
            if index >= first:
                self.extremes[index] = {name: float(values[index - first]) for name, values in block.items()}
        self.extremes = {index: row for index, row in self.extremes.items() if index in wanted}
        if self.count < SCATTER:
            self.held.append(block)
        self.count += len(good)

    def write(self, store: SweepStore, path: Path) -> None:
        """Add all blocks, and write them as one table."""
        import pyarrow
        from pyarrow import parquet

        writer = None
        try:
            for block in blocks(store):
                table = pyarrow.table(block)
                if writer is None:
                    options = {key: value for key, value in PARQUET.items() if key != "row_group_size"}
                    writer = parquet.ParquetWriter(path, table.schema, **options)
                writer.write_table(table, row_group_size=ROW_GROUP)
                self.add(block)
        finally:
            if writer is not None:
                writer.close()

    def collected(self, store: SweepStore, bands, kept, linear) -> Collected:
        """Everything together."""
        rows = _joined(self.held)
        summaries = {name: a.summary() for name, a in self.accumulators.items()}
        worst = {name: self._rows_of([i for i, _ in s.largest]) for name, s in summaries.items()}
        sensitivities, notes = _sensitivities(store, rows, self.count)
        notes += _design_notes(sampler_of(store))
        if self.failed:
            total = sum(self.failed.values())
            notes.append(
                f"{total:,} of {self.count:,} lanes failed ({100 * total / self.count:.3g} %): moments and "
                "quantiles are of the others; the bounds hold whatever the failed lanes would have given"
            )
        failed_lanes = sum(self.failed.values())
        notes += [
            f"{name}: {a.failed - failed_lanes:,} lanes that succeeded have no value of it: counted as failed"
            for name, a in self.accumulators.items()
            if a.failed > failed_lanes
        ]
        samples = np.stack([rows[name] for name in self.content["names"]], axis=1)
        for name, found in linear.items():
            good = (rows["status"] == 0) & np.isfinite(rows[name])
            linear[name] = found.compared(samples[good], rows[name][good])
        failed = dict(sorted(self.failed.items()))
        return Collected(self.count, failed, summaries, bands, sensitivities, linear, rows, worst, kept, tuple(notes))

    def _rows_of(self, indices: list[int]) -> dict[str, np.ndarray]:
        names = ("index", *self.content["names"], *self.content["reductions"])
        return {name: np.asarray([self.extremes[i][name] for i in indices]) for name in names}


def _bands(
    store: SweepStore, scales, gathered: _Gathered, probabilities
) -> tuple[dict[str, Band], dict[str, np.ndarray]]:
    """Bands of the outputs over time, and the kept series."""
    content, found, kept, count = store.content, {}, {}, 0
    sketches = {}
    for name in content["outputs"]:
        scale = scales[f"series {name}"]
        sketches[name] = QuantileSketch(scale["centre"], scale["unit"], COARSE)
        found[name] = Moments(0, np.zeros(len(scale["centre"])), np.zeros(len(scale["centre"])))
        kept[name] = []
    for piece, arrays in store.series():
        if piece.start != count:
            break
        count = piece.stop
        for name, sketch in sketches.items():
            own = {part: arrays[f"{name}/{part}"] for part in _PARTS}
            sketch.merge(QuantileSketch.from_arrays(sketch.centre, sketch.unit, own, COARSE))
            found[name] = found[name].merge(Moments(int(own["count"]), own["mean"], own["squares"]))
            kept[name].append(arrays[f"{name}/kept"])
    failed = sum(gathered.failed.values())
    units, times = content["units"], np.asarray(content["times"])
    bands = {
        name: band(name, units.get(name, "1"), times, sketch, found[name], failed, probabilities)
        for name, sketch in sketches.items()
    }
    return bands, {name: np.concatenate(pieces) for name, pieces in kept.items() if pieces}


def _write_bands(bands: dict[str, Band], path: Path) -> None:
    """Bands as one long table: output, time, mean, sd, low, high, q0.05, ..."""
    import pyarrow
    from pyarrow import parquet

    tables = []
    for name, found in bands.items():
        columns: dict[str, Any] = {"output": [name] * len(found.times), "time": found.times, "mean": found.mean}
        columns |= {"sd": found.sd, "low": found.low, "high": found.high}
        columns |= {f"q{q:g}": values for q, values in found.quantiles.items()}
        tables.append(pyarrow.table(columns))
    parquet.write_table(pyarrow.concat_tables(tables), path, **PARQUET)


def _linear(store: SweepStore) -> dict[str, Linear]:
    """Linear propagation as it was stored when the sweep began."""
    import json

    path = store.folder / "linear.json"
    if not path.exists():
        return {}
    found = json.loads(path.read_text(encoding="utf-8"))
    return {name: Linear(**{key: _from_list(value) for key, value in fields.items()}) for name, fields in found.items()}


def _from_list(value: Any) -> Any:
    """Lists of texts as tuples, lists of numbers as arrays."""
    if not isinstance(value, list):
        return value
    return tuple(value) if value and isinstance(value[0], str) else np.asarray(value, dtype=float)


def sampler_of(store: SweepStore) -> samplers.AbstractSampler:
    """The sampler of a store's plan."""
    fields = dict(store.content["plan"]["sampler"])
    kind = getattr(samplers, fields.pop("type"))
    return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()})


def _design_notes(sampler: samplers.AbstractSampler) -> list[str]:
    """What the lanes of a design are not."""
    if isinstance(sampler, samplers.Morris):
        return ["lanes of Morris are no sample of the distributions: moments, quantiles and bands do not apply"]
    if isinstance(sampler, samplers.SobolIndices | samplers.ShapleyEffects):
        return ["lanes of one block share numbers: the intervals of means and quantiles are too narrow"]
    return []


def _sensitivities(store: SweepStore, rows: dict, count: int) -> tuple[dict[str, list[Sensitivity]], list[str]]:
    """What the lanes say about causes: indices for the samplers made for them, a tornado for the others."""
    content, sampler, notes = store.content, sampler_of(store), []
    names, dims, found = content["names"], content["dims"], {}
    designed = isinstance(sampler, samplers.SobolIndices | samplers.Morris | samplers.ShapleyEffects)
    needed = ["status", *content["reductions"]]
    if designed and count > len(rows["status"]):
        rows = _joined([columns for _, columns in store.tables(needed)])
    for name in content["reductions"]:
        good = (rows["status"] == 0) & np.isfinite(rows[name])
        try:
            found[name] = _causes(sampler, name, names, dims, rows, good, content["plan"]["derivatives"])
        except (ValueError, ImportError) as error:
            found[name] = []
            notes.append(f"{name}: no sensitivities: {error}")
    return found, notes


def _causes(sampler, reduction: str, names, dims: int, rows: dict, good: np.ndarray, derivatives: bool):
    """The sensitivities of one reduction."""
    values = rows[reduction]
    if isinstance(sampler, samplers.SobolIndices):
        return [sobol_indices(reduction, names, values, good, sampler.second_order)]
    if isinstance(sampler, samplers.Morris | samplers.ShapleyEffects):
        uniforms = sampler.uniforms(0, len(values), dims)
        if isinstance(sampler, samplers.Morris):
            return [morris_effects(reduction, names, uniforms, values, good, sampler.levels)]
        return [shapley_effects(reduction, names, uniforms, values, good)]
    samples = np.stack([rows[name] for name in names], axis=1)
    found = [tornado(reduction, names, samples, values, good)]
    if derivatives:
        effects = np.stack([rows[derivative_column(reduction, name)] for name in names], axis=1)
        found.append(derivative_based(reduction, names, effects, values, good))
    return found
