"""Do 95 % intervals of the control line's parameters hold the truth 95 times in 100, with white and AR(1) noise?

    python experiments/coverage_intervals.py --out results/coverage_intervals [--count 1000] [--bootstrap 200]

Data sets are made of the true circuit and fitted in batches from the example's starts, 30 % and more away. Counted are,
with 601 samples: `wald`, what `fit` states by default, which includes testing the residuals and choosing a noise model;
`profile`, likelihood intervals under the same noise (`Fit.assess`); the same two of generalised least squares
(`uncertainty_under_noise`) where the noise is AR(1); `bootstrap`, refits to moving blocks. The same with 121 samples is
reported without a claim. A fit or an end point that fails is a miss. Exits with 1 when a count leaves the 99.9 % band.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np
from coverage_batch import Lanes, condensed, drive, gauss_newton, make_lanes, rows_of, solution
from coverage_line import CORRELATION, LABELS, SAMPLES, SHORT, Rows, band, make_line, noise, save
from rich.console import Console
from rich.table import Table

import jaxlines as jl
from jaxlines.inference.bootstrap import block_length, draw_blocks
from jaxlines.inference.end_points import end_point_search
from jaxlines.inference.generalised import Whitened, channel_noise
from jaxlines.inference.profiles import cost_limit, parameter
from jaxlines.inference.robust_covariance import generalised_freedom
from jaxlines.inference.stated_noise import StatedNoise, state_noise
from jaxlines.inference.uncertainty import student_factor

COUNT = len(LABELS)


def stated_noises(lanes: Lanes, x, data) -> tuple[list[StatedNoise], np.ndarray]:
    """The noise that each lane's residuals show, by the package's rule, and slopes (lanes, samples, parameters)."""
    rows, slopes = rows_of(lanes, x, data, [None] * len(x))
    problem, freedom = Rows(rows.shape[1]), rows.shape[1] - COUNT
    found = [state_noise(problem, r, j, variance=float(r @ r) / freedom) for r, j in zip(rows, slopes, strict=True)]
    return found, slopes


def least_squares_reach(stated: StatedNoise, slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half lengths of the intervals that `fit` states, degrees of freedom, and variances over those of white noise."""
    size = np.linalg.norm(slopes, axis=0)
    gain = np.linalg.pinv(slopes / size) / size[:, None]
    variance, freedom = np.diag(stated.spread(gain)), stated.freedom(gain)
    white = stated.variance * np.sum(gain**2, axis=1)
    return student_factor(freedom) * np.sqrt(variance), freedom, variance / white


