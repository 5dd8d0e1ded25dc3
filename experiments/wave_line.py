"""How many segments does a wave line need, and what do they miss? Ladders against the exact distributed line.

    python experiments/wave_line.py --out results/wave_line

Three comparisons, all with laminar flow and the line's exact frequency-dependent friction as reference:

- frequency: transmission matrix of N segments against the exact one (same friction), order of convergence;
- smooth closures of a valve, simulated, against the inverse Laplace transform: order of convergence, and the error
  of a raised cosine over half a wave's travel time;
- instantaneous closure: the ladder rings behind every front, which no N removes; its mean over half a travel time
  is right.

Writes results.json and wave_line.svg. Exits with 1 when a claim is missed.
"""

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from inverse_laplace import gradual_closure, instantaneous_closure, raised_cosine, raised_cosine_closure, smooth_step
from make_control_line_recording import save_json

import jaxlines as jl
from jaxlines.physics.distributed import dissipation_number
from jaxlines.simulation.frequency import line_matrix

LENGTH, BORE, SPEED, VISCOSITY, DENSITY, VELOCITY = 36.09, 0.0254, 1324.36, 39.67e-6, 878.4, 0.128
"""The line of Holmboe and Rouleau (1967), as quoted from memory of the paper; only theory is compared with here."""

OIL = jl.Oil(DENSITY * SPEED**2, DENSITY, VISCOSITY, mass="article")
PIPE = jl.Pipe(LENGTH, BORE, 20 * BORE, youngs_modulus=1e13)
WEIGHTS = jl.KagawaWeights()
CLOSURE, GENTLE = 0.5, 2.0  # [travel times]
TABLE = np.array([0.5, 1.0, 1.5, 2.5, 3.0, 3.5, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0])  # [travel times]
SEGMENTS = (20, 40, 80, 160)
LIMIT = 0.01  # of the Joukowsky pressure, at every time of the table
JUMP_LIMIT = 0.02  # the same for the mean over half a travel time after an instantaneous closure


def speed() -> float:
    """Wave speed with the pipe's own (tiny) elasticity [m/s]."""
    return float(jl.Line("V", PIPE).wave_speed(OIL, 101325.0))


def order_in_frequency() -> tuple[list[float], float]:
    """Largest relative error of the matrix over frequencies up to the third resonance, and its order in 1/N."""
    frequencies = np.linspace(0.02, 1.2, 60) * speed() / LENGTH
    exact = line_matrix(PIPE, OIL, 5e6, frequencies)
    size = np.max(np.abs(exact), axis=0)
    errors = []
    for segments in SEGMENTS:
        ladder = line_matrix(PIPE, OIL, 5e6, frequencies, segments=segments, friction="distributed")
        errors.append(float(np.max(np.abs(ladder - exact) / size)))
    return errors, _order(errors)


def _order(errors) -> float:
    """Slope of log error over log(1/N) by regression."""
    return float(-np.polyfit(np.log(SEGMENTS), np.log(errors), 1)[0])


def close_valve(segments: int, times, closure: float, rate=raised_cosine):
    """Pressure at the valve relative to before, over rho c V0; times and closure in travel times."""
    area, drop = np.pi / 4 * BORE**2, 32 * VISCOSITY * DENSITY * VELOCITY * LENGTH / BORE**2
    line = jl.Line("R", PIPE, to="V", segments=segments, weights=WEIGHTS)
    if closure:
        share = np.linspace(0.0, 1.0, 401)
        closed = np.concatenate([[0.0], np.cumsum(0.5 * (rate(share)[1:] + rate(share)[:-1]) * np.diff(share))])
        flow = jl.Sampled(share * closure * LENGTH / speed(), -VELOCITY * area * (1.0 - closed / closed[-1]))
    else:
        flow = 0.0
    parts = {"tank": jl.PressureSource("R", 5e6), "line": line, "valve": jl.FlowSource("V", flow)}
    start = {"V.pressure": 5e6 - drop, "line.volume_flow": VELOCITY * area}
    instants = np.concatenate([[0.0], times * LENGTH / speed()])
    sim = jl.simulate(
        jl.Circuit(OIL, parts), instants, initial=start, outputs=["V.pressure"], tolerance=1e-6, max_steps=10**6
    )
    return (sim["V.pressure"][1:] - start["V.pressure"]) / (DENSITY * speed() * VELOCITY)


def weighted_friction(w):
    """xi^2 with the weighting function that the simulated line has."""
    return 1.0 + 8.0 / w + 4.0 * WEIGHTS.transform(w)


def order_in_time(number: float) -> tuple[list[float], float]:
    """Largest error at the times of the table for each N, and its order in 1/N.

    The valve closes over two travel times without a jump in acceleration (the response of a second-order scheme to
    rougher inputs converges more slowly), and the exact line has the same weighting function, so that the error is
    that of the segments alone.
    """
    exact = gradual_closure(TABLE, number, GENTLE, smooth_step, friction=weighted_friction)
    errors = [float(np.max(np.abs(close_valve(n, TABLE, GENTLE, smooth_step) - exact))) for n in SEGMENTS]
    return errors, _order(errors)


