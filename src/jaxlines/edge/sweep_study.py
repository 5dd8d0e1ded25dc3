"""The table [sweep] of a study file: what is uncertain, how lanes are chosen, what is kept of them."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.building import Builder, StudyError, suggest
from jaxlines.edge.naming import at, look_up, path_metadata
from jaxlines.edge.study import NOTHING_TO_SIMULATE, Study, build_study, study_file
from jaxlines.edge.sweep_tables import CasesTable, SweepTable, UncertainTable
from jaxlines.edge.tables import check_layout
from jaxlines.inference import distributions, samplers
from jaxlines.inference.circuit_sweep import circuit_plan
from jaxlines.inference.distributions import AbstractDistribution
from jaxlines.inference.sweep_plan import SweepPlan
from jaxlines.inference.uncertain import Draws, Uncertain
from jaxlines.simulation.observation import is_gauge
from jaxlines.simulation.reductions import OfOneOutput

_DISTRIBUTIONS = {
    "normal": (distributions.Normal, ("mean", "sd")),
    "log_normal": (distributions.LogNormal, ("median", "spread")),
    "uniform": (distributions.Uniform, ("low", "high")),
    "log_uniform": (distributions.LogUniform, ("low", "high")),
    "triangular": (distributions.Triangular, ("low", "mode", "high")),
    "discrete": (distributions.Discrete, ("values", "weights")),
}
_SAMPLERS = {
    "sobol": samplers.Sobol,
    "monte_carlo": samplers.MonteCarlo,
    "latin_hypercube": samplers.LatinHypercube,
    "grid": samplers.Grid,
    "sobol_indices": samplers.SobolIndices,
    "morris": samplers.Morris,
    "shapley": samplers.ShapleyEffects,
}


@dataclasses.dataclass(frozen=True)
class SweepStudy:
    """A study with its sweep: the `Study`; plan; count of lanes; thresholds and quantiles that are asked for."""

    study: Study
    plan: SweepPlan
    count: int | None
    thresholds: dict[str, list[float]]
    quantiles: tuple[float, ...]


def load_sweep(source, count: int | None = None) -> SweepStudy:
    """Read a study with a table [sweep].

    Args: source: a TOML file, or "example:NAME"; count: of lanes, instead of the file's.
    Raises: StudyError, in one line that starts with the file, for anything that is wrong in it.
    """
    with study_file(source) as (content, path):
        layout = check_layout(content)
        if layout.sweep is None:
            raise StudyError("there is nothing to sweep: add a table [sweep] with count, uncertain and reduction")
        return sweep_of(build_study(layout, path.parent, str(source)), layout.sweep, path.parent, count)


def sweep_of(study: Study, table: SweepTable, folder: Path, count: int | None = None) -> SweepStudy:
    """The sweep of a study from its table; `count` instead of the table's. Raises StudyError with the place."""
    times = study.simulated_times()
    if times is None:
        raise StudyError(f"sweep: {NOTHING_TO_SIMULATE}")
    builder = Builder(float(study.circuit.fluid.atmospheric_pressure))
    numbers = _uncertain(study, table, builder, folder)
    reductions, thresholds = _reductions(study, table, builder)
    for name in table.outputs:
        look_up(name, study.names.outputs, "sweep.outputs", "output")
    clash = sorted(set(reductions) & set(table.outputs))
    if clash:
        raise StudyError(f"sweep: {clash[0]!r} is both an output and a reduction: give the reduction another name")
    count = table.count if count is None else count
    with at("sweep"):
        plan = circuit_plan(
            study.circuit,
            times,
            numbers,
            outputs={**{name: name for name in table.outputs}, **reductions},
            inputs=study._recorded_inputs() | study.inputs,
            initial=study._start(on_recording=study.times is None),
            sampler=_sampler(table, numbers, count),
            count=count,
            derivatives=table.derivatives,
            kept_series=table.kept_series,
            tolerance=table.tolerance,
            engine=table.engine,
            precision=table.precision,
        )
        if count is not None:
            plan.check_count(count)
    return SweepStudy(study, plan, count, thresholds, tuple(table.quantiles))


def _uncertain(study: Study, table: SweepTable, builder: Builder, folder: Path) -> Uncertain:
    """All that is uncertain, in SI."""
    single, shared = {}, {}
    for i, entry in enumerate(table.uncertain):
        where = f"sweep.uncertain.{i}"
        metadata = [path_metadata(study.circuit, study.names, path, where) for path in entry.path]
        if len({m["unit"] for m in metadata}) > 1:
            raise StudyError(f"{where}: {', '.join(entry.path)} have different units: they cannot share a value")
        name = entry.name or entry.path[0]
        if name in single:
            raise StudyError(f"{where}: {name!r} is uncertain twice: give it one distribution")
        single[name] = _distribution(entry, metadata[0], builder, where)
        if len(entry.path) > 1 or name != entry.path[0]:
            shared[name] = tuple(entry.path)
    pairs = {(pair.between[0], pair.between[1]): pair.value for pair in table.correlation}
    joint = () if table.cases is None else (_cases(study, table.cases, builder, folder),)
    with at("sweep"):
        return Uncertain(single, shared, pairs, joint)


