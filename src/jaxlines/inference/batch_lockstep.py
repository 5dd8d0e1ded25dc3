"""Lanes of a batched fit in step: one program of the ensemble engine, whose lanes are recordings.

What differs between recordings is varied by lane: free parameters, in which outputs are differentiated, numbers of
their own, and whole records of inputs.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from jaxlines.inference.batch_memory import remembered
from jaxlines.inference.problem import Problem, recorded_inputs
from jaxlines.inference.recording import Recording
from jaxlines.simulation.assembly import number_locations
from jaxlines.simulation.ensemble import FEWEST, EnsembleProgram, workers
from jaxlines.simulation.ensemble_columns import out_of_range
from jaxlines.simulation.ensemble_pilot import prepare_ensemble
from jaxlines.simulation.ensemble_program import LaneProgram, chunk_tangent, compiled
from jaxlines.simulation.lane_signals import own_signals
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import cast, computing_in

FINER, COARSER = 2, 2
"""Factor on the steps at each level of accuracy after the first, and by how many levels slopes are coarser than
outputs: a slope that is wrong by a share moves the optimum by that share of a standard error only, while an output that
is wrong moves it by as much as it is wrong."""

FIRST_FINER = 4
"""Factor on the first steps, of which the pilot asks an error of the noise, at the second level: 1/256 of that error
for a scheme of fourth order, where one half of the steps (1/16) would be too little for nearly all."""

SINGLE_SHARE, SINGLE_TIME = 1e-3, 1e-4
"""Single precision serves where the noise is at least this share of a channel's magnitude, and intervals of the grid
this share of the last time."""

FEW = 8
"""Up to so many recordings are run as so many lanes, which a processor does in a fraction of the time."""

CHUNK_ON_GPU = 32 * FEWEST
"""Lanes at once on devices other than the processor."""


class NotInStep(ValueError):
    """The lanes cannot run in step; the message says why."""


def _tangent(program: LaneProgram, differentiated: tuple[int, ...], values, columns, grid, steps):
    """Kept outputs (samples, outputs, lanes) and their slopes (samples, differentiated, outputs, lanes)."""
    outputs, slopes = chunk_tangent(program, values, columns, grid, steps, differentiated)
    kept = np.asarray(program.kept, dtype=int)
    return outputs[:, kept], slopes[:, :, kept]


@dataclasses.dataclass(frozen=True)
class LockstepLanes:
    """Recordings as lanes of one ensemble.

    Fields: program; driven: for each varied number that a free parameter drives, which parameter and by which ratio;
    fixed: the other varied numbers, lanes last; num_free; bad: lanes whose own numbers are out of range; single:
    whether single precision is enough for slopes with the first steps.
    """

    program: EnsembleProgram
    driven: tuple[tuple[int, float], ...]
    fixed: tuple[np.ndarray, ...]
    num_free: int
    bad: np.ndarray
    single: bool = False

    @property
    def name(self) -> str:
        """The engine."""
        return self.program.program.engine

    def effort(self, level: int) -> int:
        """Steps between samples at a level of accuracy."""
        return self.program.steps * (FIRST_FINER * FINER ** (level - 1) if level else 1)

    def slope_level(self, level: int) -> int:
        """The level of the slopes that go with outputs of a level."""
        return max(level - COARSER, 0)

    def run(
        self,
        numbers: np.ndarray,
        lanes: np.ndarray,
        level: int,
        take: Callable,
        *,
        outputs: bool = True,
        slopes: bool = False,
    ) -> None:
        """Simulate lanes with values of the free parameters, chunk by chunk on all cores.

        Chunks have one size whatever is left to do, so that one program serves all iterations.

        Args: numbers, shape (m, free), SI; lanes: which recordings, shape (m,); level: of accuracy; take(part, outputs,
        slopes): called with positions among the m, outputs (part, samples, channels) and slopes (part, samples,
        channels, free) in SI, None for what is not wanted, NaN for failed lanes. It is called in several threads.
        """
        size = CHUNK_ON_GPU
        if jax.default_backend() == "cpu":
            size = FEWEST if self.bad.size > FEW else FEW
        parts = [np.arange(start, min(start + size, lanes.size)) for start in range(0, lanes.size, size)]

        def one(part: np.ndarray) -> None:
            take(part, *self._call(numbers[part], lanes[part], size, level, outputs, slopes))

        if len(parts) == 1:
            one(parts[0])
        elif parts:
            with ThreadPoolExecutor(min(workers(), len(parts))) as pool:
                list(pool.map(one, parts))

    def _call(self, numbers, lanes, size: int, level: int, outputs: bool, slopes: bool):
        index = np.concatenate([np.arange(lanes.size), np.zeros(size - lanes.size, int)])
        moved = [ratio * numbers[index, parameter] for parameter, ratio in self.driven]
        columns = [*moved, *(np.ascontiguousarray(column[..., lanes[index]]) for column in self.fixed)]
        shown, partials, bad = None, None, self.bad[lanes][:, None, None]
        if slopes:
            coarse = self.slope_level(level)
            shown, partials = self._differentiated(tuple(columns), coarse, ~self.bad[lanes])
            shown = shown if outputs and coarse == level else None
            partials = np.moveaxis(partials[..., : lanes.size], -1, 0).swapaxes(2, 3)
            partials = np.where(bad[..., None], np.nan, self._by_parameter(partials))
        if shown is None and outputs:
            shown = self._simulated(columns, size, level)
        if shown is not None:
            shown = np.moveaxis(shown[..., : lanes.size], -1, 0).astype(np.float64)
            shown = np.where(bad, np.nan, shown)
        return shown, partials

    def _differentiated(self, columns: tuple, level: int, good: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs and their slopes in what the free parameters drive, lanes last.

        The first level is computed in single precision where that is enough; where it fails, in double.
        """
        own, places = self.program, tuple(range(len(self.driven)))
        for precision in ("float32", own.precision) if self.single and level == 0 else (own.precision,):
            with computing_in(precision):
                data = cast((own.values, columns, own.grid), precision)
                found = compiled(_tangent, (0, 1))(own.program, places, *data, np.asarray(self.effort(level)))
                found = (np.asarray(found[0]), np.asarray(found[1]))
            if all(np.isfinite(x[..., : good.size][..., good]).all() for x in found):
                break
        return found  # pyright: ignore[reportPossiblyUnbound]

    def _simulated(self, columns: list, size: int, level: int) -> np.ndarray:
        """Outputs, lanes last, by the program that the pilot has compiled."""
        program = self.program.program
        every = program._replace(kept=tuple(range(len(program.observed))))
        found = self.program.run_padded(columns, np.arange(size), size, self.effort(level), every)
        return found.series[:, list(program.kept)]

    def _by_parameter(self, partials: np.ndarray) -> np.ndarray:
        """Slopes in the free parameters, last axis, from those in the numbers that they drive."""
        if len(self.driven) == self.num_free and all(ratio == 1.0 for _, ratio in self.driven):
            return partials
        slopes = np.zeros((*partials.shape[:-1], self.num_free), partials.dtype)
        for place, (parameter, ratio) in enumerate(self.driven):
            slopes[..., parameter] += ratio * partials[..., place]
        return slopes


