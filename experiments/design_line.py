"""Does a designed test of a control line make bulk modulus and air fraction known as well as it was predicted to?

    python experiments/design_line.py --out results/design_line

The bundled dead-ended control line (`example:control-line`) is pumped up and let down through its valve. The flow of
the bundled recording, drawn as straight lines between knots, is the starting test. Two other flow profiles are
designed, one for the bulk modulus and one for the air fraction, within the starting test's own largest flow, slope,
energy and highest and lowest pressure. Each of the three tests is then simulated 200 times with fresh noise, and all
recordings are fitted in one batch. Claims: the scatter of the 200 estimates agrees with the standard deviation that was
predicted, for every test and parameter, within the 99 % band of chi-square; and each designed test makes its parameter
better known than the starting test, by at least a given factor in prediction, and by as much in the scatter within the
99 % band of a ratio of two variances. Exits with 1 when a claim is missed.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from make_control_line_recording import BAR, DURATION, L_PER_MIN, SENSORS, Truth, valve_flow
from scipy.stats import chi2, f as f_distribution

import jaxlines as jl
from jaxlines.edge.writing import plain, write_whole
from jaxlines.inference.design import design
from jaxlines.inference.design_inputs import Knots
from jaxlines.inference.design_result import Design

MODULUS, AIR, LEAK, PRESSURE = "fluid.bulk_modulus", "fluid.air_fraction", "leak.conductance", "initial.A.pressure"
TIMES = np.linspace(0.0, DURATION, 301)
KNOTS = np.linspace(0.0, DURATION, 21)
NOISE = SENSORS["pressure_noise_sd_bar"] * BAR
COUNT = 200
CONFIDENCE = 0.99
LEAST_GAIN = {MODULUS: 1.25, AIR: 1.5}
"""A designed test must make the standard deviation of its parameter so many times smaller."""


def setting() -> tuple[jl.Circuit, list[jl.Free]]:
    """The line of the example with the numbers behind its recording, and what is free in a fit."""
    truth, study = Truth(), jl.load_study("example:control-line")
    values = {
        MODULUS: truth.liquid_modulus_Pa,
        AIR: truth.air_fraction,
        LEAK: truth.leak_m3_per_s_Pa,
        PRESSURE: truth.initial_pressure_Pa_abs,
    }
    free = [jl.Free(f.paths[0], f.bounds, values[f.label], f.transform) for f in study.free]
    return study.circuit.replace({path: v for path, v in values.items() if path != PRESSURE}), free


def starting_profile() -> np.ndarray:
    """The valve flow of the bundled recording at the knots [m3/s]."""
    return np.asarray(valve_flow(KNOTS), dtype=float)


def pressure(circuit: jl.Circuit, inputs: dict, start: float) -> np.ndarray:
    """Pressure of the line without noise [Pa absolute]."""
    shown = jl.simulate(circuit, TIMES, inputs, initial={"A.pressure": start}, outputs=["A.pressure"], tolerance=1e-9)
    return np.asarray(shown["A.pressure"])


def excitation() -> Knots:
    """The flow to be designed, within the largest flow, slope and energy of the starting test."""
    start = starting_profile()
    largest = float(np.abs(start).max())
    rate = float(np.abs(np.diff(start) / np.diff(KNOTS)).max())
    bare = Knots("flow", KNOTS, -largest, largest, start)
    energy = bare.energy_of(bare.start_coefficients)
    return Knots("flow", KNOTS, -largest, largest, start, rate=rate, first=0.0, last=0.0, energy=energy)


def designed(circuit: jl.Circuit, free: list[jl.Free], starts: int) -> dict[str, Design]:
    """A design for each of the two parameters, within the pressures of the starting test."""
    flow = excitation()
    initial = next(f.start for f in free if f.label == PRESSURE)
    assert initial is not None
    seen = pressure(circuit, {"flow": flow.signal(flow.start_coefficients)}, initial)
    return {
        target: design(
            circuit,
            free,
            times=TIMES,
            sensors=["A.pressure"],
            noise={"A.pressure": NOISE},
            excite=flow,
            target=target,
            limits={"A.pressure": (float(seen.min()), float(seen.max()))},
            starts=starts,
        )
        for target in (MODULUS, AIR)
    }


def scatter(circuit: jl.Circuit, free: list[jl.Free], inputs: dict, count: int, seed: int) -> tuple[np.ndarray, dict]:
    """Estimates of `count` noisy recordings of one test, fitted in one batch, shape (recordings, free); how they ended.

    Every search starts from the values of the example's study file, as a user's would.
    """
    rng, clean = np.random.default_rng(seed), pressure(circuit, inputs, float(free[3].start or 0.0))
    flow = np.interp(TIMES, inputs["flow"].times, inputs["flow"].values)
    recordings = [
        jl.Recording(TIMES, {"A.pressure": clean + NOISE * rng.standard_normal(TIMES.size), "flow": flow}, name=f"{i}")
        for i in range(count)
    ]
    began = time.process_time()
    found = jl.fit_batch(
        circuit, recordings, free=jl.load_study("example:control-line").free, noise={"A.pressure": NOISE}
    )
    endings = {status: found.status.count(status) for status in set(found.status)}
    return found.values, {"endings": endings, "cpu_seconds": time.process_time() - began, "engine": found.engine}


def compare(names, values: np.ndarray, predicted: np.ndarray, truth: np.ndarray) -> dict[str, dict]:
    """For each parameter the predicted and the realised standard deviation and whether they agree."""
    count = len(values)
    low, high = np.sqrt(chi2.ppf([0.5 * (1 - CONFIDENCE), 0.5 * (1 + CONFIDENCE)], count - 1) / (count - 1))
    rows = {}
    for i, name in enumerate(names):
        sd, mean = float(np.std(values[:, i], ddof=1)), float(np.mean(values[:, i]))
        rows[name] = {
            "truth": float(truth[i]),
            "predicted_sd": float(predicted[i]),
            "realised_sd": sd,
            "ratio": sd / float(predicted[i]),
            "band": [float(low), float(high)],
            "agrees": bool(low <= sd / predicted[i] <= high),
            "bias_over_standard_error": (mean - float(truth[i])) / (sd / np.sqrt(count)),
        }
    return rows


def judge(tests: dict[str, dict], designs: dict[str, Design], count: int) -> tuple[dict, dict[str, bool]]:
    """Gains by prediction and by scatter, and whether each claim holds."""
    wide = np.sqrt(f_distribution.ppf(0.5 * (1 + CONFIDENCE), count - 1, count - 1))
    gains, claims = {}, {}
    for target, found in designs.items():
        base, own = (tests[name]["parameters"][target] for name in ("starting", target))
        predicted, realised = found.improvement, base["realised_sd"] / own["realised_sd"]
        gains[target] = {"predicted": predicted, "realised": realised}
        claims[f"designed for {target}: predicted gain at least {LEAST_GAIN[target]}"] = predicted >= LEAST_GAIN[target]
        claims[f"designed for {target}: realised gain as predicted"] = 1 / wide <= realised / predicted <= wide
        claims[f"designed for {target}: limits kept"] = limits_kept(found)
    for name, test in tests.items():
        claims[f"{name} test: every fit converged"] = set(test["endings"]) == {"converged"}
        for parameter, row in test["parameters"].items():
            claims[f"{name} test: scatter of {parameter} as predicted"] = row["agrees"]
    return gains, claims


def limits_kept(found: Design) -> bool:
    """Whether flow, slope, energy and pressure stay within those of the starting test, to one part in 10 000."""
    profile, more = found.profiles["flow"], 1.0 + 1e-4
    level = np.abs(profile.values).max() <= profile.high * more
    slope = np.abs(np.diff(profile.values) / np.diff(profile.times)).max() <= (profile.rate or 0.0) * more
    limit, shown = found.limits[0], found.outputs["A.pressure"]
    inside = limit.low / more <= shown.min() and shown.max() <= limit.high * more
    return bool(level and slope and profile.energy <= profile.base_energy * more and inside)


def summary(found: Design) -> dict:
    """What of a design goes into results.json."""
    profile = found.profiles["flow"]
    return {
        "finding": found.finding(),
        "table": found.table(),
        "knots_s": profile.times.tolist(),
        "flow_L_per_min": (profile.values / L_PER_MIN).tolist(),
        "starting_flow_L_per_min": (profile.base_values / L_PER_MIN).tolist(),
        "energy_over_starting": profile.energy / profile.base_energy,
        "limits_reached": list(found.active),
        "not_told": list(found.unidentified),
        "starts": [start._asdict() for start in found.starts],
        "simulations": found.num_simulations,
    }


def finding(tests: dict, gains: dict, claims: dict[str, bool], count: int) -> str:
    """The result in one line."""
    ratios = [row["ratio"] for test in tests.values() for row in test["parameters"].values()]
    parts = [
        f"designed for {target}: {gain['predicted']:.2f} times smaller predicted, {gain['realised']:.2f} seen"
        for target, gain in gains.items()
    ]
    parts.append(f"realised over predicted {min(ratios):.3f} .. {max(ratios):.3f} with {count} fits a test")
    missed = [claim for claim, holds in claims.items() if not holds]
    parts.append(f"{len(claims) - len(missed)} of {len(claims)} claims hold")
    return "; ".join(parts + [f"MISSED: {', '.join(missed)}"] * bool(missed))


def main() -> int:
    """Design, simulate, fit, judge, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    parser.add_argument("--count", type=int, default=COUNT, help="recordings of each test")
    parser.add_argument("--starts", type=int, default=3, help="searches for each design")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    circuit, free = setting()
    designs = designed(circuit, free, given.starts)
    first = designs[MODULUS]
    runs = {"starting": (first.base_inputs, first.sd_base)} | {n: (d.inputs, d.sd) for n, d in designs.items()}
    tests = {}
    for seed, (name, (inputs, predicted)) in enumerate(runs.items()):
        values, facts = scatter(circuit, free, inputs, given.count, seed)
        tests[name] = facts | {"parameters": compare(first.names, values, predicted, first.values)}
        for parameter, row in tests[name]["parameters"].items():
            print(
                f"{name:>20} test, {parameter:<20} predicted {row['predicted_sd']:.4g}, realised "
                f"{row['realised_sd']:.4g}, ratio {row['ratio']:.3f}"
            )
    gains, claims = judge(tests, designs, given.count)
    result = {"designs": {n: summary(d) for n, d in designs.items()}, "tests": tests, "gains": gains, "claims": claims}
    result["finding"] = finding(tests, gains, claims, given.count)
    write_whole(given.out / "results.json", json.dumps(plain(result), indent=2) + "\n")
    print(result["finding"])
    return 0 if all(claims.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
