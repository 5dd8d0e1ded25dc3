"""Our engines in the ensemble experiment: speed, errors, derivatives, cost against the number of lanes."""

import resource
import time
from typing import Any

import jax.numpy as jnp
import line_problem as line
import numpy as np
import servo_axis as axis
from ensemble_peers import Row, Run, best_seconds, interleaved, measured
from servo_axis import Reference

import jaxlines as jl

STEPS = {"float64": (2, 3, 4, 6), "float32": (2, 3, 4)}
"""Steps between samples at which our explicit engine is shown."""


def axis_program(columns, variant=axis.AXIS, **options) -> jl.EnsembleProgram:
    """The ensemble of the servo axis, one output."""
    given: dict[str, Any] = {"outputs": ["A.pressure"]} | options
    return jl.prepare_ensemble(
        axis.circuit(variant),
        axis.times,
        axis.varied(columns),
        axis.inputs(),
        initial=axis.initial(),
        **given,
    )


def line_program(columns, **options) -> jl.EnsembleProgram:
    """The ensemble of the line of 40 segments, one output."""
    return jl.prepare_ensemble(
        line.circuit(),
        axis.times,
        columns,
        line.inputs(),
        initial=line.initial(),
        outputs=[f"{line.OUTPUT}.pressure"],
        **options,
    )


def run_of(program: jl.EnsembleProgram, varied, output: str, repeats: int) -> Run:
    """What a prepared ensemble does; the first run compiles."""
    began = time.perf_counter()
    found = program.run(varied)
    first = time.perf_counter() - began
    seconds = best_seconds(lambda: program.run(varied), repeats)
    return Run(np.where(found.usable[:, None], found[output], np.nan), seconds, first - seconds)


def axis_rows(columns, reference: Reference, repeats: int = 5) -> list[Row]:
    """Our explicit engine on the servo axis at several steps, and what it picks for its default tolerance."""
    rows = []
    for precision, steps in STEPS.items():
        for count in steps:
            program = axis_program(columns, engine="explicit", steps=count, audit=0, precision=precision)
            run = run_of(program, axis.varied(columns), "A.pressure", repeats)
            rows.append(measured("jaxlines explicit", precision, f"{count} steps a sample", run, reference))
        program = axis_program(columns, precision=precision)
        run = run_of(program, axis.varied(columns), "A.pressure", repeats)
        picked = program.description
        how = f"auto, tolerance {program.tolerance:g}: {picked['engine']}, {picked['steps']} steps"
        rows.append(measured("jaxlines", precision, how, run, reference))
    return rows


def variant_rows(name: str, program: jl.EnsembleProgram, varied, output: str, reference, repeats: int = 2) -> list[Row]:
    """Our row on another problem."""
    run = run_of(program, varied, output, repeats)
    how = f"{name}: {program.description['engine']}, {program.description['steps']} steps"
    return [measured("jaxlines", "float64", how, run, reference)]


def derivatives(columns, repeats: int = 7) -> dict:
    """Cost of the Jacobian in nine numbers and of a reverse gradient over that of a forward run of the same lanes."""
    varied = axis.varied(columns)
    program = axis_program(columns, engine="explicit", steps=3, audit=0)

    def objective(times, outputs):
        return jnp.mean((outputs["A.pressure"] / 1e6) ** 2, axis=0)

    work = {
        "forward": lambda: program.run(varied),
        "jacobian": lambda: jl.ensemble_jacobian(program, varied),
        "gradient": lambda: jl.ensemble_gradient(program, objective, varied),
    }
    found: dict = {"lanes": len(columns["inertia"]), "parameters": len(varied)}
    for name, call in work.items():
        began = time.perf_counter()
        call()
        found[f"{name}_first_seconds"] = time.perf_counter() - began
    found |= {f"{name}_seconds": seconds for name, seconds in interleaved(work, repeats).items()}
    for name in ("jacobian", "gradient"):
        found[f"{name}_over_forward"] = found[f"{name}_seconds"] / found["forward_seconds"]
    return found


def scaling(counts=(1000, 10_000, 100_000, 1_000_000), precision: str = "float64") -> list[dict]:
    """Seconds and resident memory against the number of lanes, for one reduction of each."""
    rows, program = [], None
    for count in counts:
        varied = axis.varied(axis.lane_numbers(count))
        if program is None:
            columns = axis.lane_numbers(counts[0])
            program = axis_program(columns, outputs=[], reductions={"peak": jl.Peak("A.pressure")}, precision=precision)
            program.run(varied)
        program.run(
            {path: values[: min(count, 40_000)] for path, values in varied.items()}
        )  # its size of chunk compiles
        began = time.perf_counter()
        found = program.run(varied)
        seconds = time.perf_counter() - began
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        rows.append(
            {
                "lanes": count,
                "precision": precision,
                "seconds": seconds,
                "sims_per_second": count / seconds,
                "resident_gib": peak,
                "ok": int(found.usable.sum()),
            }
        )
    return rows
