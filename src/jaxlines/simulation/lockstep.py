"""Many lanes in step: one explicit fixed-step scheme, all lanes of an ensemble side by side in every array.

The scheme keeps two copies of the state (2N storage): d <- A_i d + h f(t + C_i h, y), y <- y + B_i d. Its stages are
all alike, so that they are scanned: the program holds one copy of the vector field however many stages, steps and
samples there are. Lanes never meet, so that a failed one disturbs no other, and results do not depend on how
lanes are split or ordered.

Reference: Carpenter and Kennedy, "Fourth-order 2N-storage Runge-Kutta schemes", NASA TM-109112, 1994: RK4(3)5.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.evaluation import kept_apart, put_down

DECAY = np.array(
    [
        0.0,
        -567301805773 / 1357537059087,
        -2404267990393 / 2016746695238,
        -3550918686646 / 2091501179385,
        -1275806237668 / 842570457699,
    ]
)
"""A_i: what is kept of d."""

ADVANCE = np.array(
    [
        1432997174477 / 9575080441755,
        5161836677717 / 13612068292357,
        1720146321549 / 2090206949498,
        3134564353537 / 4481467310338,
        2277821191437 / 14882151754819,
    ]
)
"""B_i: how far y goes along d."""

WHEN = np.array(
    [
        0.0,
        1432997174477 / 9575080441755,
        2526269341429 / 6820363962896,
        2006345519317 / 3224310063776,
        2802321613138 / 2924317926251,
    ]
)
"""C_i: where in the step each stage stands."""


def _error_weights() -> np.ndarray:
    """Weights v_i of an error estimate h sum v_i f_i: b + v is a scheme of third order.

    v spans what the four conditions up to third order leave free; it has the length one.
    """
    memory, slopes, stages = np.zeros(5), np.zeros(5), np.zeros((5, 5))
    for i in range(5):
        stages[i] = slopes
        memory = DECAY[i] * memory
        memory[i] += 1.0
        slopes = slopes + ADVANCE[i] * memory
    nodes = stages.sum(axis=1)
    conditions = np.stack([np.ones(5), nodes, nodes**2, stages @ nodes])
    return np.linalg.svd(conditions)[2][-1]


ERROR = _error_weights()


class Marched(NamedTuple):
    """What an interval leaves: the state at its end, and each lane's summed error estimate (scaled states)."""

    state: tuple
    error: Any


def coefficients(dtype) -> tuple:
    """A, B, C and the weights of the error estimate."""
    return tuple(jnp.asarray(c, dtype) for c in (DECAY, ADVANCE, WHEN, ERROR))


def stage_signals(field, begin, step, dtype):
    """What the signals are at the stages of a step, leading axis of stages."""
    return jax.vmap(field.signals)(begin + step * jnp.asarray(WHEN, dtype))


class Step(NamedTuple):
    """What a step leaves: state and memory d after it, and each lane's error estimate (scaled states)."""

    state: tuple
    memory: tuple
    error: Any


def explicit_step(field, begin, step, state: tuple) -> Step:
    """One step of all lanes.

    The estimate is that of the sum of all states in units of their typical sizes: one array instead of as many as
    there are states, which would cost a third of the memory traffic.
    """
    dtype = state[0].dtype
    decay, advance, _, weights = coefficients(dtype)
    rest = tuple(jnp.zeros_like(y) for y in state)
    alike = all(y.shape == field.shape for y in state)  # else blocks of states, which do not fit in rows

    def stage(carry, numbers):
        state, memory, defect, room = carry
        kept, go, weight, signals = numbers
        # Kept apart, so that every use of the state comes before its update, which then needs no copy.
        if alike:
            room = put_down(step != 0.0, lambda: field.rates(signals, state), room)
        slope = tuple(room) if alike else kept_apart(step != 0.0, field.rates, signals, state)
        memory = tuple(kept * d + step * f for d, f in zip(memory, slope, strict=True))
        after = tuple(y + go * d for y, d in zip(state, memory, strict=True))
        return (after, memory, defect + weight * field.total(slope), room), None

    signals = stage_signals(field, begin, step, dtype)
    start = (state, rest, jnp.zeros(field.shape, dtype), jnp.zeros((len(state) * alike, *field.shape), dtype))
    (after, memory, defect, _), _ = jax.lax.scan(stage, start, (decay, advance, weights, signals))
    return Step(after, memory, step * defect)


def explicit_interval(field, begin, end, steps, start: Marched) -> Marched:
    """Advance all lanes over an interval in equal steps.

    Args: field: with `signals(t)`, `rates(signals, state)` and `total(slopes)`; begin, end [s]; steps: their
    number, which may be traced; start: state and error so far.
    """
    step = (end - begin) / steps

    def one_step(k, marched: Marched) -> Marched:
        after = explicit_step(field, begin + k * step, step, marched.state)
        return Marched(after.state, marched.error + jnp.abs(jnp.asarray(after.error)))

    return jax.lax.fori_loop(0, steps, one_step, start)


def march(field, interval, grid, steps, start: tuple, error):
    """Integrate all lanes over the intervals of a grid and observe them at its times; to be called inside jit.

    Args: field; interval: a scheme such as `explicit_interval`; grid: times [s], shape (samples, pieces + 1), the
    ends of the pieces of each interval between samples (row 0 is not used: the start); steps: of each piece;
    start: the state at grid[0, -1]; error: zero for each lane.
    Returns: outputs (samples, wanted, lanes), the error estimates (lanes,).
    """

    def between(marched: Marched, ends):
        for_piece = lambda marched, piece: (interval(field, piece[0], piece[1], steps, marched), None)  # noqa: E731
        if ends.shape[0] == 2:
            marched = interval(field, ends[0], ends[1], steps, marched)
        else:
            marched, _ = jax.lax.scan(for_piece, marched, (ends[:-1], ends[1:]))
        return marched, field.outputs(field.signals(ends[-1]), marched.state)

    first = field.outputs(field.signals(grid[0, -1]), start)
    marched, rest = jax.lax.scan(between, Marched(start, error), grid[1:])
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest), marched.error
