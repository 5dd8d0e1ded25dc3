"""Weighting functions against Zielke's exact one, in time and in frequency, with the error each set is known for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ive

from jaxlines.physics.weighting import (
    JohnstonWeights,
    KagawaWeights,
    SchohlWeights,
    TrikhaWeights,
    VitkovskyTurbulentWeights,
    VitkovskyWeights,
    zielke_weight,
)

SETS = {
    "trikha": TrikhaWeights(),
    "schohl": SchohlWeights(),
    "kagawa": KagawaWeights(),
    "vitkovsky": VitkovskyWeights(),
    "johnston": JohnstonWeights(),
    "johnston 6": JohnstonWeights(6),
}


def error(name, tau):
    return SETS[name].weight(tau) / zielke_weight(tau) - 1.0


def test_exact_weight():
    """Both expressions of Zielke, with his printed coefficients and the first five zeros."""
    assert zielke_weight(0.02) == pytest.approx(0.913967, abs=5e-7)
    tau = np.array([0.05, 0.1, 0.3])
    exponents = np.array([26.374616, 70.849999, 135.020709, 218.920189, 322.555116])
    np.testing.assert_allclose(zielke_weight(tau), np.exp(-exponents * tau[:, None]).sum(1), rtol=1e-6)
    printed = (0.282095, -1.250000, 1.057855, 0.937500, 0.396696, -0.351563)
    short = np.array([1e-7, 1e-5, 1e-3])
    series = sum(m * short ** ((i - 1) / 2) for i, m in enumerate(printed))
    np.testing.assert_allclose(zielke_weight(short), series, rtol=2e-6)
    across = zielke_weight(np.array([1e-4 * (1 - 1e-9), 1e-4]))  # where the expressions change over
    assert abs(across[1] / across[0] - 1) < 2e-9


# Set -> (largest error, range of tau), and signed errors at single times, in percent as known for each set.
BANDS = {
    "trikha": [(38.5, 1e-3, 0.3)],
    "schohl": [(5.45, 1e-5, 0.3)],
    "kagawa": [(0.30, 1e-5, 0.3)],
    "vitkovsky": [(0.033, 1e-5, 0.1), (3.95, 0.1, 0.3)],
}
POINTS = {
    "trikha": {1e-4: -0.2, 1e-3: -1.1, 1e-2: 10.5},
    "vitkovsky": {0.2: -1.8, 0.3: -3.9},
    "johnston": {1e-4: -0.55, 3e-3: 1.3, 0.02: -1.1, 0.03: -3.9, 0.05: -8.6, 0.1: -29.0},
}


@pytest.mark.parametrize("name", BANDS)
def test_error_band(name):
    for percent, low, high in BANDS[name]:
        largest = 100 * np.max(np.abs(error(name, np.geomspace(low, high, 3000))))
        assert 0.9 * percent < largest <= percent


@pytest.mark.parametrize("name", POINTS)
def test_error_at_single_times(name):
    for tau, percent in POINTS[name].items():
        assert 100 * error(name, np.array(tau)) == pytest.approx(percent, abs=0.08)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("trikha", 1e-3), ("schohl", 0.012), ("kagawa", 0.005), ("vitkovsky", 0.006), ("johnston", 0.04)],
)
def test_inertia_of_slow_flow(name, tolerance):
    """sum m/n = sum 1/j_k^2 = 1/12, which makes the inertia of slow laminar flow 4/3 of the fluid's."""
    m, n = SETS[name].coefficients()
    assert np.sum(m / n) == pytest.approx(1 / 12, rel=tolerance)
    assert SETS[name].transform(0.0) == pytest.approx(np.sum(m / n), rel=1e-14)


def test_inertia_of_johnston_with_six_terms():
    m, n = JohnstonWeights(6).coefficients()
    assert np.sum(m / n) == pytest.approx(0.07936, abs=5e-6)


# |xi^2 - exact|/|exact - 1| at w R^2/nu = 1, 10, 100, 1e3, 1e4
IMPEDANCE = {
    "trikha": (1e-4, 0.0043, 0.102, 0.286, 0.310),
    "schohl": (5e-4, 0.004, 0.020, 0.061, 0.159),
    "kagawa": (2e-4, 0.0015, 0.0072, 0.025, 0.080),
    "vitkovsky": (2e-4, 0.0018, 0.0077, 0.026, 0.084),
    "johnston 6": (0.002, 0.014, 0.015, 0.078, 0.24),
}


@pytest.mark.parametrize("name", IMPEDANCE)
def test_error_of_the_impedance(name):
    """xi^2 = 1 + 8/w + 4 sum m/(w + n) against I0(z)/I2(z), w = z^2."""
    w = 1j * np.array([1.0, 10.0, 100.0, 1e3, 1e4])
    exact = ive(0, np.sqrt(w)) / ive(2, np.sqrt(w))
    ours = 1 + 8 / w + 4 * SETS[name].transform(w)
    errors = np.abs(ours - exact) / np.abs(exact - 1)
    np.testing.assert_allclose(errors, IMPEDANCE[name], rtol=0.04, atol=5e-5)
    assert np.all(errors < [0.0416, 0.348, 0.753, 0.914, 0.972])  # what steady friction alone gives


def test_fewer_terms_are_the_slow_ones():
    for kind in (KagawaWeights, VitkovskyWeights):
        few, all_of_them = kind(4), kind()
        np.testing.assert_array_equal(few.coefficients()[1], all_of_them.coefficients()[1][:4])
        late = np.geomspace(0.02, 0.3, 20)
        np.testing.assert_allclose(few.weight(late), all_of_them.weight(late), rtol=1e-3)


def test_turbulent_weights():
    """A* exp(-B* tau)/sqrt(tau), with B* = 526.2 at Re 1e4."""
    weights = VitkovskyTurbulentWeights(1e4)
    assert weights.shear_decay() == pytest.approx(526.2, abs=0.06)
    tau = np.geomspace(1e-6, 1e-2, 400)
    np.testing.assert_allclose(weights.weight(tau), 0.2820948 * np.exp(-526.2462 * tau) / np.sqrt(tau), rtol=2e-3)
    with jax.enable_x64(True):
        slope = jax.grad(lambda r: VitkovskyTurbulentWeights(r).weight(1e-3))(1e4)
        h = 1.0
        near = [VitkovskyTurbulentWeights(1e4 + k * h).weight(1e-3) for k in (-1, 1)]
        assert float(slope) == pytest.approx((near[1] - near[0]) / (2 * h), rel=1e-6)
        m, n = VitkovskyTurbulentWeights(jnp.array([1e4, 1e5])).coefficients()
    assert m.shape == n.shape == (10, 2)


def test_all_sets_are_ordered_and_positive():
    for weights in SETS.values():
        m, n = weights.coefficients()
        assert m.shape == n.shape and np.all(m > 0) and np.all(np.diff(n) > 0)


@pytest.mark.parametrize("make", [lambda: KagawaWeights(0), lambda: VitkovskyWeights(11), lambda: JohnstonWeights(2)])
def test_wrong_numbers_of_terms_are_refused(make):
    with pytest.raises(ValueError, match="terms must be a whole number"):
        make()


def test_a_laminar_mean_flow_is_no_turbulent_one():
    with pytest.raises(ValueError, match=r"reynolds_number must be .* got 500: is the flow laminar\?"):
        VitkovskyTurbulentWeights(500.0)
