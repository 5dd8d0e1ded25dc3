"""The peer from JAX: vmap of diffrax over chunks of lanes, Tsit5 for the axis and Kvaerno5 for what is stiff.

The axis runs on the plain right-hand side in jax.numpy; a circuit, such as the line, on its own vector field. Tuned as
a user would: float64 (float32 loses its step control), chunks small enough that few lanes wait for the slowest, lanes
sorted by what their cost goes with (the frequency of the spool), a first step given, chunks on all cores by threads.
Steps of Kvaerno5 end on the knots of the command; Tsit5 is faster without that, at equal error.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import servo_axis as axis
from ensemble_peers import Run, best_seconds, in_threads

import jaxlines as jl
from jaxlines.simulation.plan import ravel, unravel
from jaxlines.simulation.vector_field import rates, starting_point

CHUNK = 128


class Lane(NamedTuple):
    """How one lane is integrated, everything of scaled states.

    prepare: numbers (9,) -> what the field takes, made once; field(t, y, prepared); start(prepared); show(y): the
    pressure [Pa]; times of the samples and knots where steps may end [s].
    """

    prepare: Callable
    field: Callable
    start: Callable
    show: Callable
    times: np.ndarray
    knots: np.ndarray


def axis_lane() -> Lane:
    """The servo axis by its right-hand side in jax.numpy."""
    derivative = axis.right_hand_side(jnp)
    slope = np.append(np.diff(axis.command) / np.diff(axis.times), 0.0)
    interval, last = axis.END / (axis.SAMPLES - 1), axis.SAMPLES - 2

    def field(t, y, numbers):
        k = jnp.clip((t / interval).astype(int), 0, last)
        u = jnp.asarray(axis.command)[k] + jnp.asarray(slope)[k] * (t - jnp.asarray(axis.times)[k])
        return jnp.stack(derivative(y * axis.SIZES, u, numbers)) / axis.SIZES

    start = axis.INITIAL / axis.SIZES
    return Lane(
        lambda numbers: numbers,
        field,
        lambda numbers: jnp.asarray(start),
        lambda y: y[0] * axis.SIZES[0],
        axis.times,
        axis.times,
    )


def circuit_lane(program: axis.Compiled, node: str, times: np.ndarray) -> Lane:
    """A lane of a compiled circuit by its own vector field; what is shown is the pressure of a node."""
    plan = program.plan
    place = [name for name, _ in plan.free_nodes].index(node)

    def field(t, y, values):
        return ravel(plan, *rates(plan, values, t, *unravel(plan, y)))

    def start(values):
        return ravel(plan, *starting_point(plan, values, times[0]))

    knots = np.unique(np.concatenate([times, *(np.ravel(s.knot_times()) for s in program.base.every_signal())]))
    return Lane(program.values, field, start, lambda y: unravel(plan, y)[0][place], times, knots)


def _simulate(lane: Lane, solver, tolerance: float, first_step: float, at_knots: bool, max_steps: int) -> Callable:
    """numbers (9,) -> pressure (samples,), NaN where it fails."""
    controller: Any = diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.3, icoeff=0.3)
    if at_knots:
        controller = diffrax.ClipStepSizeController(controller, step_ts=jnp.asarray(lane.knots))

    def run(numbers):
        prepared = lane.prepare(numbers)
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(lane.field),
            solver,
            t0=lane.times[0],
            t1=lane.times[-1],
            dt0=first_step,
            y0=lane.start(prepared),
            args=prepared,
            saveat=diffrax.SaveAt(ts=jnp.asarray(lane.times), fn=lambda t, y, args: lane.show(y)),
            stepsize_controller=controller,
            adjoint=diffrax.ForwardMode(),
            max_steps=max_steps,
            throw=False,
        )
        assert found.ys is not None
        return jnp.where(found.result == diffrax.RESULTS.successful, found.ys, jnp.nan)

    return run


def vmap_diffrax(
    numbers,
    lane: Lane,
    tolerance: float,
    *,
    implicit: bool = False,
    root_finder=None,
    chunk: int = CHUNK,
    first_step: float = 1e-3,
    at_knots: bool | None = None,
    order=None,
    threads: bool = True,
    repeats: int = 2,
    max_steps: int = 100_000,
) -> Run:
    """All lanes by vmap(diffrax) in chunks, in float64.

    Args: numbers (lanes, 9), in the order that the lane takes them; lane; tolerance, relative, and absolute of scaled
    states; implicit: Kvaerno5 with `jaxlines.implicit`'s Newton root finder, else Tsit5; chunk: lanes side by side;
    first_step [s]; at_knots: whether steps end on the knots of the input (default: where implicit); order: what lanes
    are sorted by (default: the last column); threads: chunks side by side on all cores; repeats, of which the fastest
    counts. Batches of larger matrices are factorised on all cores by JAX itself, and two such programs at once can wait
    for each other for ever (jaxlib 0.10.2, 83 by 83): run those without threads.
    """
    numbers = np.asarray(numbers, dtype=float)
    solver = jl.implicit() if implicit else diffrax.Tsit5()
    if root_finder is not None:
        solver = diffrax.Kvaerno5(root_finder=root_finder)
    sorted_by = np.argsort(numbers[:, -1] if order is None else order, kind="stable")
    chunk = min(chunk, len(numbers))
    padding = np.repeat(sorted_by[-1:], -len(numbers) % chunk)
    pieces = list(numbers[np.concatenate([sorted_by, padding])].reshape(-1, chunk, numbers.shape[1]))
    with jax.enable_x64(True):
        began = time.perf_counter()
        run = _simulate(lane, solver, tolerance, first_step, implicit if at_knots is None else at_knots, max_steps)
        program = jax.jit(jax.vmap(run)).lower(pieces[0]).compile()
        compiling = time.perf_counter() - began

    def work(piece):
        with jax.enable_x64(True):  # a setting of the thread
            return np.asarray(program(piece))

    def all_lanes():
        found[:] = in_threads(work, pieces) if threads else [work(piece) for piece in pieces]

    found: list[np.ndarray] = []
    seconds = best_seconds(all_lanes, repeats)
    pressure = np.empty((len(numbers), len(lane.times)))
    pressure[sorted_by] = np.concatenate(found)[: len(numbers)]
    return Run(pressure, seconds, compiling)


def vmap_tsit5(columns, tolerance: float, **tuning) -> Run:
    """The servo axis, all lanes by vmap(Tsit5 with PID control). Args: columns; tolerance; tuning of `vmap_diffrax`."""
    return vmap_diffrax(axis.matrix(columns), axis_lane(), tolerance, **tuning)


def vmap_kvaerno5(columns, tolerance: float, **tuning) -> Run:
    """The same by Kvaerno5 with a healthy root finder, for the stiff variant."""
    return vmap_diffrax(axis.matrix(columns), axis_lane(), tolerance, implicit=True, **tuning)


def vmap_circuit(columns, tolerance: float, **tuning) -> Run:
    """The servo axis by Tsit5 on the vector field of its circuit, in place of the plain right-hand side."""
    paths = axis.varied(columns)
    with jax.enable_x64(True):
        program = axis.compiled(axis.circuit(), paths, axis.initial(), axis.inputs())
        lane = circuit_lane(program, "A", axis.times)
    return vmap_diffrax(np.stack(list(paths.values()), axis=-1), lane, tolerance, **tuning)
