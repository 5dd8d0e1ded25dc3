"""Before an ensemble runs: which engine, how many steps, and how far the error estimates can be trusted."""

import dataclasses
import time
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.ensemble import EnsembleProgram
from jaxlines.simulation.ensemble_columns import Varied, columns_of, extreme_lanes, out_of_range
from jaxlines.simulation.ensemble_making import make_program
from jaxlines.simulation.ensemble_program import ENGINES
from jaxlines.simulation.ensemble_result import Audit, Ensemble
from jaxlines.simulation.ensemble_search import MOST_STEPS, MOST_TRIALS, Say, search
from jaxlines.simulation.ensemble_trials import SAFETY, Pilot, implicit_method, lane_errors, worst
from jaxlines.simulation.graded_steps import cut_times, step_times
from jaxlines.simulation.reductions import AbstractReduction

PILOT_LANES = {True: 48, False: 24}
"""Lanes of the pilot at most, of small circuits and of others: the extremes of each varied number, and random ones."""

TIGHTEST = 1e-4
"""The adaptive solver's tolerance in the audit over that of a first audit, at least: it may be what is not exact."""

MOST_CUTS = {"explicit": 1024, "implicit": 16}
"""Steps of a piece beyond which the audit makes them no shorter."""


def _chosen(pilot: Pilot, engine: str, say: Say) -> EnsembleProgram:
    """The program with its engine and steps."""
    made = pilot.program
    adaptive = dataclasses.replace(made, program=made.program._replace(engine="adaptive"), steps=0)
    if not can_run_in_step(made):
        if engine in ("explicit", "implicit"):
            raise ValueError(
                f'engine="{engine}" cannot follow sampled controllers and delayed sensors: use engine="adaptive"'
            )
        return adaptive
    if engine == "adaptive":
        return adaptive
    found = search(pilot, ("explicit", "implicit") if engine == "auto" else (engine,), say)
    if found is None and engine != "auto":
        most = f"{MOST_STEPS} steps between samples" if engine == "explicit" else f"{MOST_TRIALS} steps"
        raise ValueError(
            f'engine="{engine}" does not reach the tolerance {made.tolerance:g} with {most}, or some lanes fail '
            'however short the steps are: try engine="auto", or save at more times'
        )
    return found or adaptive


def _given(program: EnsembleProgram, engine: str, steps: int | Sequence[float]) -> EnsembleProgram:
    """The program with an engine and steps that are given."""
    if not isinstance(steps, int | np.integer):
        return program.with_graded_steps(steps)
    return dataclasses.replace(program, program=program.program._replace(engine=engine), steps=int(steps))


