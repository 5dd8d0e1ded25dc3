"""Before an ensemble runs: which engine, how many steps, and how far the error estimates can be trusted."""

import dataclasses
import math
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.ensemble import FEWEST, EnsembleProgram, make_program
from jaxlines.simulation.ensemble_columns import Varied, columns_of, extreme_lanes, out_of_range
from jaxlines.simulation.ensemble_program import ENGINES, compiled, implicit_start, implicit_trial
from jaxlines.simulation.ensemble_result import Audit, Ensemble
from jaxlines.simulation.graded_steps import cut_times, graded_steps, step_times
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.reductions import AbstractReduction
from jaxlines.simulation.result import STATUS

PILOT_LANES = 48
"""Lanes of the pilot at most: the extremes of each varied number, and random ones."""

MOST_STEPS = 512
"""Steps of the explicit engine between stops beyond which it is given up."""

MOST_TRIALS, MOST_GRADINGS = 6000, 6
"""Steps that the pilot of the implicit engine tries, and for how many tolerances, before that is given up."""

MOST_CUTS = {"explicit": 1024, "implicit": 16}
"""Steps of a piece beyond which the audit makes them no shorter."""

IMPLICIT_COST = {True: 10.0, False: 5.0}
"""Time of an implicit step over that of an explicit one, for small circuits and for others (measured, roughly)."""

SAFETY = 2.0
"""The pilot asks for an error that is smaller by this factor, since it sees some lanes only."""

Say = Callable[[str, float], None]


class Candidate(NamedTuple):
    """A program to be tried, and what it costs: explicit steps, or as many as take as long, over all times."""

    program: EnsembleProgram
    cost: float


Ladder = Generator[Candidate, float, None]
"""Candidates that cost more and more; each is sent the error of the last over what it should be."""


