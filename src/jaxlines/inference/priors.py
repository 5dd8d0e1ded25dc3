"""What is known of a number before a fit, as a density and as rows of a least-squares problem."""

import dataclasses

import numpy as np

from jaxlines.inference.distributions import AbstractDistribution, LogNormal, LogUniform, Normal, Truncated, Uniform

_KINDS = (Normal, LogNormal, Uniform, LogUniform)


@dataclasses.dataclass(frozen=True)
class Prior:
    """A distribution as the prior of a parameter.

    The estimate with priors is the maximum a posteriori (MAP) one, which minimises sum z^2/2 + sum r^2/2 with the
    weighted residuals z of the recording and one row r a prior that is not flat:
        Normal: r = (x - mean)/sd;  LogNormal: r = ln(x/median)/spread;  Uniform, LogUniform: none, only ends;
        Truncated: the row of its base, and its ends.
    The mode of a log-normal or log-uniform prior is that of ln x (the density of x itself has another one, since a
    mode depends on the coordinate); with `transform="log"` this is the density in the coordinate of the search.

    Args: distribution: Normal, LogNormal, Uniform, LogUniform, or Truncated of one of them.
    Raises: TypeError for another distribution.
    Reference: Gelman and others, "Bayesian Data Analysis", 2013, sec. 4.1.
    """

    distribution: AbstractDistribution

    def __post_init__(self):
        if not isinstance(self._base, _KINDS):
            raise TypeError(
                "a prior must be Normal, LogNormal, Uniform or LogUniform, or Truncated of one of them, got "
                f"{self.distribution!r}"
            )

    @property
    def _base(self) -> AbstractDistribution:
        """The distribution without truncation."""
        return self.distribution.base if isinstance(self.distribution, Truncated) else self.distribution

    @property
    def support(self) -> tuple[float, float]:
        """The ends between which the density is not zero."""
        low, high = -np.inf, np.inf
        if isinstance(self._base, Uniform | LogUniform):
            low, high = self._base.low, self._base.high
        if isinstance(self._base, LogNormal):
            low = 0.0
        if isinstance(self.distribution, Truncated):
            low, high = max(low, self.distribution.low), min(high, self.distribution.high)
        return low, high

    @property
    def flat(self) -> bool:
        """Whether it adds no row, only ends."""
        return isinstance(self._base, Uniform | LogUniform)

    def residual(self, value: float) -> float:
        """The row r of the least-squares problem at a value [-]; 0 for a flat prior."""
        base = self._base
        if isinstance(base, Normal):
            return (float(value) - base.mean) / base.sd
        if isinstance(base, LogNormal):
            return float(np.log(value / base.median)) / base.spread
        return 0.0

    def slope(self, value: float) -> float:
        """dr / d value."""
        base = self._base
        if isinstance(base, Normal):
            return 1.0 / base.sd
        return 1.0 / (float(value) * base.spread) if isinstance(base, LogNormal) else 0.0

    def log_density(self, value: float) -> float:
        """Natural logarithm of the density of the number itself, per unit of the number; -inf outside its ends."""
        base, (low, high) = self._base, self.support
        if not low <= value <= high:
            return -np.inf
        share = 1.0
        if isinstance(self.distribution, Truncated):
            ends = base.probability(np.asarray([self.distribution.low, self.distribution.high]))
            share = float(ends[1] - ends[0])
        root = 0.5 * np.log(2.0 * np.pi)
        if isinstance(base, Normal):
            density = -0.5 * self.residual(value) ** 2 - np.log(base.sd) - root
        elif isinstance(base, LogNormal):
            if value == 0.0:
                return -np.inf
            density = -0.5 * self.residual(value) ** 2 - np.log(base.spread * value) - root
        elif isinstance(base, LogUniform):
            density = -np.log(value * np.log(base.high / base.low))
        else:
            assert isinstance(base, Uniform)
            density = -np.log(base.high - base.low)
        return float(density - np.log(share))

    def sample(self, rng: np.random.Generator, count: int | None = None):
        """One value, or an array of `count` values, from a NumPy random generator."""
        drawn = self.distribution.quantile(rng.random(1 if count is None else count))
        return float(drawn[0]) if count is None else drawn

    def __str__(self) -> str:
        base, (low, high) = self._base, self.support
        if isinstance(base, Normal):
            text = f"normal {base.mean:.4g}, sd {base.sd:.2g}"
        elif isinstance(base, LogNormal):
            text = f"log-normal {base.median:.4g}, spread {base.spread:.2g}"
        else:
            return f"{'uniform' if isinstance(base, Uniform) else 'log-uniform'} {low:.4g} .. {high:.4g}"
        return f"{text}, within {low:.4g} .. {high:.4g}" if isinstance(self.distribution, Truncated) else text


def as_prior(given) -> Prior | None:
    """A prior from a distribution, a prior or None."""
    return given if given is None or isinstance(given, Prior) else Prior(given)
