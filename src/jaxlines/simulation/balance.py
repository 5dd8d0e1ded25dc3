"""Where all flows into nodes and all rates of states vanish: Newton's method, and the transient as fallback.

Everything is in scaled states y (see `plan.ravel`). The unbalance g has the net flow into each node, capacity times
rate, and the rate of each state, so that M y' = g(y) with M the capacities, 1 for states. What nothing depends on (the
angle of a shaft) is held at its start. Where the Jacobian is singular beyond that (fluid in a closed circuit), w g = 0
for each left null vector w, so that w M y is conserved: it is held as well.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxlines.simulation.plan import Plan, Values, ravel, unravel
from jaxlines.simulation.vector_field import balances, sampled

_NEWTON_STEPS, _TRANSIENT_STEPS, _ATTEMPTS = 60, 400, 4
_LARGEST_CHANGE, _SHORTEST = 20.0, 1e-5


class Precision(NamedTuple):
    """What counts as zero: singular values, steps [typical sizes], flows against what a step of that size changes."""

    rank: float
    step: float
    flow: float


def _precision(y) -> Precision:
    """Limits that the arithmetic can reach."""
    return Precision(1e-12, 1e-10, 1e-7) if y.dtype == jnp.float64 else Precision(1e-6, 3e-5, 1e-3)


def unbalance(plan: Plan, values: Values, y):
    """g and M: net flow into each node (typical potential times SI capacity per second) or rate of each scaled state
    [1/s]; capacities of the nodes, 1 for states. Of sampled controllers g is the change at a sampling instant."""
    potentials, states = unravel(plan, y)
    capacity, flow, state_rates = balances(plan, values, 0.0, potentials, states)
    weights = jnp.concatenate([capacity, jnp.ones(y.size - capacity.size, y.dtype)])
    flow = ravel(plan, flow, state_rates)
    if any(controller.sampled for controller in plan.controllers):
        after = sampled(plan, values, 0.0, lambda period: True, potentials, states)
        flow = flow + ravel(plan, potentials, after) - y
    return flow, weights


class Linear(NamedTuple):
    """The unbalance about a point, and what of it the balance does not determine.

    flow: g; matrix: dg/dy; weights: M; drifting: states on which nothing depends; left: orthonormal left null vectors
    of the matrix with scaled rows, zero where it has none, shape (n, n); right: right null vectors; rows: row scales.
    """

    flow: Any
    matrix: Any
    weights: Any
    drifting: Any
    left: Any
    right: Any
    rows: Any


def _drifting(matrix, num_nodes: int):
    """States on which nothing depends but the rates of such states."""
    used = jnp.abs(matrix) > 1e-14 * jnp.max(jnp.abs(matrix), axis=1, keepdims=True)
    is_state = jnp.arange(matrix.shape[0]) >= num_nodes

    def found(held):
        return is_state & ~jnp.any(used & ~held[:, None], axis=0)

    first = found(jnp.zeros_like(is_state))
    pair = (~first, first)
    return jax.lax.while_loop(lambda p: jnp.any(p[0] != p[1]), lambda p: (p[1], found(p[1])), pair)[1]


def _slopes(plan: Plan, values: Values, y):
    """g, dg/dy and M."""

    def seen(y):
        flow, weights = unbalance(plan, values, y)
        return flow, (flow, weights)

    matrix, (flow, weights) = jax.jacfwd(seen, has_aux=True)(y)
    return flow, matrix, weights


def linearise_balance(plan: Plan, values: Values, y) -> Linear:
    """The unbalance and its Jacobian, with its null directions."""
    flow, matrix, weights = _slopes(plan, values, y)
    drifting = _drifting(matrix, len(plan.free_nodes))
    held = jnp.where(drifting[:, None], jnp.eye(y.size), matrix)
    size = jnp.max(jnp.abs(held), axis=1)
    rows = 1.0 / jnp.where(size > 0.0, size, weights)
    scaled = rows[:, None] * held
    column = jnp.max(jnp.abs(scaled), axis=0)
    column = jnp.where(column > 0.0, column, 1.0)
    left, sizes, right = jnp.linalg.svd(jnp.where(jnp.isfinite(scaled), scaled, 0.0) / column)
    null = sizes <= _precision(y).rank * sizes[0]
    left, right = jnp.where(null, left, 0.0), jnp.where(null[:, None], right, 0.0)
    return Linear(flow, held, weights, drifting, left, right, rows)


def solve_linear(linear: Linear, flow, target, damping: Any = 0.0):
    """The step d with matrix d = -flow, except: drifting states move to their target, conserved sums to theirs.

    Args: flow: g, or a change of it; target: from here to the start, or a change of that; damping: 1/dt of an implicit
        Euler step, (M/dt - matrix) d = flow, which is Newton's step where it is 0.
    """
    matrix = linear.matrix - damping * jnp.diag(jnp.where(linear.drifting, 0.0, linear.weights))
    flow = -linear.rows * jnp.where(linear.drifting, -target, flow)
    conserved = linear.left.T * (linear.rows * linear.weights)
    conserved = conserved / jnp.maximum(jnp.max(jnp.abs(conserved)), jnp.finfo(flow.dtype).tiny)
    right = flow - linear.left @ (linear.left.T @ flow) + linear.left @ (conserved @ target)
    return jnp.linalg.solve(linear.rows[:, None] * matrix + linear.left @ conserved, right)


def _share_inside(y, step, positive):
    """The largest share of a step that keeps what is positive so, and no change beyond what is usual."""
    room = jnp.where(positive & (step < 0.0), 0.9 * y / jnp.where(step < 0.0, -step, 1.0), jnp.inf)
    return jnp.minimum(jnp.min(jnp.minimum(room, 1.0)), _LARGEST_CHANGE / jnp.maximum(jnp.max(jnp.abs(step)), 1e-300))


def imbalance(linear: Linear):
    """How far each equation is from balance, below 1 when balanced; drifting states count as balanced."""
    limit = _precision(linear.flow).flow
    allowed = limit * jnp.sum(jnp.abs(linear.matrix), axis=1) + 1e-2 * limit * linear.weights
    return jnp.where(linear.drifting, 0.0, jnp.abs(linear.flow) / allowed)


class _Search(NamedTuple):
    """Where the search is: attempt, steps in it, y, 1/dt (0: Newton's method; NaN: to be chosen), the best so far."""

    attempt: Any
    count: Any
    y: Any
    damping: Any
    best: Any
    seen: Linear


def _advance(plan: Plan, values: Values, starts, positive, at: _Search) -> _Search:
    """One step: Newton's, damped until it would make the next one shorter, or one of implicit Euler, which grow."""
    limits, linear, away = _precision(starts), linearise_balance(plan, values, at.y), starts[0] - at.y
    worst = jnp.max(imbalance(linear), initial=0.0)
    fastest = jnp.max(jnp.abs(linear.flow / linear.weights))
    damping = jnp.where(jnp.isnan(at.damping), 10.0 * jnp.maximum(fastest, 1e-3), at.damping)
    step, newton = solve_linear(linear, linear.flow, away, damping), damping == 0.0
    length, largest = jnp.linalg.norm(step), jnp.max(jnp.abs(step))

    def too_long(share):
        after = unbalance(plan, values, at.y + share * step)[0]
        after = jnp.linalg.norm(solve_linear(linear, after, away - share * step, damping))
        good = jnp.where(newton, after <= (1.0 - 0.25 * share) * length + limits.step, jnp.isfinite(after))
        return ~good & (share > _SHORTEST)

    share = jax.lax.while_loop(too_long, lambda share: 0.5 * share, _share_inside(at.y, step, positive))
    y, count = at.y + share * step, at.count + 1
    better = worst < jnp.max(imbalance(at.seen), initial=0.0)
    resting = ((largest < 1e-9) & (damping < 1.0)) | (count >= _TRANSIENT_STEPS)
    growth = jnp.where(share < 1.0, 0.5, jnp.clip(0.5 / jnp.maximum(largest, 1e-12), 0.3, 4.0))
    settled = newton & (length <= limits.step * (1.0 + jnp.linalg.norm(y)))
    # A search that got stuck begins anew: from the other start, then with transients.
    stuck = ~jnp.isfinite(length) | (newton & ((share <= _SHORTEST) | (count >= _NEWTON_STEPS) | settled))
    attempt = at.attempt + stuck
    again = jnp.where(attempt < 2, 0.0, jnp.nan)
    return _Search(
        jnp.where(settled & (worst <= 1.0), _ATTEMPTS, attempt),
        jnp.where(stuck | (~newton & resting), 0, count),
        jnp.where(stuck, starts[attempt % 2], y),
        jnp.where(stuck, again, jnp.where(newton | resting, 0.0, damping / growth)),
        jnp.where(better, y, at.best),
        jax.tree.map(lambda new, old: jnp.where(better, new, old), linear, at.seen),
    )


def _search(plan: Plan, values: Values, starts, positive) -> tuple[Any, Linear]:
    """The best state that was found, and the balance about it."""
    size, kind = starts[0].size, starts.dtype
    far = jnp.full((size, size), 1.0, kind)
    worst = Linear(jnp.full(size, jnp.inf, kind), far, far[0], jnp.zeros(size, bool), 0.0 * far, 0.0 * far, far[0])
    begin = _Search(jnp.asarray(0), jnp.asarray(0), starts[0], jnp.zeros((), kind), starts[0], worst)
    end = jax.lax.while_loop(
        lambda at: at.attempt < _ATTEMPTS, lambda at: _advance(plan, values, starts, positive, at), begin
    )
    return end.best, end.seen


def balanced_state(plan: Plan, values: Values, starts, positive) -> tuple[Any, Linear]:
    """The scaled states in balance, and the balance about them (see `imbalance` for how well it is one).

    Args: values, whose signals are constants; starts: two scaled starts, shape (2, n), the first of which says what
        is held; positive: which of the states must stay above zero. Attempts: Newton's method from each start, then
        after the transient from each. Derivatives are those of the balance (implicit function theorem), in both modes.
    Reference: Deuflhard, "Newton Methods for Nonlinear Problems", 2004, sec. 3.3 (natural monotonicity test); Kelley
        and Keyes, "Convergence analysis of pseudo-transient continuation", SIAM J. Numer. Anal. 35, 1998.
    """
    y, linear = _search(plan, *jax.lax.stop_gradient((values, starts, positive)))
    return _with_slopes(plan, values, starts[0], y, linear), linear


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _with_slopes(plan: Plan, values: Values, origin, y, linear: Linear):
    """y, as a function of values and origin."""
    return y


@_with_slopes.defjvp
def _slopes_of_balance(plan, primals, tangents):
    values, origin, y, linear = primals
    y = _with_slopes(plan, values, origin, y, linear)  # so that second derivatives see how it moves
    _, change = jax.jvp(lambda values: unbalance(plan, values, y)[0], (values,), (tangents[0],))
    matrix = jnp.where(linear.drifting[:, None], jnp.eye(y.size), _slopes(plan, values, y)[1])
    return y, solve_linear(linear._replace(matrix=matrix), change, tangents[1])
