"""A store survives what may happen to it: kills, full disks, torn files, two writers, changed plans."""

import dataclasses
import errno
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from jaxlines.inference import sweep_claims, sweep_store
from jaxlines.inference.samplers import Grid, LatinHypercube, MonteCarlo, Sobol
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_claims import Claims
from jaxlines.inference.sweep_collect import collect
from jaxlines.inference.sweep_plan import SweepPlan
from jaxlines.inference.sweep_run import SweepStopped
from jaxlines.inference.sweep_store import ChangedPlan, SweepStore, open_store

from .sweep_cases import ANGLES, Analytic
from .sweep_victim import COUNT, PLAN

MODEL = Analytic("ishigami", ("a", "b", "c"))
SIMPLE = SweepPlan(MODEL, ANGLES, MonteCarlo(7))


def table_of(result) -> bytes:
    return (result.folder / "table.parquet").read_bytes()


def kill_and_resume(folder: Path, kills: int) -> int:
    """Kill sweeps at random moments of their work; how many of them were at work when they were killed."""
    chance, at_work = random.Random(3), 0
    for _ in range(kills):
        command = [sys.executable, "-m", "tests.inference.sweep_victim", str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]) as victim:
            assert victim.stdout is not None
            for _ in range(chance.randint(1, 60 // kills)):
                victim.stdout.readline()
            time.sleep(chance.uniform(0.0, 0.02))
            victim.send_signal(signal.SIGKILL)
            at_work += "finished" not in victim.stdout.read()
    return at_work


@pytest.mark.parametrize("kills", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_killed_at_random_moments_it_resumes_to_a_table_of_the_same_bytes(tmp_path, kills):
    assert kill_and_resume(tmp_path / "killed", kills) >= kills / 2
    resumed = run_sweep(PLAN, COUNT, store=tmp_path / "killed", resume=True)
    whole = run_sweep(dataclasses.replace(PLAN, model=PLAN.model), COUNT, store=tmp_path / "whole", chunk=125)
    assert table_of(resumed) == table_of(whole)
    events, _ = open_store(tmp_path / "killed").manifest()
    assert sum(event["event"] == "run" for event in events) == kills + 1
    assert not list((resumed.folder / "claims").iterdir())
    for q, values in whole.found.bands["wave"].quantiles.items():
        assert np.array_equal(values, resumed.found.bands["wave"].quantiles[q])


def test_a_sweep_is_extended_with_what_is_there(tmp_path):
    first = run_sweep(SIMPLE, 1000, store=tmp_path, chunk=256)
    kept = {path.name: path.stat().st_mtime_ns for path in (first.folder / "chunks").iterdir()}
    more = run_sweep(SIMPLE, 3000, store=tmp_path, resume=True)
    after = {path.name: path.stat().st_mtime_ns for path in (more.folder / "chunks").iterdir()}
    assert more.folder == first.folder
    assert more.count == 3000
    assert kept.items() <= after.items()
    assert table_of(more) == table_of(run_sweep(SIMPLE, 3000, store=tmp_path / "at once"))


def test_a_store_with_lanes_wants_to_be_resumed(tmp_path):
    run_sweep(SIMPLE, 100, store=tmp_path)
    with pytest.raises(FileExistsError, match="resume"):
        run_sweep(SIMPLE, 100, store=tmp_path)


def test_a_changed_plan_is_refused_unless_told(tmp_path):
    run_sweep(SIMPLE, 100, store=tmp_path)
    changed = dataclasses.replace(SIMPLE, sampler=MonteCarlo(8))
    with pytest.raises(ChangedPlan, match=r"sampler\.seed: 7 -> 8"):
        run_sweep(changed, 100, store=tmp_path, resume=True)
    assert run_sweep(changed, 100, store=tmp_path, resume=True, allow_changes=True).count == 100


def test_a_latin_hypercube_cannot_be_extended(tmp_path):
    run_sweep(dataclasses.replace(SIMPLE, sampler=LatinHypercube(0, 50)), store=tmp_path)
    with pytest.raises(ChangedPlan, match="LatinHypercube sweep, which cannot be extended"):
        run_sweep(dataclasses.replace(SIMPLE, sampler=LatinHypercube(0, 60)), store=tmp_path, resume=True)


def test_a_grid_cannot_be_extended(tmp_path):
    run_sweep(dataclasses.replace(SIMPLE, sampler=Grid((2, 3, 2))), store=tmp_path)
    with pytest.raises(ChangedPlan, match="Grid sweep, which cannot be extended"):
        run_sweep(dataclasses.replace(SIMPLE, sampler=Grid((2, 4, 2))), store=tmp_path, resume=True)


def test_shards_make_one_table(tmp_path):
    for i in (3, 1):
        part = run_sweep(SIMPLE, 1000, store=tmp_path / "s", resume=True, chunk=64, shard=(i, 3))
        assert part.count == 0
        assert "other shards" in str(part)
    whole = run_sweep(SIMPLE, 1000, store=tmp_path / "s", resume=True, shard=(2, 3))
    assert whole.count == 1000
    assert table_of(whole) == table_of(run_sweep(SIMPLE, 1000, store=tmp_path / "one"))
    with pytest.raises(ValueError, match="shard must be i of n"):
        run_sweep(SIMPLE, 10, store=tmp_path / "s", shard=(0, 3))


def test_two_writers_never_compute_the_same_chunk(tmp_path):
    slow = dataclasses.replace(SIMPLE, model=dataclasses.replace(MODEL, pause=0.02))
    errors: list[BaseException] = []

    def work():
        try:
            run_sweep(slow, 640, store=tmp_path, resume=True, chunk=32)
        except BaseException as error:
            errors.append(error)

    workers = [threading.Thread(target=work) for _ in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not errors
    events, torn = open_store(tmp_path).manifest()
    written = sorted(event["start"] for event in events if event["event"] == "chunk")
    assert written == list(range(0, 640, 32))
    assert torn == 0


def test_claims_of_the_dead_are_taken_over_and_of_the_living_are_not(tmp_path, monkeypatch):
    mine, other = Claims(tmp_path), Claims(tmp_path)
    assert mine.take(5)
    assert not other.take(5)
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    claim = tmp_path / "000000006.0"
    content = {"place": sweep_claims._place(), "pid": int(dead.stdout), "born": ""}
    claim.write_text(json.dumps(content))
    assert other.take(6)
    elsewhere = tmp_path / "000000007.0"
    elsewhere.write_text(json.dumps({**content, "place": "another machine"}))
    assert not other.take(7)
    os.utime(elsewhere, (time.time() - 1000, time.time() - 1000))
    assert other.take(7)
    assert not mine.take(7)
    other.close()
    mine.close()
    assert not list(tmp_path.iterdir())


def test_a_full_disk_loses_nothing_that_was_written(tmp_path, monkeypatch):
    real, calls = os.fsync, []

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) > 40:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(descriptor)

    monkeypatch.setattr(sweep_store.os, "fsync", full)
    with pytest.raises((SweepStopped, OSError), match="No space left on device"):
        run_sweep(SIMPLE, 2000, store=tmp_path, chunk=50)
    monkeypatch.undo()
    store = open_store(tmp_path)
    assert 0 < len(store.done()) < 40
    assert not list(store.chunks.glob(".tmp-*"))
    resumed = run_sweep(SIMPLE, 2000, store=tmp_path, resume=True)
    assert table_of(resumed) == table_of(run_sweep(SIMPLE, 2000, store=tmp_path / "one"))


@pytest.mark.parametrize("damage", ["torn", "empty", "flipped"])
def test_damaged_chunks_are_reported_and_computed_again(tmp_path, damage):
    whole = table_of(run_sweep(SIMPLE, 1000, store=tmp_path, chunk=250))
    store = open_store(tmp_path)
    path = sorted(store.chunks.glob("*.parquet"))[2]
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[len(content) // 3] ^= 0xFF
    path.write_bytes(b"" if damage == "empty" else content[:-10] if damage == "torn" else content)
    if damage == "flipped":  # only seen when it is read
        with pytest.raises(OSError, match="damaged and was set aside: resume"):
            collect(store)
    again = run_sweep(SIMPLE, 1000, store=tmp_path, resume=True)
    assert table_of(again) == whole
    assert damage == "flipped" or "was damaged" in str(again)


def test_a_torn_manifest_is_read_and_written_on(tmp_path):
    run_sweep(SIMPLE, 100, store=tmp_path, chunk=50)
    store = open_store(tmp_path)
    manifest = store.folder / "manifest.jsonl"
    manifest.write_bytes(manifest.read_bytes()[:-9])
    store.log({"event": "after"})
    events, torn = store.manifest()
    assert events[-1] == {"event": "after"}
    assert torn == 1
    assert [event["event"] for event in events[:2]] == ["run", "chunk"]


def test_times_are_in_the_manifest_only(tmp_path):
    a, b = (run_sweep(SIMPLE, 100, store=tmp_path / name, chunk=50).folder for name in "ab")
    for path in [*a.glob("*.json"), *a.glob("*.parquet"), *a.glob("chunks/*.parquet")]:
        assert path.read_bytes() == (b / path.relative_to(a)).read_bytes(), path.name
    run = open_store(tmp_path / "a").manifest()[0][0]
    assert {"versions", "processor", "program", "host", "time"} <= set(run)


def test_a_chunk_that_cannot_be_computed_stops_with_its_reason(tmp_path, monkeypatch):
    from . import sweep_cases

    real, calls = sweep_cases.FUNCTIONS["ishigami"], []

    def broken(x):
        calls.append(len(x))
        if len(calls) > 6:
            raise MemoryError("of the device")
        return real(x)

    monkeypatch.setitem(sweep_cases.FUNCTIONS, "ishigami", broken)
    with pytest.raises(SweepStopped, match=r"chunks could not be computed.*MemoryError: of the device.*resume"):
        run_sweep(SIMPLE, 1000, store=tmp_path, chunk=100)
    monkeypatch.undo()
    assert open_store(tmp_path).done()
    assert run_sweep(SIMPLE, 1000, store=tmp_path, resume=True).count == 1000


def test_an_interrupt_leaves_a_store_to_resume(tmp_path):
    def stop(progress):
        if progress.done >= 300:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(SIMPLE, 1000, store=tmp_path, chunk=100, progress=stop)
    store = open_store(tmp_path)
    assert [event["event"] for event in store.manifest()[0]][-1] == "interrupted"
    assert not list((store.folder / "claims").iterdir())
    seen = []
    assert run_sweep(SIMPLE, 1000, store=tmp_path, resume=True, progress=seen.append).count == 1000
    assert seen[-1].done == 1000
    assert "1,000 of 1,000 lanes" in str(seen[-1])


def test_other_steps_than_at_the_start_are_refused(tmp_path):
    run_sweep(SIMPLE, 100, store=tmp_path)
    prepared = open_store(tmp_path).folder / "prepared.json"
    prepared.write_text(prepared.read_text().replace('"steps": 1', '"steps": 2'))
    with pytest.raises(RuntimeError, match="steps 1, the sweep was begun with 2"):
        run_sweep(SIMPLE, 200, store=tmp_path, resume=True)


def test_several_sweeps_in_a_folder_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError, match="no sweep in this folder"):
        open_store(tmp_path)
    for seed in (1, 2):
        run_sweep(dataclasses.replace(SIMPLE, sampler=Sobol(seed)), 64, store=tmp_path)
    with pytest.raises(ValueError, match="2 sweeps: name one"):
        open_store(tmp_path)
    assert isinstance(open_store(tmp_path / SIMPLE.__class__(MODEL, ANGLES, Sobol(1)).hash()), SweepStore)
