"""End points of likelihood intervals by direct search, without stepping along a profile."""

import dataclasses
from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from jaxlines.inference.curvature import column_scale
from jaxlines.inference.least_squares import LeastSquaresProblem, Solution

ITERATIONS = 100
UNSEEN = 1e-10
"""Singular values of the scaled Jacobian below this part of the largest count as none."""

SETTLED, AT_LIMIT, PARALLEL = 1e-5, 1e-3, 2e-2
"""When a search for an end point stops; how close to the limit its cost, and to parallel the slopes, must be."""


@dataclasses.dataclass(frozen=True)
class EndPoint:
    """One end of an interval.

    Fields: value of the quantity; x where it is reached; status: "found" (the cost is at its limit), "open" (the
    quantity goes as far as the bounds let it and the cost stays below the limit), "failed"; message; cost there.
    """

    value: float
    x: np.ndarray
    status: str
    message: str
    cost: float


def _farthest(jacobian, residuals, gradient, limit, low, high) -> tuple[np.ndarray, float]:
    """The step d that makes gradient'd largest while |r + J d|^2/2 <= limit and low <= d <= high, and its multiplier.

    Without bounds d = -J^+ r + rho H^-1 g / sqrt(g' H^-1 g), H = J'J, rho^2/2 the cost that is left. An active-set
    method: walk to that point, hold the coordinate whose bound is met first, and let go the one whose multiplier has
    the wrong sign (Nocedal and Wright, "Numerical Optimization", 2006, section 16.5).
    """
    count = gradient.size
    held, step, force = np.zeros(count, dtype=bool), np.zeros(count), 0.0
    for _ in range(4 * count + 4):
        target, force = _free_step(jacobian, residuals, gradient, limit, step, held)
        way = target - step
        bound = np.where(way > 0, high, low)
        share = np.where(held | (way == 0.0), np.inf, (bound - step) / np.where(way == 0.0, 1.0, way))
        first = int(np.argmin(share))
        if share[first] < 1.0:
            step = step + max(share[first], 0.0) * way
            step[first], held[first] = bound[first], True
            continue
        step = target
        pull = gradient - force * (jacobian.T @ (residuals + jacobian @ step))  # where the objective wants to go
        wrong = held & (((step <= low) & (pull > 0)) | ((step >= high) & (pull < 0)))
        if not wrong.any():
            break
        held[np.argmax(np.where(wrong, np.abs(pull), -np.inf))] = False
    return np.clip(step, low, high), force


def _free_step(jacobian, residuals, gradient, limit, step, held) -> tuple[np.ndarray, float]:
    """`_farthest` without bounds for the coordinates that are not held, and 1/length of the multiplier."""
    rows = residuals + jacobian[:, held] @ step[held]
    free = ~held
    new = step.copy()
    if not free.any():
        return new, 0.0
    left, singular, right = np.linalg.svd(jacobian[:, free], full_matrices=False)
    # A direction that the rows do not see is left alone, unless the quantity grows along it: then it is followed by a
    # long step, which ends at the bounds.
    seen = singular > UNSEEN * max(singular[0], 1e-300)
    strong = np.where(seen, singular, UNSEEN * max(singular[0], 1e-300))
    centre = -(right[seen].T / singular[seen]) @ (left[:, seen].T @ rows)
    spare = 2.0 * (limit - 0.5 * float(np.sum((rows + jacobian[:, free] @ centre) ** 2)))
    growth = right @ gradient[free]
    growth = np.where(seen | (np.abs(growth) > 1e-6 * np.linalg.norm(gradient)), growth, 0.0)
    along = growth / strong
    length = float(np.linalg.norm(along))
    radius = np.sqrt(max(spare, 0.0))
    outwards = right.T @ (along / strong) / max(length, 1e-300)
    new[free] = centre + radius * outwards
    return new, length / max(radius, 1e-300)


class Asked(NamedTuple):
    """What a search for an end point wants to know next: rows at x, or their slopes."""

    x: np.ndarray
    slopes: bool


Search = Generator[Asked, np.ndarray, EndPoint]


def end_point(
    problem: LeastSquaresProblem,
    solution: Solution,
    quantity: Callable[[np.ndarray], tuple[float, np.ndarray]],
    sign: float,
    limit: float,
) -> EndPoint:
    """How far a quantity goes in one direction while the cost stays within its limit; see `end_point_search`."""
    search = end_point_search(problem.lower, problem.upper, solution, quantity, sign, limit)
    try:
        asked = next(search)
        while True:
            answer = problem.jacobian(asked.x) if asked.slopes else problem.residuals(asked.x)
            asked = search.send(answer)
    except StopIteration as stop:
        return stop.value


