"""Many lanes in step through stiff circuits: one linearly implicit fixed-step scheme, lanes last in every array.

A step solves s linear systems with one matrix instead of nonlinear equations, so that all lanes do the same work:

    (1/(gamma h) - J) u_i = f(t + alpha_i h, y + sum_j a_ij u_j) + sum_j (c_ij/h) u_j + gamma_i h df/dt
    y_1 = y + sum_i m_i u_i,   J = df/dy at (t, y)

J comes from as many derivatives in a direction as its pattern needs colours (see `sparsity`), and the systems are
solved with its pattern (see `elimination`). The scheme is of order 4 with an embedded one of order 3, both L-stable
and stiffly accurate, and keeps its order for stiff linear problems whose forcing varies.

Reference: Hairer and Wanner, "Solving Ordinary Differential Equations II", 2nd ed. 1996, IV.7 (the form above);
Steinebach, "Order-reduction of ROW-methods for DAEs and method of lines applications", Preprint 1741, TH Darmstadt,
1995 (the coefficients, known as RODASP).
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.jacobian import entries_of, field_like, solved, structure_of
from jaxlines.simulation.plan import Plan, Values, scales, unravel
from jaxlines.simulation.vector_field import rates


class Scheme(NamedTuple):
    """Coefficients of a linearly implicit scheme whose last stage is the error estimate.

    stages: a_ij, shape (s, s), its last row with m_i for i < s; couplings: c_ij; times: alpha_i; drift: gamma_i.
    """

    gamma: float
    stages: np.ndarray
    couplings: np.ndarray
    times: np.ndarray
    drift: np.ndarray


def _lower(*rows: list[float]) -> np.ndarray:
    """A square matrix from the parts of its rows below the diagonal."""
    matrix = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        matrix[i, :i] = row
    return matrix


_LAST = [-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401]

RODASP = Scheme(
    gamma=0.25,
    stages=_lower(
        [],
        [3.0],
        [1.831036793486759, 0.4955183967433795],
        [2.304376582692669, -0.05249275245743001, -1.176798761832782],
        _LAST,
        [*_LAST, 1.0],
    ),
    couplings=_lower(
        [],
        [-12.0],
        [-8.791795173947035, -2.207865586973518],
        [10.81793056857153, 6.780270611428266, 19.53485944642410],
        [34.19095006749676, 15.49671153725963, 54.74760875964130, 14.16005392148534],
        [34.62605830930532, 15.30084976114473, 56.99955578662667, 18.40807009793095, -5.714285714285717],
    ),
    times=np.array([0.0, 0.75, 0.21, 0.63, 1.0, 1.0]),
    drift=np.array([0.25, -0.5, -0.023504, -0.0362, 0.0, 0.0]),
)


BLOCK = 8
"""Steps of an interval at once, of which the later may be none."""


def _combined(weights, stages):
    """sum_j weights[j] stages[j] of states with a leading axis of stages."""
    return jax.tree.map(lambda k: sum(weights[j] * k[j] for j in range(len(k))), stages)


def step(plan: Plan, values: Values, t, h, state, field: Callable = rates, scheme: Scheme = RODASP) -> tuple[Any, Any]:
    """One step from t to t + h of all lanes.

    Args: values: with lanes as the last axis where they differ; t, h [s]: numbers, the same for all lanes; state:
        (potentials, states), lanes last; field: what gives its rates, as `vector_field.rates` does.
    Returns: the state at t + h, and the embedded estimate of this step's error, in the units of the state.
    Validity: inputs that are smooth within the step: jumps and kinks must fall on its ends.
    """
    structure = structure_of(plan, values, state)
    dtype = jax.tree.leaves(state)[0].dtype
    t, h = jnp.asarray(t, dtype), jnp.asarray(h, dtype)
    # Ends of a step are approached from within by a few roundings, so that jumps and kinks there are on its far side.
    nudge = jnp.minimum(4.0 * np.finfo(dtype).eps * jnp.maximum(abs(t), abs(t + h)), 0.125 * h)

    def at(share):
        return jnp.clip(t + share * h, t + nudge, t + h - nudge)

    def rate(t, y):
        return field_like(field, plan, values, t, y)

    slope, push = jax.linearize(rate, at(0.0), state)
    slopes = jax.vmap(push)(*structure.directions(t, state))
    compressed, drift = jax.tree.map(lambda x: x[:-1], slopes), jax.tree.map(lambda x: x[-1], slopes)
    elimination = structure.elimination
    factors = elimination.factor(entries_of(structure, compressed), 1.0 / (scheme.gamma * h))

    def increment(slope, coupled, share):
        right = jax.tree.map(lambda f, c, d: f + c / h + share * h * d, slope, coupled, drift)
        return solved(elimination, factors, right)

    first, count = increment(slope, jax.tree.map(jnp.zeros_like, state), scheme.drift[0]), len(scheme.times)
    known = jax.tree.map(lambda u: jnp.zeros((count - 1, *u.shape), u.dtype).at[0].set(u), first)

    def stage(known, numbers):
        i, shares, couplings, when, share = numbers
        y = jax.tree.map(jnp.add, state, _combined(shares, known))
        u = increment(rate(at(when), y), _combined(couplings, known), share)
        return jax.tree.map(lambda k, u: k.at[i].set(u, mode="drop"), known, u), (y, u)

    tables = (scheme.stages[1:, :-1], scheme.couplings[1:, :-1], scheme.times[1:], scheme.drift[1:])
    _, (reached, found) = jax.lax.scan(stage, known, (jnp.arange(1, count), *(jnp.asarray(x, dtype) for x in tables)))
    error = jax.tree.map(lambda u: u[-1], found)
    return jax.tree.map(lambda y, e: y[-1] + e, reached, error), error


def relative_error(plan: Plan, state, error):
    """The largest of all states' errors in each lane, relative to the state plus its typical size, shape (lanes,)."""
    sizes = unravel(plan, np.ones(len(scales(plan))))
    parts = jax.tree.map(
        lambda y, e, size: (
            jnp.max(abs(e) / (abs(y) + size[..., None].astype(y.dtype)), axis=range(e.ndim - 1))
            if e.size
            else jnp.zeros(e.shape[-1:], e.dtype)
        ),
        state,
        error,
        sizes,
    )
    return jax.tree.reduce(jnp.maximum, parts)


