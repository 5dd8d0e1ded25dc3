"""The search of an ensemble's engine and steps: what is cheapest of what is exact enough for some of its lanes.

Both engines have a ladder of efforts. The one whose next rung costs least is tried first; its error tells the rung
after that, up or down, until nothing is left that could be cheaper than the best so far.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable

import numpy as np

from jaxlines.simulation.ensemble import EnsembleProgram
from jaxlines.simulation.ensemble_trials import Pilot
from jaxlines.simulation.implicit_programs import implicit_structure

MOST_STEPS = 512
"""Steps of the explicit engine between stops beyond which it is given up."""

MOST_TRIALS = 6000
"""Steps that the pilot of the implicit engine tries for a tolerance before that is given up."""

MOST_RUNGS = 8
"""Efforts of an engine that are tried."""

WILD, CHEAP = 1e3, 8
"""Error over what it should be beyond which steps are taken to be too long to be stable; and steps up to which more are
just tried in small circuits, which takes less than a look at their Jacobians."""

SMALL_COST, BLOCK_COST, DENSE_COST = 30.0, 4.5, 0.005
"""Time of an implicit step over that of an explicit one: for small circuits, whose explicit steps have every number an
array of its own; for others; and what dense matrices add for every square of a number of states (measured)."""

Say = Callable[[str, float], None]


def implicit_cost(program: EnsembleProgram) -> float:
    """Time of an implicit step over that of an explicit one."""
    if program.program.small:
        return SMALL_COST
    structure = implicit_structure(program.program, program.values, "float64")
    dense = structure.elimination.method == "dense"
    return BLOCK_COST + (DENSE_COST * len(structure.colour) ** 2 if dense else 0.0)


class ExplicitLadder:
    """The explicit engine with different numbers of equal steps between stops."""

    def __init__(self, pilot: Pilot):
        self._pilot, self._bad, self._good, self._steps = pilot, 0, MOST_STEPS + 1, 1
        self._stable = 0

    @property
    def cost(self) -> float:
        """Of the next rung: explicit steps over all times; infinite when there is none."""
        return float(self._steps * self._pilot.pieces) if self._bad < self._steps < self._good else math.inf

    def candidate(self, most: float) -> tuple[EnsembleProgram, float]:
        """The next rung, and what it costs."""
        program = self._pilot.program
        program = dataclasses.replace(program, program=program.program._replace(engine="explicit"), steps=self._steps)
        return program, self.cost

    def learn(self, over: float) -> None:
        """Choose the rung after one whose error over what it should be is known."""
        n = self._steps
        factor = max(1.3 * over, 1e-3) ** 0.25 if over <= WILD else math.inf  # a method of fourth order
        if over <= 1.0:
            self._good = n
            self._steps = max(math.floor(n * max(factor, 0.6)), (self._bad + n) // 2)
            if self._steps > 0.85 * n and n > 3:
                self._steps = n  # not worth another run
            return
        self._bad = n
        if over > WILD and not (self._pilot.program.program.small and n < CHEAP):
            self._stable = self._pilot.stable_steps(MOST_STEPS + 1)
        least = max(n + 1, min(math.ceil(1.15 * n), n + 8), self._stable)
        wanted = math.ceil(n * (min(factor, 4.0) if over <= WILD else 1.3 if self._stable else 2.0))
        self._steps = max(least, wanted)
        if self._good <= MOST_STEPS:
            self._steps = min(self._steps, (n + self._good) // 2) if self._good - n > max(1, 0.15 * n) else self._good


class ImplicitLadder:
    """The implicit engine with steps graded for different tolerances of a step."""

    def __init__(self, pilot: Pilot):
        self._pilot, self._ratio = pilot, SMALL_COST if pilot.program.program.small else BLOCK_COST
        self._tolerance: float | None = 3.0 * pilot.program.tolerance
        self._bad, self._good = math.inf, 0.0
        self._expected = float(pilot.pieces)

    @property
    def cost(self) -> float:
        """Of the next rung, as far as it can be told: explicit steps that take as long; infinite when there is none."""
        return math.inf if self._tolerance is None else self._ratio * self._expected

    def candidate(self, most: float) -> tuple[EnsembleProgram, float] | None:
        """The next rung, and what it costs; None when a lane fails or it would cost more than `most`."""
        assert self._tolerance is not None
        self._ratio = implicit_cost(self._pilot.program)
        trials = int(min(MOST_TRIALS, 1.3 * most / self._ratio + 10))
        try:
            program = self._pilot.graded(self._tolerance, trials)
        except RuntimeError:
            self._tolerance = None
            return None
        self._expected = float(program.num_steps)
        return program, self.cost

    def learn(self, over: float) -> None:
        """Choose the rung after one whose error over what it should be is known."""
        assert self._tolerance is not None
        now = self._tolerance
        if over <= 1.0:
            self._good = max(self._good, now)
            new = now * min(1.0 / max(1.5 * over, 1e-9), 50.0)
        else:
            self._bad = min(self._bad, now)
            new = now / (min(max(2.0 * over, 3.0), 100.0) if np.isfinite(over) else 10.0)
        if self._good > 0.0 and not self._good < new < self._bad:
            new = math.sqrt(self._good * self._bad) if np.isfinite(self._bad) else self._good
        if self._good > 0.0 and new < 2.0 * self._good:  # fewer than a sixth of the steps would be saved
            self._tolerance = None
            return
        # Error estimates of steps go with the fourth power of their length.
        self._expected *= (now / new) ** 0.25
        self._tolerance = new


def search(pilot: Pilot, engines: Iterable[str], say: Say) -> EnsembleProgram | None:
    """The program of the cheapest engine and steps that are exact enough; None if there is none."""
    kinds = {"explicit": ExplicitLadder, "implicit": ImplicitLadder}
    ladders = {engine: kinds[engine](pilot) for engine in engines}
    rungs, best, least = dict.fromkeys(ladders, 0), None, math.inf
    while True:
        left = {e: ladder.cost for e, ladder in ladders.items() if ladder.cost < least and rungs[e] < MOST_RUNGS}
        if not left:
            return best
        engine = min(left, key=lambda e: left[e])
        say(f"pilot: {engine} engine", min(0.05 * (1 + sum(rungs.values())), 0.5))
        rungs[engine] += 1
        tried = ladders[engine].candidate(least)
        if tried is None:
            continue
        program, cost = tried
        if cost >= least:
            del ladders[engine]
            continue
        over = pilot.error(program)
        say(f"pilot: {engine} engine, {program.description['steps']} steps: {over:.2g} of the error allowed", 0.5)
        if over <= 1.0:
            best, least = program, cost
        ladders[engine].learn(over)