def _audited(pilot: Pilot, lanes: np.ndarray, fixed: bool) -> tuple[EnsembleProgram, Audit]:
    """The program, its steps cut until lanes agree with the adaptive solver unless they are fixed, and how far its
    estimates are from the truth.

    The factor is the largest error over the largest estimate, of the audited lanes and, against twice as many steps,
    of the pilot's. It is not taken lane by lane: where the error comes from kinks within steps (a valve that
    opens), embedded estimates hardly tell one lane from another; what they do tell is a lane unlike those seen.
    """
    program, engine = pilot.program, pilot.program.program.engine
    tighter = 1e-2 if engine == "adaptive" else 1.0
    exact = pilot.exact(program, lanes, tighter)
    while True:
        found, estimate = pilot.as_run(program, lanes)
        errors = lane_errors(found, exact)
        known = np.isfinite(errors) & (estimate > 0.0)
        enough = not np.nanmax(errors, initial=0.0) > program.tolerance
        if fixed or engine == "adaptive" or enough or program.steps >= MOST_CUTS[engine]:
            break
        agrees = worst(found, pilot.run(program, 2, lanes).series) <= program.tolerance / SAFETY
        if agrees and tighter > TIGHTEST:  # with twice as many steps, so that the solver is what is not exact
            tighter *= 1e-2
            exact = pilot.exact(program, lanes, tighter)
        else:
            program = dataclasses.replace(program, steps=-(-3 * program.steps // 2))
    factor = 1.0 if engine == "adaptive" else _factor(pilot, program, errors[known], estimate[known])
    if program.graded and program.steps > 1:
        program = program.with_graded_steps(cut_times(step_times(program.grid), program.steps))
    rms = np.sqrt(np.nanmean((found - exact) ** 2, axis=(0, 2)))
    names = [program.program.observed[i] for i in program.program.wanted]
    named = dict(zip(names, map(float, rms), strict=True))
    return program, Audit(lanes, program.tolerance, float(np.nanmax(errors, initial=0.0)), named, factor)


def _factor(pilot: Pilot, program: EnsembleProgram, errors: np.ndarray, estimates: np.ndarray) -> float:
    """The largest error over the largest estimate, of the audited lanes and of the pilot's."""
    coarse, pilot_estimate = pilot.run(program)
    every = np.append(errors, lane_errors(coarse, pilot.truth(program)))
    estimates = np.append(estimates, pilot_estimate)[np.isfinite(every)]
    return float(np.max(every[np.isfinite(every)], initial=0.0) / np.max(estimates, initial=1e-300)) or 1.0


def prepare_ensemble(
    circuit: Circuit,
    times,
    varied: Varied,
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    outputs: Iterable[str] | None = None,
    reductions: Mapping[str, AbstractReduction] | None = None,
    tolerance: float = 1e-4,
    engine: str = "auto",
    steps: int | Sequence[float] | None = None,
    precision: str = "float64",
    solver=None,
    max_steps: int = 100_000,
    audit: int = 8,
    seed: int = 0,
    progress: Say | None = None,
) -> EnsembleProgram:
    """The plan of an ensemble: engine, steps and error calibration, from the extreme lanes; see `ensemble`.

    Its `run(varied)` gives the results for any lanes; a plan made once gives the same numbers whatever is run with
    it, in whatever chunks. Args: as of `ensemble`; varied: the lanes that the pilot chooses from.
    Returns: an `EnsembleProgram`. Raises: ValueError, KeyError or TypeError for a wrong call.
    """
    began, say = time.perf_counter(), progress or (lambda text, share: None)
    if engine not in ("auto", *ENGINES):
        raise ValueError(f"engine must be auto, {', '.join(ENGINES)}, got {engine!r}")
    _check_steps(engine, steps)
    program = make_program(
        circuit, times, varied, inputs, initial, outputs, reductions, tolerance, precision, solver, max_steps
    )
    columns = columns_of(varied)
    good = np.flatnonzero(~out_of_range(program.circuit, list(program.paths), columns))
    columns = [column[..., good] for column in columns]
    pilot = Pilot(program, columns, extreme_lanes(columns, min(PILOT_LANES[program.program.small], good.size), seed))
    program = _chosen(pilot, engine, say) if steps is None else _given(program, engine, steps)
    if program.program.engine == "adaptive" and solver is None and can_run_in_step(program):
        # The lockstep engines were not exact enough, most likely since the circuit is stiff.
        stiff = program.program._replace(method=implicit_method(program.program.method))
        program = dataclasses.replace(program, program=stiff)
    found = None
    if audit > 0:
        say("audit against the adaptive solver", 0.6)
        lanes = np.random.default_rng(seed + 1).permutation(good.size)[:audit]
        program, found = _audited(dataclasses.replace(pilot, program=program), lanes, steps is not None)
        found = found._replace(lanes=good[found.lanes])
    return dataclasses.replace(program, audit=found, seconds={"prepare": time.perf_counter() - began})


def _check_steps(engine: str, steps: int | Sequence[float] | None) -> None:
    """Raise ValueError for steps that do not go with an engine."""
    if steps is None:
        return
    single = isinstance(steps, int | np.integer)
    if engine not in MOST_CUTS or (single and steps < 1) or (not single and (engine != "implicit" or len(steps) < 2)):
        raise ValueError(
            'steps are a number of at least 1 with engine="explicit" or "implicit", or the boundaries of all steps [s] '
            f'with "implicit"; got {steps if single else f"{len(steps)} times"} with {engine!r}'
        )


def can_run_in_step(program: EnsembleProgram) -> bool:
    """Whether the lockstep engines can follow a circuit: nothing in it is sampled or delayed."""
    plan = program.program.plan
    return not (any(c.sampled for c in plan.controllers) or any(s.delayed for s in plan.sensors))


def ensemble(
    circuit: Circuit,
    times,
    varied: Varied,
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    outputs: Iterable[str] | None = None,
    reductions: Mapping[str, AbstractReduction] | None = None,
    tolerance: float = 1e-4,
    engine: str = "auto",
    steps: int | Sequence[float] | None = None,
    precision: str = "float64",
    solver=None,
    max_steps: int = 100_000,
    audit: int = 8,
    seed: int = 0,
    chunk: int | None = None,
    progress: Say | None = None,
) -> Ensemble:
    """Simulate many variations of a circuit at once.

    Main arguments:
        circuit: what to simulate; times: where to save [s], shape (samples,); inputs, initial: as in `simulate`.
        varied: path of a number (or several that take the same value) -> its value in every lane, SI, shape (lanes,):
            numbers of the circuit ("fluid.air_fraction"), of inputs ("spool.delay"; whole records,
            "spool.values", (lanes, samples)) and start values ("initial.A.pressure").
        outputs: names whose series are returned, (lanes, samples); by default all sensors, potentials and states,
            or none when there are reductions.
        reductions: name -> what each trajectory comes down to, such as {"peak": Peak("A.pressure")}.

    Other arguments:
        tolerance: largest error of any output at any saved time, as a share of that output's largest magnitude.
        engine: "explicit" (lanes in step, low-storage Runge-Kutta), "implicit" (lanes in step, linearly implicit,
            for stiff circuits), "adaptive" (diffrax, each lane with steps of its own), or "auto": what a pilot on
            the extreme lanes finds cheapest. steps: between two stops (saved times and bends of the inputs), instead
            of those that the pilot finds; with "implicit" also the boundaries of all steps [s], those of an earlier
            plan (`description["steps"]`): the pilot chooses them short only where some lane moves fast.
        precision: "float64" or "float32"; solver, max_steps: of the adaptive engine, as in `simulate`.
        audit: lanes, chosen at random by `seed`, that are computed again by the adaptive solver at a hundredth of the
            tolerance. Their observed errors calibrate the error estimate of all lanes; those above the tolerance
            are run again with more steps, or flagged. 0: no audit.
        chunk: lanes at once, a multiple of 128. progress: called with a text and a share done.

    Returns: an `Ensemble`; `print` it. A lane that fails has a status and disturbs no other.
    Raises: ValueError, KeyError or TypeError for a wrong call, before any work is done.
    """
    program = prepare_ensemble(
        circuit,
        times,
        varied,
        inputs,
        initial=initial,
        outputs=outputs,
        reductions=reductions,
        tolerance=tolerance,
        engine=engine,
        steps=steps,
        precision=precision,
        solver=solver,
        max_steps=max_steps,
        audit=audit,
        seed=seed,
        progress=progress,
    )
    return program.run(varied, chunk=chunk, progress=progress)
