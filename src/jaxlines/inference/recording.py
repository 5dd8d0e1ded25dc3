"""A recording: measured channels over time, in SI units, with what is missing masked and what is odd noted."""

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Recording:
    """Measured channels over time.

    Args:
        times: [s], shape (samples,), strictly increasing.
        channels: name -> values in SI, shape (samples,), NaN where missing. A name is an output of the circuit
            ("A.pressure", a sensor) or one of its inputs ("spool").
        mask: name -> True where a sample may be used (default: all finite samples).
        name: how to call it in messages, and among several.
        warnings: what a reader should know about it, in words.
        conditions: path of a number in the circuit -> the value it had during this recording, SI, such as
            {"fluid.bulk_modulus": 1.3e9} or {"initial.A.pressure": 5e6}; a fit sets them.
        initial: start values of this recording in place of those given to the fit: a table such as {"A.pressure":
            "measured"}, or "steady" (see `fit`).
        noise: channel -> known standard deviation of its noise in SI, one number or shape (samples,); NaN or no entry
            where it is not known.
    Raises: ValueError for shapes that differ or times that do not increase.
    """

    times: np.ndarray
    channels: dict[str, np.ndarray]
    mask: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    name: str = "recording"
    warnings: tuple[str, ...] = ()
    conditions: dict[str, float] = dataclasses.field(default_factory=dict)
    initial: dict | str | None = None
    noise: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        times = np.asarray(self.times, dtype=np.float64)
        channels = {key: np.asarray(values, dtype=np.float64) for key, values in self.channels.items()}
        if times.ndim != 1 or times.size < 2:
            raise ValueError(f"{self.name}: a recording needs two or more times, got shape {times.shape}")
        if not np.all(np.isfinite(times)):
            raise ValueError(f"{self.name}: time is not finite at sample {int(np.argmin(np.isfinite(times)))}")
        if not np.all(np.diff(times) > 0):
            at = int(np.argmin(np.diff(times) > 0)) + 1
            raise ValueError(
                f"{self.name}: time must increase; at sample {at} it goes from {times[at - 1]:g} s to {times[at]:g} s: "
                "are rows repeated or out of order, or did the clock jump?"
            )
        for key, values in channels.items():
            if values.shape != times.shape:
                raise ValueError(f"{self.name}: channel {key!r} has shape {values.shape}, time has {times.shape}")
        mask = {
            key: np.isfinite(values) & np.asarray(self.mask.get(key, np.ones(times.shape, bool)), dtype=bool)
            for key, values in channels.items()
        }
        noise = {key: self._noise(key, channels, level) for key, level in self.noise.items()}
        for field, value in (("times", times), ("channels", channels), ("mask", mask), ("noise", noise)):
            object.__setattr__(self, field, value)

    def _noise(self, channel: str, channels: dict, level) -> np.ndarray:
        """A noise level as one number a sample; raises for what cannot be one."""
        if channel not in channels:
            raise ValueError(f"{self.name}: noise is given for {channel!r}, which is no channel of it")
        shape = channels[channel].shape
        if np.shape(level) not in ((), shape):
            raise ValueError(f"{self.name}: noise of {channel!r} has shape {np.shape(level)}, its channel {shape}")
        level = np.broadcast_to(np.asarray(level, dtype=np.float64), shape)
        if np.any(level <= 0.0):
            raise ValueError(f"{self.name}: noise of {channel!r} must be positive, got {np.nanmin(level):g}")
        return level

    def window(self, start: float, stop: float) -> "Recording":
        """The samples with start <= time <= stop [s]."""
        keep = (self.times >= start) & (self.times <= stop)
        return dataclasses.replace(
            self,
            times=self.times[keep],
            channels={key: values[keep] for key, values in self.channels.items()},
            mask={key: values[keep] for key, values in self.mask.items()},
            noise={key: values[keep] for key, values in self.noise.items()},
        )
