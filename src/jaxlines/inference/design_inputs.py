"""Inputs of which something can be chosen: values at knots, amplitudes and phases of sines, the size of a profile."""

import dataclasses
import functools
from typing import Any

import numpy as np

from jaxlines.inference.design_excitation import AbstractExcitation, check_limits, require

MAX_GRID = 2000
"""Samples of a multisine: each is a knot at which the simulation stops."""


@dataclasses.dataclass(frozen=True, eq=False)
class Knots(AbstractExcitation):
    """A profile of straight lines between knots, each knot to be chosen.

    Args: input: name of the circuit's input; times: of the knots [s], increasing, shape (knots,); low, high: limits
        of the level [unit of the input]; start: values to begin with, which the design is compared with (the middle of
        the limits by default; where they break a limit, the nearest that keep all); rate: the steepest slope [unit/s];
        first, last: fixed values at the ends, such as 0 for a valve that begins and ends closed; energy: the largest
        integral of u^2 dt [unit^2 s].
    Raises: ValueError for times that do not increase, limits without room or another number of values.
    """

    input: str
    times: Any
    low: float
    high: float
    start: Any = None
    rate: float | None = None
    first: float | None = None
    last: float | None = None
    energy: float | None = None

    def __post_init__(self):
        times = np.asarray(self.times, dtype=float)
        object.__setattr__(self, "times", times)
        right = times.ndim == 1 and times.size >= 2 and bool(np.all(np.diff(times) > 0))
        require(right, f"{self.input}: times of the knots must be two or more and increase, got {self.times}")
        check_limits(self)
        for name in ("first", "last"):
            value = getattr(self, name)
            inside = value is None or self.low <= value <= self.high
            require(inside, f"{self.input}: {name} must lie within {self.low:g} .. {self.high:g}, got {value}")
        middle = np.full(times.size, 0.5 * (self.low + self.high))
        start = middle if self.start is None else np.asarray(self.start, dtype=float)
        require(
            start.shape == times.shape,
            f"{self.input}: start needs a value for each of {times.size} knots, got shape {start.shape}",
        )
        if self.start is None:
            start[0], start[-1] = _or(self.first, start[0]), _or(self.last, start[-1])
        object.__setattr__(self, "start", start)

    @property
    def grid(self) -> np.ndarray:
        """The knots."""
        return self.times

    @property
    def base(self) -> np.ndarray:
        """Nothing."""
        return np.zeros(self.times.size)

    @property
    def basis(self) -> np.ndarray:
        """Each knot is a coefficient."""
        return np.eye(self.times.size)

    @property
    def coefficient_bounds(self) -> np.ndarray:
        """The level's limits, and the fixed ends."""
        bounds = np.tile([self.low, self.high], (self.times.size, 1))
        for place, value in ((0, self.first), (-1, self.last)):
            if value is not None:
                bounds[place] = value
        return bounds

    @property
    def start_coefficients(self) -> np.ndarray:
        """The values given."""
        return np.asarray(self.start)

    @property
    def _levels_are_bounds(self) -> bool:
        return True


def _or(value: float | None, otherwise: float) -> float:
    return float(otherwise if value is None else value)


