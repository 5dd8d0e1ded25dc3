"""Signals: inputs as functions of time. Call one at a time t [s] to get its value there."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.fields import AbstractSignal, Number, as_number, is_concrete, quantity

METHODS = ("linear", "cubic", "hold")


@jax.custom_jvp
def jump_time(time):
    """The time of a jump, which has no derivative here: asking for one is an error, not a silent zero."""
    return time


@functools.partial(jump_time.defjvp, symbolic_zeros=True)
def _jump_time_jvp(primals, tangents):
    if not isinstance(tangents[0], jax.custom_derivatives.SymbolicZero):
        raise NotImplementedError(
            "the time of a jump (Step.time, or the delay of a signal that is held) cannot be differentiated: "
            'use a Sampled signal with method="cubic" and its delay'
        )
    return primals[0], jnp.zeros_like(primals[0])


class Constant(AbstractSignal):
    """The same value at all times."""

    value: Number = quantity("1")

    def __call__(self, t):
        return self.value + 0.0 * t


class Step(AbstractSignal):
    """`before` until `time` [s], `after` from then on. The jump is known to the step-size controller."""

    before: Number = quantity("1")
    after: Number = quantity("1")
    time: Number = quantity("s")

    def __call__(self, t):
        return jnp.where(t < jump_time(self.time), self.before, self.after)

    def jump_times(self):
        return self.time[None]


class Sine(AbstractSignal):
    """mean + amplitude sin(2 pi frequency t + phase); frequency in Hz, phase in rad."""

    mean: Number = quantity("1", default=0.0)
    amplitude: Number = quantity("1", default=1.0)
    frequency: Number = quantity("Hz", low=0.0, default=1.0)
    phase: Number = quantity("rad", default=0.0)

    def __call__(self, t):
        return self.mean + self.amplitude * jnp.sin(2.0 * np.pi * self.frequency * t + self.phase)


class Sampled(AbstractSignal):
    """Samples of a recording, interpolated between them and held beyond the ends.

    Args: times [s], strictly increasing, shape (samples,); values, shape (samples,), finite; method: "linear"
        (default), "cubic" (monotone cubic, smooth, no overshoot) or "hold" (jumps at each sample); delay [s]: the
        signal is value(t - delay), which can be fitted (use "cubic": its slope has no jumps).
    Raises: ValueError when shapes differ, times do not increase or a value is not finite.
    Reference: Fritsch and Butland, "A method for constructing local monotone piecewise cubic interpolants",
    SIAM J. Sci. Stat. Comput. 5, 1984 (slopes of equally weighted neighbours).
    """

    times: Number
    values: Number
    method: str = eqx.field(static=True)
    delay: Number = quantity("s", low=-1e6, high=1e6, slip="was it given in ms?")
    evenly_spaced: bool = eqx.field(static=True)  # pyright: ignore[reportGeneralTypeIssues]

    def __init__(self, times, values, method: str = "linear", delay=0.0):
        self.times, self.values, self.delay = as_number(times), as_number(values), as_number(delay)
        self.method = method
        self.evenly_spaced = _evenly_spaced(self.times)

    def __check_init__(self):
        if self.method not in METHODS:
            raise ValueError(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")
        if self.times.shape != self.values.shape or self.times.ndim != 1 or self.times.size < 2:
            raise ValueError(
                "a sampled signal needs two or more times and as many values, got shapes "
                f"{self.times.shape} and {self.values.shape}"
            )
        if is_concrete(self.times) and not np.all(np.diff(self.times) > 0):
            at = int(np.argmin(np.diff(self.times) > 0)) + 1
            raise ValueError(f"times of a sampled signal must increase; they do not at sample {at}")
        if is_concrete(self.values) and not np.all(np.isfinite(self.values)):
            at = int(np.argmin(np.isfinite(self.values)))
            raise ValueError(f"values of a sampled signal must be finite; sample {at} is {self.values[at]}")

    def __call__(self, t):
        times, values = jnp.asarray(self.times), jnp.asarray(self.values)
        t = t - (jump_time(self.delay) if self.method == "hold" else self.delay)
        index = _interval(times, t, self.evenly_spaced)
        if self.method == "hold":
            return jnp.where(t >= times[-1], values[-1], values[index])
        width, rise = times[index + 1] - times[index], values[index + 1] - values[index]
        # Not clip: its derivative is halved where the solver lands exactly on a sample.
        share = (t - times[index]) / width
        share = jnp.where(t < times[0], 0.0, jnp.where(t > times[-1], 1.0, share))
        if self.method == "linear":
            return values[index] + share * rise
        first, last = (_monotone_slope(times, values, i) * width for i in (index, index + 1))
        bend = share * (1.0 - share) * ((1.0 - share) * (first - rise) + share * (rise - last))
        return values[index] + share * rise + bend

    def jump_times(self):
        return self.times + self.delay if self.method == "hold" else np.zeros(0)

    def knot_times(self):
        return np.zeros(0) if self.method == "hold" else self.times + self.delay

    def padded(self, size: int) -> "Sampled":
        """The same signal with its last value held to `size` samples, so that lengths share a program."""
        extra = size - self.times.size
        if extra <= 0:
            return self
        step = (self.times[-1] - self.times[0]) / (self.times.size - 1)
        times = np.concatenate([self.times, self.times[-1] + step * np.arange(1, extra + 1)])
        values = np.concatenate([self.values, np.full(extra, self.values[-1])])
        return Sampled(times, values, self.method, self.delay)


def _evenly_spaced(times) -> bool:
    """Whether no sample is further than 0.4 steps from where equal steps would put it."""
    if not is_concrete(times) or times.ndim != 1 or times.size < 2:
        return False
    even = np.linspace(times[0], times[-1], times.size)
    return bool(np.max(np.abs(times - even)) < 0.4 * (even[1] - even[0]))


def _interval(times, t, evenly_spaced: bool):
    """Index of the sample at or before t, at most the last but one."""
    last = times.size - 2
    if evenly_spaced:
        guess = (t - times[0]) / (times[-1] - times[0]) * (last + 1)
        guess = jnp.clip(jnp.floor(guess).astype(int), 0, last)
        guess = guess - (t < times[guess]) + (t >= times[guess + 1])  # rounding and jitter: one off at most
        return jnp.clip(guess, 0, last)
    if times.size <= 4096:  # one vectorised pass; a binary search is a loop of tiny operations on XLA's CPU
        return jnp.clip(jnp.sum(times <= t) - 1, 0, last)
    return jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, last)


def _monotone_slope(times, values, index):
    """Slope at a sample: harmonic mean of the neighbouring secants, zero at extremes and at the ends."""
    left, right = jnp.clip(index - 1, 0, times.size - 1), jnp.clip(index + 1, 0, times.size - 1)
    before = (values[index] - values[left]) / jnp.where(index > left, times[index] - times[left], 1.0)
    after = (values[right] - values[index]) / jnp.where(right > index, times[right] - times[index], 1.0)
    product = before * after
    safe = jnp.where(product > 0, before + after, 1.0)
    return jnp.where(product > 0, 2.0 * product / safe, 0.0)


def as_signal(value, times) -> AbstractSignal:
    """A signal as it is, a number as a constant, an array of samples at `times` joined linearly."""
    if isinstance(value, AbstractSignal):
        return value
    value = as_number(value)
    return Constant(value) if value.ndim == 0 else Sampled(times, value)