def _driven(first: Problem) -> tuple[dict[tuple[str, ...], tuple[int, float]], str]:
    """Paths that move together -> the free parameter and the ratio; and what rules lanes in step out, in words."""
    found: dict[tuple[str, ...], tuple[int, float]] = {}
    places = iter(first.locations)
    for k, parameter in enumerate(first.free):
        modes = {next(places).mode for _ in parameter.paths}
        if modes != {"set"}:
            return {}, f"{parameter.label} scales or shifts a recorded input"
        for ratio in dict.fromkeys(parameter.path_ratios):
            paths = zip(parameter.paths, parameter.path_ratios, strict=True)
            found[tuple(path for path, own in paths if own == ratio)] = (k, ratio)
    return found, ""


def _same_times(first: Problem, recordings: Sequence[Recording]) -> bool:
    """Whether all recordings have the same times, or the same from their first sample on where that is enough."""
    times = first.recording.times
    free_of_clock = not own_signals(first.values)
    largest = 1e-6 * float(np.diff(times).min())
    for recording in recordings:
        shift = recording.times[0] - times[0] if free_of_clock else 0.0
        if np.max(np.abs(recording.times - shift - times)) > largest:
            return False
    return True


def lockstep_lanes(
    first: Problem,
    recordings: Sequence[Recording],
    own: Sequence[dict[str, float]],
    starts: np.ndarray,
    interpolation: str,
    engine: str,
    tolerance: float,
) -> LockstepLanes:
    """Recordings, each with its own numbers (path -> SI), as lanes in step.

    Args: first: the problem of the first recording; starts: of the free parameters, shape (recordings, free), SI,
    where a pilot finds how many steps are needed; tolerance: of the pilot, as a share of an output's magnitude.
    Raises: NotInStep; KeyError or ValueError for wrong numbers.
    """
    driven, reason = _driven(first)
    if not reason and not _same_times(first, recordings):
        reason = "the recordings were sampled at different times"
    if reason:
        raise NotInStep(reason)
    fixed = _own_numbers(first, own) | _records(first, recordings, interpolation)
    for paths in driven:
        for path in paths:
            if any(path in others for others in fixed):
                raise ValueError(f"{path} cannot be free and have a value of its own in each recording")
    varied: dict[Any, Any] = {paths: ratio * starts[:, k] for paths, (k, ratio) in driven.items()}
    varied |= {paths: np.moveaxis(column, -1, 0) for paths, column in fixed.items()}
    program = _prepared(first, varied, engine, tolerance)
    if program.program.engine == "adaptive":
        raise NotInStep("the circuit is too stiff for lanes in step, or has sampled controllers or delayed sensors")
    columns = list(fixed.values())
    bad = np.zeros(len(recordings), bool)
    if columns:
        bad = out_of_range(program.circuit, list(fixed), columns)
    single = tolerance >= SINGLE_SHARE and _single_is_enough(program)
    return LockstepLanes(program, tuple(driven.values()), tuple(columns), len(first.free), bad, single)


