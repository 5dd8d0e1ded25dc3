"""Oil against tabulated values and against its own derivatives.

The tables follow from v(p) = v_l + R (p0/p)^(1/n) and K = -v dp/dv with a constant or a linear liquid modulus
(Cho, Lee and Oh 2002 where it is constant); they were computed independently of this code.
"""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines import Oil
from jaxlines.physics.air import LegacySimscapeAir

PRESSURES = np.array([0.101325, 0.2, 0.5, 1, 2, 5, 10, 20, 35]) * 1e6

# (modulus slope, polytropic index, air fraction): modulus of the mixture [MPa]; liquid 1.5 GPa
MODULI = {
    (0, 1, 0.001): "94.9196 312.4150 932.6073 1301.9546 1445.0444 1490.9277 1497.7216 1499.4298 1499.8138",
    (0, 1, 0.005): "19.9962 74.8349 370.2140 850.6702 1259.5756 1455.5407 1488.6321 1497.1419 1499.0657",
    (0, 1, 0.01): "10.0652 38.2822 210.4393 592.0540 1084.1409 1413.2385 1477.3241 1494.2661 1498.1232",
    (0, 1, 0.05): "2.0239 7.6618 45.9313 167.4790 500.9394 1136.7010 1388.9618 1470.6029 1490.2733",
    (0, 1, 0.10): "1.0126 3.7438 22.3688 84.7541 288.5767 896.0958 1283.5118 1439.2796 1479.6162",
    (0, 1.4, 0.005): "27.8469 85.6650 338.0694 732.4428 1136.8803 1406.6506 1470.3012 1490.8477 1496.4953",
    (0, 1.4, 0.01): "14.0539 44.0091 189.9346 483.1872 913.7208 1323.5051 1441.4837 1481.7177 1492.9723",
    (10, 1, 0.01): "10.0652 38.2829 210.5175 593.4482 1094.0219 1456.6356 1573.2397 1691.6287 1846.1297",
    (10, 1.4, 0.01): "14.0539 44.0099 189.9982 484.1146 920.7257 1361.4803 1532.6394 1675.5373 1838.2776",
}
RELATIVE_DENSITY = "1 1.00502399 1.00830500 1.00967236 1.01086243 1.01319710 1.01668408 1.02353699 1.03384637"
DIGIT = 5e-5  # half of the last digit of the modulus table [MPa]


def oil(**changes) -> Oil:
    given: dict = {"bulk_modulus": 1.5e9, "density": 850.0}
    return Oil(**given | changes)


def numbers(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()])


@pytest.mark.parametrize("case", MODULI, ids=str)
def test_modulus_of_the_mixture(case):
    slope, index, air = case
    fluid = oil(modulus_slope=slope, polytropic_index=index, air_fraction=air)
    error = np.abs(fluid.mixture_modulus(PRESSURES) / 1e6 - numbers(MODULI[case]))
    assert np.all(error <= np.maximum(1e-6 * numbers(MODULI[case]), 1.01 * DIGIT))


def test_density_row():
    fluid = oil(air_fraction=0.01, polytropic_index=1.0)
    ratio = fluid.density_at(PRESSURES) / fluid.density_at(101325.0)
    np.testing.assert_allclose(ratio, numbers(RELATIVE_DENSITY), atol=6e-9, rtol=0)


@pytest.mark.parametrize("slope", [0.0, 1e-7, 6.0, 10.0])
@pytest.mark.parametrize("air", [0.0, 0.01])
def test_modulus_is_the_derivative_of_the_specific_volume(slope, air):
    fluid = oil(modulus_slope=slope, air_fraction=air)
    with jax.enable_x64(True):
        for p in PRESSURES:
            volume, change = jax.jvp(fluid.specific_volume, (p,), (1.0,))
            np.testing.assert_allclose(-volume / change, fluid.mixture_modulus(p), rtol=1e-11)


def test_without_air_the_liquid_is_exact():
    fluid = oil(air_fraction=0.0)
    np.testing.assert_array_equal(fluid.mixture_modulus(PRESSURES), np.full(9, 1.5e9))
    np.testing.assert_allclose(fluid.density_at(PRESSURES), 850 * np.exp((PRESSURES - 101325) / 1.5e9), rtol=1e-15)
    murnaghan = oil(modulus_slope=10.0).density_at(PRESSURES)
    np.testing.assert_allclose(murnaghan, 850 * (1 + 10 * (PRESSURES - 101325) / 1.5e9) ** 0.1, rtol=1e-14)


