"""How wrong a lumped line is: its input impedance against that of the distributed one."""

import numpy as np

from jaxlines.physics.fields import array_module


def lumped_impedance_ratio(phase):
    """Input impedance of a blocked lossless line over that of its capacitance: kL cot(kL) [-].

    Args: phase kL = 2 pi f L/c [rad]. 1 at low frequency, 0 at the quarter-wave resonance (kL = pi/2),
    negative beyond it: the line then reacts with the opposite sign.
    """
    xp = array_module(phase)
    phase = xp.asarray(phase)
    small = xp.abs(phase) < 0.02
    square = phase * phase
    series = 1.0 - square / 3.0 * (1.0 + square / 15.0 * (1.0 + 2.0 * square / 21.0))
    safe = xp.where(small, 1.0, phase)
    return xp.where(small, series, safe / xp.tan(safe))


def lumped_impedance_error(length, speed, frequency):
    """Relative error of the input impedance of a lumped line, |kL cot(kL) - 1| [-].

    Args: length L of the fluid path [m]; speed c of the waves [m/s]; frequency f [Hz].
    Typical values: 1 % at f L/c = 0.0275, 10 % at 0.0863, 100 % at 0.25 (the quarter-wave resonance).
    """
    phase = 2.0 * np.pi * frequency * length / speed
    return array_module(phase).abs(lumped_impedance_ratio(phase) - 1.0)


def quarter_wave_frequency(length, speed):
    """First resonance of a line that is closed at its end: c/(4 L) [Hz]."""
    return speed / (4.0 * length)


def frequency_of_error(length, speed, error):
    """The frequency [Hz] at which `lumped_impedance_error` reaches a value, below the second resonance.

    Args: length [m]; speed [m/s]; error: one number above 0 [-]. On the host (NumPy), by bisection.
    """
    low, high = 0.0, np.pi
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if 1.0 - lumped_impedance_ratio(middle) > error else (middle, high)
    return low * speed / (2.0 * np.pi * length)


def ladder_delay_error(segments_per_wavelength):
    """How much too slow a wave runs through a chain of segments: 1 - sin(pi/N)/(pi/N) [-], about pi^2/(6 N^2).

    Args: segments_per_wavelength N [-]. Typical values: 1.6 % at 10, 0.41 % at 20, 0.10 % at 40.
    From the exact dispersion of the staggered chain, omega = (2 c/dx) sin(k dx/2).
    """
    return 1.0 - array_module(segments_per_wavelength).sinc(1.0 / segments_per_wavelength)