def _prepared(first: Problem, varied: dict, engine: str, tolerance: float) -> EnsembleProgram:
    """The program of the lanes, made once for the same circuit, inputs and varied numbers."""
    inputs = jax.tree.map(np.array, first.inputs)  # kept with the program: not the caller's
    times, paths = np.array(first.recording.times), list(varied)
    options = {"initial": first.initial, "outputs": first.wanted, "tolerance": tolerance, "engine": engine}

    def make() -> EnsembleProgram:
        return prepare_ensemble(first.circuit, times, varied, inputs, precision=first.precision, audit=0, **options)

    return remembered((first.circuit, times, paths, list(varied.values()), inputs, first.precision, options), make)


def _single_is_enough(program: EnsembleProgram) -> bool:
    """Whether single precision tells the times apart; for the explicit engine, which solves no equations."""
    gaps = np.diff(program.grid[1:], axis=1)
    shortest = float(np.min(gaps[gaps > 0.0], initial=np.inf))
    return program.program.engine == "explicit" and bool(shortest > SINGLE_TIME * np.abs(program.times).max())


def _own_numbers(first: Problem, own: Sequence[dict[str, float]]) -> dict[tuple[str, ...], np.ndarray]:
    """Numbers that recordings have of their own, (lanes,) each; the circuit's where one has none."""
    locations = number_locations(first.plan, first.values)
    leaves = jax.tree.leaves(first.values)
    columns: dict[tuple[str, ...], np.ndarray] = {}
    for lane, numbers in enumerate(own):
        for path, number in numbers.items():
            full = resolve(path, locations)
            if (full,) not in columns:
                position, member = locations[full]
                usual = np.asarray(leaves[position])[... if member is None else member]
                columns[full,] = np.full(len(own), float(usual) if np.size(usual) == 1 else np.nan)
            columns[full,][lane] = number
    return columns


def _records(first: Problem, recordings: Sequence[Recording], interpolation: str) -> dict[tuple[str, ...], np.ndarray]:
    """Records of inputs that are not the same in all recordings, (samples, lanes) each."""
    for recording in recordings:
        if not all(name in recording.channels and recording.mask[name].all() for name in first.inputs):
            recorded_inputs(first.circuit, recording, interpolation)  # says what is wrong
    columns = {}
    for name in first.inputs:
        values = np.stack([recording.channels[name] for recording in recordings], axis=-1)
        if not np.all(values == values[:, :1]):
            columns[f"{name}.values",] = values
    return columns
