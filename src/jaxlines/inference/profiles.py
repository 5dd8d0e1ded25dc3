"""Likelihood intervals of parameters and predictions: their end points by direct search, and profile curves."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxlines.inference.curvature import column_scale
from jaxlines.inference.least_squares import LeastSquaresProblem, Solution, solve

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


@dataclasses.dataclass(frozen=True)
class Interval:
    """A likelihood interval: name, value at the optimum, lower and upper `EndPoint`, confidence level."""

    name: str
    value: float
    low: EndPoint
    high: EndPoint
    level: float

    @property
    def ends(self) -> tuple[float, float]:
        """The two values, infinite where the end is open, NaN where it was not found."""
        signs = ((self.low, -np.inf), (self.high, np.inf))
        low, high = (
            end.value if end.status == "found" else sign if end.status == "open" else np.nan for end, sign in signs
        )
        return float(low), float(high)

    @property
    def kind(self) -> str:
        """ "two_sided", "upper_limit", "lower_limit", "open" (the profile stays below its limit) or "failed"."""
        found = (self.low.status, self.high.status)
        if "failed" in found:
            return "failed"
        kinds = {("found", "found"): "two_sided", ("open", "found"): "upper_limit", ("found", "open"): "lower_limit"}
        return kinds.get(found, "open")

    def __str__(self) -> str:
        low, high = self.ends
        return f"{self.name}: {self.value:.6g}, {100 * self.level:g} % {low:.6g} .. {high:.6g} ({self.kind})"


def cost_limit(solution: Solution, noise: str = "known", level: float = 0.95, freedom: int | None = None) -> float:
    """The cost up to which a point is inside the interval.

    Known noise: cost_min + q/2, q the `level` point of chi-squared with one degree of freedom (3.84). Estimated noise:
    cost_min (1 + F/(n - p)), F the point of F(1, n - p), which is exact for a linear model (Bates and Watts,
    "Nonlinear Regression Analysis", 1988, section 6.1). freedom: n - p, counted from the rows by default.
    """
    from scipy.special import chdtri, fdtri

    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie between 0 and 1, got {level:g}: per cent?")
    if noise == "known":
        return solution.cost + 0.5 * float(chdtri(1, 1.0 - level))
    if noise != "estimated":
        raise ValueError(f'noise must be "known" or "estimated", got {noise!r}')
    freedom = max(solution.residuals.size - solution.x.size, 1) if freedom is None else freedom
    return solution.cost * (1.0 + float(fdtri(1, freedom, level)) / freedom)


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


def end_point(
    problem: LeastSquaresProblem,
    solution: Solution,
    quantity: Callable[[np.ndarray], tuple[float, np.ndarray]],
    sign: float,
    limit: float,
) -> EndPoint:
    """How far a quantity goes in one direction while the cost stays within its limit and x within its bounds.

    A sequence of linear steps, each the exact answer for the linearised rows and quantity; a step is shortened that
    neither lowers the merit, -sign * quantity + penalty * excess cost, nor halves the excess. On a linear model the
    first step is exact.

    Args: quantity: x -> (value, slopes by x); sign: +1 for the upper end, -1 for the lower.
    Reference: compare Venzon and Moolgavkar, Applied Statistics 37, 1988; Neale and Miller, Behavior Genetics 27, 1997.
    """
    x, rows, slopes = solution.x.copy(), solution.residuals, solution.jacobian
    scale = column_scale(slopes, problem.lower, problem.upper)
    value, gradient = quantity(x)
    first, span, penalty, word = value, limit - solution.cost, 0.0, "too many steps"
    for _ in range(ITERATIONS):
        low, high = (problem.lower - x) / scale, (problem.upper - x) / scale
        step, force = _farthest(slopes * scale, rows, sign * gradient * scale, limit, low, high)
        step = step * scale
        predicted = abs(float(gradient @ step))
        penalty = max(0.5 * penalty, 2.0 * force)
        terms = (sign, penalty, limit)
        trial = _shortened(problem, quantity, x, step, (sign * value, 0.5 * float(rows @ rows)), terms)
        if trial is None:
            word = "no shorter step is better"
            break
        x, rows, value, gradient = trial
        slopes = problem.jacobian(x)
        if not np.all(np.isfinite(slopes)):
            return EndPoint(np.nan, x, "failed", "the derivatives are not finite on the way", np.nan)
        if predicted <= SETTLED * abs(value - first) and 0.5 * float(rows @ rows) - limit <= SETTLED * span:
            break
    return _checked(problem, (x, rows, slopes), (sign, value, gradient), scale, limit, span, word)


def _shortened(problem, quantity, x, step, here, terms):
    """The first of ever shorter steps that lowers the merit: x, rows, value, gradient; None when none does."""
    sign, penalty, limit = terms

    def merit(value, cost):
        return -value + penalty * max(cost - limit, 0.0)

    before = merit(*here)
    for shorter in range(25):
        trial = np.clip(x + step * 0.5**shorter, problem.lower, problem.upper)
        rows = problem.residuals(trial)
        cost = 0.5 * float(rows @ rows)
        value, gradient = quantity(trial)
        if not (np.isfinite(cost) and np.isfinite(value)):
            continue
        back = cost - limit < 0.5 * (here[1] - limit) > 0.0  # coming back under the limit counts whatever it costs
        if back or merit(sign * value, cost) < before:
            return trial, rows, value, gradient
    return None


def _checked(problem, point, quantity, scale, limit, span, word) -> EndPoint:
    """Judge an end from its own slopes: the gradients of quantity and cost must be parallel, or bounds must hold it."""
    (x, rows, slopes), (sign, value, gradient) = point, quantity
    cost = 0.5 * float(rows @ rows)
    uphill, wanted = (slopes.T @ rows) * scale, sign * gradient * scale
    width = problem.upper - problem.lower
    near = 1e-9 * np.where(np.isfinite(width), width, 0.0)
    on_low, on_high = x <= problem.lower + near, x >= problem.upper - near
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


def parameter(index: int, count: int) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """The quantity that is coordinate `index` of `count`."""
    return lambda x: (float(x[index]), np.eye(count)[index])


def differentiable(function: Callable) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """A quantity from a scalar function written in JAX, such as a predicted peak pressure [Pa] of coordinates."""
    import jax

    from jaxlines.simulation.precision import computing_in

    value, slopes = jax.jit(function), jax.jit(jax.jacfwd(function))

    def evaluate(x):
        with computing_in("float64"):
            x = np.asarray(x, dtype=float)
            return float(value(x)), np.asarray(slopes(x))

    return evaluate


def interval(
    problem: LeastSquaresProblem,
    solution: Solution,
    quantity: int | str | Callable[[np.ndarray], tuple[float, np.ndarray]],
    *,
    noise: str = "known",
    level: float = 0.95,
    name: str = "",
) -> Interval:
    """The likelihood interval of a parameter (label or index) or of a prediction (see `differentiable`).

    Args: noise: "known" (rows are divided by their noise) or "estimated" (by something proportional to it).
    Returns: an `Interval` in coordinates for a parameter; its ends say when a bound stopped them.
    """
    count = len(problem.labels)
    if isinstance(quantity, str):
        if quantity not in problem.labels:
            raise KeyError(f"{quantity!r} is no parameter; there are {', '.join(problem.labels)}")
        quantity = problem.labels.index(quantity)
    if isinstance(quantity, int):
        name = name or problem.labels[quantity]
        quantity = parameter(quantity, count)
    limit = cost_limit(solution, noise, level)
    low, high = (end_point(problem, solution, quantity, sign, limit) for sign in (-1.0, 1.0))
    return Interval(name or "prediction", float(quantity(solution.x)[0]), low, high, level)


def intervals(problem: LeastSquaresProblem, solution: Solution, *, noise: str = "known", level: float = 0.95):
    """The likelihood intervals of all parameters: label -> `Interval`."""
    return {label: interval(problem, solution, label, noise=noise, level=level) for label in problem.labels}


@dataclasses.dataclass(frozen=True)
class Held:
    """A problem with one coordinate held: the others are free."""

    whole: LeastSquaresProblem
    index: int
    value: float

    def _others(self) -> np.ndarray:
        return np.arange(len(self.whole.labels)) != self.index

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the free ones."""
        return tuple(label for i, label in enumerate(self.whole.labels) if i != self.index)

    @property
    def lower(self) -> np.ndarray:
        """Their lower bounds."""
        return self.whole.lower[self._others()]

    @property
    def upper(self) -> np.ndarray:
        """Their upper bounds."""
        return self.whole.upper[self._others()]

    @property
    def recording(self) -> np.ndarray:
        """As in the whole problem."""
        return self.whole.recording

    @property
    def channel(self) -> np.ndarray:
        """As in the whole problem."""
        return self.whole.channel

    @property
    def time(self) -> np.ndarray:
        """As in the whole problem."""
        return self.whole.time

    def every(self, x) -> np.ndarray:
        """All coordinates."""
        return np.insert(np.asarray(x, dtype=float), self.index, self.value)

    def residuals(self, x) -> np.ndarray:
        """Rows of the whole problem."""
        return self.whole.residuals(self.every(x))

    def jacobian(self, x) -> np.ndarray:
        """Slopes by the free ones."""
        return self.whole.jacobian(self.every(x))[:, self._others()]


def profile_curve(problem: LeastSquaresProblem, solution: Solution, label: str, values) -> np.ndarray:
    """2 (cost - cost_min) of the best fit with a coordinate held at each of some values, shape (values,).

    Each fit starts from its neighbour's end, outwards from the optimum. Inside 3.84 lie the 95 % of known noise.
    """
    index = problem.labels.index(label)
    values, heights = np.asarray(values, dtype=float), np.full(np.size(values), np.nan)
    for side in (values >= solution.x[index], values < solution.x[index]):
        x = np.delete(solution.x, index)
        order = np.flatnonzero(side)
        for i in order[np.argsort(np.abs(values[order] - solution.x[index]))]:
            end = solve(Held(problem, index, float(values[i])), x)
            if end.status == "failed":
                break
            heights[i], x = 2.0 * (end.cost - solution.cost), end.x
    return heights
