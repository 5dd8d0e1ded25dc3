"""Do a million lanes of a DSN control line cost more in a sweep than bare, and does a sweep stay small?

    python experiments/sweep_scale.py --out results/sweep_scale [--lanes 1000000]

A control line of the 70-m antennas whose motors are held (`jaxlines.catalogue.dsn70m`), pumped up and let down by its
valve and saved at 601 times as in the bundled example, with six uncertain numbers. The sweep samples, computes, writes
every lane to disk, and collects moments and quantiles of the peak pressure. It runs in a process of its own, whose
memory is measured, and is compared there with the bare ensemble program (no sampling, no files, no statistics), run
before and after.

Claims: quantiles of all lanes within 2 GiB, right to 0.1 % of the spread against a plain sort; throughput, collecting
included, at least 90 % of the bare ensemble's. Writes results.json. Exits with 1 when a claim fails.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from first_result import machine

import jaxlines as jl
from jaxlines.catalogue import dsn70m
from jaxlines.inference.circuit_sweep import circuit_plan
from jaxlines.inference.distributions import LogNormal, Normal, Triangular, Uniform
from jaxlines.inference.samplers import Sobol
from jaxlines.inference.sweep import chosen_chunk, run_sweep
from jaxlines.inference.sweep_plan import SweepPlan
from jaxlines.inference.sweep_store import open_store
from jaxlines.simulation.reductions import Peak

MEMORY_LIMIT = 2 * 2**30
SHARE_LIMIT = 0.90
QUANTILE_LIMIT = 1e-3  # of the standard deviation
BARE_RUNS, BARE_LANES = 4, 131_072
TIMES = np.linspace(0.0, 12.0, 601)  # those of the bundled example of a control line
FLOW = jl.Sampled(
    [0.0, 0.5, 0.6, 4.0, 4.1, 8.0, 8.1, 10.0, 10.1, 12.0], 6.5e-5 * np.array([0, 0, 1, 1, 0, 0, -1, -1, 0, 0])
)


def make_plan() -> SweepPlan:
    """The line, what is uncertain of it, and the peak of its pressure."""
    oil = jl.Oil(1.379e9, 850.0, 27.7e-6, air_fraction=5e-3, polytropic_index=1.2)
    parts = {
        "line": dsn70m.control_line("azimuth_1", "A"),
        "valve": jl.FlowSource("A", "flow"),
        "leak": jl.LaminarLeak("A", "tank", conductance=5e-12),
        "reservoir": jl.Tank("tank"),
    }
    numbers = {
        "fluid.bulk_modulus": Triangular(0.9e9, 1.379e9, 1.6e9),
        "fluid.air_fraction": LogNormal(5e-3, 0.5),
        "fluid.polytropic_index": Uniform(1.0, 1.4),
        "leak.conductance": LogNormal(5e-12, 0.3),
        "initial.A.pressure": Uniform(1.2e5, 5e5),
        "valve.gain": Normal(1.0, 0.02),
    }
    outputs = {"peak": Peak("A.pressure")}
    return circuit_plan(
        jl.Circuit(oil, parts), TIMES, numbers, outputs=outputs, inputs={"flow": FLOW}, sampler=Sobol(1)
    )


def timed(run) -> tuple[Any, float, float]:
    """What a function returns, and the wall and processor time it takes [s]."""
    began, used = time.perf_counter(), time.process_time()
    return run(), time.perf_counter() - began, time.process_time() - used


def bare_times(plan: SweepPlan, program, first: int) -> tuple[float, float]:
    """Wall and processor time a lane of the bare program, for values that are there already [s]."""
    varied = plan.varied(plan.samples(first, first + BARE_LANES))
    _, seconds, used = timed(lambda: program.run(varied))
    return seconds / BARE_LANES, used / BARE_LANES


def measure(folder: Path, lanes: int) -> dict:
    """Bare runs, the sweep, bare runs: rates, quantiles and their errors, memory."""
    plan = make_plan()
    chunk = chosen_chunk(lanes, plan.model.lanes_at_once())
    run_sweep(plan, 2 * chunk, store=folder / "warm", chunk=chunk)  # loads and compiles what is needed once
    program = plan.model.prepare(plan.varied(plan.samples(0, 64)))
    program.run(plan.varied(plan.samples(0, BARE_LANES)))
    before = peak_memory()
    bare = [bare_times(plan, program, k * BARE_LANES) for k in range(BARE_RUNS)]
    result, seconds, used = timed(lambda: run_sweep(plan, lanes, store=folder / "sweep"))
    bare += [bare_times(plan, program, k * BARE_LANES) for k in range(BARE_RUNS)]
    memory = peak_memory()
    store, summary = open_store(folder / "sweep"), result["peak"]
    every = np.sort(np.concatenate([columns["peak"] for _, columns in store.tables(["peak"])]))
    every = every[np.isfinite(every)]
    errors = {
        f"{q.probability:g}": (q.value - float(np.quantile(every, q.probability))) / summary.sd
        for q in summary.quantiles
    }
    size = sum(path.stat().st_size for path in store.folder.rglob("*") if path.is_file())
    return {
        "lanes": result.count,
        "failed": result.failed_fraction,
        "bare_lanes_per_second": [1 / wall for wall, _ in bare],
        "processor_share": lanes / used * float(np.mean([cpu for _, cpu in bare])),
        "sweep_seconds": seconds,
        "sweep_lanes_per_second": lanes / seconds,
        "share": lanes / seconds * float(np.mean([wall for wall, _ in bare])),
        "peak_memory_bytes": memory,
        "peak_memory_before_bytes": before,
        "disk_bytes": size,
        "engine": dict(program.description),
        "quantiles": {f"{q.probability:g}": [q.value, *q.ci95] for q in summary.quantiles},
        "quantile_errors": errors,
    }


def peak_memory() -> int:
    """The largest resident memory of this process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def finding(result: dict) -> str:
    """The result in one line."""
    missed = [name for name, holds in result["claims"].items() if not holds]
    worst = max(abs(error) for error in result["quantile_errors"].values())
    verdict = f"MISSED: {', '.join(missed)}" if missed else "all claims hold"
    return (
        f"{result['lanes']:,} lanes at {result['sweep_lanes_per_second']:,.0f}/s, {100 * result['share']:.1f} % of the "
        f"bare ensemble; {result['peak_memory_bytes'] / 2**30:.2f} GiB, {result['disk_bytes'] / 2**20:.0f} MiB "
        f"on disk; quantiles right to {100 * worst:.2g} % of the spread; {verdict}"
    )


def main() -> int:
    """Measure in a process of its own, judge, write results.json."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    parser.add_argument("--lanes", type=int, default=1_000_000)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child is not None:
        given.out.write_text(json.dumps(measure(given.child, given.lanes)))
        return 0
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=given.out) as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, __file__, "--out", str(answer), "--lanes", str(given.lanes), "--child", folder]
        subprocess.run(command, check=True, env={**os.environ, "EQX_ON_ERROR": "nan"})
        result = json.loads(answer.read_text())
    result["machine"] = machine()
    result["claims"] = {
        "memory": result["peak_memory_bytes"] <= MEMORY_LIMIT,
        "throughput": result["share"] >= SHARE_LIMIT,
        "quantiles": max(abs(error) for error in result["quantile_errors"].values()) <= QUANTILE_LIMIT,
        "lanes": result["lanes"] == given.lanes,
    }
    result["finding"] = finding(result)
    temporary = given.out / ".results.json"
    temporary.write_text(json.dumps(result, indent=1) + "\n")
    temporary.replace(given.out / "results.json")
    print(result["finding"])
    return 0 if all(result["claims"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