def profile_hits(lanes: Lanes, x, data, models, freedom, inflation, exact, known: str, say) -> np.ndarray:
    """Which truths lie in the likelihood intervals of each lane, (lanes, parameters); an end not found is a miss."""
    rows, slopes = condensed(*rows_of(lanes, x, data, models))
    samples, searches, of = data.shape[1], [], []
    for lane in range(len(x)):
        end = solution(x[lane], rows[lane], slopes[lane])
        for i in range(COUNT):
            # Condensed rows do not tell how many there are: s^2 is given through the inflation.
            scale = 2.0 * end.cost / (samples - COUNT) if known == "estimated" else 1.0
            limit = cost_limit(end, "known", 0.95, freedom[lane, i], scale * inflation[lane, i])
            for sign in (-1.0, 1.0):
                bounds = (lanes.line.lower, lanes.line.upper)
                searches.append(end_point_search(*bounds, end, parameter(i, COUNT), sign, limit))
                of.append(lane)
    ends = drive(lanes, searches, np.array(of), data, models, say)
    signed = {"found": 0.0, "open": np.inf, "failed": np.nan}
    found = np.array([end.value + signed[end.status] * sign for end, sign in zip(ends, [-1, 1] * (len(ends) // 2))])  # noqa: B905
    low, high = found.reshape(len(x), COUNT, 2).transpose(2, 0, 1)
    return (low <= exact) & (exact <= high)


def generalised(lanes: Lanes, x, data, stated, slopes) -> tuple[np.ndarray, list, np.ndarray, np.ndarray]:
    """Generalised least squares as in `solve_with_autoregression`: x, models, half lengths, degrees of freedom."""
    x, fitted = np.array(x), [own.fitted for own in stated]
    problem = Rows(data.shape[1])
    chosen = np.array([own is not None for own in fitted])
    for turn in range(2):
        if turn:
            rows, slopes = rows_of(lanes, x, data, [None] * len(x))
            fitted = [channel_noise(problem, rows[k], slopes[k]) if c else None for k, c in enumerate(chosen)]
        models = [None if own is None else own.models[0] for own in fitted]
        x, _ = gauss_newton(lanes, x, data, models)
    _, slopes = rows_of(lanes, x, data, [None] * len(x))
    _, white = rows_of(lanes, x, data, models)
    reach, freedom = np.zeros((len(x), COUNT)), np.zeros((len(x), COUNT))
    for k, own in enumerate(fitted):
        if own is None:
            reach[k], freedom[k], _ = least_squares_reach(stated[k], slopes[k])
            continue
        freedom[k] = generalised_freedom(Whitened(problem, own), slopes[k])
        reach[k] = student_factor(freedom[k]) * np.sqrt(np.diag(np.linalg.inv(white[k].T @ white[k])))
    return x, models, reach, freedom


def bootstrap_hits(lanes: Lanes, x, data, exact, draws: int, seed: int) -> np.ndarray:
    """Which truths lie within the normal interval of a moving-block bootstrap with refits, (lanes, parameters)."""
    rng, samples = np.random.default_rng(seed), data.shape[1]
    pressure, _ = lanes.at(x)
    enlarge, hits = np.sqrt(samples / (samples - COUNT)), np.zeros((len(x), COUNT), dtype=bool)
    for lane in range(len(x)):
        left = data[lane] - pressure[lane]
        length = block_length(left)
        made = np.stack([pressure[lane] + enlarge * draw_blocks(left, length, rng) for _ in range(draws)])
        ends, _ = gauss_newton(lanes, np.repeat(x[lane][None], draws, axis=0), made, rounds=3)
        factor = student_factor(float(samples - COUNT))
        hits[lane] = np.abs(x[lane] - exact) <= factor * ends.std(axis=0, ddof=1)
    return hits


def study(samples: int, correlation: float, count: int, num_bootstrap: int, draws: int, say) -> dict:
    """Hits of every method on `count` data sets with one kind of noise."""
    line = make_line(samples)
    lanes, exact = make_lanes(line), line.to_coordinates(line.truth)
    true_pressure = lanes.at(np.stack([exact, exact]))[0][0]
    data = true_pressure + noise(np.random.default_rng(round(100 * correlation)), count, samples, correlation)
    fits = jl.fit_batch(line.circuit, [line.recording(p) for p in data], free=line.free)
    good = np.array([status == "converged" for status in fits.status])
    say(f"{samples} samples, correlation {correlation}: {good.sum()} of {count} fits converged")
    x, last = gauss_newton(lanes, line.to_coordinates(fits.values), data, rounds=2)
    good &= last < 0.01
    stated, slopes = stated_noises(lanes, x, data)
    told = [least_squares_reach(own, j) for own, j in zip(stated, slopes, strict=True)]
    reach, freedom, inflation = (np.stack(part) for part in zip(*told, strict=True))
    hits = {"wald": np.abs(x - exact) <= reach}
    plain = [None] * count
    hits["profile"] = profile_hits(lanes, x, data, plain, freedom, inflation, exact, "estimated", say)
    if correlation:
        ends, models, reach, freedom = generalised(lanes, x, data, stated, slopes)
        hits["generalised wald"] = np.abs(ends - exact) <= reach
        ones = np.ones_like(freedom)
        whole = np.array([model is not None for model in models])
        scale = np.where(whole[:, None], ones, inflation * np.array([own.variance for own in stated])[:, None])
        hits["generalised profile"] = profile_hits(lanes, ends, data, models, freedom, scale, exact, "known", say)
    hits["bootstrap"] = bootstrap_hits(lanes, x[:num_bootstrap], data[:num_bootstrap], exact, draws, 1)
    methods = [own.method for own in stated]
    counted = {name: (own & good[: len(own), None]).sum(axis=0) for name, own in hits.items()}
    return {
        "hits": {name: dict(zip(LABELS, map(int, own), strict=True)) for name, own in counted.items()},
        "methods": {name: methods.count(name) for name in sorted(set(methods))},
        "failed": int(np.sum(~good)),
    }


def judge(found: dict, count: int, num_bootstrap: int) -> tuple[dict, list[str]]:
    """The band of each method and the counts that leave it."""
    bands = {name: band(count) for name in ("wald", "profile", "generalised wald", "generalised profile")}
    bands["bootstrap"] = band(num_bootstrap)
    missed = [
        f"{kind} {method} {label}: {hits}"
        for kind, result in found.items()
        for method, by_label in result["hits"].items()
        for label, hits in by_label.items()
        if not bands[method][0] <= hits <= bands[method][1]
    ]
    return bands, missed


def show(found: dict, bands: dict) -> None:
    """The counts as a table."""
    table = Table("noise", "method", "band", *LABELS)
    for kind, result in found.items():
        for method, by_label in result["hits"].items():
            table.add_row(kind, method, "{}..{}".format(*bands[method]), *map(str, by_label.values()))
    Console(width=150).print(table)


def main() -> int:
    """Make, fit, count, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    parser.add_argument("--count", type=int, default=1000, help="data sets for Wald and likelihood intervals")
    parser.add_argument("--bootstrap", type=int, default=200, help="data sets for the bootstrap")
    parser.add_argument("--draws", type=int, default=200, help="bootstrap samples a data set")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="samples of a data set in the claimed study")
    parser.add_argument("--no-short", action="store_true", help=f"leave out the study with {SHORT} samples")
    options = parser.parse_args()
    num_bootstrap, began = min(options.bootstrap, options.count), time.process_time()
    console = Console(width=120, highlight=False, stderr=True)
    warnings.simplefilter("ignore")

    def run(samples: int) -> dict:
        kinds = (("white", 0.0), ("AR(1)", CORRELATION))
        counts = (options.count, num_bootstrap, options.draws)
        return {f"{kind}, {samples} samples": study(samples, c, *counts, console.print) for kind, c in kinds}

    found = run(options.samples)
    bands, missed = judge(found, options.count, num_bootstrap)
    short = {} if options.no_short else run(SHORT)
    outside = judge(short, options.count, num_bootstrap)[1]
    show(found | short, bands)
    finding = f"{options.count} data sets of {options.samples} samples, {num_bootstrap} for the bootstrap: " + (
        "every count lies in its band" if not missed else "OUTSIDE THE BAND: " + "; ".join(missed)
    )
    if short:
        finding += f"; with {SHORT} samples (no claim) outside: {'; '.join(outside) or 'none'}"
    content = {"found": found, "short": short, "bands": bands, "missed": missed, "outside_when_short": outside}
    save(options.out, {**content, "cpu_seconds": time.process_time() - began, "finding": finding})
    print(finding)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
