"""Viscosity against tabulated values, and what an oil makes of it."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.physics import viscosity
from jaxlines.physics.fluids import Oil

# Walther's equation with A 9.32 and B 3.65 (OpenHydraulics, about ISO VG 46): T [K] -> nu [mm^2/s]
WALTHER = {273.15: 471.1904, 293.15: 115.7018, 313.15: 41.3428, 333.15: 19.0371, 373.15: 6.4829}
TEMPERATURES = np.array(list(WALTHER))
VISCOSITIES = np.array(list(WALTHER.values())) * 1e-6
HALF_DIGIT = 5.1e-11


def test_walther_by_its_own_parameters():
    np.testing.assert_allclose(
        viscosity.walther_viscosity(TEMPERATURES, 9.32, 3.65), VISCOSITIES, rtol=0, atol=HALF_DIGIT
    )


def test_walther_from_two_viscosities():
    A, B = viscosity.walther_parameters(313.15, 41.3428e-6, 373.15, 6.4829e-6)
    assert pytest.approx(9.32, abs=1e-4) == A
    assert pytest.approx(3.65, abs=1e-4) == B
    law = viscosity.Walther.from_two_viscosities(313.15, 41.3428e-6, 373.15, 6.4829e-6)
    seen = law.kinematic(TEMPERATURES, 41.3428e-6, 313.15)
    np.testing.assert_allclose(seen, VISCOSITIES, rtol=2e-5)


def test_walther_in_an_oil():
    for temperature, nu in WALTHER.items():
        oil = Oil(
            1.5e9, 870.0, kinematic_viscosity=41.3428e-6, viscosity=viscosity.Walther(3.65), temperature=temperature
        )
        assert oil.dynamic_viscosity() == pytest.approx(870 * nu * 1e-6, rel=4e-6)


def test_vogel():
    """Through its two points exactly; with a typical c within 2 % of Walther's from 20 C to 100 C, 11 % at 0 C."""
    c = 178.0
    b = np.log(41.3428 / 6.4829) / (1 / (313.15 - c) - 1 / (373.15 - c))
    law = viscosity.Vogel(b=b, c=c)
    seen = law.kinematic(TEMPERATURES, 41.3428e-6, 313.15)
    np.testing.assert_allclose(seen[[2, 4]], VISCOSITIES[[2, 4]], rtol=1e-12)
    np.testing.assert_allclose(seen[1:], VISCOSITIES[1:], rtol=0.02)
    assert seen[0] / VISCOSITIES[0] == pytest.approx(1.1, abs=0.01)
    a = 41.3428e-6 / np.exp(b / (313.15 - c))
    np.testing.assert_allclose(viscosity.vogel_viscosity(TEMPERATURES, a, b, c), seen, rtol=1e-12)


def test_barus():
    """Times 1.49 for 20 MPa at 2e-8 1/Pa; temperature and pressure multiply."""
    assert viscosity.barus_factor(101325.0 + 20e6, 2e-8) == pytest.approx(1.49, abs=0.005)
    oil = Oil(1.5e9, 870.0, 41.3428e-6, viscosity=viscosity.Walther(3.65), viscosity_pressure_coefficient=2e-8)
    assert oil.dynamic_viscosity() == pytest.approx(870 * 41.3428e-6, rel=1e-14)
    assert oil.dynamic_viscosity(101325.0 + 20e6) == pytest.approx(870 * 41.3428e-6 * np.exp(0.4), rel=1e-13)


def test_constant_by_default():
    oil = Oil(1.4e9, 850.0, 30e-6)
    assert oil.dynamic_viscosity() == 30e-6 * 850.0
    assert oil.dynamic_viscosity(2e7) == 30e-6 * 850.0


def warm(law, thermal_expansion=7e-4):
    return lambda numbers: Oil(
        1.5e9,
        870.0,
        numbers[0],
        viscosity=law(numbers[1]),
        temperature=numbers[2],
        reference_temperature=numbers[3],
        thermal_expansion=thermal_expansion,
        viscosity_pressure_coefficient=numbers[4],
    ).dynamic_viscosity(numbers[5])


@pytest.mark.parametrize("law", [viscosity.Walther, lambda b: viscosity.Vogel(b=200 * b)], ids=["Walther", "Vogel"])
def test_gradients(law):
    """In every number, at the reference temperature too."""
    function = warm(law)
    with jax.enable_x64(True):
        for temperature in (313.15, 293.0, 353.0):
            at = np.array([46e-6, 3.6, temperature, 313.15, 2e-8, 1.5e7])
            exact = np.asarray(jax.jacfwd(function)(at))
            steps = np.diag(1e-4 * at)
            central = np.array([(function(at + h) - function(at - h)) / (2 * h.max()) for h in steps])
            np.testing.assert_allclose(exact * at, central * at, rtol=1e-6, atol=1e-8)


@settings(max_examples=100, deadline=None)
@given(
    slope=st.floats(2.0, 5.0),
    nu=st.floats(2e-6, 1e-3),
    temperature=st.floats(250.0, 400.0),
    step=st.floats(0.1, 50.0),
)
def test_warmer_is_thinner(slope, nu, temperature, step):
    law = viscosity.Walther(slope)
    cold, hot = law.kinematic(np.array([temperature, temperature + step]), nu, 313.15)
    assert hot < cold


def test_wrong_calls():
    with pytest.raises(ValueError, match="two different temperatures are needed, got 313"):
        viscosity.Walther.from_two_viscosities(313.15, 46e-6, 313.15, 7e-6)
    with pytest.raises(ValueError, match=r"viscosities must be 3\.1e-07 m\^2/s or more, got 1e-07"):
        viscosity.Walther.from_two_viscosities(313.15, 1e-7, 373.15, 5e-7)
    with pytest.raises(ValueError, match=r"temperature must be 150\.\.700 K, got 40 K: was it given in C"):
        Oil(1.5e9, 870.0, temperature=40.0)
