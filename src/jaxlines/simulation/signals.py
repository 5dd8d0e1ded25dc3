"""Signals: inputs as functions of time. Call one at a time t [s] to get its value there."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.fields import AbstractSignal, Number, as_number, is_concrete, quantity

METHODS = ("linear", "hold")


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
        return jnp.where(t < self.time, self.before, self.after)

    def jump_times(self):
        return self.time[None] if is_concrete(self.time) else jnp.asarray(self.time)[None]


class Sine(AbstractSignal):
    """mean + amplitude sin(2 pi frequency t + phase); frequency in Hz, phase in rad."""

    mean: Number = quantity("1", default=0.0)
    amplitude: Number = quantity("1", default=1.0)
    frequency: Number = quantity("Hz", low=0.0, default=1.0)
    phase: Number = quantity("rad", default=0.0)

    def __call__(self, t):
        return self.mean + self.amplitude * jnp.sin(2.0 * np.pi * self.frequency * t + self.phase)


class Sampled(AbstractSignal):
    """Samples of a recording, joined by straight lines or held until the next; ends are held.

    Args: times [s], strictly increasing, shape (samples,); values, shape (samples,), finite;
        method: "linear" (default) or "hold" (the value jumps at each sample, known to the controller).
    Raises: ValueError when shapes differ, times do not increase or a value is not finite.
    """

    times: Number = eqx.field(converter=as_number)
    values: Number = eqx.field(converter=as_number)
    method: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        if self.method not in METHODS:
            raise ValueError(f'method must be "linear" or "hold", got {self.method!r}')
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
        # An equally spaced guess corrected by neighbours would be faster still; a full comparison is one
        # vectorised pass, where a binary search is a loop of tiny operations on XLA's CPU backend.
        index = jnp.clip(jnp.sum(times <= t) - 1, 0, times.size - 2)
        if self.method == "hold":
            return jnp.where(t >= times[-1], values[-1], values[index])
        share = (t - times[index]) / (times[index + 1] - times[index])
        return values[index] + jnp.clip(share, 0.0, 1.0) * (values[index + 1] - values[index])

    def jump_times(self):
        return self.times if self.method == "hold" else np.zeros(0)

    def knot_times(self):
        return self.times if self.method == "linear" else np.zeros(0)

    def padded(self, size: int) -> "Sampled":
        """The same signal with its last value held to `size` samples, so that lengths share a program."""
        extra = size - self.times.size
        if extra <= 0:
            return self
        step = self.times[-1] - self.times[-2]
        more_times = self.times[-1] + step * np.arange(1, extra + 1)
        times = np.concatenate([self.times, more_times])
        return Sampled(times, np.concatenate([self.values, np.full(extra, self.values[-1])]), self.method)


def as_signal(value, times) -> AbstractSignal:
    """A signal as it is, a number as a constant, an array of samples at `times` joined linearly."""
    if isinstance(value, AbstractSignal):
        return value
    value = as_number(value)
    return Constant(value) if value.ndim == 0 else Sampled(times, value)
