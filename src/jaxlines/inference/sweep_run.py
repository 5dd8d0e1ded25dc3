"""Running a sweep: claims chunks, has them computed, writes them, and survives what may happen meanwhile."""

import concurrent.futures
import dataclasses
import importlib.metadata
import os
import platform
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxlines.inference.sweep_plan import SweepPlan
from jaxlines.inference.sweep_store import Piece, SweepStore
from jaxlines.inference.sweep_workers import (
    Engine,
    Result,
    Task,
    check_same,
    compute,
    make_engine,
    pilot_samples,
    plain,
    prepare,
)

MAX_FAILED_CHUNKS = 3
POLL_SECONDS = 0.5
_PACKAGES = ("jaxlines", "jax", "jaxlib", "diffrax", "numpy", "scipy", "pyarrow")


class SweepStopped(RuntimeError):
    """A sweep ended before its last lane; what was computed is kept, and resuming goes on from there."""


@dataclasses.dataclass
class Progress:
    """How far a sweep is: lanes done and wanted; of this run, lanes that failed and lanes a second."""

    done: int
    count: int
    failed: int
    rate: float

    @property
    def remaining(self) -> float:
        """Seconds to go at this rate."""
        return (self.count - self.done) / self.rate if self.rate > 0 else np.inf

    def __str__(self) -> str:
        left = "" if not np.isfinite(self.remaining) else f", {_duration(self.remaining)} left"
        failed = f", {self.failed:,} failed" if self.failed else ""
        return f"{self.done:,} of {self.count:,} lanes{failed}, {self.rate:,.0f} lanes/s{left}"


