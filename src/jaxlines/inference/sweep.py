"""A circuit for many values of uncertain numbers: what spreads, how far, and because of what."""

import dataclasses
import json
import shutil
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.inference.propagation import lanes_to_evaluate, linear_propagation
from jaxlines.inference.samplers import Grid, Rows
from jaxlines.inference.statistics import QUANTILES
from jaxlines.inference.sweep_collect import collect, nothing
from jaxlines.inference.sweep_plan import PILOT, SweepPlan
from jaxlines.inference.sweep_result import SweepResult
from jaxlines.inference.sweep_run import Progress, prepare_store, run_chunks
from jaxlines.inference.sweep_store import ChangedPlan, SweepStore, stores_in, write_new
from jaxlines.inference.sweep_workers import run_lanes


def run_sweep(
    plan: SweepPlan,
    count: int | None = None,
    *,
    store=None,
    resume: bool = False,
    allow_changes: bool = False,
    chunk: int | None = None,
    where: str = "local",
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    thresholds: dict[str, list[float]] | None = None,
    quantiles=QUANTILES,
    linear: bool = True,
    progress: Callable[[Progress], Any] | None = None,
    title: str = "",
) -> SweepResult:
    """Run a plan and collect what it says. See `sweep` for the arguments; title: of the report.

    Raises: ValueError, KeyError for a wrong call, before any work; FileExistsError when the store has lanes and resume
        is False; ChangedPlan, RuntimeError when resuming would mix different numbers; SweepStopped when lanes could not
        be computed or written.
    """
    total = plan.sampler.total(plan.uncertain.dims)
    if count is None and total is None:
        raise ValueError(f"{type(plan.sampler).__name__} has no end: say how many lanes, count=10_000")
    count = total if count is None else count
    assert count is not None
    plan.check_count(count)
    for name in thresholds or {}:
        if name not in plan.model.reductions:
            known = ", ".join(plan.model.reductions) or "none"
            raise KeyError(f"thresholds: there is no reduction {name!r}; there are {known}")
    if chunk is not None and chunk < 1:
        raise ValueError(f"chunk must be 1 or more lanes, got {chunk}")
    _check_shard(shard)
    options = {"engine": where, "workers": workers, "shard": shard, "progress": progress}
    chunk = chunk or chosen_chunk(count, plan.model.lanes_at_once())
    if store is not None:
        opened = _opened(Path(store), plan, resume, allow_changes, chunk)
        opened.ask(thresholds or {}, quantiles, title)
        return _run(opened, plan, count, linear, options)
    folder = tempfile.mkdtemp(prefix="jaxlines-sweep-")
    try:
        opened = SweepStore.create(folder, plan, chunk)
        opened.ask(thresholds or {}, quantiles, title)
        result = _run(opened, plan, count, linear, options)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    return result


def _run(store: SweepStore, plan: SweepPlan, count: int, linear: bool, options) -> SweepResult:
    """Compute what is missing in a store, and collect all of it."""
    notes = store.check()
    if store.pending(count, options["shard"]):
        program, prepared, more = prepare_store(store, plan)
        notes += more
        if linear and not isinstance(plan.sampler, Grid | Rows):
            _store_linear(store, plan, program)
        run_chunks(store, plan, program, prepared, count, **options)
    missing = store.pending(count)
    if missing and options["shard"] != (1, 1):
        found = nothing(f"{len(missing)} chunks are left to the other shards: collect when they are done")
    else:
        found = collect(store)
    return SweepResult(store.folder, store.content, dataclasses.replace(found, notes=(*notes, *found.notes)))


def chosen_chunk(count: int, most: int) -> int:
    """Lanes of a chunk, a power of two: a sixteenth of all, 1024 at least (fewer for a short sweep), `most` at most."""
    return min(most, max(1 << (count // 16).bit_length(), min(1024, max(64, 1 << (count - 1).bit_length()))))


def _check_shard(shard: tuple[int, int]) -> None:
    number, of = shard
    if not 1 <= number <= of:
        raise ValueError(f"shard must be i of n with 1 <= i <= n, got {number}/{of}")


def _opened(root: Path, plan: SweepPlan, resume: bool, allow_changes: bool, chunk: int) -> SweepStore:
    """The store of a plan, when it may be used."""
    own, others = root / plan.hash(), [path for path in stores_in(root) if path.name != plan.hash()]
    if own.is_dir() and not resume and any((own / "chunks").glob("[0-9]*.parquet")):
        raise FileExistsError(f"{own} has lanes of this sweep already: resume it (resume=True, --resume)")
    if resume and not (own / "plan.json").is_file() and others and not allow_changes:
        before = SweepStore(others[-1])
        if not before.content["extendable"] and _same_but_count(before.content["plan"], plan.identity()):
            kind = before.content["plan"]["sampler"]["type"]
            raise ChangedPlan(
                f"{others[-1]} is a {kind} sweep, which cannot be extended or cut: its lanes depend on their number. "
                "Use Sobol or MonteCarlo for a count that may grow, or allow changes to begin a new sweep beside it"
            )
        changes = "; ".join(list(_differences(before.content["plan"], plan.identity()))[:4])
        raise ChangedPlan(
            f"the plan has changed since {others[-1].name} ({changes}): go back to it, or allow changes "
            "(allow_changes=True, --allow-changes) to begin a new sweep beside it"
        )
    return SweepStore.create(root, plan, chunk)


def _same_but_count(before: dict, now: dict) -> bool:
    """Whether two identities differ in the number of lanes of the same sampler only."""
    own = {key: value for key, value in before["sampler"].items() if key in ("count", "levels")}
    return before == json.loads(json.dumps({**now, "sampler": {**now["sampler"], **own}}))


def _differences(before: Any, now: Any, place: str = ""):
    """What differs between two identities, in words."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in [*before, *(key for key in now if key not in before)]:
            yield from _differences(before.get(key), now.get(key), f"{place}.{key}" if place else key)
    elif before != json.loads(json.dumps(now)):
        yield f"{place}: {_short(before)} -> {_short(now)}"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _store_linear(store: SweepStore, plan: SweepPlan, program: Any) -> None:
    """Linear propagation around the means, into linear.json; nothing when a lane of it fails."""
    path = store.folder / "linear.json"
    if path.exists() or not plan.model.reductions:
        return
    means, covariance, lanes = lanes_to_evaluate(plan.uncertain)
    found = run_lanes(plan, program, lanes, PILOT)  # as many at once as the pilot, whose program is there
    if np.any(found.status != 0):
        store.log({"event": "note", "note": "no linear propagation: a lane around the means failed"})
        return
    exact: dict[str, np.ndarray] = {}
    if getattr(program, "derivatives", None) is not None:
        gradients = program.derivatives(plan.varied(lanes[:1]))
        for reduction, of in gradients.items():
            driven = [plan.paths[name] for name in plan.uncertain.names]
            exact[reduction] = np.asarray([sum(float(of[path][0]) for path in paths) for paths in driven])
    names = plan.uncertain.names
    linear = {
        name: linear_propagation(name, names, means, covariance, lanes, values, exact.get(name))
        for name, values in found.reductions.items()
    }
    content = {
        name: {f.name: _json(getattr(of, f.name)) for f in dataclasses.fields(of)} for name, of in linear.items()
    }
    write_new(path, lambda temporary: temporary.write_text(json.dumps(content, indent=1)))


def _json(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
