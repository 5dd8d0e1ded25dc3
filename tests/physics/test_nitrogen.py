"""The gas of accumulators against a reference equation of state and its own thermodynamics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.physics.nitrogen import IdealGas, Nitrogen, density_of, isentropic_stiffness, nitrogen_heat_capacity

NITROGEN = Nitrogen()
# Temperature [K], pressure [Pa]: density [kg/m^3], c_v [J/(kg K)], isentropic stiffness rho a^2 [Pa] by CoolProp 8.0.0.
COOLPROP = {
    (273.15, 5e06): (62.6464, 757.436, 7.48454e06),
    (273.15, 1e07): (125.248, 770.105, 1.64102e07),
    (273.15, 2e07): (238.62, 789.078, 4.09059e07),
    (273.15, 3e07): (327.525, 802.733, 7.52743e07),
    (300, 5e06): (56.3445, 754.657, 7.44165e06),
    (300, 1e07): (111.725, 764.863, 1.60925e07),
    (300, 2e07): (212.537, 781.13, 3.85636e07),
    (300, 3e07): (294.781, 793.721, 6.88215e07),
    (350, 5e06): (47.6684, 752.598, 7.37825e06),
    (350, 1e07): (93.741, 760.002, 1.57017e07),
    (350, 2e07): (178.031, 772.643, 3.5996e07),
    (350, 3e07): (249.68, 783.233, 6.17359e07),
}
densities, temperatures = st.floats(1.0, 350.0), st.floats(250.0, 450.0)


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def test_densities_at_300_kelvin():
    pressures = np.array([5e6, 1e7, 2e7, 3e7])
    np.testing.assert_allclose(density_of(NITROGEN, pressures, 300.0), [56.427, 111.916, 213.096, 296.550], atol=6e-4)


def test_as_a_reference_equation_of_state():
    error = {}
    for (temperature, pressure), (density, capacity, stiffness) in COOLPROP.items():
        found = (
            density_of(NITROGEN, pressure, temperature),
            nitrogen_heat_capacity(density, temperature),
            isentropic_stiffness(NITROGEN, density, temperature),
        )
        error[temperature, pressure] = np.abs(np.array(found) / (density, capacity, stiffness) - 1)
    worst = np.max(list(error.values()), axis=0)
    assert np.all(worst < [0.00852, 0.0224, 0.0245])
    assert np.argmax([e[0] for e in error.values()]) == list(COOLPROP).index((273.15, 3e7))


@jax.jit
def closed_and_automatic(gas, density, temperature):
    """dp/drho, dp/dT and -(rho^2/T) dc_v/drho as the gas gives them, and as they follow from its pressure."""
    slope = jax.grad(lambda d: jnp.asarray(gas.heat_capacity(d, temperature)))(density)
    given = (gas.pressure_by_density(density, temperature), gas.pressure_by_temperature(density, temperature))
    derived = jax.grad(gas.pressure, (0, 1))(density, temperature)
    curvature = jax.grad(jax.grad(gas.pressure, 1), 1)(density, temperature)
    return jnp.stack([*given, -(density**2) / temperature * slope]), jnp.stack([*derived, curvature])


@settings(max_examples=50, deadline=None)
@given(densities, temperatures)
def test_derivatives(density, temperature):
    for gas in (NITROGEN, IdealGas()):
        given, derived = closed_and_automatic(gas, density, temperature)
        np.testing.assert_allclose(given, derived, rtol=1e-9, atol=1e-9)


@jax.jit
def root_and_slopes(pressure, temperature):
    """Density, its pressure, and d density as Newton's steps give it and as the implicit function has it."""
    density = density_of(NITROGEN, pressure, temperature)
    slopes = jax.grad(lambda p, t: density_of(NITROGEN, p, t), (0, 1))(pressure, temperature)
    by_pressure = 1 / NITROGEN.pressure_by_density(density, temperature)
    expected = by_pressure, -NITROGEN.pressure_by_temperature(density, temperature) * by_pressure
    return NITROGEN.pressure(density, temperature), jnp.stack(slopes), jnp.stack(expected)


@settings(max_examples=50, deadline=None)
@given(st.floats(1e5, 6e7), temperatures)
def test_density_is_the_root_with_its_derivatives(pressure, temperature):
    found, slopes, expected = root_and_slopes(pressure, temperature)
    assert float(found) == pytest.approx(pressure, rel=1e-12)
    np.testing.assert_allclose(slopes, expected, rtol=1e-8)


def test_thin_nitrogen_is_an_ideal_gas():
    gas = IdealGas()
    assert density_of(NITROGEN, 1e4, 300.0) == pytest.approx(density_of(gas, 1e4, 300.0), rel=1e-4)
    assert NITROGEN.heat_capacity(0.01, 300.0) == pytest.approx(gas.heat_capacity(0.01, 300.0), rel=2e-3)
    assert isentropic_stiffness(gas, 12.0, 300.0) == pytest.approx(1.4 * gas.pressure(12.0, 300.0), rel=1e-14)
    assert density_of(gas, 1e7, 300.0) == pytest.approx(1e7 / (296.8 * 300.0), rel=1e-15)


def test_wrong_gases_are_refused():
    with pytest.raises(ValueError, match=r"gas_constant must be .* got 8.314 J"):
        IdealGas(8.314)
    with pytest.raises(ValueError, match=r"heat_ratio must be .* got 1$"):
        IdealGas(heat_ratio=1.0)
