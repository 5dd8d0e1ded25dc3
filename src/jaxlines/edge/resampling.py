"""Recordings on another step of time, without aliasing: a low-pass filter first, then samples."""

import dataclasses

import numpy as np

from jaxlines.inference.recording import Recording

TAPS_PER_STEP = 10
"""Half length of the filter in new steps; the transition from pass to stop then takes about a fifth of the new rate."""

MOST_ROWS = 20_000_000


def _even(times, values, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Values at an even step no wider than the recorded ones, linear between samples; NaN across gaps.

    Samples at an even step, up to 1e-6 of it, are kept as they are.
    """
    steps = np.diff(times)
    finest = float(np.min(steps))
    if np.ptp(steps) <= 1e-6 * finest * max(1.0, abs(times[-1]) / finest * 1e-9):
        return times, values
    count = int(np.ceil((times[-1] - times[0]) / finest)) + 1
    if count > MOST_ROWS:
        raise ValueError(f"times from {finest:g} s to {np.max(steps):g} s apart are too uneven to be resampled")
    even = np.linspace(times[0], times[-1], count)
    good = np.isfinite(values)
    dense = np.interp(even, times[good], values[good])
    after = np.clip(np.searchsorted(times, even), 1, times.size - 1)
    missing = ~(good[after] & good[after - 1]) & (np.abs(even - times[after]) > 1e-9 * finest)
    return even, np.where(missing, np.nan, dense)


def _low_pass(values, ratio: float) -> np.ndarray:
    """Values without what is above half the new rate; ratio: new step over old step.

    A symmetric filter (no delay) whose weights are renormalised at the ends and around missing samples; NaN where
    fewer than half of its weights meet samples.
    """
    from scipy.signal import fftconvolve, firwin

    half = int(np.ceil(TAPS_PER_STEP * ratio))
    # Cut-off so far below half the new rate that the stop band begins there.
    taps = firwin(2 * half + 1, 0.8 / ratio, window=("kaiser", 6.0))  # pyright: ignore[reportArgumentType]
    good = np.isfinite(values)
    centre = float(np.mean(values[good]))
    total = fftconvolve(np.where(good, values - centre, 0.0), taps, mode="same")
    weight = fftconvolve(good.astype(float), taps, mode="same")
    share = np.where(weight > 0.5, weight, np.nan)
    return centre + total / share


def resample_channel(times, values, new_times) -> np.ndarray:
    """A channel at new times of an even, wider or narrower step, without aliasing.

    Args: times [s], shape (samples,); values, the same shape, NaN where missing; new_times [s] at an even step.
    Returns: values at the new times; NaN outside the recording and in its gaps. Equal steps are only interpolated.
    Validity: frequencies below 0.3 of the new rate pass (within 1 %), those above half of it are suppressed below
    0.1 %.
    """
    times, values, new_times = (np.asarray(x, dtype=float) for x in (times, values, new_times))
    even, dense = _even(times, values, float(np.median(np.diff(new_times))))
    ratio = float(np.median(np.diff(new_times)) / np.median(np.diff(even)))
    smooth = _low_pass(dense, ratio) if ratio > 1.0 + 1e-9 else dense
    return np.interp(new_times, even, smooth, left=np.nan, right=np.nan)


def new_grid(start: float, stop: float, step: float) -> np.ndarray:
    """Times from start to stop [s] at an even step. Raises ValueError for a step that leaves too little or too much."""
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"the step must be positive, got {step:g} s")
    count = int(np.floor((stop - start) / step * (1.0 + 1e-12))) + 1
    if not 10 <= count <= MOST_ROWS:
        raise ValueError(
            f"a step of {step:g} s makes {count} samples of {start:g} s to {stop:g} s; 10 to {MOST_ROWS} can be used"
        )
    return start + step * np.arange(count)


def resample(recording: Recording, step: float) -> Recording:
    """A recording at an even step [s], low-pass filtered first so that nothing is folded down (aliasing).

    Never done unasked: a filter changes the noise that the intervals of a fit rest on; residuals of a filtered
    recording are white only up to the filter's cut-off, which lies at 0.4 of the new rate.
    Args: recording; step [s].
    Returns: a `Recording` that says so in its warnings.
    Raises: ValueError for a step that is not positive or leaves fewer than 10 samples.
    Reference: A. V. Oppenheim and R. W. Schafer, "Discrete-Time Signal Processing", secs. 4.6, 7.5.
    """
    times = new_grid(float(recording.times[0]), float(recording.times[-1]), step)
    masked = {name: np.where(recording.mask[name], x, np.nan) for name, x in recording.channels.items()}
    channels = {name: resample_channel(recording.times, values, times) for name, values in masked.items()}
    old = float(np.median(np.diff(recording.times)))
    note = f"resampled from a step of {old:.4g} s to {step:.4g} s, low-pass filtered before"
    return dataclasses.replace(recording, times=times, channels=channels, mask={}, warnings=(*recording.warnings, note))
