"""Does a one-lump fit find the truth behind the bundled recording of a control line, which came from a finer model?

    python experiments/control_line_recovery.py --out results/control_line_recovery

The recording is made anew by the distributed model of `make_control_line_recording.py` and must equal the bundled one.
The study `example:control-line` is then fitted to it four times: as the example does, without the uncertainties of
known numbers (so that the standard deviations come from the noise alone), without noise (what is left is the bias of
the one-lump model), and with air left out, which must be noticed. Exits with 1 when a claim is missed.

Answer: modulus within 0.01 % of the truth and air within 0.2 %, 95 % intervals of 0.8 % and 1.5 % (0.13 % and 1.3 %
from noise alone); the one-lump model errs by at most 0.14 standard deviations of the noise; without air the residuals
reach 17 bar and are far from white.
"""

import argparse
import dataclasses
import sys
from pathlib import Path

import make_control_line_recording as generator
from control_line_figure import draw
from rich.console import Console
from rich.table import Table

import jaxlines as jl
from jaxlines.inference.fit_result import Fit

MODULUS, AIR, LEAK, PRESSURE = "fluid.bulk_modulus", "fluid.air_fraction", "leak.conductance", "initial.A.pressure"
HALF_WIDTH_LIMITS = {MODULUS: 0.05, AIR: 0.20}  # of the 95 % intervals, relative to the estimate
BIAS_LIMIT = 0.3  # of the statistical standard deviation
START_DISTANCE = 0.5  # relative distance of every start from the truth
BUNDLED = Path(jl.__file__).parent / "examples" / "control-line.csv"
LABELS = {
    "example": "noise, uncertain bore and flow",
    "statistical": "noise",
    "noise_free": "no noise",
    "airless": "noise, air left out",
}


def truths() -> dict[str, float]:
    """Path in the circuit -> the number behind the recording [SI]."""
    truth = generator.Truth()
    pressure = truth.initial_pressure_Pa_abs
    return {MODULUS: truth.liquid_modulus_Pa, AIR: truth.air_fraction, LEAK: truth.leak_m3_per_s_Pa, PRESSURE: pressure}


def make_recordings(folder: Path) -> tuple[Path, Path]:
    """The recording with noise and the one without, made by one run of the distributed model."""
    truth = generator.Truth()
    times, pressures, _ = generator.simulate(
        truth, generator.valve_flow, truth.initial_pressure_Pa_abs, generator.DURATION
    )
    t, p, q = generator.sample(times, pressures)
    made = []
    for name, noise_free in (("noisy", False), ("noise_free", True)):
        (folder / name).mkdir(parents=True, exist_ok=True)
        generator.write(folder / name, truth, t, *((p, q) if noise_free else generator.sense(p, q)), noise_free)
        made.append(folder / name / BUNDLED.name)
    return made[0], made[1]


def fits(study, noise_free: Path) -> dict[str, Fit]:
    """The four fits by name."""
    channels = {"A.pressure": "p_line [bar_g]", "flow": "q_valve [L/min]"}
    clean = jl.read_recording(noise_free, time="t [s]", channels=channels)
    statistical = dataclasses.replace(study, known=())
    airless = dataclasses.replace(
        statistical,
        circuit=study.circuit.replace({AIR: 0.0}),
        free=tuple(f for f in study.free if f.label != AIR),
    )
    return {
        "example": study.fit(),
        "statistical": statistical.fit(),
        "noise_free": dataclasses.replace(statistical, recording=clean).fit(),
        "airless": airless.fit(),
    }


def summary(fit: Fit) -> dict:
    """What of a fit goes into results.json."""
    channel = fit.channels["A.pressure"]
    return {
        "status": fit.status,
        "parameters": {name: estimate._asdict() for name, estimate in fit.parameters.items()},
        "rmse_Pa": channel.rmse,
        "whiteness_p": channel.whiteness_p,
        "warnings": list(fit.warnings),
        "num_evaluations": fit.num_evaluations,
        "seconds": fit.seconds,
    }


def half_width(estimate) -> float:
    """Half the 95 % interval over the estimate; infinite without an interval."""
    if estimate.kind != "interval":
        return float("inf")
    return (estimate.ci95[1] - estimate.ci95[0]) / 2.0 / estimate.value


def inside(estimate, truth: float) -> bool:
    """Whether the truth lies in the 95 % interval."""
    return estimate.kind == "interval" and estimate.ci95[0] <= truth <= estimate.ci95[1]


