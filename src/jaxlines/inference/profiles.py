"""Likelihood intervals of parameters and predictions: their end points by direct search, and profile curves."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxlines.inference.end_points import EndPoint as EndPoint, end_point as end_point
from jaxlines.inference.least_squares import LeastSquaresProblem, Solution, solve


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


def cost_limit(
    solution: Solution,
    noise: str = "known",
    level: float = 0.95,
    freedom: float | None = None,
    inflation: float = 1.0,
) -> float:
    """The cost up to which a point is inside the interval.

    Known noise: cost_min + q/2, q the `level` point of chi-squared with one degree of freedom (3.84). Estimated noise:
    cost_min + s^2 F/2, s^2 = 2 cost_min/(n - p), F the point of F(1, n - p), which is exact for a linear model (Bates
    and Watts, "Nonlinear Regression Analysis", 1988, section 6.1).

    Args: freedom: degrees of freedom of the variance, where they are not n - p (infinite for known noise); inflation:
    variance of the parameter over that under white noise, where residuals are correlated (Pace, Salvan and Sartori,
    "Adjusting composite likelihood ratio statistics", Statistica Sinica 21, 2011).
    """
    from scipy.special import chdtri, fdtri

    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie between 0 and 1, got {level:g}: per cent?")
    if noise not in ("known", "estimated"):
        raise ValueError(f'noise must be "known" or "estimated", got {noise!r}')
    spare = max(solution.residuals.size - solution.x.size, 1)
    if freedom is None:
        freedom = np.inf if noise == "known" else spare
    variance = 1.0 if noise == "known" else 2.0 * solution.cost / spare
    point = float(fdtri(1, freedom, level) if np.isfinite(freedom) else chdtri(1, 1.0 - level))
    return solution.cost + 0.5 * inflation * variance * point


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
    freedom: float | None = None,
    inflation: float = 1.0,
) -> Interval:
    """The likelihood interval of a parameter (label or index) or of a prediction (see `differentiable`).

    Args: noise: "known" (rows are divided by their noise) or "estimated" (by something proportional to it); freedom,
    inflation: as in `cost_limit`.
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
    limit = cost_limit(solution, noise, level, freedom, inflation)
    low, high = (end_point(problem, solution, quantity, sign, limit) for sign in (-1.0, 1.0))
    return Interval(name or "prediction", float(quantity(solution.x)[0]), low, high, level)


def intervals(
    problem: LeastSquaresProblem,
    solution: Solution,
    *,
    noise: str = "known",
    level: float = 0.95,
    freedom=None,
    inflation=None,
) -> dict[str, Interval]:
    """The likelihood intervals of all parameters: label -> `Interval`; freedom, inflation: one a parameter, if any."""
    count = len(problem.labels)
    freedom = [None] * count if freedom is None else np.broadcast_to(freedom, count)
    inflation = np.ones(count) if inflation is None else np.broadcast_to(inflation, count)
    return {
        label: interval(problem, solution, label, noise=noise, level=level, freedom=f, inflation=float(k))
        for label, f, k in zip(problem.labels, freedom, inflation, strict=True)
    }


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