@dataclasses.dataclass(frozen=True)
class Pilot:
    """Some lanes of an ensemble, to be run in different ways."""

    program: EnsembleProgram
    columns: list[np.ndarray]
    lanes: np.ndarray

    def run(self, program: EnsembleProgram, cuts: int = 1, lanes: np.ndarray | None = None) -> tuple[Any, Any]:
        """All observed outputs (samples, observed, lanes), NaN for failed lanes, and error estimates.

        cuts: equal parts of each of the program's steps.
        """
        every = tuple(range(len(program.program.observed)))
        whole = program.program._replace(kept=every, reductions=(), taken=())
        lanes = self.lanes if lanes is None else lanes
        # Large circuits take longer to run than to compile once more for few lanes.
        size = FEWEST if whole.small and whole.engine != "adaptive" else len(lanes)
        found = program.run_padded(self.columns, lanes, size, cuts * program.steps, whole)
        good = np.isin(found.status, [STATUS["ok"], STATUS["tension"]])
        return np.where(good, found.series, np.nan), found.estimate

    def exact(self, program: EnsembleProgram, lanes: np.ndarray) -> np.ndarray:
        """The outputs of some lanes by the adaptive solver, implicit where the program's engine is."""
        method = _implicit(program.program.method) if program.program.engine == "implicit" else program.program.method
        adaptive = program.program._replace(engine="adaptive", method=method)
        return self.run(dataclasses.replace(self.program, program=adaptive), 1, lanes)[0]

    def explicit(self) -> Ladder:
        """The explicit engine with more and more steps, as a method of fourth order needs them for its last error."""
        program, steps = self.program.program._replace(engine="explicit"), 1
        while steps <= MOST_STEPS:
            candidate = dataclasses.replace(self.program, program=program, steps=steps)
            over = yield Candidate(candidate, float(steps * self.pieces))
            steps = math.ceil(steps * (min(max(over**0.25, 1.25), 4.0) if np.isfinite(over) else 2.0))

    def implicit(self) -> Ladder:
        """The implicit engine with graded steps that are shorter and shorter; none when a lane fails however short."""
        tolerance, cost = self.program.tolerance, IMPLICIT_COST[self.program.program.small]
        for _ in range(MOST_GRADINGS):
            try:
                boundaries = self.graded(tolerance)
            except RuntimeError:
                return
            over = yield Candidate(self.program.with_graded_steps(boundaries), cost * (len(boundaries) - 1))
            tolerance /= min(max(2.0 * over, 3.0), 100.0)

    def graded(self, tolerance: float) -> np.ndarray:
        """Boundaries of the steps [s] that all lanes together need for an error estimate of each step.

        In double precision, whatever the program's is: the estimates of short steps would be lost in roundings.
        Raises: RuntimeError as `graded_steps`.
        """
        made = self.program
        with computing_in("float64"):
            columns = tuple(np.ascontiguousarray(column[..., self.lanes]) for column in self.columns)
            data = cast((made.values, columns), "float64")
            program, begin = made.program._replace(engine="implicit", kept=(), reductions=(), taken=()), made.times[0]
            start = compiled(implicit_start)(program, *data, begin)

            def trial(t, h, state):
                return compiled(implicit_trial)(program, *data, t, h, state)

            stops = made.grid[1:].ravel()
            return graded_steps(trial, made.times, start, tolerance, knots=stops, max_steps=MOST_TRIALS).times

    def search(self, engines: Iterable[str], say: Say) -> EnsembleProgram | None:
        """The program of the cheapest engine and steps that are exact enough; None if there is none.

        Tried in order of cost; the error is told from twice as many steps.
        """
        floors = {"explicit": 1.0, "implicit": IMPLICIT_COST[self.program.program.small]}
        ladders = {engine: getattr(self, engine)() for engine in engines}
        costs: dict[str, float] = {engine: floors[engine] * self.pieces for engine in engines}
        over, ready, tried = dict.fromkeys(engines), {}, 0
        while costs:
            engine = min(costs, key=lambda e: costs[e])
            if engine not in ready:
                try:
                    ready[engine], costs[engine] = ladders[engine].send(over[engine])
                except StopIteration:
                    del costs[engine]
                continue
            program, tried = ready.pop(engine), tried + 1
            say(f"pilot: {engine} engine, {program.description['steps']} steps", min(0.05 * (1 + tried), 0.5))
            found, over[engine] = self.enough(program)
            if found is not None:
                return found
            costs[engine] *= 1.25  # what comes next takes more than that
        return None

    @property
    def pieces(self) -> int:
        """Intervals between stops, over all times."""
        return int(np.count_nonzero(np.diff(self.program.grid[1:], axis=1)))

    def enough(self, program: EnsembleProgram) -> tuple[EnsembleProgram | None, float]:
        """The program if it is exact enough, with three quarters of its equal steps if these are, else None; and its
        error over what it should be."""
        wanted, found = self.program.tolerance / SAFETY, self.run(program)[0]
        if not np.isfinite(found).all(axis=(0, 1)).mean() > 0.5:
            return None, np.inf  # twice as many steps would not tell more
        exact = self.run(program, 2)[0]
        over = worst(found, exact) / wanted
        if not over <= 1.0:
            return None, over
        if not program.graded and program.steps >= 4:
            fewer = dataclasses.replace(program, steps=3 * program.steps // 4)
            if worst(self.run(fewer)[0], exact) <= wanted:
                return fewer, over
        return program, over


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
    found = pilot.search(("explicit", "implicit") if engine == "auto" else (engine,), say)
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
    exact = pilot.exact(program, lanes)
    while True:
        found, estimate = pilot.run(program, 1, lanes)
        errors = lane_errors(found, exact)
        known = np.isfinite(errors) & (estimate > 0.0)
        enough = not np.nanmax(errors, initial=0.0) > program.tolerance
        if fixed or engine == "adaptive" or enough or program.steps >= MOST_CUTS[engine]:
            break
        program = dataclasses.replace(program, steps=-(-3 * program.steps // 2))
    factor = 1.0
    if engine != "adaptive":
        coarse, pilot_estimate = pilot.run(program)
        every = np.append(errors[known], lane_errors(coarse, pilot.run(program, 2)[0]))
        estimates = np.append(estimate[known], pilot_estimate)[np.isfinite(every)]
        factor = float(np.max(every[np.isfinite(every)], initial=0.0) / np.max(estimates, initial=1e-300)) or 1.0
    if program.graded and program.steps > 1:
        program = program.with_graded_steps(cut_times(step_times(program.grid), program.steps))
    rms = np.sqrt(np.nanmean((found - exact) ** 2, axis=(0, 2)))
    named = dict(zip(program.program.observed, map(float, rms), strict=True))
    return program, Audit(lanes, program.tolerance, float(np.nanmax(errors, initial=0.0)), named, factor)


def prepare_ensemble(
    circuit: Circuit,
    times,
    varied: Varied,
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    outputs: Iterable[str] | None = None,
    reductions: dict[str, AbstractReduction] | None = None,
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
    pilot = Pilot(program, columns, extreme_lanes(columns, min(PILOT_LANES, good.size), seed))
    program = _chosen(pilot, engine, say) if steps is None else _given(program, engine, steps)
    if program.program.engine == "adaptive" and solver is None and can_run_in_step(program):
        # The lockstep engines were not exact enough, most likely since the circuit is stiff.
        stiff = program.program._replace(method=_implicit(program.program.method))
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
    reductions: dict[str, AbstractReduction] | None = None,
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
