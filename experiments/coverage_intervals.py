"""Do 95 % intervals of the control line's parameters hold the truth 95 times in 100, with white and AR(1) noise?

    python experiments/coverage_intervals.py --out results/coverage_intervals [--count 1000] [--bootstrap 200]

Data sets are made of the true circuit and fitted in batches from the example's starts, 30 % and more away. With white
noise Wald intervals are those of the batched fit; with AR(1) noise they are what the package does by default, which
includes testing the residuals. Likelihood intervals are found by direct search. Bootstrap intervals use moving blocks.
A fit or an end point that fails is a miss. Exits with 1 when a count leaves the 99.9 % band of a right interval.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from coverage_line import CORRELATION, LABELS, Line, LineProblem, band, compiled, make_line, noise, save
from rich.console import Console
from rich.table import Table
from scipy import stats

import jaxlines as jl
from jaxlines.inference.least_squares import solve
from jaxlines.inference.noise_models import solve_with_autoregression
from jaxlines.inference.profiles import intervals
from jaxlines.inference.robust_covariance import block_bootstrap, uncertainty_under_noise

FREEDOM_FACTOR = 0.975


def wald_of_batch(line: Line, fits, exact) -> np.ndarray:
    """Which truths lie in the intervals of the batched fit, shape (data sets, parameters)."""
    x = line.to_coordinates(fits.values)
    slopes = np.stack([f.slope(fits.values[:, i]) for i, f in enumerate(line.free)], axis=1)
    factor = stats.t.ppf(FREEDOM_FACTOR, line.times.size - len(LABELS))
    good = np.array([status == "converged" for status in fits.status])[:, None]
    return good & (np.abs(x - exact) <= factor * fits.sd / slopes)


def wald_by_default(problem, solution, exact) -> tuple[np.ndarray, str]:
    """The same from the package's own choice of a noise model, and which one it was."""
    found = uncertainty_under_noise(problem, solution, draws=200)
    return np.abs(found.x - exact) <= found.factor * found.sd, found.method


def profile_hits(problem, solution, exact) -> np.ndarray:
    """Which truths lie in their likelihood intervals; an end that was not found is a miss."""
    hits = []
    for i, found in enumerate(intervals(problem, solution, noise="estimated").values()):
        low, high = found.ends
        hits.append(bool(low <= exact[i] <= high))
    return np.array(hits)


def bootstrap_hits(problem, solution, exact, seed: int) -> np.ndarray:
    """Which truths lie within the normal interval of a moving-block bootstrap."""
    sd = block_bootstrap(problem, solution, count=300, refit=False, seed=seed).std(axis=0, ddof=1)
    return np.abs(solution.x - exact) <= stats.t.ppf(FREEDOM_FACTOR, solution.residuals.size - exact.size) * sd


def study(line: Line, programs, correlation: float, count: int, num_bootstrap: int, say) -> dict:
    """Hits of every method on `count` data sets with one kind of noise."""
    exact = line.to_coordinates(line.truth)
    pressures = np.asarray(programs[0](exact)) + noise(
        np.random.default_rng(round(100 * correlation)), count, line.times.size, correlation
    )
    fits = jl.fit_batch(line.circuit, [line.recording(p) for p in pressures], free=line.free)
    say(f"correlation {correlation}: {count} fits, {fits.num_iterations} iterations")
    ends = line.to_coordinates(fits.values)
    hits = {name: np.zeros(len(LABELS), dtype=int) for name in ("wald", "profile", "bootstrap")}
    methods: dict[str, int] = {}
    if correlation == 0.0:
        hits["wald"] = wald_of_batch(line, fits, exact).sum(axis=0)
    for lane in range(count):
        if fits.status[lane] != "converged":
            continue
        problem = LineProblem(line, programs, pressures[lane])
        solution = solve(problem, ends[lane], tolerance=1e-9)
        if not solution.ok:
            continue
        if correlation:
            inside, method = wald_by_default(problem, solution, exact)
            hits["wald"] += inside
            methods[method] = methods.get(method, 0) + 1
            hits["profile"] += profile_hits(*solve_with_autoregression(problem, solution), exact)
        else:
            hits["profile"] += profile_hits(problem, solution, exact)
        if lane < num_bootstrap:
            hits["bootstrap"] += bootstrap_hits(problem, solution, exact, lane)
        if lane % 50 == 49:
            say(f"correlation {correlation}: {lane + 1} of {count}")
    return {
        "hits": {name: dict(zip(LABELS, map(int, found), strict=True)) for name, found in hits.items()},
        "methods": methods,
        "failed": int(sum(status != "converged" for status in fits.status)),
    }


def judge(found: dict, count: int, num_bootstrap: int) -> tuple[dict, list[str]]:
    """The band of each method and the counts that leave it."""
    bands = {"wald": band(count), "profile": band(count), "bootstrap": band(num_bootstrap)}
    missed = [
        f"{kind} {method} {label}: {hits}"
        for kind, result in found.items()
        for method, by_label in result["hits"].items()
        for label, hits in by_label.items()
        if not bands[method][0] <= hits <= bands[method][1]
    ]
    return bands, missed


def main() -> int:
    """Make, fit, count, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    parser.add_argument("--count", type=int, default=1000, help="data sets for Wald and likelihood intervals")
    parser.add_argument("--bootstrap", type=int, default=200, help="data sets for the bootstrap")
    options = parser.parse_args()
    num_bootstrap, began = min(options.bootstrap, options.count), time.process_time()
    console = Console(width=120, highlight=False, stderr=True)
    warnings.simplefilter("ignore")
    line = make_line()
    programs = compiled(line)
    with jl_precision():
        found = {
            kind: study(line, programs, correlation, options.count, num_bootstrap, console.print)
            for kind, correlation in (("white", 0.0), ("AR(1)", CORRELATION))
        }
    bands, missed = judge(found, options.count, num_bootstrap)
    table = Table("noise", "method", "band", *LABELS)
    for kind, result in found.items():
        for method, by_label in result["hits"].items():
            table.add_row(kind, method, "{}..{}".format(*bands[method]), *map(str, by_label.values()))
    Console(width=140).print(table)
    finding = f"{options.count} data sets, {num_bootstrap} for the bootstrap: " + (
        "every count lies in its band" if not missed else "OUTSIDE THE BAND: " + "; ".join(missed)
    )
    cpu = time.process_time() - began
    save(options.out, {"found": found, "bands": bands, "missed": missed, "cpu_seconds": cpu, "finding": finding})
    print(finding)
    return 1 if missed else 0


def jl_precision():
    """Float64 for what is called outside the package's own calls."""
    from jaxlines.simulation.precision import computing_in

    return computing_in("float64")


if __name__ == "__main__":
    sys.exit(main())
