"""What does the ring-down of a hose tell? Lumped lines fitted to every run of the rotary actuators, and carried over.

Question: which lumped line describes the pressure after an actuator meets its end stop, how well, and do its numbers
hold for units that were not fitted?

Model, two lumps: supply at the hold pressure -> line and hose (inertance I_1, resistance R_1, capacitance C_h) ->
passage into the actuator (I_2, R_2) -> chamber (C_p), where the gauge sits and from which the actuator draws Q_0:

    I_1 dQ_1/dt = p_s - p_h - R_1 Q_1 - K Q_1|Q_1|    C_h dp_h/dt = Q_1 - Q_2
    I_2 dQ_2/dt = p_h - p - R_2 Q_2                   C_p dp/dt = Q_2 - Q_0 / (1 + exp(4 (t - d)/T))

Free in a run: I_1, R_1, C_h, I_2, R_2, C_p, delay d and duration T of the arrest; K follows from the steady balance
before the stop, Q_0 from a parabola through 0.1 s of the angle before it. The older structure, one lump that takes
the measured rate of the angle, is fitted beside it; so are structures between both. Everything is in raw counts:
frequency, damping and relative numbers can be stated, never Pa, a bulk modulus or an air fraction.

Answer on 333 runs of four units: RMSE median 0.36 % and 90th percentile 0.43 % of hold (one lump: 1.11 % and 1.30 %);
runs of a unit that was not learnt from are predicted within 0.65 % (median) and 0.99 % (90th percentile). Modes at
21.7 Hz (damping ratio 0.29) and 88.6 Hz (0.17). Left-out runs want neither air (on its bound in 330 runs) nor a
duration of their own for the stop; what is left over has a shape common to all runs (76 % of its mean square).
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from ringdown_carry_over import carry_over, paired, spread, wanted
from ringdown_data import Ringdown, read_all
from ringdown_figure import draw
from ringdown_fits import Fits, baseline, fit_all, residuals, table
from ringdown_model import AIRY, BASELINE, MAIN, SHORT, STRUCTURES
from ringdown_statistics import common_shape, information, uncertainty

TARGETS = {"median": 0.5, "p90": 0.7, "converged_share": 0.97, "other_units_median": 1.3, "other_units_p90": 1.3}
TWICE = (BASELINE, MAIN)  # structures that are searched from two starts
CARRIED = (BASELINE, SHORT, MAIN, AIRY)  # structures whose numbers are carried over
NOT_SETTLED = [
    "scale: volumes, moduli and pressures in Pa need one known volume or a calibrated gauge",
    "temperature: it drifts with hold pressure within a unit and differs with load and wear between units",
    "air against hose stiffening: both stiffen the line with pressure, and stroke speed rises with it as well",
    "the delay of the angle channel against wind-up of the shaft",
    "what is left after the fit has a shape common to all runs (common_share_of_residuals): the structure still lacks "
    "something, which no interval within a run shows",
]


def stiffness_trend(rows: pd.DataFrame) -> dict:
    """d ln stiffness / d ln hold pressure by unit, ports apart, with standard error, with and without speed."""
    trend = {}
    for unit, part in rows.groupby("unit"):
        if len(part) < 8:
            continue
        y, hold, speed = (np.log(part[c].to_numpy()) for c in ("stiffness", "hold_counts", "speed_counts_per_s"))
        ports = pd.get_dummies(part["port"]).to_numpy(float)
        for label, columns in (("alone", [hold]), ("beside stroke speed", [hold, speed])):
            design = np.column_stack([*columns, ports])
            solution, *_ = np.linalg.lstsq(design, y, rcond=None)
            left = y - design @ solution
            variance = left @ left / (len(y) - design.shape[1]) * np.linalg.pinv(design.T @ design)[0, 0]
            trend.setdefault(str(unit), {})[label] = {"slope": float(solution[0]), "se": float(np.sqrt(variance))}
    return trend


def structures_table(runs: list[Ringdown], fits: dict[str, Fits], carried: dict) -> dict:
    """One entry a structure: errors, status, criteria, what is common to its residuals, left-out runs."""
    found = {}
    for name, fit in fits.items():
        found[name] = {
            **{f"{k}_rmse_percent": v for k, v in spread(fit.percent).items()},
            "converged": int(fit.converged.sum()),
            "on_a_bound": sum(s == "at_bound" for s in fit.result.status),
            "free_parameters": list(fit.result.names),
            "common_share_of_residuals": common_shape(residuals(runs, fit)),
            **information(runs, fit),
            "left_out_rmse_percent": {
                kind: spread(list(errors[name].values())) for kind, (errors, _) in carried.items() if name in errors
            },
        }
    return found


def terms(carried: dict) -> dict:
    """Terms that were tried on top of the main structure, or of a simpler one, and whether left-out runs want them."""
    tried = {"air": (AIRY, MAIN), "duration of the stop": (MAIN, SHORT), "second lump": (MAIN, BASELINE)}
    found = {}
    for term, (more, less) in tried.items():
        by_kind = {kind: paired(errors, groups, more, less) for kind, (errors, groups) in carried.items() if groups}
        if by_kind:
            found[term] = {**by_kind, "wanted": all(wanted(difference) for difference in by_kind.values())}
    return found


def results_of(runs: list[Ringdown], fits: dict[str, Fits], rows: pd.DataFrame, carried: dict) -> dict:
    """What results.json says about the fits."""
    main_fit = fits[MAIN]
    told = terms(carried)
    return {
        "structure": MAIN,
        "fitted_runs": len(runs),
        "converged": int(main_fit.converged.sum()),
        "starts_or_searches_in_doubt": rows.loc[rows.status != "converged", ["run_id", "status"]].to_dict("records"),
        "rmse_percent": spread(main_fit.percent),
        "by_unit": {str(unit): {**spread(part.rmse_percent), "runs": len(part)} for unit, part in rows.groupby("unit")},
        "structures": structures_table(runs, fits, carried),
        "baseline_damped_cosine": spread(baseline(runs)),
        "left_out_damped_cosine": {
            kind: spread(list(errors["damped cosine"].values())) for kind, (errors, groups) in carried.items() if groups
        },
        "uncertainty": uncertainty(runs, STRUCTURES[MAIN], main_fit),
        "terms": told,
        "not_wanted": [term for term, one in told.items() if not one["wanted"]],
        "stiffness_over_hold": stiffness_trend(rows),
        **{
            f"median_{name}": float(np.median(rows[name])) for name in rows if name.startswith(("frequency", "damping"))
        },
        "median_residual_autocorrelation": float(rows.residual_autocorrelation.median()),
        "intervals": "standard deviations by Newey and West over 45 ms, as residuals are correlated; beside them the "
        "scatter of runs, and over units and ports Student intervals",
        "not_settled": NOT_SETTLED,
        "targets": TARGETS,
    }


def verdict(results: dict) -> tuple[bool, str]:
    """Whether the targets are met, and the finding in one sentence."""
    rmse, total = results["rmse_percent"], results["runs"]
    left = results["structures"][MAIN]["left_out_rmse_percent"].get("other units")
    older = results["structures"][BASELINE]
    passed = (
        rmse["median"] <= TARGETS["median"]
        and rmse["p90"] <= TARGETS["p90"]
        and results["converged"] >= TARGETS["converged_share"] * total
        and (left is None or left["median"] <= TARGETS["other_units_median"])
        and (left is None or left["p90"] <= TARGETS["other_units_p90"])
    )
    text = (
        f"two lumps: {results['converged']} of {total} runs converged, rmse median {rmse['median']:.2f} %, 90th "
        f"percentile {rmse['p90']:.2f} % of hold (one lump {older['median_rmse_percent']:.2f} and "
        f"{older['p90_rmse_percent']:.2f} %)"
    )
    if left is not None:
        text += f"; runs of other units predicted within {left['median']:.2f} % (median), {left['p90']:.2f} % (p90)"
    if results["terms"]:
        text += f"; not wanted by left-out runs: {', '.join(results['not_wanted']) or 'none of the terms tried'}"
    if AIRY in results["structures"]:
        text += f" (air on its bound in {results['structures'][AIRY]['on_a_bound']} runs)"
    text += f"; residuals are not white (neighbours correlate by {results['median_residual_autocorrelation']:.2f})"
    return passed, text


def save(folder: Path, content: dict) -> None:
    """Write results.json in one step, so that a reader never sees half of it."""
    part = folder / "results.json.part"
    part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    os.replace(part, folder / "results.json")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with runs.parquet and runs_index.csv")
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json, runs.csv and figure.png")
    parser.add_argument("--skip-carry-over", action="store_true", help="only fit every run")
    parser.add_argument("--only", nargs="+", choices=list(STRUCTURES), default=list(STRUCTURES), help="structures")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    console, began = Console(stderr=True), time.perf_counter()
    runs, trouble = read_all(args.data)
    console.log(f"{len(runs)} runs, {len(trouble)} left out")
    chosen = {name: s for name, s in STRUCTURES.items() if name in {*args.only, BASELINE, MAIN}}
    fits = {name: fit_all(runs, s, console, name, name in TWICE) for name, s in chosen.items()}
    fitting = time.perf_counter() - began
    rows = table(runs, STRUCTURES[MAIN], fits[MAIN])
    rows.to_csv(args.out / "runs.csv", index=False)
    kinds = () if args.skip_carry_over else ("halves", "other units")
    carried = {
        kind: carry_over(runs, {n: STRUCTURES[n] for n in CARRIED if n in fits}, fits, kind, console) for kind in kinds
    }
    results = {"runs": len(runs) + len(trouble), **results_of(runs, fits, rows, carried), "left_out": trouble}
    results |= {"figure": draw(args.out, runs, fits, rows, carried, TARGETS)}
    passed, text = verdict(results)
    results |= {"seconds": time.perf_counter() - began, "seconds_fitting": fitting, "passed": passed, "finding": text}
    save(args.out, results)
    print(("" if passed else "MISSED: ") + text)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
