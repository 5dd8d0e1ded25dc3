"""Gradients of many lanes in step, backwards in time: cotangents of the varied numbers from those of the outputs.

The adjoint of each stage d <- A_i d + h f(y), y <- y + B_i d, in reverse: with l and m the cotangents of y and d,
m <- m + B_i l, l <- l + h J^T m, p <- p + h P^T m, m <- A_i m. States are kept at the samples; those of the stages
between are computed again, interval by interval, so that memory grows with the number of samples alone.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxlines.simulation.lane_field import BoundField
from jaxlines.simulation.lockstep import Marched, coefficients, explicit_interval, explicit_step, stage_signals


class Cotangents(NamedTuple):
    """Of the state, one array for each, and of the columns."""

    state: tuple
    columns: tuple


def _spread(field: BoundField, t, partials, weights, into: Cotangents, pull_signals: bool) -> Cotangents:
    """Add weights^T times the partial derivatives of some numbers to the cotangents."""
    size, count = field.field.size, len(field.columns)
    state, columns = list(into.state), list(into.columns)
    signals: dict[int, Any] = {}
    for row, weight in zip(partials, weights, strict=True):
        for place, value in row.items():
            term = weight * value
            if place < size:
                state[place] = state[place] + term
            elif place < size + count:
                columns[place - size] = columns[place - size] + term
            else:
                signals[place - size - count] = signals.get(place - size - count, 0.0) + term
    if signals and pull_signals:
        nothing = jnp.zeros_like(into.state[0])
        pulled = field.pulled(t, [signals.get(k, nothing) for k in range(len(field.field.signal_names))])
        columns = [a + b for a, b in zip(columns, pulled, strict=True)]
    return Cotangents(tuple(state), tuple(columns))


def adjoint_interval(field: BoundField, begin, end, steps: int, start: tuple, after: Cotangents, varied: bool):
    """Cotangents before an interval from those after it; varied: whether columns vary the signals."""
    dtype = start[0].dtype
    step = (end - begin) / steps
    decay, advance, when, _ = coefficients(dtype)

    def kept(state, k):
        return explicit_step(field, begin + k * step, step, state, keep=True)

    _, before = jax.lax.scan(kept, start, jnp.arange(steps))

    def one_step(cotangents: Cotangents, numbers):
        k, states = numbers

        def stage(carry, numbers):
            cotangents, memory = carry
            keep, go, t, signals, state = numbers
            memory = tuple(m + go * c for m, c in zip(memory, cotangents.state, strict=True))
            _, partials = field.rates_and_partials(signals, state)
            weights = tuple(step * m for m in memory)
            cotangents = _spread(field, t, partials, weights, cotangents, varied)
            return (cotangents, tuple(keep * m for m in memory)), None

        times = begin + k * step + step * when
        signals = stage_signals(field, begin + k * step, step, dtype)
        rest = tuple(jnp.zeros_like(c) for c in cotangents.state)
        data = (decay, advance, times, signals, states)
        (cotangents, _), _ = jax.lax.scan(stage, (cotangents, rest), data, reverse=True)
        return cotangents, None

    return jax.lax.scan(one_step, after, (jnp.arange(steps), before), reverse=True)[0]


def _observed(field: BoundField, t, state: tuple, given, into: Cotangents) -> Cotangents:
    """Add the cotangents (wanted, lanes) of the outputs at a sample."""
    _, partials = field.outputs_and_partials(field.signals(t), state)
    return _spread(field, t, partials, list(given), into, field.varies_signals)


def march_adjoint(field: BoundField, grid, steps: int, states: tuple, given) -> tuple:
    """Cotangents of the columns.

    Args: field; grid: as in `march`; steps: of each piece, static; states: at the samples, one array
    (samples, lanes) each; given: cotangents of the outputs (samples, wanted, lanes).
    """
    nothing = Cotangents(tuple(jnp.zeros_like(y[0]) for y in states), tuple(jnp.zeros_like(c) for c in field.columns))

    def between(after: Cotangents, data):
        ends, before, at_end, weights = data
        after = _observed(field, ends[-1], at_end, weights, after)
        pieces = _piece_starts(field, ends, steps, before)

        def piece(after, at):
            begin, end, state = at
            return adjoint_interval(field, begin, end, steps, state, after, field.varies_signals), None

        return jax.lax.scan(piece, after, (ends[:-1], ends[1:], pieces), reverse=True)[0], None

    starts = tuple(y[:-1] for y in states)
    data = (grid[1:], starts, tuple(y[1:] for y in states), given[1:])
    cotangents, _ = jax.lax.scan(between, nothing, data, reverse=True)
    t = grid[0, -1]
    cotangents = _observed(field, t, tuple(y[0] for y in states), given[0], cotangents)
    rows = [{k + field.field.size: v for k, v in row.items()} for row in field.start_partials()]
    return _spread(field, t, rows, cotangents.state, cotangents, field.varies_signals).columns


def _piece_starts(field: BoundField, ends, steps: int, state: tuple):
    """The states at the beginning of every piece of an interval."""
    if ends.shape[0] == 2:
        return tuple(y[None] for y in state)

    def piece(state, at):
        return explicit_interval(field, at[0], at[1], steps, Marched(state, jnp.zeros_like(state[0]))).state, state

    return jax.lax.scan(piece, state, (ends[:-1], ends[1:]))[1]