def end_point_search(
    lower: np.ndarray,
    upper: np.ndarray,
    solution: Solution,
    quantity: Callable[[np.ndarray], tuple[float, np.ndarray]],
    sign: float,
    limit: float,
) -> Search:
    """How far a quantity goes in one direction while the cost stays within its limit and x within its bounds.

    A sequence of linear steps, each the exact answer for the linearised rows and quantity; a step is shortened that
    neither lowers the merit, -sign * quantity + penalty * excess cost, nor halves the excess. On a linear model the
    first step is exact.

    A generator: it yields what it wants to know, `Asked`, is sent the answer, and returns an `EndPoint`, so that many
    searches can share each simulation of a batch. Rows may be condensed: any orthogonal transformation of them will do.

    Args: lower, upper: bounds of x; solution: the optimum; quantity: x -> (value, slopes by x); sign: +1 for the upper
    end, -1 for the lower; limit: see `profiles.cost_limit`.
    Reference: compare Venzon and Moolgavkar, Applied Statistics 37, 1988; Neale and Miller, Behavior Genetics 27, 1997.
    """
    x, rows, slopes = solution.x.copy(), solution.residuals, solution.jacobian
    scale = column_scale(slopes, lower, upper)
    value, gradient = quantity(x)
    first, span, penalty, word = value, limit - solution.cost, 0.0, "too many steps"
    for _ in range(ITERATIONS):
        low, high = (lower - x) / scale, (upper - x) / scale
        step, force = _farthest(slopes * scale, rows, sign * gradient * scale, limit, low, high)
        step = step * scale
        predicted = abs(float(gradient @ step))
        penalty = max(0.5 * penalty, 2.0 * force)
        terms = (sign, penalty, limit)
        here = (sign * value, 0.5 * float(rows @ rows))
        trial = yield from _shortened((lower, upper), quantity, x, step, here, terms)
        if trial is None:
            word = "no shorter step is better"
            break
        x, rows, value, gradient = trial
        slopes = yield Asked(x, True)
        if not np.all(np.isfinite(slopes)):
            return EndPoint(np.nan, x, "failed", "the derivatives are not finite on the way", np.nan)
        if predicted <= SETTLED * abs(value - first) and 0.5 * float(rows @ rows) - limit <= SETTLED * span:
            break
    return _checked((lower, upper), (x, rows, slopes), (sign, value, gradient), scale, limit, span, word)


def _shortened(bounds, quantity, x, step, here, terms):
    """The first of ever shorter steps that lowers the merit: x, rows, value, gradient; None when none does."""
    sign, penalty, limit = terms

    def merit(value, cost):
        return -value + penalty * max(cost - limit, 0.0)

    before = merit(*here)
    for shorter in range(25):
        trial = np.clip(x + step * 0.5**shorter, *bounds)
        rows = yield Asked(trial, False)
        cost = 0.5 * float(rows @ rows)
        value, gradient = quantity(trial)
        if not (np.isfinite(cost) and np.isfinite(value)):
            continue
        back = cost - limit < 0.5 * (here[1] - limit) > 0.0  # coming back under the limit counts whatever it costs
        if back or merit(sign * value, cost) < before:
            return trial, rows, value, gradient
    return None


def _checked(bounds, point, quantity, scale, limit, span, word) -> EndPoint:
    """Judge an end from its own slopes: the gradients of quantity and cost must be parallel, or bounds must hold it."""
    (x, rows, slopes), (sign, value, gradient) = point, quantity
    cost = 0.5 * float(rows @ rows)
    uphill, wanted = (slopes.T @ rows) * scale, sign * gradient * scale
    lower, upper = bounds
    width = upper - lower
    near = 1e-9 * np.where(np.isfinite(width), width, 0.0)
    on_low, on_high = x <= lower + near, x >= upper - near
    inner = ~(on_low | on_high)
    at_limit = abs(cost - limit) <= AT_LIMIT * span
    force = float(uphill[inner] @ wanted[inner]) / max(float(uphill[inner] @ uphill[inner]), 1e-300)
    pull = wanted - (max(force, 0.0) if at_limit else 0.0) * uphill
    pushes = np.where(on_low, np.maximum(pull, 0.0), np.where(on_high, np.minimum(pull, 0.0), pull))
    rest = float(np.linalg.norm(pushes)) / max(float(np.linalg.norm(wanted)), 1e-300)
    if cost > limit + AT_LIMIT * span or rest > PARALLEL:
        return EndPoint(float(value), x, "failed", f"no end point ({rest:.1e} of the slope is left): {word}", cost)
    if at_limit:
        return EndPoint(float(value), x, "found", "the cost is at its limit", cost)
    return EndPoint(float(value), x, "open", "the bounds end it while the cost is below its limit", cost)
