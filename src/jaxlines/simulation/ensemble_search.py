"""The search of an ensemble's engine and steps: some lanes run in different ways, the cheapest first."""

import dataclasses
import math
from collections.abc import Callable, Generator, Iterable
from typing import Any, NamedTuple

import numpy as np

from jaxlines.simulation.ensemble import FEWEST, EnsembleProgram
from jaxlines.simulation.ensemble_program import compiled, implicit_start, implicit_trial
from jaxlines.simulation.graded_steps import graded_steps
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import STATUS

MOST_STEPS = 512
"""Steps of the explicit engine between stops beyond which it is given up."""

MOST_TRIALS, MOST_GRADINGS = 6000, 6
"""Steps that the pilot of the implicit engine tries, and for how many tolerances, before that is given up."""

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

    def exact(self, program: EnsembleProgram, lanes: np.ndarray, tighter: float = 1.0) -> np.ndarray:
        """The outputs of some lanes by the adaptive solver at a hundredth of the tolerance times `tighter`.

        Where the program's engine is implicit, an implicit solver; but for large circuits, whose dense Jacobians take
        it seconds a lane, the explicit one first.
        """
        given, tolerance = program.program.method, tighter * self.program.tolerance
        methods = [given]
        if program.program.engine == "implicit":
            methods = [implicit_method(given)] if program.program.small else [given, implicit_method(given)]
        for method in methods:
            adaptive = program.program._replace(engine="adaptive", method=method)
            shown = self.run(dataclasses.replace(self.program, program=adaptive, tolerance=tolerance), 1, lanes)[0]
            if np.isfinite(shown).all(axis=(0, 1)).any():
                break
        return shown  # pyright: ignore[reportPossiblyUnbound]

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


def implicit_method(method):
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
