"""Are posteriors of the control line's parameters right? Coverage of their intervals, and simulation-based calibration.

    python experiments/coverage_posterior.py --out results/coverage_posterior [--count 500] [--coverage 200]

Truths are drawn from the prior: the coordinates uniform in a box of four to eight standard errors around the example's
numbers, the noise log-normal around 0.4 bar. Each data set is made by the true circuit; its posterior is drawn by the
no-U-turn sampler with the noise inferred, starting from the truth's neighbourhood and warmed up. Ranks of the truths
and of their log-likelihood among thinned draws must be uniform within a simultaneous 99 % band; 95 % intervals of the
first data sets must hold the truth as often as they say. Exits with 1 when a claim is missed.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from coverage_batch import Lanes, make_lanes
from coverage_line import LABELS, NOISE_SD, band, make_line, save

from jaxlines.inference.calibration import calibrate, rank_of, thin
from jaxlines.inference.density import make_density
from jaxlines.inference.posterior import run_chain, whitening
from jaxlines.simulation.ensemble_program import chunk_tangent
from jaxlines.simulation.precision import cast, computing_in

SAMPLES = 61  # any number will do: a posterior is as exact with few samples as with many
NOISE_PRIOR = (0.0, 0.3)  # of the logarithm of the noise over 0.4 bar
HALF_WIDTHS = np.array([8.0, 6.0, 4.0, 4.0])  # of the prior's box, in standard errors of the example
WARMUP, DRAWS, THINNED = 200, 300, 49
LANES, FEW_LANES = 250, 65
"""Posteriors side by side. No multiples of 64: the engine hands whole blocks of 64 lanes, or fewer lanes, to a compiled
function of its own, which XLA's CPU compiler cannot place inside the sampler's loops (it ends the process)."""


def prior_box(lanes: Lanes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of the prior in coordinates, and the curvature of the likelihood at its middle."""
    line = lanes.line
    middle = line.to_coordinates(line.truth)
    slopes = lanes.at(np.stack([middle, middle]))[1][0] / NOISE_SD
    curvature = slopes.T @ slopes
    sd = np.sqrt(np.diag(np.linalg.inv(curvature)))
    low = np.maximum(middle - HALF_WIDTHS * sd, line.lower)
    return low, np.minimum(middle + HALF_WIDTHS * sd, line.upper), curvature


def traced(lanes: Lanes) -> Callable:
    """x -> pressure (samples,) and slopes by the coordinates (samples, 4), traceable; under vmap all lanes in step."""
    program, line = lanes.program, lanes.line
    logs = np.array([f.transform == "log" for f in line.free])
    order = [[f.paths[0] for f in line.free].index(paths[0]) for paths in program.paths]
    values, grid = cast((program.values, program.grid), "float64")

    def together(x):
        numbers = jnp.where(logs, jnp.exp(jnp.where(logs, x, 0.0)), x)
        columns = tuple(numbers[:, i] for i in order)
        outputs, slopes = chunk_tangent(program.program, values, columns, grid, program.steps)
        back = jnp.moveaxis(slopes[:, np.argsort(order), 0], -1, 0)  # (points, samples, numbers)
        return outputs[:, 0].T, back * jnp.where(logs, numbers, 1.0)[:, None]

    @jax.custom_batching.custom_vmap
    def one(x):
        pressure, slopes = together(x[None])
        return pressure[0], slopes[0]

    one.def_vmap(lambda size, batched, x: (together(x), (True, True)))
    return one


