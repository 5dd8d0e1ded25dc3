"""Exact derivatives of every lane of an ensemble: all of some tens of numbers, or the gradient of an objective."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.chunks import checked_chunk
from jaxlines.simulation.ensemble import FEWEST, EnsembleProgram, workers
from jaxlines.simulation.ensemble_columns import Varied, as_slice, out_of_range
from jaxlines.simulation.ensemble_program import LaneProgram, chunk_tangent, compiled
from jaxlines.simulation.lockstep_gradient import lane_outputs
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import cast, computing_in

DERIVATIVE_LANES = {"float64": 5 * FEWEST, "float32": 8 * FEWEST}
"""Lanes at once, at most: with more, XLA shares out the loops of a chunk among threads that have their own chunks."""


class EnsembleJacobian(NamedTuple):
    """Derivatives of an ensemble, SI.

    Fields: times [s]; outputs: name -> (lanes, samples); reductions: name -> (lanes,); slopes: output -> path ->
    d output / d number, (lanes, samples); reduction_slopes: reduction -> path -> (lanes,). NaN for lanes that fail.
    """

    times: np.ndarray
    outputs: dict[str, np.ndarray]
    reductions: dict[str, np.ndarray]
    slopes: dict[str, dict[str, np.ndarray]]
    reduction_slopes: dict[str, dict[str, np.ndarray]]


class EnsembleGradient(NamedTuple):
    """An objective of every lane, (lanes,), and its derivatives: path -> the shape of the varied numbers."""

    value: np.ndarray
    gradient: dict[str, np.ndarray]


class _Outputs(dict[str, Any]):
    """Outputs by name, for an objective."""

    def __missing__(self, name: str):
        return self[resolve(name, list(self), "output of this ensemble")]


def _tangent_chunk(program: LaneProgram, values, columns, grid, steps):
    """Kept outputs, reductions, and their derivatives in the columns, lanes last."""
    outputs, slopes = chunk_tangent(program, values, columns, grid, steps)
    kept, times = np.asarray(program.kept, dtype=int), grid[:, -1]
    reduced, reduced_slopes = [], []
    for reduction, taken in zip(program.reductions, program.taken, strict=True):
        series = tuple(outputs[:, i] for i in taken)

        def along(c, reduction=reduction, taken=taken, series=series):
            tangents = tuple(slopes[:, c, i] for i in taken)
            return jax.jvp(lambda *series: reduction(times, *series), series, tangents)[1]

        reduced.append(reduction(times, *series))
        reduced_slopes.append(jnp.stack([along(c) for c in range(len(columns))]))
    return outputs[:, kept], slopes[:, :, kept], reduced, reduced_slopes


def _gradient_chunk(program: LaneProgram, objective: Callable, steps: int, values, columns, grid):
    """The objective of every lane, and the cotangents of the columns."""
    outputs_of = lane_outputs(program, values, grid, steps)

    def total(columns):
        outputs = outputs_of(columns)
        value = objective(grid[:, -1], _Outputs((name, outputs[:, i]) for i, name in enumerate(program.observed)))
        if jnp.shape(value) != outputs.shape[-1:]:
            raise ValueError(
                f"the objective must give one number for each lane, shape {outputs.shape[-1:]}, got "
                f"{jnp.shape(value)}: series have the shape (samples, lanes), sum over axis 0"
            )
        return jnp.sum(value), value

    (_, value), gradient = jax.value_and_grad(total, has_aux=True)(columns)
    return value, gradient


def _in_chunks(program: EnsembleProgram, columns, good: np.ndarray, chunk: int, run: Callable, write: Callable) -> None:
    """Run good lanes chunk by chunk on all cores; write(part, result) takes down what comes of each."""
    parts = [good[i : i + chunk] for i in range(0, good.size, chunk)]

    def one(part: np.ndarray) -> None:
        index = np.concatenate([part, np.full(chunk - part.size, part[0])])
        chosen = tuple(np.ascontiguousarray(column[..., as_slice(index)]) for column in columns)
        with computing_in(program.precision):
            result = run(*cast((program.values, chosen, program.grid), program.precision))
            write(as_slice(part), jax.tree.map(lambda x: np.asarray(x)[..., : part.size], result))

    with ThreadPoolExecutor(min(workers(), max(len(parts), 1))) as pool:
        list(pool.map(one, parts))


def _steps(program: EnsembleProgram) -> int:
    """Steps of the plan. Raises: ValueError for the adaptive engine."""
    if program.program.engine == "adaptive":
        raise ValueError(
            "derivatives of an ensemble need a lockstep engine: use `simulate` with gradient= inside jax.vmap for "
            "circuits with sampled controllers or delayed sensors"
        )
    return program.steps


def ensemble_jacobian(program: EnsembleProgram, varied: Varied, *, chunk: int | None = None) -> EnsembleJacobian:
    """Outputs and reductions of every lane and their derivatives in all varied numbers, by forward sensitivities.

    The derivatives are those of the computed solution, exactly (no finite differences). For up to some tens of
    numbers; beyond that `ensemble_gradient` costs less.

    Args: program: of `prepare_ensemble`; varied: path -> (lanes,), as there; chunk: lanes at once, a multiple of 128.
    Returns: an `EnsembleJacobian`. Raises: ValueError or KeyError for a wrong call.
    """
    columns, steps = program.ordered(varied), _steps(program)
    for paths, column in zip(program.paths, columns, strict=True):
        if column.ndim > 1:
            raise ValueError(f"{paths[0]} is a record in each lane: use ensemble_gradient for its derivatives")
    for name, reduction in zip(program.names, program.program.reductions, strict=True):
        if not reduction.differentiable:
            raise ValueError(f"{name} ({type(reduction).__name__}) has no derivative: leave it out, or take a Crossing")
    lanes, kind = columns[0].shape[-1], program.precision
    kept = [program.program.observed[i] for i in program.program.kept]
    labels = [paths[0] for paths in program.paths]
    samples = len(program.times)
    series = np.full((samples, len(kept), lanes), np.nan, kind)
    slopes = np.full((samples, len(labels), len(kept), lanes), np.nan, kind)
    reduced = np.full((len(program.names), lanes), np.nan, kind)
    reduced_slopes = np.full((len(program.names), len(labels), lanes), np.nan, kind)

    def write(part, result):
        series[..., part], slopes[..., part] = result[0], result[1]
        for k in range(len(program.names)):
            reduced[k, part], reduced_slopes[k][:, part] = result[2][k], result[3][k]

    good = np.flatnonzero(~out_of_range(program.circuit, list(program.paths), columns))
    size = _chunk_size(good.size, kind) if chunk is None else checked_chunk(chunk)
    _in_chunks(
        program, columns, good, size, lambda *data: compiled(_tangent_chunk)(program.program, *data, steps), write
    )
    return EnsembleJacobian(
        times=program.times,
        outputs={name: series[:, i].T for i, name in enumerate(kept)},
        reductions=dict(zip(program.names, reduced, strict=True)),
        slopes={n: {label: slopes[:, c, i].T for c, label in enumerate(labels)} for i, n in enumerate(kept)},
        reduction_slopes={
            n: {label: reduced_slopes[k, c] for c, label in enumerate(labels)} for k, n in enumerate(program.names)
        },
    )


def ensemble_gradient(
    program: EnsembleProgram, objective: Callable, varied: Varied, *, chunk: int | None = None
) -> EnsembleGradient:
    """An objective of every lane and its gradient in all varied numbers, backwards in time.

    The gradient is that of the computed solution, exactly, at a few times the cost of a simulation whatever the count
    of numbers: whole records that drive the circuit ("spool.values", (lanes, samples)) included. Memory grows with the
    number of steps, up to some 256 MB for each core. A lane that has no finite solution gives NaN.

    Args: program: of `prepare_ensemble`; objective(times, outputs) -> (lanes,), of `jax.numpy`: outputs are name ->
        (samples, lanes), of the ensemble's outputs and of what its reductions need; varied: path -> numbers.
    Returns: an `EnsembleGradient`. Raises: ValueError or KeyError for a wrong call.
    """
    columns, steps = program.ordered(varied), _steps(program)
    lanes, kind = columns[0].shape[-1], program.precision
    value = np.full(lanes, np.nan, kind)
    gradient = [np.full(column.shape, np.nan, kind) for column in columns]

    def write(part, result):
        value[part] = result[0]
        for into, found in zip(gradient, result[1], strict=True):
            into[..., part] = found

    good = np.flatnonzero(~out_of_range(program.circuit, list(program.paths), columns))
    size = _chunk_size(good.size, kind) if chunk is None else checked_chunk(chunk)
    _in_chunks(
        program,
        columns,
        good,
        size,
        lambda *data: compiled(_gradient_chunk, (0, 1, 2))(program.program, objective, steps, *data),
        write,
    )
    named = zip(program.paths, gradient, strict=True)
    return EnsembleGradient(value, {paths[0]: np.moveaxis(g, -1, 0) for paths, g in named})


def _chunk_size(lanes: int, precision: str) -> int:
    """Lanes at once for derivatives."""
    if jax.default_backend() != "cpu":
        return 16 * 2 * FEWEST
    share = -(-lanes // workers())
    rounds = -(-share // DERIVATIVE_LANES[precision])
    return -(-share // (rounds * FEWEST)) * FEWEST
