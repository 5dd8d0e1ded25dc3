"""Distributions of uncertain numbers, as functions of uniform ones: arguments of a sweep, never state on a model."""

import abc
import dataclasses
import functools
import itertools
from typing import Any

import numpy as np


class AbstractDistribution(abc.ABC):
    """A distribution of one number x. What it says of x is its quantile function x = F^-1(u), 0 < u < 1."""

    @abc.abstractmethod
    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u, same shape."""

    @abc.abstractmethod
    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x), same shape."""


class _Scipy(AbstractDistribution):
    """A distribution that scipy.stats knows; `_frozen` is it."""

    @property
    @abc.abstractmethod
    def _frozen(self) -> Any: ...

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        return np.asarray(self._frozen.ppf(u), dtype=float)

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        return np.asarray(self._frozen.cdf(x), dtype=float)


def _require(right: bool, rule: str, got: str) -> None:
    """Raise ValueError that states a rule and what was received."""
    if not right:
        raise ValueError(f"{rule}, got {got}")


def _increasing(name: str, *ends: float) -> None:
    rule = f"{name}: the ends must be finite and increasing"
    ordered = all(np.isfinite(ends)) and all(a <= b for a, b in itertools.pairwise(ends))
    _require(ordered and ends[0] < ends[-1], rule, " .. ".join(f"{end:g}" for end in ends))


@dataclasses.dataclass(frozen=True)
class Normal(_Scipy):
    """Normal distribution with a mean and a standard deviation (both in the unit of the number)."""

    mean: float
    sd: float

    def __post_init__(self):
        rule = "Normal: mean must be finite and sd positive (is it a variance, or a lower bound?)"
        _require(np.isfinite(self.mean) and np.isfinite(self.sd) and self.sd > 0, rule, f"{self.mean:g}, {self.sd:g}")

    @functools.cached_property
    def _frozen(self):
        from scipy import stats

        return stats.norm(self.mean, self.sd)


@dataclasses.dataclass(frozen=True)
class LogNormal(_Scipy):
    """ln x is normal: x = median exp(spread z), for positive numbers known to a factor.

    Args: median, in the unit of the number; spread: standard deviation of ln x [-]; for small ones it is the relative
        standard deviation of x. 95 % lie within the factors exp(-1.96 spread) and exp(1.96 spread).
    """

    median: float
    spread: float

    def __post_init__(self):
        rule = "LogNormal: median and spread (standard deviation of ln x) must be positive"
        right = self.median > 0 and self.spread > 0 and np.isfinite([self.median, self.spread]).all()
        _require(bool(right), rule, f"{self.median:g}, {self.spread:g}")

    @classmethod
    def between(cls, low: float, high: float, share: float = 0.95) -> "LogNormal":
        """The one of which a share lies between two positive numbers, the rest equally beyond both."""
        from scipy.special import ndtri

        _require(0 < low < high and 0 < share < 1, "LogNormal.between: 0 < low < high, 0 < share < 1", f"{low}, {high}")
        return cls(float(np.sqrt(low * high)), float(np.log(high / low) / (2 * ndtri(0.5 + 0.5 * share))))

    @functools.cached_property
    def _frozen(self):
        from scipy import stats

        return stats.lognorm(self.spread, scale=self.median)


@dataclasses.dataclass(frozen=True)
class Uniform(_Scipy):
    """Every value between two ends equally likely."""

    low: float
    high: float

    def __post_init__(self):
        _increasing("Uniform", self.low, self.high)

    @functools.cached_property
    def _frozen(self):
        from scipy import stats

        return stats.uniform(self.low, self.high - self.low)


@dataclasses.dataclass(frozen=True)
class LogUniform(_Scipy):
    """Every order of magnitude between two positive ends equally likely."""

    low: float
    high: float

    def __post_init__(self):
        _increasing("LogUniform", self.low, self.high)
        _require(self.low > 0, "LogUniform: the ends must be positive", f"{self.low:g}")

    @functools.cached_property
    def _frozen(self):
        from scipy import stats

        return stats.loguniform(self.low, self.high)


@dataclasses.dataclass(frozen=True)
class Triangular(_Scipy):
    """Density rising from `low` to `mode` and falling to `high`: two limits and a best guess."""

    low: float
    mode: float
    high: float

    def __post_init__(self):
        _increasing("Triangular", self.low, self.mode, self.high)

    @functools.cached_property
    def _frozen(self):
        from scipy import stats

        return stats.triang((self.mode - self.low) / (self.high - self.low), self.low, self.high - self.low)


@dataclasses.dataclass(frozen=True)
class Truncated(AbstractDistribution):
    """Another distribution, given that the number lies between two ends (either may be infinite)."""

    base: AbstractDistribution
    low: float = -np.inf
    high: float = np.inf

    def __post_init__(self):
        _require(isinstance(self.base, AbstractDistribution), "Truncated: base must be a distribution", repr(self.base))
        below, above = self._ends
        rule = "Truncated: the base distribution must have some probability between low and high"
        _require(self.low < self.high and above - below > 1e-9, rule, f"{self.low:g} .. {self.high:g}")

    @functools.cached_property
    def _ends(self) -> tuple[float, float]:
        return float(self.base.probability(np.asarray(self.low))), float(self.base.probability(np.asarray(self.high)))

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        below, above = self._ends
        return np.clip(self.base.quantile(below + u * (above - below)), self.low, self.high)

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        below, above = self._ends
        return np.clip((self.base.probability(x) - below) / (above - below), 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Discrete(AbstractDistribution):
    """One of a few values, equally likely or with weights."""

    values: tuple[float, ...]
    weights: tuple[float, ...] | None = None

    def __post_init__(self):
        object.__setattr__(self, "values", tuple(float(v) for v in self.values))
        _require(
            bool(self.values) and bool(np.isfinite(self.values).all()), "Discrete: values must be finite", f"{self.values}"
        )
        if self.weights is not None:
            object.__setattr__(self, "weights", tuple(float(w) for w in self.weights))
            right = len(self.weights) == len(self.values) and min(self.weights) >= 0 and 0 < sum(self.weights) < np.inf
            _require(right, "Discrete: as many weights as values, none negative, not all zero", f"{self.weights}")

    @functools.cached_property
    def _steps(self) -> np.ndarray:
        """F after each value."""
        weights = np.ones(len(self.values)) if self.weights is None else np.asarray(self.weights)
        return np.cumsum(weights) / weights.sum()

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """The value whose share of the probabilities u falls into, in the order in which they were given."""
        place = np.searchsorted(self._steps, u, side="right")
        return np.asarray(self.values)[np.minimum(place, len(self.values) - 1)]

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        shares = np.diff(self._steps, prepend=0.0)
        return (np.asarray(self.values) <= np.asarray(x)[..., None]) @ shares
