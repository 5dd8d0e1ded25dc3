"""Air that dissolves, at equilibrium, frozen and with rates; vapour in the bubbles; against tabulated values."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.physics.air import DissolvingAir, FreeAir, KineticAir, LegacySimscapeAir, gas_modulus, gas_volume
from jaxlines.physics.fluids import Oil
from jaxlines.physics.solubility import (
    HenrySolubility,
    LinearSolubility,
    PolynomialSolubility,
    henry_saturation_pressure,
    linear_undissolved,
    polynomial_undissolved,
)

P0 = 101325.0
# Linear solubility up to 3 MPa, liquid 1.5 GPa, 1 % air, isothermal: p [MPa] -> K [MPa]
EQUILIBRIUM = {
    0.2: 37.0146,
    0.5: 204.2403,
    1.0: 579.5946,
    1.5: 879.1312,
    2.0: 1073.3613,
    2.5: 1195.6566,
    2.9: 1261.2809,
    3.1: 1500.0,
}
FROZEN = {0.5: 238.6, 1.0: 728.7, 2.0: 1324.6}
POLYNOMIAL = {0: 1, 0.1: 0.99910908, 0.25: 0.9510726929, 0.5: 0.5, 0.75: 0.04892730713, 0.9: 0.00089092, 1: 0}
LINEAR = LinearSolubility(3e6)


def oil(air, **changes) -> Oil:
    given: dict = {"bulk_modulus": 1.5e9, "density": 850.0, "air_fraction": 0.01, "polytropic_index": 1.0}
    return Oil(**given | changes, air=air)


def test_modulus_at_equilibrium():
    for p, K in EQUILIBRIUM.items():
        assert oil(DissolvingAir(LINEAR)).mixture_modulus(p * 1e6) / 1e6 == pytest.approx(K, abs=5.1e-5)


def test_modulus_frozen():
    for p, K in FROZEN.items():
        frozen = oil(DissolvingAir(LINEAR, "frozen"))
        assert frozen.mixture_modulus(p * 1e6) / 1e6 == pytest.approx(K, abs=0.051)
        equilibrium = oil(DissolvingAir(LINEAR))
        assert frozen.density_at(p * 1e6) == equilibrium.density_at(p * 1e6)
        # without a state, air with rates is frozen air
        assert oil(KineticAir(LINEAR)).mixture_modulus(p * 1e6) == frozen.mixture_modulus(p * 1e6)


def test_polynomial():
    x = np.array(list(POLYNOMIAL))
    seen = polynomial_undissolved(500.0 + x * (3e6 - 500.0), 3e6, 500.0)
    np.testing.assert_allclose(seen, list(POLYNOMIAL.values()), rtol=0, atol=5.1e-9)
    np.testing.assert_array_equal(polynomial_undissolved(np.array([0.0, 500.0, 3e6, 4e6]), 3e6, 500.0), [1, 1, 0, 0])


def test_dissolving_is_the_derivative():
    with jax.enable_x64(True):
        p = np.array([50.0, 2e3, 1e5, 1.1e5, 1e6, 2.99e6, 3e6, 5e6])
        for law in (LINEAR, PolynomialSolubility(3e6, 500.0), HenrySolubility(0.09)):
            _, slope = jax.jvp(lambda x: law.undissolved(x, 0.01), (p,), (np.ones(8),))  # noqa: B023
            np.testing.assert_allclose(law.dissolving(p, 0.01) + np.zeros(8), -slope, rtol=1e-9, atol=1e-20)


def test_saturation_pressures_of_henry():
    """Saturation pressure over p0 for 0.1, 1, 5 and 10 % air and a Bunsen coefficient of 0.09."""
    alpha = np.array([0.001, 0.01, 0.05, 0.10])
    seen = henry_saturation_pressure(alpha / (1 - alpha), 0.09) / P0
    np.testing.assert_allclose(seen, [1.011, 1.112, 1.585, 2.235], rtol=0, atol=5.1e-4)


@pytest.mark.parametrize("alpha", [0.0, 0.01, 0.1])
def test_henry_keeps_the_amount_of_air(alpha):
    """Bubbles and dissolved air (0.09 p/p0) together are the same at every pressure; at p0 bubbles are alpha."""
    fluid, ratio = oil(DissolvingAir(HenrySolubility(0.09)), air_fraction=alpha), alpha / (1 - alpha)
    p = np.array([2e3, 3e4, P0, 1.005 * henry_saturation_pressure(ratio, 0.09)])
    bubbles = (fluid.specific_volume(p) - oil(FreeAir(), air_fraction=0.0).specific_volume(p)) * p / P0
    np.testing.assert_allclose((bubbles + 0.09 * p / P0)[:3], ratio + 0.09, rtol=1e-12)
    assert bubbles[3] == pytest.approx(0.0, abs=1e-15)
    assert bubbles[2] == pytest.approx(ratio, abs=1e-15)
    assert fluid.air_content() == pytest.approx(ratio + 0.09)


@pytest.mark.parametrize(("p", "jump"), [(3e6, True), (P0, True)])
def test_corners_of_linear_solubility(p, jump):
    """Volume is continuous, its derivatives from below and above are those of the two sides."""
    fluid, step = oil(DissolvingAir(LINEAR)), 1.0
    v = fluid.specific_volume
    below, above = (v(p) - v(p - step)) / step, (v(p + step) - v(p)) / step
    dissolving = 1 / (3e6 - P0)
    ratio, liquid = 0.01 / 0.99, np.exp(-(p - P0) / 1.5e9)
    free = -liquid / 1.5e9 - (ratio * P0 / (p * p) if p == P0 else 0.0)
    with_dissolution = free - ratio * (P0 / p) * dissolving
    outer, inner = (below, above) if p == P0 else (above, below)
    assert outer == pytest.approx(free, rel=1e-4)
    assert inner == pytest.approx(with_dissolution, rel=1e-4)
    with jax.enable_x64(True):
        assert float(jax.grad(v)(p)) == pytest.approx(free, rel=1e-12)
    assert fluid.mixture_modulus(p) == pytest.approx(-v(p) / free, rel=1e-12)
    assert (fluid.mixture_modulus(p * 1.0001) / fluid.mixture_modulus(p * 0.9999) > 1.1) == (p == 3e6)


def test_rates_of_release_and_absorption():
    fluid = oil(KineticAir(LINEAR, release_time=0.5, absorption_time=40.0, transition=0.01))
    assert fluid.undissolved_rate(1e5, 0.4) == pytest.approx(0.6 / 0.5, rel=1e-12)
    assert fluid.undissolved_rate(5e6, 0.4) == pytest.approx(-0.4 / 40.0, rel=1e-12)
    at_rest = fluid.undissolved_air(1e6)
    assert at_rest == pytest.approx((3e6 - 1e6) / (3e6 - P0), rel=1e-14)
    assert fluid.undissolved_rate(1e6, at_rest) == 0.0
    with jax.enable_x64(True):  # smooth through the switch: the mean of both rates there
        slope = jax.grad(lambda x: fluid.undissolved_rate(1e6, x))(at_rest)
    assert float(slope) == pytest.approx(-0.5 * (1 / 0.5 + 1 / 40.0), rel=1e-12)
    assert oil(FreeAir()).undissolved_rate(1e6, 0.4) == 0.0


def test_hysteresis_of_kinetic_air():
    """Down to 0.2 MPa and back in 1 s, then rest: more air after than before, and at rest the old amount again."""
    fluid = oil(KineticAir(LINEAR, release_time=0.2, absorption_time=20.0))
    step, theta, seen = 0.01, float(fluid.undissolved_air(2e6)), {}
    for k in range(12000):
        t = k * step
        p = 2e6 - 1.8e6 * np.sin(np.pi * t) ** 2 if t < 1 else 2e6
        seen[k] = theta
        theta += step * float(fluid.undissolved_rate(p, theta))
    assert seen[100] > 1.5 * seen[0]
    assert fluid.mixture_modulus(1e6, seen[70]) < fluid.mixture_modulus(1e6, seen[30])  # softer in compression
    assert theta == pytest.approx(seen[0], rel=0.01)


@settings(max_examples=100, deadline=None)
@given(
    law=st.sampled_from([LINEAR, PolynomialSolubility(3e6, 500.0), HenrySolubility(0.09)]),
    alpha=st.floats(0, 0.3),
    p=st.floats(0, 1e7),
    theta=st.floats(0, 1),
)
def test_rates_stay_within_bounds(law, alpha, p, theta):
    """Towards equilibrium, never out of 0..1, between the slow and the fast rate."""
    fluid = oil(KineticAir(law, 0.5, 40.0), air_fraction=alpha)
    missing, rate = fluid.undissolved_air(p) - theta, fluid.undissolved_rate(p, theta)
    assert rate * missing >= 0
    assert abs(missing) / 40.0 * (1 - 1e-12) <= abs(rate) <= abs(missing) / 0.5 * (1 + 1e-12)
    assert fluid.undissolved_rate(p, 0.0) >= 0 >= fluid.undissolved_rate(p, 1.0)


def test_bubbles():
    """Halved at twice the pressure when isothermal; less when adiabatic; the modulus is -V dp/dV."""
    assert gas_volume(2 * P0, 1.0) == pytest.approx(0.5, rel=1e-15)
    assert gas_volume(2 * P0, 1.4) == pytest.approx(0.5 ** (1 / 1.4), rel=1e-15)
    assert gas_modulus(2e5, 1.4) == pytest.approx(2.8e5)
    with jax.enable_x64(True):
        for vapour in (0.0, 2339.0):
            volume, change = jax.jvp(lambda p: gas_volume(p, 1.3, vapour), (5e4,), (1.0,))  # noqa: B023
            assert -float(volume / change) == pytest.approx(float(gas_modulus(5e4, 1.3, vapour)), rel=1e-13)


def test_vapour_in_bubbles():
    """(p - p_v) V_g = const: nothing changes at p0, little above, and at p_v the volume has no bound."""
    air = FreeAir(vapour="in_bubbles")
    fluid, dry = oil(air, vapour_pressure=2339.0), oil(FreeAir(), vapour_pressure=2339.0)
    assert fluid.specific_volume(P0) == pytest.approx(dry.specific_volume(P0), rel=1e-15)
    assert fluid.mixture_modulus(1e7) == pytest.approx(dry.mixture_modulus(1e7), rel=5e-4)
    ratio = 0.01 / 0.99
    for above in (1e4, 1e2, 10.0):
        p = 2339.0 + above
        gas = ratio * (P0 - 2339.0) / above
        assert fluid.specific_volume(p) - np.exp(-(p - P0) / 1.5e9) == pytest.approx(gas, rel=1e-12)
    assert fluid.specific_volume(2340.0) > 500
    assert fluid.mixture_modulus(2349.0) == pytest.approx(10.0, rel=0.02)


def test_vapour_is_ignored_unless_asked_for():
    for law in (FreeAir(), DissolvingAir(LINEAR), KineticAir(LINEAR)):
        for p in (2e3, 1e5, 1e6):
            dry, wet = oil(law, vapour_pressure=0.0), oil(law, vapour_pressure=1500.0)
            assert dry.specific_volume(p) == wet.specific_volume(p)


def test_legacy_air_has_its_pressure_floor():
    fluid = oil(LegacySimscapeAir(pressure_floor=1e4), mass="article")
    r, K = 0.01 / 0.99 * P0 / 1e4, 1.5e9
    for p in (-1e5, 1e3, 1e4):
        assert fluid.mixture_modulus(p) == pytest.approx(K * (1 + r) / (1 + r * K / 1e4), rel=1e-14)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LinearSolubility(1e5), "saturation_pressure must be .* got 100000 Pa: it is absolute and above atmo"),
        (lambda: PolynomialSolubility(2e3, 1e4), "vapour_pressure_high must be below saturation_pressure"),
        (lambda: DissolvingAir(LINEAR, "slow"), 'convention must be "equilibrium" or "frozen", got \'slow\''),
        (lambda: FreeAir(vapour="yes"), 'vapour must be "ignored" or "in_bubbles", got \'yes\''),
        (lambda: LegacySimscapeAir(vapour="in_bubbles"), "LegacySimscapeAir knows no vapour pressure"),
        (lambda: KineticAir(LINEAR, release_time=0.0), "release_time must be .* got 0 s"),
        (
            lambda: oil(FreeAir(vapour="in_bubbles"), vapour_pressure=2e5),
            "vapour_pressure in bubbles must be below 101325 Pa, got 200000 Pa",
        ),
    ],
)
def test_wrong_calls(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_linear_law_on_its_own():
    np.testing.assert_allclose(linear_undissolved(np.array([1e3, P0, 3e6, 9e6]), 3e6), [1, 1, 0, 0])
    assert linear_undissolved(0.5 * (P0 + 3e6), 3e6) == pytest.approx(0.5)
