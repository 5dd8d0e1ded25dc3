"""Distributions of uncertain numbers, as functions of uniform ones: arguments of a sweep, never state on a model."""

import abc
import dataclasses
import functools
import itertools

import numpy as np


class AbstractDistribution(abc.ABC):
    """A distribution of one number x. What it says of x is its quantile function x = F^-1(u), 0 < u < 1."""

    @abc.abstractmethod
    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u, same shape."""

    @abc.abstractmethod
    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x), same shape."""


def _require(right: bool, rule: str, got: str) -> None:
    """Raise ValueError that states a rule and what was received."""
    if not right:
        raise ValueError(f"{rule}, got {got}")


def _increasing(name: str, *ends: float) -> None:
    rule = f"{name}: the ends must be finite and increasing"
    ordered = all(np.isfinite(ends)) and all(a <= b for a, b in itertools.pairwise(ends))
    _require(ordered and ends[0] < ends[-1], rule, " .. ".join(f"{end:g}" for end in ends))


@dataclasses.dataclass(frozen=True)
class Normal(AbstractDistribution):
    """Normal distribution with a mean and a standard deviation (both in the unit of the number)."""

    mean: float
    sd: float

    def __post_init__(self):
        rule = "Normal: mean must be finite and sd positive (is it a variance, or a lower bound?)"
        _require(np.isfinite(self.mean) and np.isfinite(self.sd) and self.sd > 0, rule, f"{self.mean:g}, {self.sd:g}")

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        from scipy.special import ndtri

        return self.mean + self.sd * ndtri(u)

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        from scipy.special import ndtr

        return ndtr((x - self.mean) / self.sd)


@dataclasses.dataclass(frozen=True)
class LogNormal(AbstractDistribution):
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

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        from scipy.special import ndtri

        return self.median * np.exp(self.spread * ndtri(u))

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        from scipy.special import ndtr

        positive = np.maximum(x, np.finfo(float).tiny)
        return ndtr(np.log(positive / self.median) / self.spread) * (np.asarray(x) > 0)


@dataclasses.dataclass(frozen=True)
class Uniform(AbstractDistribution):
    """Every value between two ends equally likely."""

    low: float
    high: float

    def __post_init__(self):
        _increasing("Uniform", self.low, self.high)

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        return self.low + u * (self.high - self.low)

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        return np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class LogUniform(AbstractDistribution):
    """Every order of magnitude between two positive ends equally likely."""

    low: float
    high: float

    def __post_init__(self):
        _increasing("LogUniform", self.low, self.high)
        _require(self.low > 0, "LogUniform: the ends must be positive", f"{self.low:g}")

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        return self.low * np.exp(u * np.log(self.high / self.low))

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        return np.log(np.clip(x, self.low, self.high) / self.low) / np.log(self.high / self.low)


@dataclasses.dataclass(frozen=True)
class Triangular(AbstractDistribution):
    """Density rising from `low` to `mode` and falling to `high`: two limits and a best guess."""

    low: float
    mode: float
    high: float

    def __post_init__(self):
        _increasing("Triangular", self.low, self.mode, self.high)

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """x at the probabilities u."""
        rising, falling = self.mode - self.low, self.high - self.mode
        width = self.high - self.low
        below = self.low + np.sqrt(u * width * rising)
        return np.where(u * width <= rising, below, self.high - np.sqrt((1.0 - u) * width * falling))

    def probability(self, x: np.ndarray) -> np.ndarray:
        """F(x)."""
        rising, falling, width = self.mode - self.low, self.high - self.mode, self.high - self.low
        x = np.clip(x, self.low, self.high)
        below = (x - self.low) ** 2 / (width * rising) if rising > 0 else np.zeros_like(x)
        above = 1.0 - (self.high - x) ** 2 / (width * falling) if falling > 0 else np.ones_like(x)
        return np.where(x <= self.mode, below, above)


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
            bool(self.values) and bool(np.isfinite(self.values).all()),
            "Discrete: values must be finite",
            f"{self.values}",
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
