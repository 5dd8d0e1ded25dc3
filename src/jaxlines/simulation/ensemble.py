"""Many variations of a circuit at once: `ensemble`, and `prepare_ensemble` for running a plan chunk by chunk."""

import dataclasses
import itertools
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from jaxlines.simulation.chunks import (
    FEWEST as FEWEST,
    MOST_ON_GPU as MOST_ON_GPU,
    checked_chunk,
    cpu_chunk,
    device_bytes,
    devices,
    gpu_chunk,
    on_device,
    workers as workers,
)
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.ensemble_columns import Varied, as_slice, columns_of, out_of_range, places_of
from jaxlines.simulation.ensemble_program import ChunkResult, LaneProgram, run_chunk
from jaxlines.simulation.ensemble_result import LANE_STATUS, Audit, Ensemble
from jaxlines.simulation.graded_steps import graded_grid, step_times
from jaxlines.simulation.implicit_programs import implicit_structure
from jaxlines.simulation.plan import Values
from jaxlines.simulation.precision import cast, computing_in


@dataclasses.dataclass(frozen=True)
class EnsembleProgram:
    """A plan for an ensemble: engine, steps and error calibration are fixed once; `run` it for any lanes.

    Fields: circuit; program: what is compiled; paths: of each varied number; values: those of the circuit; times
    [s]; grid: where pieces end, see `lane_times.step_grid` and, if graded, `graded_steps.graded_grid`; units of the
    outputs; steps of each piece; tolerance; precision; audit; description: what the numbers depend on, for a record;
    seconds spent so far; graded: whether the pieces are steps that the pilot has found.
    """

    circuit: Circuit
    program: LaneProgram
    paths: tuple[tuple[str, ...], ...]
    values: Values
    times: np.ndarray
    grid: np.ndarray
    names: tuple[str, ...]
    units: dict[str, str]
    steps: int
    tolerance: float
    precision: str
    audit: Audit | None
    seconds: dict[str, float]
    graded: bool = False

    @property
    def description(self) -> dict[str, Any]:
        """What the numbers depend on; "steps" are those between stops, or the boundaries of all graded ones [s]."""
        import diffrax

        return {
            "engine": self.program.engine,
            "steps": step_times(self.grid) if self.graded else self.steps,
            "precision": self.precision,
            "tolerance": self.tolerance,
            "factor": self.audit.factor if self.audit else 1.0,
            "solver": type(self.program.method.solver).__name__ if self.program.engine == "adaptive" else "",
            "platform": jax.default_backend(),
            "versions": {"jax": jax.__version__, "diffrax": diffrax.__version__, "numpy": np.__version__},
        }

    @property
    def num_steps(self) -> int:
        """Steps over all times; 0 for the adaptive engine."""
        if self.program.engine == "adaptive":
            return 0
        return self.steps * int(np.count_nonzero(np.diff(self.grid[1:], axis=1)))

    def with_implicit_engine(self) -> "EnsembleProgram":
        """The same lanes, steps and outputs by the implicit engine."""
        if self.program.engine == "implicit":
            return self
        structure = implicit_structure(self.program, self.values, self.precision)
        dense = structure.elimination.method == "dense"
        return dataclasses.replace(self, program=self.program._replace(engine="implicit", dense=dense))

    def with_graded_steps(self, boundaries) -> "EnsembleProgram":
        """The program of the implicit engine with given boundaries of all its steps [s], shape (steps + 1,)."""
        grid = graded_grid(self.times, boundaries)
        return dataclasses.replace(self.with_implicit_engine(), grid=grid, steps=1, graded=True)

    def chunk_lanes(self, lanes: int) -> int:
        """How many lanes are run at once."""
        if self.program.engine == "adaptive":
            return FEWEST
        states, numbers = self._num_states(), sum(np.size(leaf) for leaf in jax.tree.leaves(self.values.kinds))
        itemsize = np.dtype(self.precision).itemsize
        if jax.default_backend() != "cpu":
            saved = len(self.times) * (len(self.program.observed) + len(self.program.kept))
            return gpu_chunk(lanes, itemsize * (saved + 40 * states + numbers), device_bytes())
        if not self.program.small and self.program.engine == "implicit":
            return FEWEST  # more of them are not faster, and the audit has compiled for so many
        return cpu_chunk(lanes, itemsize * (6 * states + numbers), workers())

    def _num_states(self) -> int:
        plan = self.program.plan
        return len(plan.free_nodes) + sum(int(np.prod(s.shape)) * len(k.members) for k in plan.kinds for s in k.states)

    def run(
        self,
        varied: Varied,
        *,
        chunk: int | None = None,
        progress: Callable[[str, float], None] | None = None,
    ) -> Ensemble:
        """Results for other values of the varied numbers, (lanes,) each, in the order of preparation or by name.

        Args: chunk: lanes at once, a multiple of 128; by default what suits the cache or the device. Results do
        not depend on it. Raises: ValueError or KeyError for a wrong call; a lane that fails has a status instead.
        """
        began = time.perf_counter()
        columns = self.ordered(varied)
        bad = out_of_range(self.circuit, list(self.paths), columns)
        good = np.flatnonzero(~bad)
        found = _Found(self, bad.size)
        found.leave_out(bad)
        if good.size:
            self._run_lanes(columns, good, self.steps, found, chunk, progress)
            self._run_again(columns, good, found, chunk, progress)
        seconds = {**self.seconds, "run": time.perf_counter() - began}
        return found.ensemble(seconds)

    def ordered(self, varied: Varied) -> list[np.ndarray]:
        """The varied numbers in the order of preparation, lanes last."""
        known = {path: i for i, paths in enumerate(self.paths) for path in paths}
        places = places_of(varied, {path: (i, None) for path, i in known.items()})
        by_place = dict(zip(places, columns_of(varied), strict=True))
        missing = [paths for paths in self.paths if paths not in by_place]
        if missing:
            raise ValueError(f"this ensemble varies {', '.join(missing[0])} too: give its values")
        return [by_place[paths] for paths in self.paths]

    def _run_lanes(self, columns, lanes: np.ndarray, steps: int, found: "_Found", chunk, progress) -> None:
        """Run some lanes chunk by chunk, on all cores, and write down what they give."""
        size = self.chunk_lanes(lanes.size) if chunk is None else checked_chunk(chunk)
        parts = [lanes[i : i + size] for i in range(0, lanes.size, size)]
        done = 0

        def one(part: np.ndarray, device) -> None:
            with on_device(device):
                found.write(part, self.run_padded(columns, part, size, steps))

        with ThreadPoolExecutor(min(workers(), len(parts))) as pool:
            for part, _ in zip(parts, pool.map(one, parts, itertools.cycle(devices())), strict=True):
                done += part.size
                if progress:
                    progress(f"{done} of {lanes.size} lanes", done / lanes.size)

    def _run_again(self, columns, lanes: np.ndarray, found: "_Found", chunk, progress) -> None:
        """Run lanes that are not exact enough, or not finite, with 4 and 16 times as many steps; flag the rest."""
        if self.program.engine == "adaptive":
            return
        chunk = chunk or self.chunk_lanes(lanes.size)  # that of the first run, whose program is compiled
        for times_as_many in (4, 16):
            over = lanes[self._over(found.error[lanes])]
            if not over.size:
                return
            self._run_lanes(columns, over, times_as_many * self.steps, found, chunk, progress)
        over = lanes[self._over(found.error[lanes])]
        found.status[over] = np.where(
            found.status[over] == LANE_STATUS["ok"], LANE_STATUS["inaccurate"], found.status[over]
        )

    def _over(self, errors: np.ndarray) -> np.ndarray:
        """Which errors are not within the tolerance; without an audit, those that are not even finite."""
        return ~(errors <= self.tolerance) if self.audit else ~np.isfinite(errors)

    def run_padded(
        self, columns, part: np.ndarray, size: int, steps: int, program: LaneProgram | None = None
    ) -> ChunkResult:
        """The results of some lanes, filled up to a size with the first of them."""
        index = np.concatenate([part, np.full(size - part.size, part[0])])
        chosen = tuple(np.ascontiguousarray(column[..., as_slice(index)]) for column in columns)
        program = program or self.program
        tolerance = 1e-2 * self.tolerance  # of each step of the adaptive engine, whose errors add up
        with computing_in(self.precision):
            values, chosen, grid = cast((self.values, chosen, self.grid), self.precision)
            result = run_chunk(program, values, chosen, grid, np.asarray(steps), np.asarray(tolerance, self.precision))
            return jax.tree.map(lambda x: np.asarray(x)[..., : part.size], result)


