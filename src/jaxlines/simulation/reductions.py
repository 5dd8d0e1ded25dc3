"""Numbers that a trajectory comes down to: peak, time of peak, final value, rms, quantile over time, crossing.

A reduction is called with the times [s], shape (samples,), and its outputs, shape (samples, lanes) each, inside the
compiled program, so that no time series of an ensemble has to be kept.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp


@dataclasses.dataclass(frozen=True)
class AbstractReduction(abc.ABC):
    """One number for each lane, from one or several outputs. differentiable: whether it has a derivative."""

    differentiable: ClassVar[bool] = True

    @property
    @abc.abstractmethod
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs that it needs."""

    @abc.abstractmethod
    def __call__(self, times, *series) -> Any:
        """Its value for each lane, shape (lanes,)."""


@dataclasses.dataclass(frozen=True)
class OfOneOutput(AbstractReduction):
    """A reduction of one output. Args: output: its name, such as "A.pressure"."""

    output: str

    @property
    def outputs(self) -> tuple[str, ...]:
        return (self.output,)


@dataclasses.dataclass(frozen=True)
class Peak(OfOneOutput):
    """The largest value at the saved times, in the unit of the output."""

    def __call__(self, times, series):
        return jnp.max(series, axis=0)


@dataclasses.dataclass(frozen=True)
class Trough(OfOneOutput):
    """The smallest value at the saved times, in the unit of the output."""

    def __call__(self, times, series):
        return jnp.min(series, axis=0)


@dataclasses.dataclass(frozen=True)
class TimeOfPeak(OfOneOutput):
    """The saved time at which the output is largest [s]; the first of several.

    It is one of the saved times and jumps between them, so that its derivative is an error, not a silent zero.
    """

    differentiable = False

    def __call__(self, times, series):
        return times[jnp.argmax(series, axis=0)]


@dataclasses.dataclass(frozen=True)
class Final(OfOneOutput):
    """The value at the last saved time, in the unit of the output."""

    def __call__(self, times, series):
        return series[-1]


@dataclasses.dataclass(frozen=True)
class TimeMean(OfOneOutput):
    """The mean over time by the trapezoidal rule, in the unit of the output."""

    def __call__(self, times, series):
        return _mean(times, series)


@dataclasses.dataclass(frozen=True)
class RootMeanSquare(OfOneOutput):
    """sqrt(mean over time of y^2) by the trapezoidal rule, in the unit of the output."""

    def __call__(self, times, series):
        return jnp.sqrt(_mean(times, series**2))


@dataclasses.dataclass(frozen=True)
class TimeQuantile(OfOneOutput):
    """The value below which the output lies for a share of the saved times, in its unit.

    Args: output; share: 0..1, of the saved times (weigh them by saving at equal distances).
    """

    share: float

    def __post_init__(self):
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"share must be 0..1, got {self.share:g}: was it given in percent?")

    def __call__(self, times, series):
        return jnp.quantile(series, self.share, axis=0)


@dataclasses.dataclass(frozen=True)
class Crossing(OfOneOutput):
    """The first time at which the output crosses a level, between the saved times by a straight line [s].

    Args: output; level, in the unit of the output; direction: "up", "down" or "either". NaN for a lane that
    never crosses.
    """

    level: float
    direction: str = "up"

    def __post_init__(self):
        if self.direction not in ("up", "down", "either"):
            raise ValueError(f'direction must be "up", "down" or "either", got {self.direction!r}')

    def __call__(self, times, series):
        below, above = series[:-1] < self.level, series[1:] >= self.level
        up, down = below & above, ~below & ~above
        crosses = {"up": up, "down": down, "either": up | down}[self.direction]
        first = jnp.argmax(crosses, axis=0)
        before, after = (jnp.take_along_axis(s, first[None], axis=0)[0] for s in (series[:-1], series[1:]))
        rise = jnp.where(after == before, 1.0, after - before)
        share = (self.level - before) / rise
        time = times[first] + share * (times[first + 1] - times[first])
        return jnp.where(jnp.any(crosses, axis=0), time, jnp.nan)


@dataclasses.dataclass(frozen=True)
class Custom(AbstractReduction):
    """A reduction of your own.

    Args: function(times, *series) -> (lanes,), of `jax.numpy`, with series of shape (samples, lanes) in the order of
    `names`; names: the outputs that it takes.
    """

    function: Callable
    names: tuple[str, ...]

    def __post_init__(self):
        object.__setattr__(self, "names", (self.names,) if isinstance(self.names, str) else tuple(self.names))

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.names

    def __call__(self, times, *series):
        return self.function(times, *series)


def _mean(times, series):
    """The mean over time by the trapezoidal rule."""
    widths = jnp.diff(times)[:, None]
    return jnp.sum(0.5 * (series[1:] + series[:-1]) * widths, axis=0) / (times[-1] - times[0])
