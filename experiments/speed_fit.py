"""How fast is a fit? One recording and many at once, against SciPy, Numba and CasADi at the same optimum.

The fits are those of `speed_fit_problem.py`, the peers those of `speed_fit_peers.py`: the same model, tolerance of
1e-6, weights, bounds and starts, 30 to 60 % away in every number. Peers fit a few recordings, and their time is
multiplied (results say so). SciPy runs on one core, and its time for many is divided by the number of cores, as if
processes shared them without loss; Numba is given the better of that and of its own threads. Aimed at: many recordings
100 times as fast as SciPy over its LSODA and 3 times as fast as SciPy over Numba; one recording, warm, 10 times as fast
as the former. Claimed, also on processors whose vector units are half as wide and beside other work: 100, 2 and 8
times; estimates that agree within 0.05 of a standard error.

Writes results.json. Exits with 1 when a claim is missed.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import speed_fit_peers as peers
import speed_fit_problem as problem
from ensemble_peers import CORES, Missing
from first_result import machine

import jaxlines as jl

CLAIMS = {"many_over_scipy": 100.0, "many_over_numba": 2.0, "one_over_scipy": 8.0}
AIMS = {"many_over_scipy": 100.0, "many_over_numba": 3.0, "one_over_scipy": 10.0}
AGREEMENT = 0.05


def fit_many(task: problem.Task) -> jl.BatchFit:
    """All recordings of a task by one batched fit."""
    return jl.fit_batch(
        problem.circuit(),
        problem.recordings(task),
        free=problem.free(),
        starts=problem.starts_of(task),
        local=problem.local(task),
        noise={"A.pressure": problem.NOISE},
    )


def timed(work: Callable, repeats: int) -> tuple[object, dict[str, float]]:
    """What work gives, and its times [s]: the first one (cold), and the least of some later ones."""
    began = time.perf_counter()
    work()
    cold, warm, processor, found = time.perf_counter() - began, [], [], None
    for _ in range(repeats):
        began, used = time.perf_counter(), time.process_time()
        found = work()
        warm.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
    return found, {"cold_s": cold, "warm_s": min(warm), "warm_processor_s": min(processor)}


def runs_of_peers(task: problem.Task, few: int, some: int) -> tuple[dict[str, peers.Fits], dict[str, str]]:
    """Name -> fits of each peer, and of those that cannot run here the reason."""
    every = {
        "SciPy LSODA": lambda: peers.scipy_lsoda(task.part(few)),
        "SciPy LSODA, right-hand side by Numba": lambda: peers.scipy_lsoda(task.part(some), compiled=True),
        "Numba DOPRI5, one thread": lambda: peers.numba_dopri5(task.part(some), 1),
        "Numba DOPRI5, all threads": lambda: peers.numba_dopri5(task.part(some), CORES),
        "CasADi RK4, 4 steps, exact slopes": lambda: peers.casadi_rk4(task.part(some)),
    }
    found, missing = {}, {}
    for name, run in every.items():
        try:
            found[name] = run()
        except (Missing, ImportError) as reason:
            missing[name] = str(reason)
    return found, missing


def row(name: str, fits: peers.Fits, values: np.ndarray, sd: np.ndarray, count: int) -> dict:
    """What a peer needs for one fit and, extrapolated, for many, and how far its estimates are from ours."""
    done = len(fits.values)
    shared = 1 if name.endswith("all threads") else CORES
    away = np.abs((fits.values - values[:done]) / sd[:done])
    return {
        "fits_measured": done,
        "one_s": fits.seconds / done,
        "one_processor_s": fits.processor_seconds / done,
        "many_s": fits.seconds / done * count / shared,
        "many_is_extrapolated": done != count or shared > 1,
        "evaluations_per_fit": fits.simulations,
        "compile_s": fits.compile_seconds,
        "largest_difference_in_standard_errors": float(away.max()),
    }


def judged(many: dict, one: dict, rows: dict[str, dict]) -> dict[str, float]:
    """The ratios that are claimed."""
    scipy = rows["SciPy LSODA"]
    ratios = {"many_over_scipy": scipy["many_s"] / many["warm_s"], "one_over_scipy": scipy["one_s"] / one["warm_s"]}
    numba = [r["many_s"] for name, r in rows.items() if name.startswith("Numba")]
    if numba:
        ratios["many_over_numba"] = min(numba) / many["warm_s"]
    return ratios


def main() -> int:
    """Fit, compare, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    parser.add_argument("--count", type=int, default=500, help="recordings that are fitted at once")
    parser.add_argument("--few", type=int, default=5, help="recordings that SciPy alone fits")
    parser.add_argument("--some", type=int, default=50, help="recordings that the other peers fit")
    parser.add_argument("--repeats", type=int, default=3, help="warm runs, of which the fastest counts")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    ran_on = machine()
    task = problem.make_task(args.count)
    fit, many = timed(lambda: fit_many(task), args.repeats)
    one = timed(lambda: fit_many(task.part(1)), args.repeats)[1]
    assert isinstance(fit, jl.BatchFit)
    values = problem.from_paths(fit.values)
    sd = fit.sd / fit.values * values
    found, missing = runs_of_peers(task, min(args.few, args.count), min(args.some, args.count))
    rows = {name: row(name, fits, values, sd, args.count) for name, fits in found.items()}
    ratios, converged = judged(many, one, rows), fit.status.count("converged")
    agree = all(r["largest_difference_in_standard_errors"] <= AGREEMENT for r in rows.values())
    missed = [name for name, ratio in ratios.items() if ratio < CLAIMS[name]]
    missed += [] if agree else ["same optimum"]
    missed += [] if converged == args.count else ["all converged"]
    results = {
        "machine": ran_on,
        "count": args.count,
        "cores": CORES,
        "converged": converged,
        "jaxlines": {"many": many, "one": one, "fits_per_second": args.count / many["warm_s"], "engine": fit.engine},
        "peers": rows,
        "not_run": missing,
        "ratios": ratios,
        "claims": CLAIMS,
        "aims": AIMS,
        "missed": missed,
    }
    part = args.out / "results.json.part"
    part.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    os.replace(part, args.out / "results.json")
    shown = ", ".join(f"{name.replace('_', ' ')} {ratio:.3g} times" for name, ratio in ratios.items())
    print(
        f"{'MISSED (' + ', '.join(missed) + '): ' if missed else ''}{args.count} recordings in {many['warm_s']:.2f} s "
        f"warm ({many['cold_s']:.1f} s cold), one in {one['warm_s']:.3f} s; {shown}"
    )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
