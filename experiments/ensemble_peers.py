"""What the engines of the ensemble experiment have in common: rows of the table, errors, and timing.

A peer is a function that gives `Run`s; `measured` makes a `Row` of one, against a `servo_axis.Reference`. A peer
whose package or compiler is not there raises `Missing`, which `attempted` turns into a line of its own, so that the
others run.
"""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from servo_axis import Reference

CORES = os.cpu_count() or 1


class Missing(Exception):
    """A peer cannot run here; the message says why."""


class Run(NamedTuple):
    """What an engine did.

    pressure: p_A (lanes run, samples) [Pa]; seconds: wall time on all cores, compilation apart; lanes: indices of the
    lanes run (None: all); compile_seconds; extrapolated: measured on one core and divided by their number.
    """

    pressure: np.ndarray
    seconds: float
    compile_seconds: float
    lanes: np.ndarray | None = None
    extrapolated: bool = False


class Row(NamedTuple):
    """One row of the table; errors are None where no lane of the reference was run."""

    engine: str
    precision: str
    setting: str
    lanes: int
    sims_per_second: float
    rms_error_pa: float | None
    max_error_pa: float | None
    compile_seconds: float
    failed_lanes: int
    extrapolated: bool


class Errors(NamedTuple):
    """Errors of p_A over the lanes that did not fail, and how many did (of those compared)."""

    rms: float | None
    largest: float | None
    failed: int


def errors(pressure: np.ndarray, reference: Reference, lanes: np.ndarray | None = None) -> Errors:
    """Errors of p_A against the reference. A lane that is not finite has failed, and so has one 1e7 Pa off.

    Args: pressure (lanes run, samples) [Pa]; reference; lanes: indices of the lanes run (None: all from 0).
    """
    ran = np.arange(len(pressure)) if lanes is None else np.asarray(lanes)
    _, mine, theirs = np.intersect1d(ran, reference.lanes, return_indices=True)
    if not mine.size:
        return Errors(None, None, 0)
    off = np.asarray(pressure, dtype=float)[mine] - reference.pressure[theirs]
    with np.errstate(invalid="ignore"):
        good = np.isfinite(off).all(axis=1) & (np.abs(off).max(axis=1) < 1e7)
    if not good.any():
        return Errors(None, None, int(mine.size))
    kept = off[good]
    return Errors(float(np.sqrt(np.mean(kept * kept))), float(np.abs(kept).max()), int((~good).sum()))


def measured(engine: str, precision: str, setting: str, run: Run, reference: Reference) -> Row:
    """The row of a run."""
    found, count = errors(run.pressure, reference, run.lanes), len(run.pressure)
    return Row(
        engine,
        precision,
        setting,
        count,
        count / run.seconds,
        found.rms,
        found.largest,
        run.compile_seconds,
        found.failed,
        run.extrapolated,
    )


def attempted(peers: dict[str, Callable[[], list[Row]]]) -> tuple[list[Row], dict[str, str]]:
    """Rows of all peers that run here, and name -> reason of those that do not."""
    rows, missing = [], {}
    for name, peer in peers.items():
        try:
            rows += peer()
        except (Missing, ImportError) as problem:
            missing[name] = f"{type(problem).__name__}: {problem}"
    return rows, missing


def best_seconds(work: Callable[[], object], repeats: int) -> float:
    """The smallest wall time of some repeats [s], so that other work on the machine counts least."""
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return min(found)


def interleaved(calls: dict[str, Callable], repeats: int) -> dict[str, float]:
    """Best seconds of some calls, taken in turn so that a slow spell of the machine meets all of them."""
    best = {}
    for name, call in calls.items():
        call()  # compiles
        best[name] = np.inf
    for _ in range(repeats):
        for name, call in calls.items():
            began = time.perf_counter()
            call()
            best[name] = min(best[name], time.perf_counter() - began)
    return {name: float(seconds) for name, seconds in best.items()}


def in_threads(work: Callable, pieces: list) -> list:
    """work(piece) for all pieces, on all cores by threads, in order; for work that lets go of the interpreter."""
    if CORES == 1 or len(pieces) == 1:
        return [work(piece) for piece in pieces]
    with ThreadPoolExecutor(CORES) as pool:
        return list(pool.map(work, pieces))


def equal_accuracy(rows: list[Row], rms_error_pa: float) -> Row | None:
    """The fastest row whose rms error is no larger than a given one; None when there is none."""
    good = [row for row in rows if row.rms_error_pa is not None and row.rms_error_pa <= rms_error_pa]
    return max((row for row in good if not row.failed_lanes), key=lambda row: row.sims_per_second, default=None)
