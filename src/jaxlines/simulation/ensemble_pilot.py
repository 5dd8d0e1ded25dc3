"""Before an ensemble runs: which engine, how many steps, and how far the error estimates can be trusted."""

import dataclasses
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.ensemble import FEWEST, EnsembleProgram, make_program
from jaxlines.simulation.ensemble_columns import Paths, columns_of, extreme_lanes, out_of_range
from jaxlines.simulation.ensemble_program import ENGINES
from jaxlines.simulation.ensemble_result import Audit, Ensemble
from jaxlines.simulation.integration import make_method
from jaxlines.simulation.reductions import AbstractReduction
from jaxlines.simulation.result import STATUS

PILOT_LANES = 48
"""Lanes of the pilot at most: the extremes of each varied number, and random ones."""

MOST_STEPS = {"explicit": 512, "implicit": 64}
"""Steps between stops beyond which an engine is given up."""

IMPLICIT_COST = {True: 10.0, False: 5.0}
"""Time of an implicit step over that of an explicit one, for small circuits and for others (measured, roughly)."""

SAFETY = 2.0
"""The pilot asks for an error that is smaller by this factor, since it sees some lanes only."""

Say = Callable[[str, float], None]


@dataclasses.dataclass(frozen=True)
class Pilot:
    """Some lanes of an ensemble, to be run in different ways."""

    program: EnsembleProgram
    columns: list[np.ndarray]
    lanes: np.ndarray

    def run(self, engine: str, steps: int, lanes: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """All observed outputs (samples, observed, lanes), NaN for failed lanes, and error estimates."""
        program = self.program.program
        every = tuple(range(len(program.observed)))
        program = program._replace(engine=engine, kept=every, reductions=(), taken=())
        if engine == "adaptive" and self.program.program.engine == "implicit":
            program = program._replace(method=_implicit(program.method))
        lanes = self.lanes if lanes is None else lanes
        size = len(lanes) if engine == "adaptive" else FEWEST
        found = self.program.run_padded(self.columns, lanes, size, steps, program)
        good = np.isin(found.status, [STATUS["ok"], STATUS["tension"]])
        return np.where(good, found.series, np.nan), found.estimate

    def steps_for(self, engine: str, most: int) -> int | None:
        """The fewest steps whose error, against twice as many, is well below the tolerance; None if there are none."""
        wanted, shown = self.program.tolerance / SAFETY, {1: self.run(engine, 1)[0]}
        steps = 1
        while steps <= most:
            shown[2 * steps] = self.run(engine, 2 * steps)[0]
            if worst(shown[steps], shown[2 * steps]) <= wanted:
                fewer = 3 * steps // 4
                if steps >= 4 and worst(self.run(engine, fewer)[0], shown[2 * steps]) <= wanted:
                    return fewer
                return steps
            steps *= 2
        return None


def _implicit(method):
    """The method with an implicit solver."""
    from jaxlines.simulation.integration import implicit

    return method._replace(solver=implicit())


def lane_errors(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Largest error of any output at any time as a share of its largest magnitude, (lanes,); infinite for a lane
    that failed where the exact one did not, NaN where the exact one failed."""
    size = np.nanmax(np.abs(np.where(np.isfinite(exact), exact, np.nan)), axis=(0, 2), initial=0.0)
    scaled = np.abs(found - exact) / np.where(size > 0.0, size, np.inf)[:, None]
    failed = ~np.isfinite(exact).all(axis=(0, 1))
    return np.where(failed, np.nan, np.where(np.isfinite(scaled), scaled, np.inf).max(axis=(0, 1)))


def worst(found: np.ndarray, exact: np.ndarray) -> float:
    """The largest of `lane_errors`; infinite when more than half of the lanes failed."""
    errors = lane_errors(found, exact)
    if np.isnan(errors).mean() > 0.5:
        return np.inf
    return float(np.nanmax(errors))


def _chosen(pilot: Pilot, engine: str, say: Say) -> tuple[str, int]:
    """Engine and steps."""
    plan, small = pilot.program.program.plan, pilot.program.program.small
    if any(c.sampled for c in plan.controllers) or any(s.delayed for s in plan.sensors):
        if engine in ("explicit", "implicit"):
            raise ValueError(
                f'engine="{engine}" cannot follow sampled controllers and delayed sensors: use engine="adaptive"'
            )
        return "adaptive", 0
    if engine == "adaptive":
        return engine, 0
    if engine != "auto":
        say(f"steps of the {engine} engine", 0.1)
        steps = pilot.steps_for(engine, MOST_STEPS[engine])
        if steps is None:
            raise ValueError(
                f'engine="{engine}" does not reach the tolerance {pilot.program.tolerance:g} with '
                f'{MOST_STEPS[engine]} steps between samples: try engine="auto", or save at more times'
            )
        return engine, steps
    say("steps of the explicit engine", 0.1)
    cheap = int(IMPLICIT_COST[small])
    explicit = pilot.steps_for("explicit", cheap)
    if explicit is not None:
        return "explicit", explicit
    say("steps of the implicit engine", 0.3)
    implicit = pilot.steps_for("implicit", MOST_STEPS["implicit"])
    most = MOST_STEPS["explicit"] if implicit is None else int(IMPLICIT_COST[small] * implicit)
    explicit = pilot.steps_for("explicit", most)
    if explicit is not None:
        return "explicit", explicit
    return ("adaptive", 0) if implicit is None else ("implicit", implicit)


def _audited(pilot: Pilot, lanes: np.ndarray) -> tuple[int, Audit | None]:
    """Steps, raised until lanes agree with the adaptive solver, and how far their estimates are from the truth.

    The factor is the largest error over the largest estimate, of the audited lanes and, against twice as many steps,
    of the pilot's. It is not taken lane by lane: where the error comes from kinks within steps (a valve that
    opens), embedded estimates hardly tell one lane from another; what they do tell is a lane unlike those seen.
    """
    program = pilot.program
    exact, _ = pilot.run("adaptive", 0, lanes)
    steps, engine = program.steps, program.program.engine
    while True:
        found, estimate = pilot.run(engine, steps, lanes)
        errors = lane_errors(found, exact)
        known = np.isfinite(errors) & (estimate > 0.0)
        if engine == "adaptive" or not np.nanmax(errors, initial=0.0) > program.tolerance or steps >= 1024:
            break
        steps = -(-3 * steps // 2)
    factor = 1.0
    if engine != "adaptive":
        coarse, pilot_estimate = pilot.run(engine, steps)
        every = np.append(errors[known], lane_errors(coarse, pilot.run(engine, 2 * steps)[0]))
        estimates = np.append(estimate[known], pilot_estimate)[np.isfinite(every)]
        factor = float(np.max(every[np.isfinite(every)], initial=0.0) / np.max(estimates, initial=1e-300)) or 1.0
    rms = np.sqrt(np.nanmean((found - exact) ** 2, axis=(0, 2)))
    named = dict(zip(program.program.observed, map(float, rms), strict=True))
    return steps, Audit(lanes, program.tolerance, float(np.nanmax(errors, initial=0.0)), named, factor)


def prepare_ensemble(
    circuit: Circuit,
    times,
    varied: dict[Paths, Any],
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    outputs: Iterable[str] | None = None,
    reductions: dict[str, AbstractReduction] | None = None,
    tolerance: float = 1e-4,
    engine: str = "auto",
    steps: int | None = None,
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
    if steps is not None and (engine not in MOST_STEPS or steps < 1):
        raise ValueError(f'steps (at least 1) go with engine="explicit" or "implicit", got {steps} with {engine!r}')
    program = make_program(
        circuit, times, varied, inputs, initial, outputs, reductions, tolerance, precision, solver, max_steps
    )
    columns = columns_of(varied)
    good = np.flatnonzero(~out_of_range(program.circuit, list(program.paths), columns))
    columns = [column[..., good] for column in columns]
    pilot = Pilot(program, columns, extreme_lanes(columns, min(PILOT_LANES, good.size), seed))
    engine, count = (engine, steps) if steps else _chosen(pilot, engine, say)
    program = dataclasses.replace(program, program=program.program._replace(engine=engine), steps=count)
    if engine == "adaptive" and solver is None and not pilot_is_smooth(program):
        program = dataclasses.replace(
            program, program=program.program._replace(method=_implicit(program.program.method))
        )
    found = None
    if audit > 0:
        say("audit against the adaptive solver", 0.6)
        lanes = np.random.default_rng(seed + 1).permutation(good.size)[:audit]
        count, found = _audited(dataclasses.replace(pilot, program=program), lanes)
        if steps is None:
            program = dataclasses.replace(program, steps=count)
        found = found._replace(lanes=good[found.lanes]) if found else None
    return dataclasses.replace(program, audit=found, seconds={"prepare": time.perf_counter() - began})


def pilot_is_smooth(program: EnsembleProgram) -> bool:
    """Whether the adaptive engine is chosen for what the lockstep engines cannot follow, not for stiffness."""
    plan = program.program.plan
    return any(c.sampled for c in plan.controllers) or any(s.delayed for s in plan.sensors)


def ensemble(
    circuit: Circuit,
    times,
    varied: dict[Paths, Any],
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    outputs: Iterable[str] | None = None,
    reductions: dict[str, AbstractReduction] | None = None,
    tolerance: float = 1e-4,
    engine: str = "auto",
    steps: int | None = None,
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
            of those that the pilot finds.
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