def _distribution(entry: UncertainTable, metadata: dict, builder: Builder, where: str) -> AbstractDistribution:
    """A distribution in SI."""
    given = [kind for kind in _DISTRIBUTIONS if getattr(entry, kind) is not None]
    if len(given) != 1:
        found = ", ".join(given) or "none"
        raise StudyError(f"{where}: give one distribution ({', '.join(_DISTRIBUTIONS)}), got {found}")
    kind, fields = _DISTRIBUTIONS[given[0]]
    content, where_in = getattr(entry, given[0]), f"{where}.{given[0]}"
    for key in content:
        if key not in fields:
            raise StudyError(f"{where_in}: unknown key {key!r}, {suggest(key, fields)}")
    for key in fields:
        if key not in content and key != "weights":
            raise StudyError(f"{where_in}: {key!r} is missing")
    values = {key: _value(key, value, metadata, builder, f"{where_in}.{key}") for key, value in content.items()}
    with at(where):
        found = kind(**values)
        if entry.within is None:
            return found
        low, high = (builder.number(end, metadata, f"{where}.within") for end in entry.within)
        return distributions.Truncated(found, low, high)


def _value(key: str, value: Any, metadata: dict, builder: Builder, where: str) -> Any:
    """A parameter of a distribution in SI: a value of the number, a difference of it, or a plain number."""
    if isinstance(value, list):
        return tuple(_value(key, item, metadata, builder, where) for item in value)
    if key in ("spread", "weights"):
        return builder.number(value, {"unit": "1"}, where)
    return builder.number(value, {**metadata, "level": metadata.get("level") and key != "sd"}, where)


def _cases(study: Study, table: CasesTable, builder: Builder, folder: Path) -> Draws:
    """A table of cases in SI."""
    import pandas

    from jaxlines.edge.units import conversion

    with at("sweep.cases"):
        frame = pandas.read_csv(folder / table.file)
        columns = {}
        for path, column in table.columns.items():
            if column not in frame:
                raise StudyError(f"{table.file} has no column {column!r}, {suggest(column, list(frame))}")
            metadata = path_metadata(study.circuit, study.names, path, "columns")
            unit = column.rpartition("[")[2].rstrip("]").strip() if "[" in column else "1"
            options = {"level": metadata.get("level"), "atmospheric_pressure": builder.atmospheric_pressure}
            factor, offset = conversion(unit, metadata["unit"], **options)
            columns[path] = factor * frame[column].to_numpy(dtype=float) + offset
        return Draws.from_table(columns)


def _reductions(study: Study, table: SweepTable, builder: Builder) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Reductions by name, and the thresholds that are asked for, in SI."""
    known, found, thresholds = reduction_types(), {}, {}
    for i, entry in enumerate(table.reduction):
        where = f"sweep.reduction.{i}"
        if entry.type not in known:
            raise StudyError(f"{where}: unknown type {entry.type!r}, {suggest(entry.type, known)}")
        metadata = look_up(entry.output, study.names.outputs, f"{where}.output", "output")
        options, gauge = dict(entry.options), is_gauge(study.circuit, entry.output)
        if "level" in options:
            options["level"] = builder.shown(options["level"], metadata, f"{where}.options.level", gauge)
        with at(where):
            reduction = known[entry.type](entry.output, **options)
        name = entry.name or f"{entry.type} {entry.output}"
        if name in found:
            raise StudyError(f"{where}: there are two reductions {name!r}: give one of them another name")
        found[name] = reduction
        if entry.above:
            thresholds[name] = [builder.shown(x, metadata, f"{where}.above", gauge) for x in entry.above]
    return found, thresholds


def reduction_types() -> dict[str, Any]:
    """The reductions of one output, by name."""
    return {kind.__name__: kind for kind in OfOneOutput.__subclasses__()}


def _sampler(table: SweepTable, numbers: Uncertain, count: int | None) -> samplers.AbstractSampler | None:
    """The sampler; None where every row of a table of cases is taken once."""
    if table.cases is not None and not table.uncertain and count is None:
        return None
    kind = _SAMPLERS[table.sampler]
    if kind is samplers.Grid:
        return samplers.Grid(tuple(_levels(entry) for entry in table.uncertain))
    options: dict[str, Any] = {"seed": table.seed}
    if kind is samplers.SobolIndices:
        options["second_order"] = table.second_order
    if kind is samplers.LatinHypercube:
        options["count"] = count
    return kind(**options)


def _levels(entry: UncertainTable) -> int:
    """The levels of a number on a grid: as many as a discrete one has values."""
    if entry.levels is not None:
        return entry.levels
    if entry.discrete is not None:
        return len(np.atleast_1d(entry.discrete.get("values", [])))
    raise StudyError(f"sweep.uncertain: {entry.path[0]} needs levels for a grid, such as levels = 5")
