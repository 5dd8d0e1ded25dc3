"""Some lanes of an ensemble run in different ways, and how far these are from one another."""

import dataclasses
from typing import Any

import numpy as np

from jaxlines.simulation.ensemble import FEWEST, EnsembleProgram
from jaxlines.simulation.explicit_stability import steps_needed
from jaxlines.simulation.graded_steps import cut_times, step_times
from jaxlines.simulation.lane_stepper import LaneStepper, Shown
from jaxlines.simulation.result import STATUS

SAFETY = 1.5
"""The pilot asks for an error that is smaller by this factor, since it sees some lanes only."""

NEARLY, FINER = 4.0, 1.5
"""Error over what it should be up to which twice as many steps are exact; and how many more steps than what it is
compared with an exact one of the same engine has."""


@dataclasses.dataclass(frozen=True)
class Pilot:
    """Some lanes of an ensemble, to be run in different ways.

    Fields: program; columns: of all lanes; lanes: which; known: what has been run, by how.
    """

    program: EnsembleProgram
    columns: list[np.ndarray]
    lanes: np.ndarray
    known: dict[Any, Any] = dataclasses.field(default_factory=dict)

    def run(self, program: EnsembleProgram, cuts: int = 1, lanes: np.ndarray | None = None) -> Shown:
        """What lanes do, by default those of the pilot; each way is run once. cuts: equal parts of every step."""
        lanes = self.lanes if lanes is None else lanes
        steps = step_times(program.grid) if program.graded else None
        key = (program.program, steps, cuts * program.steps, program.tolerance, program.precision, lanes.tobytes())
        if key not in self.known:
            run = self._stepped if program.program.engine == "implicit" else self._run
            self.known[key] = run(program, cuts, lanes)
        return self.known[key]

    def _run(self, program: EnsembleProgram, cuts: int, lanes: np.ndarray, size: int | None = None) -> Shown:
        """By a program of the ensemble's own."""
        wanted = program.program.wanted
        whole = program.program._replace(kept=wanted, reductions=(), taken=())
        if size is None:
            size = self._size(lanes) if whole.engine != "adaptive" else len(lanes)
        found = program.run_padded(self.columns, lanes, size, cuts * program.steps, whole)
        good = np.isin(found.status, [STATUS["ok"], STATUS["tension"]])
        return Shown(np.where(good, found.series, np.nan), found.estimate)

    def _size(self, lanes: np.ndarray) -> int:
        """Lanes that are run together: of large circuits few, since these take longer to run than to compile."""
        return FEWEST if self.program.program.small else max(len(lanes), len(self.lanes))

    def _stepped(self, program: EnsembleProgram, cuts: int, lanes: np.ndarray) -> Shown:
        """By single steps of the implicit engine, driven from here: what a pilot needs in place of a long compilation.

        A last digit apart it is what the program of the ensemble does.
        """
        boundaries = step_times(program.grid)
        if cuts * program.steps > 1:
            boundaries = cut_times(boundaries, cuts * program.steps)
        return self._stepper(lanes, program.precision).through(np.asarray(boundaries))

    def _stepper(self, lanes: np.ndarray, precision: str = "float64") -> LaneStepper:
        key = ("stepper", lanes.tobytes(), precision)
        if key not in self.known:
            size = max(len(lanes), len(self.lanes))
            index = np.concatenate([lanes, np.full(size - len(lanes), lanes[0])])
            chosen = [np.ascontiguousarray(column[..., index]) for column in self.columns]
            self.known[key] = LaneStepper(self.program, chosen, len(lanes), precision)
        return self.known[key]

    def as_run(self, program: EnsembleProgram, lanes: np.ndarray) -> Shown:
        """What lanes do in the very program that will run the ensemble, where its outputs are all that is wanted and
        many lanes take no longer than compiling for few."""
        inner = program.program
        if inner.engine == "adaptive" or inner.reductions or inner.kept != inner.wanted or not inner.small:
            return self.run(program, 1, lanes)
        return self._run(program, 1, lanes, program.chunk_lanes(self.columns[0].shape[-1]))

    def exact(self, program: EnsembleProgram, lanes: np.ndarray, tighter: float = 1.0) -> np.ndarray:
        """The wanted outputs of some lanes by the adaptive solver at a hundredth of the tolerance times `tighter`.

        Where the program's engine is implicit, an implicit solver; but for large circuits, whose dense Jacobians take
        it seconds a lane, the explicit one first.
        """
        given, tolerance = program.program.method, tighter * self.program.tolerance
        methods = [given]
        if program.program.engine == "implicit":
            methods = [implicit_method(given)] if program.program.small else [given, implicit_method(given)]
        for method in methods:
            adaptive = program.program._replace(engine="adaptive", method=method)
            shown = self.run(dataclasses.replace(self.program, program=adaptive, tolerance=tolerance), 1, lanes).series
            if np.isfinite(shown).all(axis=(0, 1)).any():
                break
        return shown  # pyright: ignore[reportPossiblyUnbound]

    def graded(self, tolerance: float, most: int) -> EnsembleProgram:
        """The implicit engine with the steps that all lanes together need for an error estimate of each step.

        In double precision, whatever the program's is: the estimates of short steps would be lost in roundings.
        Raises: RuntimeError as `graded_steps`.
        """
        made = self.program
        boundaries, shown = self._stepper(self.lanes).graded(tolerance, made.grid[1:].ravel(), most)
        program = made.with_graded_steps(boundaries)
        if made.precision == "float64":
            lanes, steps = self.lanes.tobytes(), step_times(program.grid)
            self.known[program.program, steps, 1, made.tolerance, made.precision, lanes] = shown
        return program

    def stable_steps(self, most: int) -> int:
        """The fewest steps of the explicit engine in the longest piece in which nothing grows that should decay.

        At the start, and where the implicit engine has been at the samples if it has run.
        """
        longest = float(np.max(np.diff(self.program.grid[1:], axis=1)))
        return steps_needed(self._stepper(self.lanes).spectra(), longest, most)

    def error(self, program: EnsembleProgram) -> float:
        """The largest error of a program over what it should be; infinite where half of the lanes fail."""
        found = self.run(program).series
        if not np.isfinite(found).all(axis=(0, 1)).mean() > 0.5:
            return np.inf  # twice as many steps would not tell more
        exact = self.truth(program)
        over = worst(found, exact) * SAFETY / self.program.tolerance
        if over <= NEARLY and "truth" not in self.known:
            self.known["truth"] = exact, program.program.engine, 2 * program.num_steps
        return over

    def truth(self, program: EnsembleProgram) -> np.ndarray:
        """What is exact beside a program: twice as many steps, or what nearly agreed with half as many before.

        That serves later programs of both engines: of a method of fourth order it is closer by a factor of 16.
        """
        exact, engine, steps = self.known.get("truth", (None, "", 0))
        if exact is None or (engine == program.program.engine and steps < FINER * program.num_steps):
            return self.run(program, 2).series
        return exact

    @property
    def pieces(self) -> int:
        """Intervals between stops, over all times."""
        return int(np.count_nonzero(np.diff(self.program.grid[1:], axis=1)))


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
