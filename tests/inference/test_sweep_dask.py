"""The same sweep on a Dask cluster, with workers that die."""

import os
import signal
import threading
import time

import pytest

from jaxlines.inference.samplers import MonteCarlo
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_plan import SweepPlan
from jaxlines.inference.sweep_store import open_store
from jaxlines.inference.sweep_workers import make_engine

from .sweep_cases import ANGLES, Analytic

distributed = pytest.importorskip("distributed")
PLAN = SweepPlan(Analytic("ishigami", ("a", "b", "c"), outputs=("wave",)), ANGLES, MonteCarlo(1))
SLOW = SweepPlan(Analytic("ishigami", ("a", "b", "c"), outputs=("wave",), pause=0.1), ANGLES, MonteCarlo(1))


def table_of(result) -> bytes:
    return (result.folder / "table.parquet").read_bytes()


@pytest.mark.slow
def test_a_scheduler_by_its_address_gives_the_same_table(tmp_path):
    options = {"processes": False, "protocol": "tcp", "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=2, **options) as cluster:
        where = cluster.scheduler_address.replace("tcp://", "dask://")
        there = run_sweep(PLAN, 1000, store=tmp_path / "dask", chunk=256, where=where)
    assert table_of(there) == table_of(run_sweep(PLAN, 1000, store=tmp_path / "local", chunk=32))


@pytest.mark.slow
def test_workers_that_die_lose_nothing(tmp_path):
    with distributed.LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=":0") as cluster:
        address = cluster.scheduler_address.removeprefix("tcp://")
        done = threading.Event()

        def kill():
            for _ in range(3):
                time.sleep(1.0)
                if not done.is_set():
                    pids = [w.process.pid for w in cluster.workers.values() if w.process and w.process.pid]
                    os.kill(pids[0], signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        there = run_sweep(SLOW, 2000, store=tmp_path / "dask", chunk=20, where=f"dask://{address}")
        done.set()
        killer.join()
    local = run_sweep(SLOW, 2000, store=tmp_path / "local", chunk=500)
    assert table_of(there) == table_of(local)
    assert open_store(tmp_path / "dask").manifest()[0][0]["engine"] == f"dask://{address}"


@pytest.mark.slow
def test_a_cluster_of_four_on_this_machine(tmp_path):
    there = run_sweep(PLAN, 1000, store=tmp_path / "dask", chunk=32, where="dask", workers=4)
    assert table_of(there) == table_of(run_sweep(PLAN, 1000, store=tmp_path / "local", chunk=256))


def test_unknown_engines_and_numbers_of_workers_are_refused():
    with pytest.raises(ValueError, match='"local", "dask" or "dask://HOST:PORT", got \'ray\''):
        make_engine("ray")
    with pytest.raises(ValueError, match="1 or more, got 0"):
        make_engine("local", 0)
    with pytest.raises(OSError, match=r"Timed out|timed out"):
        make_engine("dask://127.0.0.1:1", timeout=0.5)
