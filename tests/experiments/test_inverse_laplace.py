"""Water hammer of the exact line in time against published inversions, a Fourier series, and the lossless line."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from jaxlines.physics.distributed import bessel_ratio

TIME = runpy.run_path(str(Path(__file__).parents[2] / "experiments" / "inverse_laplace.py"))

# Pressure at the valve in units of rho c V0 after an instantaneous closure, by two settings of another inversion.
HAMMER_TIMES = np.array([0.5, 1.0, 1.5, 2.5, 3.0, 3.5, 5, 7, 9, 11, 13, 15])
HAMMER = {
    6.702481e-3: (
        *(1.068803, 1.099453, 1.123882, -0.660496, -0.775952, -0.839287),
        *(0.780131, -0.522023, 0.525186, -0.301912, 0.321674, -0.128453),
    ),
    1.00826118e-3: (
        *(1.025847, 1.036859, 1.045434, -0.883127, -0.928634, -0.953277),
        *(0.919617, -0.832988, 0.815148, -0.736313, 0.715762, -0.642153),
    ),
}


@pytest.mark.parametrize("dissipation", HAMMER)
def test_water_hammer_of_the_exact_line(dissipation):
    """Instantaneous closure of a valve at the end of a line with laminar flow, to the printed digits."""
    for order in (11, 14):
        ours = TIME["instantaneous_closure"](HAMMER_TIMES, dissipation, order)
        np.testing.assert_allclose(ours, HAMMER[dissipation], atol=6e-7)


@pytest.mark.parametrize("closure_time", [0.5, 5.0])
def test_water_hammer_of_a_smooth_closure(closure_time):
    """Raised cosine, against a Fourier series of the whole transform, which has no need of the fronts."""
    times, dissipation, period = np.array([0.1, 0.5, 1.0, 2.05, 2.2, 2.6, 4.4, 7.0, 15.0]), 6.702481e-3, 40.0
    k = np.arange(20001)
    s, w = (12.0 + 1j * np.pi * k) / period, np.pi / closure_time
    xi = np.sqrt(bessel_ratio(np.sqrt(s / dissipation)))
    values = xi * np.tanh(s * xi) * w * w * (1.0 + np.exp(-s * closure_time)) / (2.0 * s * (s * s + w * w))
    values[0] *= 0.5
    series = [np.sum((values * np.exp(s * time)).real) / period for time in times]
    ours = TIME["raised_cosine_closure"](times, dissipation, closure_time)
    np.testing.assert_allclose(ours, series, atol=1e-6)


def test_water_hammer_without_friction():
    """Slow closure of a nearly lossless line: sum of the passages of the closure itself."""
    times, closure_time = np.linspace(0.05, 9.0, 20), 1.3

    def stopped(t):
        return np.where(t < 0, 0.0, 0.5 * (1.0 - np.cos(np.pi * np.clip(t / closure_time, 0.0, 1.0))))

    passages = sum((-1.0) ** k * (2.0 if k else 1.0) * stopped(times - 2.0 * k) for k in range(6))
    ours = TIME["raised_cosine_closure"](times, 1e-11, closure_time)
    np.testing.assert_allclose(ours, passages, atol=1e-4)
