"""Does a network of a thousand lines compile as fast as one of ten? Grids of wave lines, compiled and simulated.

    python experiments/scale_network.py --out results/scale_network

Junction i of n is joined to i + 1 and to i + sqrt(n), a grid wound on itself, by pipes of random lengths, each a line
of segments; two pumps feed it, a leak drains it. Every network is planned, compiled and simulated in a process of its
own, several times in turn; the smallest times count, so that other work on the machine does not. Times on the clock.

Writes results.json and scale_network.svg. Exits with 1 when the largest network takes more than twice the time of
the smallest from circuit to compiled program, or a simulation fails.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from first_result import machine
from make_control_line_recording import save_json

import jaxlines as jl
from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.integration import integrate, make_method
from jaxlines.simulation.observation import shown_by_default

LINES = (10, 30, 100, 300, 1000)
LIMIT = 2.0  # time of the largest network over that of the smallest
SEGMENTS, DURATION, TOLERANCE = 8, 0.02, 1e-6


def network(lines: int, segments: int = SEGMENTS) -> jl.Circuit:
    """A grid of lines with half as many junctions; input "flow"."""
    nodes = lines // 2
    row, random = max(2, round(nodes**0.5)), np.random.default_rng(0)
    parts: dict = {}
    for i in range(nodes):
        for j, other in enumerate(((i + 1) % nodes, (i + row) % nodes)):
            pipe = jl.Pipe(random.uniform(3.0, 6.0), 0.02, 0.025)
            parts[f"line{2 * i + j}"] = jl.Line(f"n{i}", pipe, to=f"n{other}", segments=segments)
    parts["pump"] = jl.FlowSource("n0", "flow")
    parts["second"] = jl.FlowSource(f"n{nodes // 2}", jl.Sine(5e-5, 5e-5, 50.0))
    parts["leak"] = jl.LaminarLeak(f"n{nodes - 1}", "T", 1e-11)
    parts["tank"] = jl.Tank("T")
    return jl.Circuit(jl.Oil(1.4e9, 850.0, 30e-6, 0.005), parts)


def measure(lines: int, segments: int = SEGMENTS) -> dict:
    """Times [s] of planning, tracing, compiling and a step for a network, and its size."""
    circuit, times = network(lines, segments), np.linspace(0.0, DURATION, 41)
    method, tolerance = make_method(None, "forward", 10_000), np.asarray(TOLERANCE)
    with jax.enable_x64(True):
        inputs = bind_inputs(circuit, {"flow": jl.Step(0.0, 1e-4, 1e-3)}, times)
        marks = [time.perf_counter()]
        plan, values = compile_circuit(circuit, None, inputs)
        wanted = tuple(shown_by_default(plan))
        marks.append(time.perf_counter())
        traced = jax.jit(integrate, static_argnums=(0, 1, 2)).trace(plan, wanted, method, values, times, tolerance)
        marks.append(time.perf_counter())
        program = traced.lower().compile()
        marks.append(time.perf_counter())
        seconds = []
        for _ in range(3):
            began = time.perf_counter()
            found = jax.block_until_ready(program(values, times, tolerance))
            seconds.append(time.perf_counter() - began)
    steps = int(found.num_steps)
    planning, tracing, compiling = (float(x) for x in np.diff(marks))
    return {
        "plan": planning,
        "trace": tracing,
        "compile": compiling,
        "total": planning + tracing + compiling,
        "step": min(seconds) / steps,
        "steps": steps,
        "status": int(found.status),
        "nodes": len(plan.free_nodes),
        "kinds": len(plan.kinds),
        "states": len(wanted),
        "operations": count_operations(traced.jaxpr.jaxpr),
    }


def count_operations(jaxpr) -> int:
    """Operations of a program, those of its inner programs included."""
    inner = [p for equation in jaxpr.eqns for p in jax.tree.leaves(list(equation.params.values()), is_leaf=_is_program)]
    return len(jaxpr.eqns) + sum(count_operations(getattr(p, "jaxpr", p)) for p in inner if _is_program(p))


def _is_program(thing) -> bool:
    """Whether a parameter of an operation is a program itself."""
    return hasattr(getattr(thing, "jaxpr", thing), "eqns")


def measure_apart(lines: int) -> dict:
    """The same in a process of its own, in which nothing has been compiled before."""
    measure(2)  # what every program needs once
    return measure(lines)


def repeated(repeats: int) -> dict[int, dict]:
    """Every network measured in processes of its own, in turn; the repetition with the smallest total counts."""
    best: dict[int, dict] = {}
    for _ in range(repeats):
        for lines in LINES:
            command = [sys.executable, __file__, "--measure", str(lines)]
            found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            best[lines] = min(found, best.get(lines, found), key=lambda row: row["total"])
    return best


def draw(path: Path, rows: dict[int, dict]) -> None:
    """Times over the number of lines."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    lines = list(rows)
    for name in ("total", "compile", "trace", "plan"):
        axes[0].plot(lines, [row[name] for row in rows.values()], "o-", label=name)
    axes[0].axhline(LIMIT * rows[lines[0]]["total"], color="k", ls=":", label=f"{LIMIT:g} x smallest network")
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_ylabel("seconds from circuit to program")
    axes[0].legend()
    axes[1].loglog(lines, [1e6 * row["step"] / row["states"] for row in rows.values()], "o-")
    axes[1].set_ylabel("microseconds per step and state")
    for ax in axes:
        ax.set_xscale("log")
        ax.set_xlabel("lines")
    figure.savefig(path)
    plt.close(figure)


def main() -> int:
    """Measure, judge, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for results.json and the figure")
    parser.add_argument("--repeats", type=int, default=3, help="of every measurement")
    parser.add_argument("--measure", type=int, help="measure one network here and print the result")
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure_apart(arguments.measure)))
        return 0
    if arguments.out is None:
        parser.error("--out is needed")
    arguments.out.mkdir(parents=True, exist_ok=True)
    host, rows = machine(), repeated(arguments.repeats)
    for lines, row in rows.items():
        print(
            f"{lines:5d} lines, {row['nodes']:4d} junctions, {row['states']:6d} states, {row['kinds']} kinds: plan "
            f"{row['plan']:.2f} s, trace {row['trace']:.2f} s, compile {row['compile']:.2f} s, {row['operations']} "
            f"operations; {1e3 * row['step']:.2f} ms a step"
        )
    ratio = rows[LINES[-1]]["total"] / rows[LINES[0]]["total"]
    claims = {
        f"at most {LIMIT:g} times the time to a program": ratio <= LIMIT,
        "all simulations succeed": all(row["status"] == 0 for row in rows.values()),
        "the program does not grow": rows[LINES[-1]]["operations"] <= 1.1 * rows[LINES[0]]["operations"],
    }
    missed = [name for name, holds in claims.items() if not holds]
    finding = (
        f"{LINES[-1]} lines and {rows[LINES[-1]]['nodes']} junctions: program in {rows[LINES[-1]]['total']:.1f} s, "
        f"{ratio:.2f} times that of {LINES[0]} lines; {1e3 * rows[LINES[-1]]['step']:.1f} ms a step for "
        f"{rows[LINES[-1]]['states']} states" + f"; MISSED: {', '.join(missed)}" * bool(missed)
    )
    draw(arguments.out / "scale_network.svg", rows)
    result = {"machine": host, "rows": rows, "ratio": ratio, "claims": claims, "finding": finding}
    save_json(arguments.out / "results.json", result)
    print(finding)
    return 0 if not missed else 1


if __name__ == "__main__":
    sys.exit(main())