def make_sampler(model: Callable, low, high, curvature):
    """A compiled function of data sets: keys, data, starts -> draws of x and ln s, log-likelihoods, divergences."""
    zero = np.zeros(SAMPLES, dtype=int)
    width = high - low

    def log_likelihood(rows, logs):
        return -0.5 * jnp.sum(rows**2) * jnp.exp(-2.0 * logs[0]) - rows.size * logs[0]

    def one(key, data, centre):
        def both(x):
            pressure, slopes = model(x)
            return (pressure - data) / NOISE_SD, slopes / NOISE_SD

        density = make_density(both, low, high, zero, zero, noise_prior=NOISE_PRIOR)
        root = jnp.asarray(_root(curvature, width))
        keys = jax.random.split(key)
        start = 0.3 * jax.random.normal(keys[0], centre.shape)
        u, _, divergent = run_chain(keys[1], lambda u: density.log_density(centre + root @ u), start, WARMUP, DRAWS, 6)
        x, logs = jax.vmap(lambda u: density.to_x(centre + root @ u))(u[:: DRAWS // (2 * THINNED)])
        heights = jax.lax.map(lambda pair: log_likelihood(both(pair[0])[0], pair[1]), (x, logs))
        return x, logs, heights, divergent

    return jax.jit(jax.vmap(one))


def _root(curvature, width) -> np.ndarray:
    """Whitening in z of x = low + width * sigmoid(z), taken at the middle, and of ln s."""
    turn = 0.25 * width
    whole = np.zeros((turn.size + 1, turn.size + 1))
    whole[:-1, :-1] = curvature * np.outer(turn, turn) + 0.5 * np.eye(turn.size)
    whole[-1, -1] = 2.0 * SAMPLES + NOISE_PRIOR[1] ** -2
    return whitening(whole)


def draw_truths(rng, count: int, low, high) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and ln s from the prior."""
    return low + rng.random((count, low.size)) * (high - low), rng.normal(*NOISE_PRIOR, size=count)


def study(count: int, seed: int, say) -> tuple[dict, np.ndarray, int, float]:
    """Ranks by quantity, hits of 95 % intervals (data sets, quantities), divergences, smallest spread of draws."""
    rng, lanes = np.random.default_rng(seed), make_lanes(make_line(SAMPLES))
    low, high, curvature = prior_box(lanes)
    sampler = make_sampler(traced(lanes), low, high, curvature)
    x, logs = draw_truths(rng, count, low, high)
    exact = lanes.at(x)[0]
    unit = rng.standard_normal(exact.shape)
    data = exact + unit * NOISE_SD * np.exp(logs)[:, None]
    heights = -0.5 * np.sum(unit**2, axis=1) - SAMPLES * logs
    share = np.clip((x - low) / (high - low), 0.02, 0.98)
    centres = np.concatenate([np.log(share / (1.0 - share)), logs[:, None]], axis=1)
    ranks = {name: np.zeros(count, dtype=int) for name in (*LABELS, "noise", "log-likelihood")}
    hits, divergences = np.zeros((count, len(ranks)), dtype=bool), 0
    size = LANES if count > FEW_LANES else FEW_LANES
    for first in range(0, count, size):
        own = np.minimum(np.arange(first, first + size), count - 1)
        keys = jax.random.split(jax.random.key(seed + first), size)
        found = [np.asarray(a) for a in sampler(keys, data[own], centres[own])]
        for k in range(min(size, count - first)):
            lane = first + k
            every = np.concatenate([found[0][k], found[1][k], found[2][k][:, None]], axis=1)
            truth = np.concatenate([x[lane], [logs[lane], heights[lane]]])
            ends = np.quantile(every, [0.025, 0.975], axis=0)
            hits[lane] = (truth >= ends[0]) & (truth <= ends[1])
            for i, name in enumerate(ranks):
                ranks[name][lane] = rank_of(truth[i], thin(every[:, i], THINNED))
            divergences += int(found[3][k].sum())
        say(f"{min(first + size, count)} of {count} posteriors")
    return ranks, hits, divergences, float(np.min(high - low))


def main() -> int:
    """Draw, sample, rank, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    parser.add_argument("--count", type=int, default=500, help="replicates of the calibration")
    parser.add_argument("--coverage", type=int, default=200, help="of them the first ones whose intervals are counted")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    began, coverage = time.process_time(), min(options.coverage, options.count)
    warnings.simplefilter("ignore")
    with computing_in("float64"):
        ranks, hits, divergences, _ = study(
            options.count, options.seed, lambda text: print(text, file=sys.stderr, flush=True)
        )
    tests = calibrate(ranks, THINNED)
    counts = dict(zip(ranks, map(int, hits[:coverage].sum(axis=0)), strict=True))
    low, high = band(coverage)
    missed = [f"ranks of {t.name}" for t in tests if not t.inside]
    missed += [f"{name}: {n} hits" for name, n in counts.items() if name in LABELS and not low <= n <= high]
    for test in tests:
        print(
            f"{test.name:<22} hits {counts[test.name]} of {coverage}, ranks {test.worst:.2g} (limit {test.limit:.2g})"
        )
    finding = f"{options.count} replicates, {divergences} divergent trajectories: " + (
        "MISSED " + ", ".join(missed)
        if missed
        else "ranks inside their 99 % bands, intervals hold as often as they say"
    )
    content = {
        "ranks": {name: own.tolist() for name, own in ranks.items()},
        "tests": [{k: v for k, v in t._asdict().items() if k != "ranks"} for t in tests],
        "hits": counts,
        "band": [low, high],
        "divergences": divergences,
        "cpu_seconds": time.process_time() - began,
        "finding": finding,
    }
    save(options.out, content)
    print(finding)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