def _duration(seconds: float) -> str:
    """ "2 h 05 min"; "40 s"."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


def environment() -> dict:
    """What numbers may depend on besides the plan: versions and processor."""
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = None
    return {"python": platform.python_version(), "processor": _processor(), "versions": versions}


def _processor() -> str:
    """The processor type."""
    try:
        with open("/proc/cpuinfo") as file:
            return next(line.partition(":")[2].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def run_chunks(
    store: SweepStore,
    plan: SweepPlan,
    program: Any,
    prepared: dict,
    count: int,
    *,
    engine: str = "local",
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    progress: Callable[[Progress], Any] | None = None,
) -> None:
    """Compute what is missing of `count` lanes.

    Chunks that another process has claimed are left to it, and taken over if it dies; with a shard, only its chunks are
    computed and nobody is waited for. KeyboardInterrupt leaves a store that can be resumed.
    Raises: SweepStopped when chunks could not be computed or written, with the reason; what was written is kept.
    """
    pending = store.pending(count, shard)
    if not pending:
        return
    alone = engine == "local" and workers == 1
    task = Task.local(plan, prepared, store.chunk, program) if alone else Task.remote(plan, prepared, store.chunk)
    store.log(_header(store, plan, prepared, count, engine, workers, shard))
    job = _Job(store, task, count, progress, engine, workers)
    try:
        job.work(deque(pending), wait=shard == (1, 1))
    except KeyboardInterrupt:
        store.log({"event": "interrupted", "time": time.time(), "pid": os.getpid()})
        raise
    finally:
        job.close()


def _header(store: SweepStore, plan: SweepPlan, prepared: dict, count, engine, workers, shard) -> dict:
    """The line of the manifest that opens a run."""
    return {
        "event": "run",
        "time": time.time(),
        "host": platform.node(),
        "pid": os.getpid(),
        "count": count,
        "chunk": store.chunk,
        "shard": list(shard),
        "engine": engine,
        "workers": workers,
        "program": prepared["description"],
        **environment(),
    }


class _Job:
    """One run of this process: what is under way, what failed, how fast."""

    def __init__(self, store, task, count, progress, engine, workers):
        self.store, self.task, self.count, self.report = store, task, count, progress
        self.make = lambda: make_engine(engine, workers)
        self.engine: Engine = self.make()
        self.under_way: dict[concurrent.futures.Future, Piece] = {}
        self.errors: list[tuple[Piece, BaseException]] = []
        self.breaks = 0
        self.begun, self.computed, self.failed = time.perf_counter(), 0, 0
        self.before = sum(min(p.stop, count) - p.start for p in store.done() if p.start < count)

    def work(self, pending: deque[Piece], wait: bool) -> None:
        """Compute all pending pieces; with `wait`, also until those that others have are there."""
        while True:
            elsewhere = self._round(pending)
            if self.errors:
                piece, error = self.errors[0]
                raise SweepStopped(
                    f"{len(self.errors)} chunks could not be computed, the first the lanes {piece.start} to "
                    f"{piece.stop} ({type(error).__name__}: {error}); the others are kept: resume to try again"
                ) from error
            if not elsewhere or not wait:
                return
            time.sleep(POLL_SECONDS)
            pending = deque(self.store.pending(self.count))

    def _round(self, pending: deque[Piece]) -> int:
        """Compute what is not claimed by others. Returns how many chunks were."""
        elsewhere = 0
        while pending or self.under_way:
            while pending and len(self.under_way) < self.engine.slots and len(self.errors) < MAX_FAILED_CHUNKS:
                piece = pending.popleft()
                if not self.store.claims.take(piece.chunk):
                    elsewhere += 1
                elif not self._still_missing(piece):
                    self.store.claims.release(piece.chunk)
                else:
                    self._submit(piece)
            if not self.under_way:
                if len(self.errors) >= MAX_FAILED_CHUNKS:
                    break
                continue
            finished, _ = concurrent.futures.wait(self.under_way, return_when=concurrent.futures.FIRST_COMPLETED)
            for future in finished:
                self._finish(future, pending)
        return elsewhere

    def _still_missing(self, piece: Piece) -> bool:
        """Whether nobody wrote a piece before it was claimed."""
        if not self.store.has(piece):
            return True
        self.before += piece.stop - piece.start
        return False

    def _submit(self, piece: Piece) -> None:
        try:
            future = self.engine.executor.submit(compute, self.task, piece.start, piece.stop)
        except concurrent.futures.BrokenExecutor:
            self._renew()
            future = self.engine.executor.submit(compute, self.task, piece.start, piece.stop)
        self.under_way[future] = piece

    def _finish(self, future: concurrent.futures.Future, pending: deque[Piece]) -> None:
        """Write a result, or note why there is none."""
        piece = self.under_way.pop(future)
        try:
            result: Result = future.result()
        except concurrent.futures.BrokenExecutor as error:  # a process was killed: all its pool's work is lost
            self.store.claims.release(piece.chunk)
            pending.append(piece)
            self.store.log({"event": "worker died", "start": piece.start, "stop": piece.stop, "time": time.time()})
            self.breaks += 1
            if self.breaks > 10 * self.engine.slots:
                raise SweepStopped(
                    f"worker processes die again and again ({error}): is there enough memory?"
                ) from error
            return
        except Exception as error:  # of whatever kind: other chunks may be computed, this one is reported
            self.store.claims.release(piece.chunk)
            self.store.log({"event": "chunk failed", "start": piece.start, "stop": piece.stop, "error": repr(error)})
            self.errors.append((piece, error))
            return
        self._write(piece, result)

    def _write(self, piece: Piece, result: Result) -> None:
        try:
            self.store.write(piece, result.columns, result.series)
            self._log(piece, result)
        except OSError as error:
            done = sum(p.stop - p.start for p in self.store.done())
            raise SweepStopped(
                f"the lanes {piece.start} to {piece.stop} could not be written ({error.strerror or error}); {done:,} "
                f"lanes are safe in {self.store.folder}: make room, then resume"
            ) from error
        finally:
            self.store.claims.release(piece.chunk)
        self.computed += piece.stop - piece.start
        self.failed += int((result.columns["status"] != 0).sum())
        if self.report is not None:
            rate = self.computed / max(time.perf_counter() - self.begun, 1e-9)
            self.report(Progress(self.before + self.computed, self.count, self.failed, rate))

    def _log(self, piece: Piece, result: Result) -> None:
        codes, counts = np.unique(result.columns["status"], return_counts=True)
        self.store.log(
            {
                "event": "chunk",
                "start": piece.start,
                "stop": piece.stop,
                "status": {int(code): int(n) for code, n in zip(codes, counts, strict=True)},
                "seconds": round(result.seconds, 6),
                "host": result.host,
                "time": time.time(),
            }
        )

    def _renew(self) -> None:
        """Another pool after one broke."""
        self.engine.close()
        self.engine = self.make()

    def close(self) -> None:
        """End the engine; give back what is claimed."""
        for future in self.under_way:
            future.cancel()
        self.engine.close()
        self.store.claims.close()


def prepare_store(store: SweepStore, plan: SweepPlan) -> tuple[Any, dict, list[str]]:
    """The program, what the first worker fixed (this one, if none did), and notes on what differs harmlessly since.

    Raises: RuntimeError when this process would compute other numbers than those that are there.
    """
    pilot, known = plan.varied(pilot_samples(plan)), store.prepared()
    if known is None:
        program = plan.model.prepare(pilot)
        known = store.prepared(lambda: {**prepare(plan, program), "environment": environment()})
        assert known is not None
        if known["description"] == plain(program.description):
            return program, known, []
    program = plan.model.prepare(pilot, known["description"])
    check_same(known["description"], program.description)
    notes, mine = [], environment()
    if known["environment"]["processor"] != mine["processor"]:
        notes.append("another type of processor than at the start: equal within the tolerance, not bit for bit")
    theirs = known["environment"]["versions"]
    changed = [f"{p} {theirs.get(p)} -> {v}" for p, v in mine["versions"].items() if theirs.get(p) != v]
    if changed:
        notes.append(f"other versions than at the start ({', '.join(changed)}): equal within the tolerance")
    return program, known, notes
