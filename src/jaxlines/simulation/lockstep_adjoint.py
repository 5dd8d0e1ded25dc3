"""Gradients of many lanes in step, backwards in time: cotangents of the varied numbers from those of the outputs.

The adjoint of each stage d <- A_i d + h f(y), y <- y + B_i d, in reverse: with l and m the cotangents of y and d,
m <- m + B_i l, l <- l + h J^T m, p <- p + h P^T m, m <- A_i m, where J = df/dy and P = df/dp are never formed: m is
pulled back through f. The scheme itself runs backwards beside it, y <- y - B_i d, d <- (d - h f(y))/A_i, from the y
and d that are stored after every step (A_1 = 0: a step begins with no memory). Where these would fill the memory, they
are stored for a part of the samples at a time, which is then computed twice.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.bound_field import BoundField
from jaxlines.simulation.evaluation import kept_apart
from jaxlines.simulation.lockstep import DECAY, coefficients, explicit_step, stage_signals

STORED_BYTES = 256_000_000
"""Bytes of the steps that are stored at once, at most (but for those between two samples)."""


class Cotangents(NamedTuple):
    """Of the state, one array for each, of the columns, and of the signals at one time."""

    state: tuple
    columns: tuple
    signals: tuple


class Steps(NamedTuple):
    """Steps one after the other: begin and length [s], (samples, steps); states and then memories d after each of
    them, (samples times steps, 2 states, lanes)."""

    begin: jax.Array
    length: jax.Array
    after: jax.Array


def march_steps(field: BoundField, grid, steps: int, start: tuple) -> Steps:
    """Integrate all lanes and store every step.

    Args: field; grid: ends of the pieces of each interval between samples (see `march`, without its row 0); steps: of
    each piece, static; start: the state at grid[0, 0].
    """
    length = (grid[:, 1:] - grid[:, :-1])[..., None] / steps
    begin = grid[:, :-1, None] + length * jnp.arange(steps)
    begin, length = (x.reshape(grid.shape[0], -1) for x in (begin, jnp.broadcast_to(length, begin.shape)))

    def one_step(k, carry):
        state, every = carry
        after = explicit_step(field, begin.ravel()[k], length.ravel()[k], state)
        for i, x in enumerate((*after.state, *after.memory)):
            every = jax.lax.dynamic_update_slice(every, x[None, None], (k, i, 0))
        return after.state, every

    nothing = jnp.zeros((begin.size, 2 * len(start), *field.shape), grid.dtype)
    return Steps(begin, length, jax.lax.fori_loop(0, begin.size, one_step, (start, nothing))[1])


def after_step(field: BoundField, steps: Steps, k, memory: bool = False) -> tuple:
    """The state after a step, or the memory d."""
    first, width = field.field.size * memory, (1, 1, steps.after.shape[-1])
    rows = range(first, first + field.field.size)
    return tuple(jax.lax.dynamic_slice(steps.after, (k, i, 0), width).ravel() for i in rows)


def outputs_of_steps(field: BoundField, grid, steps: Steps):
    """Outputs (samples, wanted, lanes) at the times of a grid from all steps between them."""
    every = steps.begin.shape[1]

    def show(at):
        k, t = at
        return field.outputs(field.signals(t), after_step(field, steps, k * every + every - 1))

    first = field.outputs(field.signals(grid[0, -1]), field.start())
    shown = jax.lax.map(show, (jnp.arange(grid.shape[0] - 1), grid[1:, -1]))
    return jnp.concatenate([first[None], shown])


def count_parts(field: BoundField, grid, steps: int) -> int:
    """In how many parts of equally many samples the steps are stored."""
    samples, pieces = grid.shape[0] - 1, grid.shape[1] - 1
    width = field.columns[0].dtype.itemsize * field.shape[-1]
    stored = width * 2 * field.field.size * pieces * steps * samples
    return next(n for n in range(1, samples + 1) if samples % n == 0 and (stored <= n * STORED_BYTES or n == samples))


def _added(field: BoundField, found: dict, factor, into: Cotangents) -> Cotangents:
    """Cotangents with others, given by place: states, columns, signals."""
    size, count = field.field.size, len(field.columns)
    every = [*into.state, *into.columns, *into.signals]
    for place, value in found.items():
        every[place] = every[place] + factor * value
    return Cotangents(tuple(every[:size]), tuple(every[size : size + count]), tuple(every[size + count :]))


def _pulled(field: BoundField, times, into: Cotangents, signals: tuple) -> Cotangents:
    """Add cotangents of the signals at some times, an array (times, lanes) each, to those of the columns."""
    if not field.varies_signals:
        return into
    pulled = field.pulled(times, signals)
    return into._replace(columns=tuple(a + b for a, b in zip(into.columns, pulled, strict=True)))


def _without_signals(field: BoundField, state: tuple, columns: tuple) -> Cotangents:
    return Cotangents(state, columns, tuple(jnp.zeros_like(state[0]) for _ in field.field.signal_names))


def _backwards(decay: np.ndarray) -> np.ndarray:
    """1/A_i, and zero for the first stage, before which there is no memory."""
    return np.concatenate([[0.0], 1.0 / decay[1:]])


def _step_back(field: BoundField, begin, step, state: tuple, memory: tuple, after: Cotangents) -> Cotangents:
    """Cotangents before a step from those after it; state and memory: after it."""
    dtype = state[0].dtype
    decay, advance, when, _ = coefficients(dtype)

    def stage(carry, numbers):
        (state, memory), (pulled, columns, weights), decayed = carry
        keep, undo, go, signals = numbers
        always = step != 0.0

        def before():
            return tuple(y - go * d for y, d in zip(state, memory, strict=True)), tuple(
                decayed * m + go * c for m, c in zip(weights, pulled, strict=True)
            )

        state, weights = kept_apart(always, before)
        slope, found = field.rates_and_pulled(signals, state, weights, always)
        memory = tuple(undo * (d - step * f) for d, f in zip(memory, slope, strict=True))
        into = _added(field, found, step, _without_signals(field, pulled, columns))
        carry = (state, memory), (into.state, into.columns, weights), keep
        return carry, into.signals if field.varies_signals else ()

    rest = tuple(jnp.zeros_like(c) for c in after.state)
    start = (state, memory), (after.state, after.columns, rest), jnp.zeros((), dtype)
    data = (decay, jnp.asarray(_backwards(DECAY), dtype), advance, stage_signals(field, begin, step, dtype))
    (_, (pulled, columns, _), _), signals = jax.lax.scan(stage, start, data, reverse=True)
    return _pulled(field, begin + step * when, _without_signals(field, pulled, columns), signals)


def _observed(field: BoundField, t, state: tuple, given, into: Cotangents) -> Cotangents:
    """Add the cotangents (wanted, lanes) of the outputs at a sample."""
    found = field.pull_outputs(field.signals(t), state, tuple(given))
    found = _added(field, found, 1.0, _without_signals(field, into.state, into.columns))
    return _pulled(field, t[None], found, tuple(s[None] for s in found.signals))


def _part_back(field: BoundField, times, steps: Steps, given, after: Cotangents) -> Cotangents:
    """Cotangents before some samples from those after them; times of the samples [s]."""
    samples, every = steps.begin.shape

    def interval(after: Cotangents, data):
        k, t, begin, length, weights = data
        last = after_step(field, steps, k * every + every - 1)

        def one_step(after: Cotangents, at):
            j, begin, length = at
            state, memory = (after_step(field, steps, k * every + j, memory) for memory in (False, True))
            return _step_back(field, begin, length, state, memory, after), None

        after = _observed(field, t, last, weights, after)
        return jax.lax.scan(one_step, after, (jnp.arange(every), begin, length), reverse=True)[0], None

    data = (jnp.arange(samples), times, steps.begin, steps.length, given)
    return jax.lax.scan(interval, after, data, reverse=True)[0]


def march_adjoint(field: BoundField, grid, steps: int, stored: Steps | tuple, given) -> tuple:
    """Cotangents of the columns.

    Args: field; grid: as in `march`; steps: of each piece, static; stored: all steps (`march_steps`), or the states
    at the samples, one array (samples, lanes) each; given: cotangents of the outputs (samples, wanted, lanes).
    """
    nothing = tuple(jnp.zeros(field.shape, grid.dtype) for _ in range(field.field.size))
    after = _without_signals(field, nothing, tuple(jnp.zeros_like(c) for c in field.columns))
    if isinstance(stored, Steps):
        found, first = _part_back(field, grid[1:, -1], stored, given[1:], after), field.start()
    else:
        parts = count_parts(field, grid, steps)

        def part(after: Cotangents, data):
            grid, start, given = data
            return _part_back(field, grid[:, -1], march_steps(field, grid, steps, start), given, after), None

        split = lambda x: x.reshape(parts, -1, *x.shape[1:])  # noqa: E731
        starts = tuple(y[: -1 : (grid.shape[0] - 1) // parts] for y in stored)
        found, _ = jax.lax.scan(part, after, (split(grid[1:]), starts, split(given[1:])), reverse=True)
        first = tuple(y[0] for y in stored)
    found = _observed(field, grid[0, -1], first, given[0], found)
    pulled = field.pull_start(found.state)
    found = _added(field, pulled, 1.0, _without_signals(field, found.state, found.columns))
    return _pulled(field, grid[:1, -1], found, tuple(s[None] for s in found.signals)).columns
