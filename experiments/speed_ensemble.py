"""How fast are ensembles, at which error, beside the fastest that Python users have today?

    python experiments/speed_ensemble.py --out results/speed_ensemble [--lanes 4096] [--parts axis,derivatives,...]

The servo axis (servo_axis.py): a servovalve, two lines with entrained air, a motor with inertia; five states, nine
varied numbers, 2 s, 201 samples. Peers (extra `bench`, a C compiler): vmap(diffrax), parallel Numba, SUNDIALS, SciPy,
CasADi, and C with SIMD over lanes in the scheme of our explicit engine, the bound. Each runs at several settings;
errors are against a reference to rounding. Compared is the fastest setting of a peer whose rms error is no smaller
than ours and at most four times as large (else the next larger), so that the peer is at least as fast as at equal
error. Times on the clock, compiled, best of some repeats.

Parts: difference (our vector field against the plain one), axis, derivatives, profile (where the time goes), first
(time to the first result, in processes of their own), stiff, line, scaling (1e3 to 1e6 lanes). Writes results.json:
rows, ratios, targets. Exits with 1 when a claim is missed.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import ensemble_ours as ours
import ensemble_profile
import line_problem as line
import numpy as np
import servo_axis as axis
from ensemble_peers import Row, attempted
from ensemble_peers_all import axis_peers, line_peers, stiff_peers
from first_result import machine
from make_control_line_recording import save_json

PARTS = ("difference", "axis", "derivatives", "profile", "first", "stiff", "line", "scaling")


class Claims:
    """Measured numbers beside what is claimed of them and what was aimed at."""

    def __init__(self):
        self.rows: list[dict] = []

    def add(self, name: str, value: float | None, claimed: float, aim: float, at_most: bool = False) -> None:
        """Take down a number; claimed: what it must reach; aim: what was aimed at."""
        met = value is not None and (value <= claimed if at_most else value >= claimed)
        reached = value is not None and (value <= aim if at_most else value >= aim)
        self.rows.append({"name": name, "value": value, "claimed": claimed, "met": met, "aim": aim, "reached": reached})


def nearest(rows: list[Row], engine: str, precision: str, rms: float) -> Row | None:
    """The fastest setting of a peer whose rms error is no smaller than ours, and at most four times as large."""
    found = [r for r in rows if r.engine == engine and r.precision == precision and not r.failed_lanes]
    near = [r for r in found if r.rms_error_pa and rms <= r.rms_error_pa <= 4.0 * rms]
    worse = [r for r in found if r.rms_error_pa and r.rms_error_pa >= rms]
    if near:
        return max(near, key=lambda r: r.sims_per_second)
    return min(worse, key=lambda r: r.rms_error_pa or 0.0, default=None)


def ratios(rows: list[Row], claims: Claims) -> None:
    """Our explicit engine at three steps against each peer."""
    for precision in ("float64", "float32"):
        mine = next(
            r for r in rows if r.engine == "jaxlines explicit" and r.setting[0] == "3" and r.precision == precision
        )
        rms = mine.rms_error_pa or 0.0
        against = {
            "float64": [("Numba DOPRI5", "float64", 2.0, 3.0), ("vmap(diffrax Tsit5)", "float64", 4.0, 15.0)],
            "float32": [("Numba DOPRI5", "float64", 4.0, 10.0), ("Numba DOPRI5", "float32", 3.0, 6.0)],
        }[precision]
        against.append(("SIMD C, plain", precision, *((0.5, 0.6) if precision == "float64" else (0.45, 0.7))))
        for engine, its_precision, claimed, aim in against:
            peer = nearest(rows, engine, its_precision, rms)
            if peer is None and engine.startswith("SIMD"):  # the same scheme: the same steps
                peer = next(
                    (r for r in rows if r.engine == engine and r.precision == precision and r.setting[0] == "3"), None
                )
            value = mine.sims_per_second / peer.sims_per_second if peer else None
            where = f" at {peer.setting} ({peer.rms_error_pa:.0f} Pa)" if peer else ""
            claims.add(f"{precision} ({rms:.0f} Pa) over {engine} {its_precision}{where}", value, claimed, aim)


def servo(lanes: int, claims: Claims) -> tuple[list[Row], dict[str, str]]:
    """Our rows and the peers' on the servo axis."""
    columns = axis.lane_numbers(lanes)
    reference = axis.reference(columns, np.arange(64))
    rows = ours.axis_rows(columns, reference)
    peers, missing = attempted(axis_peers(columns, reference, np.arange(6)))
    ratios(rows + peers, claims)
    return rows + peers, missing