def judge(study, found: dict[str, Fit], same: bool) -> tuple[dict, dict[str, bool]]:
    """The numbers that the claims are about, and whether each claim holds."""
    truth, example, statistical = truths(), found["example"].parameters, found["statistical"].parameters
    starts = {f.label: float(f.to_value(f.start_coordinate())) for f in study.free}
    away = {name: abs(start / truth[name] - 1.0) for name, start in starts.items()}
    widths = {
        fit: {name: half_width(found[fit].parameters[name]) for name in HALF_WIDTH_LIMITS}
        for fit in ("example", "statistical")
    }
    clean = found["noise_free"].parameters
    bias = {name: abs(clean[name].value - truth[name]) / (statistical[name].sd or 0.0) for name in (MODULUS, AIR, LEAK)}
    channel, airless = found["statistical"].channels["A.pressure"], found["airless"]
    numbers = {
        "relative_distance_of_starts": away,
        "relative_half_widths": widths,
        "bias_over_statistical_sd": bias,
        "range_of_air_over_polytropic_index": example[AIR].note,
    }
    narrow = [w[name] <= limit for w in widths.values() for name, limit in HALF_WIDTH_LIMITS.items()]
    claims = {
        "the recording equals the bundled one": same,
        "fits with air converged": all(fit.status == "converged" for name, fit in found.items() if name != "airless"),
        "starts are far from the truth": min(away.values()) >= START_DISTANCE * (1.0 - 1e-9),
        "intervals are narrow": all(narrow),
        "bias is small": max(bias.values()) <= BIAS_LIMIT,
        "truth lies inside the intervals": all(inside(e, truth[name]) for name, e in example.items()),
        "residuals are white": channel.white,
        "missing air is noticed": not airless.channels["A.pressure"].white
        and any("A.pressure are not white" in warning for warning in airless.warnings),
        "air is stated over the polytropic index": "for an index of 1 to 1.4" in example[AIR].note,
    }  # fmt: skip
    return numbers, claims


def show(found: dict[str, Fit], console: Console) -> None:
    """Truth and estimates, a column each."""
    table = Table(title="Truth and estimates, SI (standard deviation)", title_justify="left")
    for heading in ("number", "truth", *(LABELS[name] for name in found)):
        table.add_column(heading, justify="left" if heading == "number" else "right")
    for name, truth in truths().items():
        estimates = [fit.parameters.get(name) for fit in found.values()]
        table.add_row(name, f"{truth:.5g}", *(f"{e.value:.5g} ({e.sd or 0:.1g})" if e else "0" for e in estimates))
    channels = [fit.channels["A.pressure"] for fit in found.values()]
    table.add_row("rmse [Pa]", "", *(f"{channel.rmse:.4g}" for channel in channels))
    table.add_row("whiteness p", "", *(f"{channel.whiteness_p:.2g}" for channel in channels))
    console.print(table)


def finding(numbers: dict, found: dict[str, Fit], claims: dict[str, bool]) -> str:
    """The result in one line."""
    truth, widths = truths(), numbers["relative_half_widths"]
    parts = []
    for name, label in ((MODULUS, "modulus"), (AIR, "air")):
        error = 100.0 * (found["example"].parameters[name].value / truth[name] - 1.0)
        with_known, alone = (100.0 * widths[fit][name] for fit in ("example", "statistical"))
        parts.append(f"{label} {error:+.2g} % off, 95 % within {with_known:.2g} % ({alone:.2g} % from noise alone)")
    missed = [claim for claim, holds in claims.items() if not holds]
    bias = max(numbers["bias_over_statistical_sd"].values())
    parts.append(f"bias of the one-lump model at most {bias:.2f} standard deviations of the noise alone")
    parts.append(f"{len(claims) - len(missed)} of {len(claims)} claims hold")
    return "; ".join(parts + [f"MISSED: {', '.join(missed)}"] * bool(missed))


def main() -> int:
    """Make the recordings, fit, judge, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the recordings, results.json, figure.png")
    folder = parser.parse_args().out
    noisy, noise_free = make_recordings(folder)
    study = jl.load_study("example:control-line")
    found = fits(study, noise_free)
    numbers, claims = judge(study, found, noisy.read_bytes() == BUNDLED.read_bytes())
    console = Console(width=170, highlight=False, markup=False)
    show(found, console)
    console.print(f"air: {numbers['range_of_air_over_polytropic_index']}")
    for name, ratio in numbers["bias_over_statistical_sd"].items():
        console.print(f"bias of {name}: {ratio:.3f} of the statistical standard deviation")
    figure = draw(folder, found, truths(), numbers | {"bias_limit": BIAS_LIMIT}, LABELS)
    result = {"truth": truths(), "fits": {name: summary(fit) for name, fit in found.items()}, **numbers}
    result |= {"figure": figure, "claims": claims, "finding": finding(numbers, found, claims)}
    generator.save_json(folder / "results.json", result)
    console.print(result["finding"], soft_wrap=True)
    return 0 if all(claims.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
