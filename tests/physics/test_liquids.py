"""Equations of state of liquids against tabulated values and their own derivatives."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.physics import liquids
from jaxlines.physics.fluids import Oil

ATMOSPHERE = 101325.0
LAWS = {
    "Murnaghan": liquids.Murnaghan(),
    "Tait": liquids.Tait(),
    "Tait from zero": liquids.Tait(reference_pressure=0.0),
    "Dowson-Higginson": liquids.DowsonHigginson(),
}
# Tait's equation with the parameters of OpenHydraulics' GenericOil at 293.15 K: p [Pa], rho [kg/m^3], K [MPa]
TAIT = [
    (0.0, 856.80520, 1534.127),
    (10e6, 862.21813, 1642.749),
    (20e6, 867.31642, 1750.650),
    (35e6, 874.45518, 1911.256),
]
# Dowson and Higginson, p gauge [Pa]: relative density, K [MPa]
DOWSON_HIGGINSON = [(10e6, 1.00589971, 1733.985), (20e6, 1.01160542, 1802.607), (100e6, 1.05128205, 2398.5)]


def test_tait_by_its_own_parameters():
    modulus = 8.4e9 * np.exp(-0.0058 * 293.15)
    assert modulus == pytest.approx(1.5341273e9, abs=51)
    density = 870 / (1 + 7.7e-4 * 20)
    for p, rho, K in TAIT:
        assert density / liquids.tait_volume(p, modulus, 10.9) == pytest.approx(rho, abs=5.1e-6)
        assert liquids.tait_modulus(p, modulus, 10.9) == pytest.approx(K * 1e6, abs=510)


def test_tait_in_an_oil_with_temperature():
    """The same from the numbers at 0 C, by thermal expansion and temperature coefficient of the modulus."""
    oil = Oil(
        bulk_modulus=8.4e9 * np.exp(-0.0058 * 273.15),
        density=870.0,
        modulus_slope=10.9,
        liquid=liquids.Tait(reference_pressure=0.0),
        temperature=293.15,
        reference_temperature=273.15,
        thermal_expansion=7.7e-4,
        modulus_temperature_coefficient=0.0058,
    )
    for p, rho, K in TAIT:
        assert oil.density_at(p) == pytest.approx(rho, abs=5.1e-6)
        assert oil.liquid_density(p) == pytest.approx(rho, abs=5.1e-6)
        assert oil.mixture_modulus(p) == pytest.approx(K * 1e6, abs=510)


def test_dowson_higginson():
    assert liquids.dowson_higginson_modulus(ATMOSPHERE, 0.6e-9, 1.7e-9) == pytest.approx(1.6667e9, abs=5e4)
    oil = Oil(1 / 0.6e-9, 850.0, modulus_slope=1 + 2 * 1.7 / 0.6, liquid=liquids.DowsonHigginson())
    for gauge, ratio, K in DOWSON_HIGGINSON:
        p = ATMOSPHERE + gauge
        assert 1 / liquids.dowson_higginson_volume(p, 0.6e-9, 1.7e-9) == pytest.approx(ratio, abs=5.1e-9)
        assert liquids.dowson_higginson_modulus(p, 0.6e-9, 1.7e-9) == pytest.approx(K * 1e6, rel=1e-6)
        assert oil.density_at(p) / 850 == pytest.approx(ratio, abs=5.1e-9)
        assert oil.mixture_modulus(p) == pytest.approx(K * 1e6, rel=1e-6)


def test_murnaghan_special_slopes():
    """Slope 0 is a constant modulus, 1 a density linear in pressure."""
    p = np.array([1e3, 1e5, 1e7, 1e8])
    gauge = (p - ATMOSPHERE) / 1.5e9
    np.testing.assert_allclose(liquids.murnaghan_volume(p, 1.5e9, 0.0), np.exp(-gauge), rtol=1e-15)
    np.testing.assert_allclose(liquids.murnaghan_volume(p, 1.5e9, 1.0), 1 / (1 + gauge), rtol=1e-15)
    np.testing.assert_array_equal(liquids.murnaghan_modulus(p, 1.5e9, 0.0), np.full(4, 1.5e9))


@pytest.mark.parametrize("law", LAWS)
def test_shared_numbers(law):
    """At the reference pressure every law has volume 1, the modulus and the slope that it was given."""
    this = LAWS[law]
    p = 0.0 if law == "Tait from zero" else ATMOSPHERE
    with jax.enable_x64(True):
        modulus, slope = jax.jvp(lambda x: this.modulus(x, 1.5e9, 9.0), (p,), (1.0,))
    assert this.volume(p, 1.5e9, 9.0) == 1.0
    assert float(modulus) == pytest.approx(1.5e9, rel=1e-14)
    assert float(slope) == pytest.approx(9.0, rel=1e-12)


@pytest.mark.parametrize("slope", [0.0, 1e-7, 1.0, 6.0, 12.0])
@pytest.mark.parametrize("law", LAWS)
def test_modulus_is_the_derivative_of_the_volume(law, slope):
    this = LAWS[law]
    with jax.enable_x64(True):
        p = np.array([1.0, 2e3, 1e5, 1e6, 1e7, 1e8])
        volume, change = jax.jvp(lambda x: this.volume(x, 1.5e9, slope), (p,), (np.ones(6),))
        np.testing.assert_allclose(-volume / change, this.modulus(p, 1.5e9, slope), rtol=1e-11)


@settings(max_examples=100, deadline=None)
@given(law=st.sampled_from(list(LAWS)), slope=st.floats(0, 15), p=st.floats(0, 1e8), step=st.floats(1.0, 1e8))
def test_density_and_modulus_grow(law, slope, p, step):
    this = LAWS[law]
    modulus = this.modulus(np.array([p, p + step]), 1.5e9, slope)
    volume = this.volume(np.array([p, p + step]), 1.5e9, slope)
    assert 0 < volume[1] < volume[0]
    if slope >= 1 or law == "Murnaghan":  # below 1, Tait's and Dowson-Higginson's moduli fall at last
        assert 0 < modulus[0] <= modulus[1] * (1 + 1e-13)