def _no_error(state):
    leaf = jax.tree.leaves(state)[0]
    return jnp.zeros(leaf.shape[-1:], leaf.dtype)


def integrate(
    plan: Plan, values: Values, grid, start, field: Callable = rates, show: Callable | None = None, cuts=1
) -> tuple[Any, Any]:
    """Integrate all lanes over intervals of several steps each; pure, to be called inside jit.

    In reverse, what is kept is the state at the ends of the intervals, and of one interval at a time that at the ends
    of its steps; the rest is computed again.

    Args: values, start, field: see `step`; grid: times [s], shape (intervals, steps + 1): row by row the boundaries of
        the steps of an interval, the last of a row being the first of the next; knots of inputs are among them. Two
        equal boundaries stand for no step, so that rows may differ in their number of steps. show(t, state): what is
        kept at the ends of the intervals, by default the state; cuts: equal parts that each step is cut into (a traced
        number rules derivatives in reverse out).
    Returns: what is shown at the ends of the intervals (leading axis), and for each lane the sum over all steps of the
        largest relative error estimate, shape (lanes,); not finite where the lane has failed.
    """

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def one_step(carry, times):
        begin, end = times
        length = (end - begin) / cuts

        def advance(carry):
            def part(k, carry):
                state, summed = carry
                state, error = step(plan, values, begin + k * length, length, state, field)
                return state, summed + relative_error(plan, state, error)

            return jax.lax.fori_loop(0, cuts, part, carry)

        return jax.lax.cond(end > begin, advance, lambda carry: carry, carry), None

    def block(carry, times):
        return jax.lax.cond(
            times[1][-1] > times[0][0], lambda c: jax.lax.scan(one_step, c, times)[0], lambda c: c, carry
        ), None

    # Steps that are none are passed over in blocks: one by one they would take as long as steps of few lanes.
    size = math.gcd(grid.shape[1] - 1, BLOCK)

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def interval(carry, row):
        carry, _ = jax.lax.scan(block, carry, (row[:-1].reshape(-1, size), row[1:].reshape(-1, size)))
        return carry, carry[0] if show is None else show(row[-1], carry[0])

    (_, summed), saved = jax.lax.scan(interval, (start, _no_error(start)), grid)
    return saved, summed
