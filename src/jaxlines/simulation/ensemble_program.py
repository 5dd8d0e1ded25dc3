"""The compiled program of an ensemble: a chunk of lanes from its numbers to its results."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.assembly import Location, set_numbers
from jaxlines.simulation.block_field import BlockField
from jaxlines.simulation.compiled_programs import compiled as compiled
from jaxlines.simulation.integration import Method, integrate
from jaxlines.simulation.lane_field import BoundField, LaneField
from jaxlines.simulation.lockstep import explicit_interval, march
from jaxlines.simulation.lockstep_tangent import march_tangent
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.reductions import AbstractReduction
from jaxlines.simulation.result import STATUS
from jaxlines.simulation.rosenbrock import integrate as integrate_stiff

ENGINES = ("explicit", "implicit", "adaptive")

MOST_STATES, MOST_NUMBERS = 48, 1500
"""Up to so many states and numbers of a circuit, every number is a lane array of its own (`LaneField`)."""


class LaneProgram(NamedTuple):
    """Everything static about the runs of an ensemble.

    Fields: plan; observed: names of all that is looked at; places: for each varied number where it is; kept: which
    of the observed are returned as series; reductions, and for each which of the observed it takes; pressures:
    which of the observed are pressures of free nodes; engine: one of `ENGINES`; small: whether every number
    is a lane array of its own; method: of the adaptive engine; fixed: see `special_numbers`; dense: whether the
    implicit engine solves with dense matrices.
    """

    plan: Plan
    observed: tuple[str, ...]
    places: tuple[tuple[Location, ...], ...]
    kept: tuple[int, ...]
    reductions: tuple[AbstractReduction, ...]
    taken: tuple[tuple[int, ...], ...]
    pressures: tuple[int, ...]
    engine: str
    small: bool
    method: Method
    fixed: tuple[tuple[int, int, float], ...] = ()
    dense: bool = False

    @property
    def wanted(self) -> tuple[int, ...]:
        """Which of the observed somebody asked for: they are returned, or reduced."""
        return tuple(sorted({*self.kept, *(i for taken in self.taken for i in taken)}))


class ChunkResult(NamedTuple):
    """Of one chunk of lanes: series (samples, kept, lanes), reductions (reductions, lanes), status codes and error
    estimates (lanes,)."""

    series: Any
    reductions: Any
    status: Any
    estimate: Any


def is_small(plan: Plan, values: Values) -> bool:
    """Whether a circuit is small enough for a lane array for each of its numbers."""
    states = len(plan.free_nodes) + sum(
        int(np.prod(s.shape)) * len(kind.members) for kind in plan.kinds for s in kind.states
    )
    numbers = sum(int(np.prod(np.shape(leaf))) for leaf in jax.tree.leaves((values.kinds, values.fluid)))
    return 0 < states <= MOST_STATES and numbers <= MOST_NUMBERS


def numbers_of_lane(program: LaneProgram, values: Values, numbers) -> Values:
    """The values of one lane."""
    locations = [place for places in program.places for place in places]
    repeated = [number for places, number in zip(program.places, numbers, strict=True) for _ in places]
    return set_numbers(values, locations, repeated)


def small_field(
    program: LaneProgram, values: Values, columns, t, derivatives: str = "", differentiated=None
) -> BoundField:
    """The vector field of the lanes of a small circuit; derivatives, differentiated: see `LaneField.bind`."""
    field = LaneField(program.plan, values, program.places, program.observed, program.fixed)
    return field.bind(values, columns, t, derivatives, differentiated)


def field_of(program: LaneProgram, values: Values, columns, t) -> BoundField | BlockField:
    """The vector field of the lanes."""
    return (small_field if program.small else block_field)(program, values, columns, t)


def marched(program: LaneProgram, values: Values, columns, grid, steps):
    """Outputs (samples, observed, lanes) and error estimates of the lockstep engines."""
    if program.engine == "implicit":
        return _marched_implicitly(program, values, columns, grid, steps)
    field = field_of(program, values, columns, grid[0, -1])
    return march(field, explicit_interval, grid, steps, field.start(), jnp.zeros(field.shape, grid.dtype))


def block_field(program: LaneProgram, values: Values, columns, t) -> BlockField:
    """The field of the implicit engine, whatever the size of the circuit."""
    return BlockField(program.plan, values, program.places, program.observed, columns, t)


def _marched_implicitly(program: LaneProgram, values: Values, columns, grid, cuts):
    """Outputs (samples, observed, lanes) and error estimates; cuts: equal parts of each step of the grid."""
    begin = grid[0, -1]
    field = block_field(program, values, columns, begin)
    held, rate = field.implicit(begin)

    def show(t, state):
        return field.outputs(field.signals(t), tuple(jax.tree.leaves(state)))

    start = field.tree(field.start())
    shown, error = integrate_stiff(program.plan, held, grid[1:], start, rate, show, cuts)
    return jnp.concatenate([show(begin, start)[None], shown]), error


def _adapted(program: LaneProgram, values: Values, columns, times, tolerance):
    """Outputs (samples, observed, lanes) and status codes of the adaptive engine."""

    def one(numbers):
        found = integrate(
            program.plan, program.observed, program.method, numbers_of_lane(program, values, numbers), times, tolerance
        )
        return found.outputs, found.status

    return jax.vmap(one, in_axes=-1, out_axes=-1)(list(columns))


def _status(program: LaneProgram, values: Values, columns, outputs):
    """Status codes of lanes from their outputs."""

    def fluid_of(numbers):
        fluid = numbers_of_lane(program, values, numbers).fluid
        return fluid.air_content(), jnp.asarray(fluid.vapour_pressure)

    air, vapour = jax.vmap(fluid_of, in_axes=-1)(list(columns))
    status = jnp.full(outputs.shape[-1], STATUS["ok"], jnp.int8)
    if program.pressures:
        lowest = jnp.min(outputs[:, np.asarray(program.pressures)], axis=(0, 1))
        status = jnp.where((air <= 0.0) & (lowest < vapour), jnp.int8(STATUS["tension"]), status)
    return jnp.where(jnp.all(jnp.isfinite(outputs), axis=(0, 1)), status, jnp.int8(STATUS["non_finite"]))


def _chunk(program: LaneProgram, values: Values, columns, grid, steps, tolerance) -> ChunkResult:
    times = grid[:, -1]
    if program.engine == "adaptive":
        outputs, solved = _adapted(program, values, columns, times, tolerance)
        estimate = jnp.full(outputs.shape[-1], jnp.nan, outputs.dtype)
        status = jnp.where(solved == STATUS["ok"], _status(program, values, columns, outputs), solved.astype(jnp.int8))
    else:
        outputs, estimate = marched(program, values, columns, grid, steps)
        status = _status(program, values, columns, outputs)
    reductions = [
        reduction(times, *(outputs[:, i] for i in taken))
        for reduction, taken in zip(program.reductions, program.taken, strict=True)
    ]
    reduced = jnp.stack(reductions) if reductions else jnp.zeros((0, outputs.shape[-1]), outputs.dtype)
    return ChunkResult(outputs[:, np.asarray(program.kept, dtype=int)], reduced, status, estimate)


def run_chunk(program: LaneProgram, values: Values, columns, grid, steps, tolerance) -> ChunkResult:
    """The results of a chunk of lanes; compiled once for each program and size of chunk."""
    return compiled(_chunk)(program, values, columns, grid, steps, tolerance)


def chunk_tangent(program: LaneProgram, values: Values, columns, grid, steps, differentiated=None):
    """Outputs (samples, observed, lanes) and their derivatives (samples, columns, observed, lanes).

    differentiated: indices of the columns that derivatives are taken in, (lanes,) each; all by default.
    """
    differentiated = tuple(range(len(columns)) if differentiated is None else differentiated)
    if program.small and program.engine == "explicit":
        return march_tangent(
            small_field(program, values, columns, grid[0, -1], "partials", differentiated), grid, steps
        )

    def outputs(columns):
        return marched(program, values, columns, grid, steps)[0]

    def along(c):
        tangents = [jnp.full_like(x, k == c) for k, x in enumerate(columns)]
        return jax.jvp(outputs, (list(columns),), (tangents,))

    shown, slopes = jax.lax.map(along, jnp.asarray(differentiated))
    return shown[0], jnp.moveaxis(slopes, 0, 1)