def variant(name: str, lanes: int, claims: Claims) -> tuple[list[Row], dict[str, str]]:
    """The stiff variant or the line of 40 segments against vmap(diffrax Kvaerno5)."""
    if name == "stiff":
        columns = axis.lane_numbers(lanes, variant=axis.STIFF)
        reference = axis.reference(columns, np.arange(8), 1e-9)
        program = ours.axis_program(columns, axis.STIFF)
        rows = ours.variant_rows(name, program, axis.varied(columns), "A.pressure", reference)
        peers, missing = attempted(stiff_peers({k: v[:256] for k, v in columns.items()}, reference))
    else:
        columns = line.varied(lanes)
        reference = line.reference(columns, np.arange(2))
        program = ours.line_program(columns, tolerance=1e-3)
        rows = ours.variant_rows(name, program, columns, f"{line.OUTPUT}.pressure", reference)
        few = {k: v[:16] for k, v in columns.items()}
        peers, missing = attempted(
            {k: v for k, v in line_peers(few, reference, tolerances=(1e-3, 1e-4)).items() if "Kvaerno5" in k}
        )
    rms = rows[0].rms_error_pa or 0.0
    peer = nearest(peers, "vmap(diffrax Kvaerno5)", "float64", rms)
    value = rows[0].sims_per_second / peer.sims_per_second if peer else None
    claims.add(f"{name} ({rms:.0f} Pa) over vmap(diffrax Kvaerno5)", value, 5.0, 5.0)
    return [r._replace(engine=f"{r.engine}, {name}") for r in rows + peers], missing


def first_calls(claims: Claims) -> dict[str, float]:
    """Seconds to the first result after imports: a fresh process, a gradient, a second process with a cache."""
    script = Path(__file__).with_name("ensemble_first_call.py")

    def seconds(*arguments: str) -> float:
        done = subprocess.run([sys.executable, script, *arguments], capture_output=True, text=True, check=True)
        return float(done.stdout.split()[-1])

    with tempfile.TemporaryDirectory() as cache:
        found = {"first": seconds("ensemble"), "gradient": seconds("gradient"), "filling": seconds("ensemble", cache)}
        found["second process"] = seconds("ensemble", cache)
    claims.add("first call [s]", found["first"], 5.0, 5.0, at_most=True)
    claims.add("first gradient [s]", found["gradient"], 10.0, 10.0, at_most=True)
    claims.add("second process, programs cached [s]", found["second process"], 2.0, 2.0, at_most=True)
    return found


def run(parts: list[str], lanes: int) -> tuple[dict, Claims]:
    """Everything that was asked for."""
    claims, results, rows, missing = Claims(), {}, [], {}
    if "difference" in parts:
        results["right_hand_side_difference"] = axis.right_hand_side_difference()
        claims.add("difference of the vector fields", results["right_hand_side_difference"], 1e-12, 1e-12, at_most=True)
    if "axis" in parts:
        found, gone = servo(lanes, claims)
        rows, missing = rows + found, missing | gone
    if "derivatives" in parts:
        results["derivatives"] = ours.derivatives(axis.lane_numbers(lanes))
        claims.add("Jacobian over forward", results["derivatives"]["jacobian_over_forward"], 6.0, 6.0, at_most=True)
        claims.add("gradient over forward", results["derivatives"]["gradient_over_forward"], 5.0, 4.0, at_most=True)
    if "profile" in parts:
        results["profile"] = ensemble_profile.profile(lanes)
    if "first" in parts:
        results["seconds_to_first_result"] = first_calls(claims)
    for name in ("stiff", "line"):
        if name in parts:
            found, gone = variant(name, 512 if name == "stiff" else 256, claims)
            rows, missing = rows + found, missing | gone
    if "scaling" in parts:
        results["scaling"] = ours.scaling()
        rates = [row["sims_per_second"] for row in results["scaling"][1:]]
        claims.add("1e4 to 1e6 lanes: slowest over fastest rate", min(rates) / max(rates), 0.7, 0.7)
        growth = results["scaling"][-1]["resident_gib"] - results["scaling"][1]["resident_gib"]
        claims.add("resident memory from 1e4 to 1e6 lanes [GiB]", growth, 1.0, 1.0, at_most=True)
    results["rows"] = [row._asdict() for row in rows]
    return results | {"missing": missing, "claims": claims.rows}, claims


def main() -> int:
    """Run, print a table, write results.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--lanes", type=int, default=4096)
    parser.add_argument("--parts", default=",".join(PARTS))
    options = parser.parse_args()
    parts = options.parts.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"unknown parts {', '.join(unknown)}; there are {', '.join(PARTS)}")
    if "profile" in parts and options.lanes % ensemble_profile.GRADIENT_LANES:
        least = ensemble_profile.GRADIENT_LANES
        parser.error(f"--lanes must be a multiple of {least} for the part profile, got {options.lanes}")
    options.out.mkdir(parents=True, exist_ok=True)
    results, claims = run(parts, options.lanes)
    save_json(options.out / "results.json", {"machine": machine(), "lanes": options.lanes} | results)
    for row in results["rows"]:
        rms = "-" if row["rms_error_pa"] is None else f"{row['rms_error_pa']:.3g}"
        print(
            f"{row['engine']:28} {row['precision']:8} {row['setting']:44} {row['sims_per_second']:12.0f}/s {rms:>9} Pa"
        )
    for claim in claims.rows:
        value = "not measured" if claim["value"] is None else f"{claim['value']:.3g}"
        mark = "" if claim["met"] else "  MISSED"
        print(f"{claim['name']}: {value} (claimed {claim['claimed']:g}, aimed at {claim['aim']:g}){mark}")
    missed = [claim["name"] for claim in claims.rows if not claim["met"]]
    met = len(claims.rows) - len(missed)
    print(f"ensembles: {met} of {len(claims.rows)} claims hold" + (f"; missed: {'; '.join(missed)}" if missed else ""))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
