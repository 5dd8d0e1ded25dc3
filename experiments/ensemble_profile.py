"""Where the time of an ensemble goes: parts of a run timed on their own, and what derivatives add to it.

All parts do the same lanes on all cores, in the chunks that a run takes: rates alone (everything that the circuit
computes, stage after stage), the steps of the scheme around them, the whole compiled program with outputs and
status, and the run with Python and copies. What of the steps does not depend on the number of lanes (XLA's loops and
the start of each kernel) follows from the same steps with few lanes.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import ensemble_ours as ours
import jax
import jax.numpy as jnp
import numpy as np
import servo_axis as axis
from ensemble_peers import interleaved

import jaxlines as jl
from jaxlines.simulation.chunks import FEWEST, workers
from jaxlines.simulation.ensemble_program import compiled, field_of, marched, run_chunk, small_field
from jaxlines.simulation.evaluation import put_down
from jaxlines.simulation.lockstep import WHEN
from jaxlines.simulation.lockstep_adjoint import march_adjoint, march_steps
from jaxlines.simulation.precision import cast, computing_in

STEPS = 3
"""Steps between samples."""

GRADIENT_LANES = 512
"""Lanes at once of the halves of a gradient: a divisor of all lanes."""


def _rates_alone(program, values, columns, grid):
    """The rates at every stage of every step, without the steps."""
    field = field_of(program, values, columns, grid[0, -1])
    state, when = field.start(), jnp.asarray(WHEN, grid.dtype)

    def stage(slopes, t):
        return put_down(t >= grid[0, 0], lambda: field.rates(field.signals(t), state), slopes), None

    def step(slopes, ends):
        width = (ends[1] - ends[0]) / STEPS
        return jax.lax.scan(stage, slopes, ends[0] + width * (jnp.arange(STEPS)[:, None] + when).ravel())

    pieces = jnp.stack([grid[1:, :-1].ravel(), grid[1:, 1:].ravel()], axis=1)
    return jax.lax.scan(step, jnp.zeros((len(state), *field.shape), grid.dtype), pieces)[0]


def _steps_alone(program, values, columns, grid):
    return marched(program, values, columns, grid, np.asarray(STEPS))


def _stored(program, values, columns, grid):
    field = small_field(program, values, columns, grid[0, -1])
    return march_steps(field, grid[1:], STEPS, field.start())


def _backwards(program, values, columns, grid, stored, given):
    field = small_field(program, values, columns, grid[0, -1], "pulled")
    return march_adjoint(field, grid, STEPS, stored, given)


class _Parts:
    """Parts of the run of a program on all cores."""

    def __init__(self, columns: dict[str, np.ndarray], precision: str):
        self.varied = axis.varied(columns)
        self.program = ours.axis_program(columns, engine="explicit", steps=STEPS, audit=0, precision=precision)
        self.precision, self.pool = precision, ThreadPoolExecutor(workers())
        self._columns = self.program.ordered(self.varied)

    def on_all_cores(self, function: Callable, lanes: int, *more) -> Callable:
        """A call that runs a compiled function for every chunk of so many lanes; more: other arguments."""
        count = self._columns[0].shape[-1]
        with computing_in(self.precision):
            values, columns, grid = cast((self.program.values, tuple(self._columns), self.program.grid), self.precision)
        chunks = [tuple(column[i : i + lanes] for column in columns) for i in range(0, count, lanes)]

        def one(chunk):
            with computing_in(self.precision):
                jax.block_until_ready(function(self.program.program, values, chunk, grid, *more))

        return lambda: list(self.pool.map(one, chunks))

    def backwards(self, lanes: int) -> Callable:
        """The same for the backward half of a gradient."""
        with computing_in(self.precision):
            few = tuple(column[:lanes] for column in self._columns)
            data = cast((self.program.values, few, self.program.grid), self.precision)
            stored = compiled(_stored)(self.program.program, *data)
            given = jnp.ones((len(self.program.times), len(self.program.program.observed), lanes), self.precision)
        return self.on_all_cores(compiled(_backwards), lanes, stored, given)


def forward_profile(columns: dict[str, np.ndarray], precision: str, repeats: int = 7) -> dict[str, float]:
    """Seconds of the parts of a run."""
    parts = _Parts(columns, precision)
    lanes = parts.program.chunk_lanes(len(columns["inertia"]))
    whole = (np.asarray(STEPS), np.asarray(1e-6, precision))
    found = interleaved(
        {
            "rates": parts.on_all_cores(compiled(_rates_alone), lanes),
            "steps": parts.on_all_cores(compiled(_steps_alone), lanes),
            "program": parts.on_all_cores(run_chunk, lanes, *whole),
            "run": lambda: parts.program.run(parts.varied),
            "steps, few lanes": parts.on_all_cores(compiled(_steps_alone), FEWEST),
        },
        repeats,
    )
    few = found.pop("steps, few lanes")
    # seconds = lanes a + chunks b: b from two sizes of chunks of the same lanes
    a_chunk = (few - found["steps"]) / (1.0 / FEWEST - 1.0 / lanes) / lanes
    return found | {"whatever the lanes": max(a_chunk, 0.0), "lanes_at_once": lanes}


def gradient_profile(columns: dict[str, np.ndarray], precision: str, repeats: int = 5) -> dict:
    """Seconds of a run, of a gradient and of its halves, and of both derivatives with other numbers of lanes."""
    parts, lanes = _Parts(columns, precision), GRADIENT_LANES

    def objective(times, outputs):
        return jnp.mean((outputs["A.pressure"] / 1e6) ** 2, axis=0)

    calls: dict[str, Callable] = {
        "run": lambda: parts.program.run(parts.varied),
        "forwards, every step stored": parts.on_all_cores(compiled(_stored), lanes),
        "backwards": parts.backwards(lanes),
        "gradient": lambda: jl.ensemble_gradient(parts.program, objective, parts.varied),
        "jacobian": lambda: jl.ensemble_jacobian(parts.program, parts.varied),
    }
    for size in (256, 512, 1024):
        calls[f"gradient, {size} lanes at once"] = lambda size=size: jl.ensemble_gradient(
            parts.program, objective, parts.varied, chunk=size
        )
        calls[f"jacobian, {size} lanes at once"] = lambda size=size: jl.ensemble_jacobian(
            parts.program, parts.varied, chunk=size
        )
    return interleaved(calls, repeats)


def profile(lanes: int) -> dict:
    """Seconds of parts of runs and gradients of so many lanes, in both precisions."""
    columns = axis.lane_numbers(lanes)
    return {
        precision: {"forward": forward_profile(columns, precision), "derivatives": gradient_profile(columns, precision)}
        for precision in ("float64", "float32")
    }