@dataclasses.dataclass(frozen=True, eq=False)
class Multisine(AbstractExcitation):
    """mean + sum a_k cos(2 pi f_k t) + b_k sin(2 pi f_k t): amplitude and phase of each frequency are to be chosen.

    Args: input; frequencies f_k [Hz], shape (sines,); stop: length [s]; low, high: limits of the level, kept at all
        samples; mean: middle of the level (of the limits by default); start: amplitudes to begin with, shape (sines,)
        (equal ones that fill half the room by default), with phases by Schroeder; rate: the steepest slope [unit/s];
        energy: the largest integral of u^2 dt [unit^2 s]; per_period: samples in the shortest period.
    Raises: ValueError for frequencies that are not positive or more than 2000 samples.
    Reference: Schroeder, "Synthesis of low-peak-factor signals", IEEE Trans. Inf. Theory 16, 1970.
    """

    input: str
    frequencies: Any
    stop: float
    low: float
    high: float
    mean: float | None = None
    start: Any = None
    rate: float | None = None
    energy: float | None = None
    per_period: int = 20

    def __post_init__(self):
        frequencies = np.atleast_1d(np.asarray(self.frequencies, dtype=float))
        object.__setattr__(self, "frequencies", frequencies)
        right = frequencies.size > 0 and bool(np.all(frequencies > 0.0))
        require(right, f"{self.input}: frequencies must be positive [Hz], got {self.frequencies}")
        require(self.stop > 0.0, f"{self.input}: stop must be positive [s], got {self.stop:g}")
        check_limits(self)
        mean = 0.5 * (self.low + self.high) if self.mean is None else self.mean
        require(self.low < mean < self.high, f"{self.input}: mean {mean:g} leaves no room within its limits")
        object.__setattr__(self, "mean", float(mean))
        count = self._samples
        require(
            count <= MAX_GRID,
            f"{self.input}: {count} samples would be needed for {frequencies.max():g} Hz over {self.stop:g} s, "
            f"{MAX_GRID} are allowed: shorten the test, lower the frequencies or give per_period",
        )
        room = min(self.high - mean, mean - self.low)
        equal = np.full(frequencies.size, 0.5 * room / frequencies.size)
        start = equal if self.start is None else np.atleast_1d(np.asarray(self.start, dtype=float))
        require(start.shape == frequencies.shape, f"{self.input}: start needs one amplitude for each frequency")
        object.__setattr__(self, "start", start)

    @property
    def _samples(self) -> int:
        return int(np.ceil(self.stop * float(np.max(self.frequencies)) * self.per_period)) + 1

    @property
    def grid(self) -> np.ndarray:
        """Evenly spaced."""
        return np.linspace(0.0, self.stop, self._samples)

    @property
    def base(self) -> np.ndarray:
        """The mean."""
        return np.full(self._samples, float(self.mean or 0.0))

    @functools.cached_property
    def basis(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Cosines, then sines."""
        angle = 2.0 * np.pi * np.outer(self.grid, self.frequencies)
        return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)

    @property
    def coefficient_bounds(self) -> np.ndarray:
        """No amplitude can be larger than the whole room."""
        room = self.high - self.low
        return np.tile([-room, room], (2 * self.frequencies.size, 1))

    @property
    def start_coefficients(self) -> np.ndarray:
        """The amplitudes given, at Schroeder's phases."""
        k = np.arange(self.frequencies.size)
        phase = -np.pi * k * (k + 1) / self.frequencies.size
        start = np.asarray(self.start)
        return np.concatenate([start * np.sin(phase), start * np.cos(phase)])

    def amplitudes(self, coefficients) -> np.ndarray:
        """Amplitude of each frequency [unit of the input], shape (sines,)."""
        return np.hypot(*np.reshape(coefficients, (2, -1)))


@dataclasses.dataclass(frozen=True, eq=False)
class Scaled(AbstractExcitation):
    """A given profile times a factor to be chosen: offset + factor * values.

    Args: input; times [s] and values of the profile, shape (samples,); low, high: limits of the level; smallest,
        largest: limits of the factor [-]; start: factor to begin with; offset: what is not multiplied; rate, energy: as
        in `Knots`.
    """

    input: str
    times: Any
    profile: Any
    low: float
    high: float
    smallest: float = 0.0
    largest: float = 10.0
    start: float = 1.0
    offset: float = 0.0
    rate: float | None = None
    energy: float | None = None

    def __post_init__(self):
        for name in ("times", "profile"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        right = self.times.shape == self.profile.shape and self.times.size >= 2
        require(right, f"{self.input}: profile needs a value for each of its times")
        check_limits(self)
        require(self.smallest < self.largest, f"{self.input}: smallest must be less than largest: nothing is to choose")

    @property
    def grid(self) -> np.ndarray:
        """Times of the profile."""
        return self.times

    @property
    def base(self) -> np.ndarray:
        """The offset."""
        return np.full(self.times.size, self.offset)

    @property
    def basis(self) -> np.ndarray:
        """The profile."""
        return self.profile[:, None]

    @property
    def coefficient_bounds(self) -> np.ndarray:
        """Of the factor."""
        return np.array([[self.smallest, self.largest]])

    @property
    def start_coefficients(self) -> np.ndarray:
        """The factor given."""
        return np.array([self.start])