def test_gradient_at_zero_air_is_the_limit():
    with jax.enable_x64(True):
        slope = jax.grad(lambda air: oil(air_fraction=air).mixture_modulus(2e6))(0.0)
        step = (oil(air_fraction=1e-7).mixture_modulus(2e6) - 1.5e9) / 1e-7
    np.testing.assert_allclose(slope, step, rtol=1e-3)


def test_article_oil_has_constant_density():
    fluid = oil(mass="article", air_fraction=0.01)
    np.testing.assert_array_equal(fluid.density_at(PRESSURES), np.full(9, 850.0))


def test_temperature():
    """K0 exp(-c (T - T_r)) and rho/(1 + a (T - T_r))."""
    warm: dict = {"temperature": 330.0, "thermal_expansion": 7e-4, "modulus_temperature_coefficient": 0.0058}
    fluid = oil(**warm)
    assert fluid.mixture_modulus(1e7) == pytest.approx(1.5e9 * np.exp(-0.0058 * 16.85), rel=1e-13)
    assert fluid.density_at(101325.0) == pytest.approx(850 / (1 + 7e-4 * 16.85), rel=1e-14)
    assert oil(mass="article", **warm).density_at(1e7) == pytest.approx(850 / (1 + 7e-4 * 16.85), rel=1e-14)


@settings(max_examples=200, deadline=None)
@given(
    air=st.floats(0, 0.3),
    index=st.floats(1.0, 1.4),
    slope=st.floats(0, 15),
    p=st.floats(1e3, 5e7),
    step=st.floats(1e-3, 1.0),
)
def test_modulus_and_density_grow_with_pressure(air, index, slope, p, step):
    fluid = oil(air_fraction=air, polytropic_index=index, modulus_slope=slope)
    low, high = fluid.mixture_modulus(p), fluid.mixture_modulus(p * (1 + step))
    assert 0 < low <= high * (1 + 1e-12)
    assert low <= fluid.liquid_modulus(p) * (1 + 1e-12)
    assert 0 < fluid.density_at(p) < fluid.density_at(p * (1 + step))


def test_lee_chart_within_ten_percent():
    """Chart of the Lee Company for MIL-H-83282 with 2 % air: share of the air-free modulus at two gauge pressures."""
    fluid = oil(bulk_modulus=2.07e9, air_fraction=0.02, polytropic_index=1.0)
    for gauge_psi, ratio in ((500, 0.80), (2000, 0.98)):
        p = 101325 + gauge_psi * 6894.757
        assert fluid.mixture_modulus(p) / fluid.liquid_modulus(p) == pytest.approx(ratio, rel=0.1)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("bulk_modulus", 1.4e4, r"bulk_modulus must be 1e\+08\.\.1e\+11 Pa, got 14000 Pa: was it given in bar"),
        ("density", 0.85, r"density must be 100\.\.3000 kg/m\^3, got 0\.85 kg/m\^3: was it given in g/cm\^3"),
        ("kinematic_viscosity", 27.7, r"kinematic_viscosity must be .* got 27\.7 m\^2/s: was it given in mm\^2/s"),
        ("air_fraction", 1.0, r"air_fraction must be 0\.\.0\.5, got 1: was it given in percent"),
        ("air_fraction", -1e-3, r"air_fraction must be 0\.\.0\.5, got -0\.001"),
        ("bulk_modulus", float("nan"), "bulk_modulus must be .* got nan Pa"),
        ("temperature", 40.0, r"temperature must be 150\.\.700 K, got 40 K: was it given in C"),
        ("viscosity_pressure_coefficient", 20.0, r"viscosity_pressure_coefficient must be .* was it given in 1/GPa"),
        ("air", LegacySimscapeAir(), 'air law LegacySimscapeAir needs mass="article": it holds the volume of the liq'),
        ("mass", "volume", 'mass must be "conserved" or "article", got \'volume\''),
    ],
)
def test_wrong_numbers_are_refused(field, value, message):
    with pytest.raises(ValueError, match=message):
        oil(**{field: value})


def test_text_is_refused():
    with pytest.raises(TypeError, match=r"expected a number in SI units, got the text '1\.5 GPa'"):
        oil(bulk_modulus="1.5 GPa")