class _Found:
    """Arrays that the chunks of an ensemble write into."""

    def __init__(self, program: EnsembleProgram, lanes: int):
        self.program = program
        series, kind = (len(program.program.kept), len(program.times), lanes), program.precision
        self.series = np.empty(series, kind)  # filled by the threads that compute it
        self.reduced = np.empty((len(program.program.reductions), lanes), kind)
        self.status = np.zeros(lanes, np.int8)
        self.error = np.full(lanes, np.nan)

    def leave_out(self, bad: np.ndarray) -> None:
        """Flag lanes whose numbers are out of range: they are not run."""
        self.status[bad] = LANE_STATUS["out_of_range"]
        self.series[..., bad] = np.nan
        self.reduced[:, bad] = np.nan

    def write(self, part: np.ndarray, result: ChunkResult) -> None:
        """Write down what a chunk gave; lanes that are not finite leave no numbers behind."""
        failed, into = ~np.isin(result.status, [LANE_STATUS["ok"], LANE_STATUS["tension"]]), as_slice(part)
        self.series[..., into] = np.moveaxis(result.series, 1, 0)
        self.reduced[:, into] = result.reductions
        if failed.any():
            self.series[..., part[failed]] = np.nan
            self.reduced[:, part[failed]] = np.nan
        self.status[part] = result.status
        factor = self.program.audit.factor if self.program.audit else 1.0
        self.error[part] = factor * result.estimate

    def ensemble(self, seconds: dict[str, float]) -> Ensemble:
        """The result."""
        program = self.program
        kept = [program.program.observed[i] for i in program.program.kept]
        return Ensemble(
            times=program.times,
            outputs={name: self.series[k].T for k, name in enumerate(kept)},
            reductions=dict(zip(program.names, self.reduced, strict=True)),
            status_code=self.status,
            error=self.error,
            audit=program.audit,
            units={name: program.units[name] for name in kept},
            description=program.description,
            seconds=seconds,
        )