def raised_cosine_errors(number: float) -> dict:
    """Closure over half a travel time: largest error for each N, and how much of it the weighting function is."""
    exact = raised_cosine_closure(TABLE, number, CLOSURE)
    weighted = gradual_closure(TABLE, number, CLOSURE, raised_cosine, friction=weighted_friction)
    found = [close_valve(n, TABLE, CLOSURE) for n in SEGMENTS]
    return {
        "times": TABLE.tolist(),
        "exact": exact.tolist(),
        "ladder": found[-1].tolist(),
        "errors": [float(np.max(np.abs(values - exact))) for values in found],
        "error_of_weights": float(np.max(np.abs(weighted - exact))),
    }


def sudden_closure(number: float) -> dict:
    """Instantaneous closure with the finest ladder: its ringing, and its mean over half a travel time."""
    times = np.linspace(0.0, 15.9, 15901)[1:]
    ours = close_valve(SEGMENTS[-1], times, 0.0)
    fronts = np.min(np.abs(times[:, None] - np.arange(0.0, 17.0, 2.0)), axis=1) < 1e-9
    exact = np.full(times.shape, np.nan)
    exact[~fronts] = instantaneous_closure(times[~fronts], number)
    inside = TABLE[(TABLE % 2 > 0.24) & (TABLE % 2 < 1.76)]  # no front within the window
    windows = [np.abs(times - t) <= 0.25 for t in inside]
    means = [(float(np.mean(ours[w])), float(np.nanmean(exact[w]))) for w in windows]
    ringing = float(np.nanmax(np.abs(ours - exact)[times > 0.02]))
    return {"times": inside.tolist(), "means": means, "ringing": ringing, "trace": (times, ours, exact)}


def draw(path: Path, number: float, sudden: dict) -> None:
    """Smooth and sudden closure, ladder and exact line."""
    times = np.linspace(0.0, 16.0, 1601)[1:]
    figure, axes = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    axes[0].plot(times, raised_cosine_closure(times, number, CLOSURE), "k", lw=2.5, alpha=0.35, label="exact")
    axes[0].plot(times, close_valve(SEGMENTS[-1], times, CLOSURE), lw=1, label=f"{SEGMENTS[-1]} segments")
    axes[0].set_title("valve closed smoothly over half a travel time")
    t, ours, exact = sudden["trace"]
    axes[1].plot(t, exact, "k", lw=2.5, alpha=0.35, label="exact")
    axes[1].plot(t, ours, lw=0.6, label=f"{SEGMENTS[-1]} segments: they ring behind every front")
    axes[1].set_title("valve closed at once")
    for ax in axes:
        ax.set_ylabel("pressure rise at the valve / rho c V0")
        ax.legend(loc="upper right")
    axes[1].set_xlabel("time / (L/c)")
    figure.savefig(path)
    plt.close(figure)


def main() -> int:
    """Compare, judge, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json and the figure")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    number = float(dissipation_number(LENGTH, BORE, speed(), VISCOSITY))
    in_frequency, frequency_order = order_in_frequency()
    in_time, time_order = order_in_time(number)
    smooth = raised_cosine_errors(number)
    sudden = sudden_closure(number)
    mean_error = max(abs(ours - exact) for ours, exact in sudden["means"])
    needed = next((n for n, error in zip(SEGMENTS, smooth["errors"], strict=True) if error <= LIMIT), None)
    claims = {
        "second order in frequency": 1.9 <= frequency_order <= 2.1,
        "second order in time": 1.8 <= time_order <= 2.3,
        "smooth closure within 1 %": smooth["errors"][-1] <= LIMIT,
        "mean after a sudden closure": mean_error <= JUMP_LIMIT,
        "the ringing is there": sudden["ringing"] > 0.1,
    }
    for n, f, t, quick in zip(SEGMENTS, in_frequency, in_time, smooth["errors"], strict=True):
        print(
            f"{n:4d} segments: matrix off by {100 * f:.3g} %; pressure by {100 * t:.2g} % of rho c V0 after a gentle "
            f"closure (segments alone), by {100 * quick:.2g} % after a raised cosine over {CLOSURE:g} L/c"
        )
    missed = [name for name, holds in claims.items() if not holds]
    finding = (
        f"order {frequency_order:.2f} in frequency, {time_order:.2f} in time; raised cosine within "
        f"{100 * smooth['errors'][-1]:.2g} % at {SEGMENTS[-1]} segments ({100 * smooth['error_of_weights']:.2g} % of "
        f"it by the weighting function), within 1 % from {needed}; sudden closure rings by up to "
        f"{100 * sudden['ringing']:.0f} %, its mean over half a travel time is within {100 * mean_error:.2g} %"
    ) + f"; MISSED: {', '.join(missed)}" * bool(missed)
    draw(folder / "wave_line.svg", number, sudden)
    result = {
        "dissipation_number": number,
        "segments": SEGMENTS,
        "matrix_error": in_frequency,
        "gentle_closure_error": in_time,
        "raised_cosine": smooth,
        "sudden_closure": {"times": sudden["times"], "ladder_and_exact_means": sudden["means"]},
        "ringing": sudden["ringing"],
        "segments_needed": needed,
        "claims": claims,
        "finding": finding,
    }
    save_json(folder / "results.json", result)
    print(finding)
    return 0 if not missed else 1


if __name__ == "__main__":
    sys.exit(main())
