"""Gradients of many lanes in step, backwards in time: cotangents of the varied numbers from those of the outputs.

The adjoint of each stage d <- A_i d + h f(y), y <- y + B_i d, in reverse: with l and m the cotangents of y and d,
m <- m + B_i l, l <- l + h J^T m, p <- p + h P^T m, m <- A_i m. States are kept at the samples; an interval between
samples is computed again, step by step, with the partial derivatives J = df/dy and P = df/dp before every stage, which
are kept until its adjoint is done. Memory grows with the number of samples alone.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxlines.simulation.bound_field import BoundField
from jaxlines.simulation.lockstep import DECAY, Marched, coefficients, explicit_interval

KEPT_BYTES = 16_000_000
"""Bytes of partial derivatives that are kept at once where that is more than one step."""


class Cotangents(NamedTuple):
    """Of the state, one array for each, of the columns, and of the signals at one time."""

    state: tuple
    columns: tuple
    signals: tuple


def _spread(field: BoundField, partials, weights, into: Cotangents) -> Cotangents:
    """Add weights^T times the partial derivatives of some numbers to the cotangents."""
    size, count = field.field.size, len(field.columns)
    found = [*into.state, *into.columns, *into.signals]
    for row, weight in zip(partials, weights, strict=True):
        for place, value in row.items():
            found[place] = found[place] + weight * value
    return Cotangents(tuple(found[:size]), tuple(found[size : size + count]), tuple(found[size + count :]))


def _pulled(field: BoundField, times, into: Cotangents, signals: tuple) -> Cotangents:
    """Add cotangents of the signals at some times, an array (times, lanes) each, to those of the columns."""
    if not field.varies_signals:
        return into
    pulled = field.pulled(times, signals)
    return into._replace(columns=tuple(a + b for a, b in zip(into.columns, pulled, strict=True)))


def _without_signals(field: BoundField, state: tuple, columns: tuple) -> Cotangents:
    return Cotangents(state, columns, tuple(jnp.zeros_like(state[0]) for _ in field.field.signal_names))


def _stages(begin, step, count: int, dtype) -> tuple:
    """A_i, B_i and times of the stages of some steps, one after the other."""
    decay, advance, when, _ = coefficients(dtype)
    times = (begin + step * jnp.arange(count))[:, None] + step * when
    return jnp.tile(decay, count), jnp.tile(advance, count), times.ravel()


def _replayed(field: BoundField, step, stages: tuple, state: tuple) -> tuple:
    """What changes of the partial derivatives before some stages, an array (stages, lanes) each."""
    keep, go, times = stages

    def stage(carry, numbers):
        state, memory = carry
        keep, go, signals = numbers
        slope, moving = field.rates_and_moving_partials(signals, state)
        memory = tuple(keep * d + step * f for d, f in zip(memory, slope, strict=True))
        return (tuple(y + go * d for y, d in zip(state, memory, strict=True)), memory), moving

    rest = tuple(jnp.zeros_like(y) for y in state)
    return jax.lax.scan(stage, (state, rest), (keep, go, jax.vmap(field.signals)(times)))[1]


def _back(field: BoundField, step, stages: tuple, moving: tuple, after: Cotangents) -> Cotangents:
    """Cotangents before some stages from those after them."""
    keep, go, times = stages

    def stage(carry, numbers):
        state, columns, memory = carry
        keep, go, moving = numbers
        memory = tuple(m + go * c for m, c in zip(memory, state, strict=True))
        weights = tuple(step * m for m in memory)
        found = _spread(field, field.rate_rows(moving), weights, _without_signals(field, state, columns))
        signals = found.signals if field.varies_signals else ()
        return (found.state, found.columns, tuple(keep * m for m in memory)), signals

    rest = tuple(jnp.zeros_like(c) for c in after.state)
    start = (after.state, after.columns, rest)
    (state, columns, _), signals = jax.lax.scan(stage, start, (keep, go, moving), reverse=True)
    return _pulled(field, times, _without_signals(field, state, columns), signals)


def _steps_at_once(field: BoundField, steps: int) -> int:
    """How many steps keep their partial derivatives at once: a divisor of the steps of an interval."""
    width = field.columns[0].dtype.itemsize * field.shape[-1]
    least = width * len(DECAY) * max(len(field.moving_partials), 1)
    return max(n for n in range(1, steps + 1) if steps % n == 0 and (n == 1 or n * least <= KEPT_BYTES))


def adjoint_interval(field: BoundField, begin, end, steps: int, start: tuple, after: Cotangents) -> Cotangents:
    """Cotangents before an interval from those after it."""
    at_once, step = _steps_at_once(field, steps), (end - begin) / steps
    begins = begin + (at_once * step) * jnp.arange(steps // at_once)
    starts = _starts(field, begins, begins + at_once * step, at_once, start)

    def some_steps(after: Cotangents, numbers):
        begin, state = numbers
        stages = _stages(begin, step, at_once, state[0].dtype)
        return _back(field, step, stages, _replayed(field, step, stages, state), after), None

    return jax.lax.scan(some_steps, after, (begins, starts), reverse=True)[0]


def _starts(field: BoundField, begins, ends, steps: int, state: tuple) -> tuple:
    """The states at the beginning of each of some intervals that follow one another."""
    if begins.shape[0] == 1:
        return tuple(y[None] for y in state)

    def interval(state, at):
        return explicit_interval(field, at[0], at[1], steps, Marched(state, jnp.zeros_like(state[0]))).state, state

    return jax.lax.scan(interval, state, (begins, ends))[1]


def _observed(field: BoundField, t, state: tuple, given, into: Cotangents) -> Cotangents:
    """Add the cotangents (wanted, lanes) of the outputs at a sample."""
    _, partials = field.outputs_and_partials(field.signals(t), state)
    found = _spread(field, partials, list(given), _without_signals(field, into.state, into.columns))
    return _pulled(field, t[None], found, tuple(s[None] for s in found.signals))


def _marched_back(field: BoundField, grid, steps: int, states: tuple, given) -> Cotangents:
    """Cotangents of the start and of the columns, but for what the start depends on; see `march_adjoint`."""

    def between(after: Cotangents, data):
        ends, before, at_end, weights = data
        after = _observed(field, ends[-1], at_end, weights, after)
        starts = _starts(field, ends[:-1], ends[1:], steps, before)

        def piece(after, at):
            begin, end, state = at
            return adjoint_interval(field, begin, end, steps, state, after), None

        return jax.lax.scan(piece, after, (ends[:-1], ends[1:], starts), reverse=True)[0], None

    nothing = tuple(jnp.zeros_like(y[0]) for y in states), tuple(jnp.zeros_like(c) for c in field.columns)
    data = (grid[1:], tuple(y[:-1] for y in states), tuple(y[1:] for y in states), given[1:])
    found, _ = jax.lax.scan(between, _without_signals(field, *nothing), data, reverse=True)
    return _observed(field, grid[0, -1], tuple(y[0] for y in states), given[0], found)


def march_adjoint(field: BoundField, grid, steps: int, states: tuple, given) -> tuple:
    """Cotangents of the columns.

    Args: field; grid: as in `march`; steps: of each piece, static; states: at the samples, one array
    (samples, lanes) each; given: cotangents of the outputs (samples, wanted, lanes).
    """

    found = _marched_back(field, grid, steps, states, given)
    rows = [{k + field.field.size: v for k, v in row.items()} for row in field.start_partials()]
    found = _spread(field, rows, found.state, _without_signals(field, found.state, found.columns))
    return _pulled(field, grid[:1, -1], found, tuple(s[None] for s in found.signals)).columns
