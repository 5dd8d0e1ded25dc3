"""Oil with every law of liquid, air and viscosity: exact derivatives, consistency, the same on host and in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.physics.air import DissolvingAir, FreeAir, KineticAir, LegacySimscapeAir
from jaxlines.physics.fluids import Oil
from jaxlines.physics.liquids import DowsonHigginson, Tait
from jaxlines.physics.solubility import HenrySolubility, LinearSolubility, PolynomialSolubility
from jaxlines.physics.viscosity import Vogel, Walther

WARM: dict = {
    "temperature": 330.0,
    "thermal_expansion": 7e-4,
    "modulus_temperature_coefficient": 0.0058,
    "viscosity_pressure_coefficient": 2e-8,
}
SMOOTH = PolynomialSolubility(3e6, 500.0)


def mixed(**changes) -> Oil:
    """An oil with air, linear modulus, off its reference temperature, with vapour pressure far from 0."""
    given: dict = {
        "bulk_modulus": 1.5e9,
        "density": 850.0,
        "air_fraction": 0.01,
        "modulus_slope": 9.0,
        "vapour_pressure": 1200.0,
    } | WARM
    return Oil(**given | changes)


OILS = {
    "free air": mixed(),
    "zero air": mixed(air_fraction=0.0),
    "constant modulus": mixed(modulus_slope=0.0),
    "Tait": mixed(liquid=Tait()),
    "Dowson-Higginson": mixed(liquid=DowsonHigginson()),
    "vapour": mixed(air=FreeAir(vapour="in_bubbles")),
    "vapour, zero air": mixed(air=FreeAir(vapour="in_bubbles"), air_fraction=0.0),
    "linear": mixed(air=DissolvingAir(LinearSolubility(3e6))),
    "linear, zero air": mixed(air=DissolvingAir(LinearSolubility(3e6)), air_fraction=0.0),
    "polynomial": mixed(air=DissolvingAir(SMOOTH)),
    "polynomial, vapour": mixed(air=DissolvingAir(SMOOTH, vapour="in_bubbles")),
    "Henry": mixed(air=DissolvingAir(HenrySolubility(0.09))),
    "Henry, zero air": mixed(air=DissolvingAir(HenrySolubility(0.09)), air_fraction=0.0),
    "frozen": mixed(air=DissolvingAir(SMOOTH, "frozen")),
    "kinetic": mixed(air=KineticAir(SMOOTH, 0.4, 20.0, vapour="in_bubbles")),
    "kinetic, Henry": mixed(air=KineticAir(HenrySolubility(0.09), 0.4, 20.0)),
    "legacy": mixed(air=LegacySimscapeAir(), mass="article"),
    "Walther": mixed(viscosity=Walther(3.6)),
    "Vogel": mixed(viscosity=Vogel(800.0, 178.0), mass="article"),
}
POINTS = np.array([2e3, 2.5e3, 6e4, 1.5e5, 1e6, 2.9e6, 3e6, 2e7])
"""Near vapour pressure, about atmospheric pressure, and up to and at saturation [Pa]."""


def everything(fluid: Oil, p, undissolved):
    """All that an oil says at a pressure."""
    theta = undissolved if fluid.air.kinetic else None
    said = [
        fluid.specific_volume(p, theta),
        fluid.mixture_modulus(p, theta),
        fluid.density_at(p, theta),
        fluid.liquid_density(p),
        fluid.undissolved_rate(p, undissolved),
        fluid.undissolved_air(p),
        fluid.gas_volume(p),
        fluid.dynamic_viscosity(p),
    ]
    return array_of(said)


def array_of(said):
    xp = jnp if any(isinstance(x, jax.Array) for x in said) else np
    return xp.stack(xp.broadcast_arrays(*said))


def corner(name: str, p) -> bool:
    """Whether the law has a corner at this pressure."""
    return name.startswith("linear") and p == 3e6


@pytest.mark.parametrize("name", OILS)
def test_derivatives_in_every_number_and_in_pressure(name):
    """Against differences of fourth order, to 1e-6 of the largest term of each result; values of host and JAX agree."""
    leaves, structure = jax.tree.flatten((OILS[name], np.asarray(1e6), np.asarray(0.6)))

    def function(x):
        return everything(*jax.tree.unflatten(structure, list(x)))

    h, largest = 2e-4, np.abs(everything(OILS[name], POINTS, 0.6)).max(axis=1)
    with jax.enable_x64(True):
        both = jax.jit(lambda x: (function(x), jax.jacfwd(function)(x)))
        for p in POINTS:
            if corner(name, p):
                continue
            at = np.array([*leaves[:-2], p, leaves[-1]])
            size = np.where(at == 0.0, 1e-3, np.abs(at))
            size[3] = max(at[3], 1e-9)  # a trace of air is much at 2 kPa
            low2, low, high, high2 = (function(at[:, None] + k * h * np.diag(size)) for k in (-2, -1, 1, 2))
            central = (8 * (high - low) - (high2 - low2)) / (12 * h)
            value, jacobian = both(at)
            exact = np.asarray(jacobian) * size
            allowed = 1e-6 * np.max(np.abs(exact), axis=1) + 2e-11 * largest  # the rest is rounding
            np.testing.assert_allclose(value, function(at), rtol=2e-12, atol=1e-14)
            assert np.all(np.isfinite(exact)), p
            assert np.all(np.abs(exact - central) <= allowed[:, None]), (p, np.abs(exact - central).max(axis=1))


@pytest.mark.parametrize("name", [n for n in OILS if n not in ("legacy", "frozen") and not n.startswith("kinetic")])
def test_modulus_density_and_volume_agree(name):
    """K = -v dp/dv = rho dp/drho, at corners too, where both take the same side."""
    fluid = OILS[name]
    with jax.enable_x64(True):
        volume, change = jax.jvp(fluid.specific_volume, (POINTS,), (np.ones(8),))
        np.testing.assert_allclose(-volume / change, fluid.mixture_modulus(POINTS), rtol=1e-10)
        if fluid.mass == "conserved":
            density, change = jax.jvp(fluid.density_at, (POINTS,), (np.ones(8),))
            np.testing.assert_allclose(density / change, fluid.mixture_modulus(POINTS), rtol=1e-10)


@pytest.mark.parametrize("name", ["kinetic", "kinetic, Henry"])
def test_volume_and_modulus_of_a_kinetic_air(name):
    """K at constant theta, and gas_volume = dv/dtheta."""
    fluid, p = OILS[name], POINTS
    with jax.enable_x64(True):
        volume, change = jax.jvp(lambda x: fluid.specific_volume(x, 0.6), (p,), (np.ones(8),))
        np.testing.assert_allclose(-volume / change, fluid.mixture_modulus(p, 0.6), rtol=1e-10)
        _, slope = jax.jvp(lambda x: fluid.specific_volume(p, x), (np.full(8, 0.6),), (np.ones(8),))
        np.testing.assert_allclose(slope, fluid.gas_volume(p), rtol=1e-14)
    at_rest = fluid.specific_volume(p, fluid.undissolved_air(p))
    np.testing.assert_allclose(fluid.specific_volume(p), at_rest, rtol=1e-15)


@pytest.mark.parametrize("name", OILS)
def test_on_the_host_an_array_of_pressures_is_as_one_by_one(name):
    host = everything(OILS[name], POINTS, 0.6)
    assert isinstance(host, np.ndarray) and host.dtype == np.float64
    one_by_one = np.stack([everything(OILS[name], p, 0.6) for p in POINTS], axis=1)
    np.testing.assert_allclose(host, one_by_one, rtol=1e-15)


@pytest.mark.parametrize("name", OILS)
def test_trial_steps_below_zero_are_finite(name):
    p = np.array([-1e6, -1.0, 0.0, 1.0, 100.0, 1200.0])
    with jax.enable_x64(True):
        value, slope = jax.jvp(lambda x: everything(OILS[name], x, 0.6), (p,), (np.ones(6),))
    assert np.all(np.isfinite(value)) and np.all(np.isfinite(slope))
    assert np.all(np.asarray(value)[:4] > 0)


@settings(max_examples=200, deadline=None)
@given(
    name=st.sampled_from([n for n in OILS if n != "legacy"]),
    air=st.floats(0, 0.3),
    index=st.floats(1.0, 1.4),
    p=st.floats(2e3, 5e7),
    step=st.floats(1e-3, 1.0),
)
def test_modulus_is_positive_and_density_grows_with_every_law(name, air, index, p, step):
    """At equilibrium the modulus may dip, but never to zero."""
    template = OILS[name]
    fluid = mixed(air_fraction=air, polytropic_index=index, air=template.air, liquid=template.liquid)
    assert 0 < fluid.mixture_modulus(p) <= fluid.liquid_modulus(p) * (1 + 1e-12)
    assert 0 < fluid.mixture_modulus(p, 0.3) <= fluid.liquid_modulus(p) * (1 + 1e-12)
    assert 0 < fluid.density_at(p) < fluid.density_at(p * (1 + step))
    assert 0 <= fluid.undissolved_air(p * (1 + step)) <= fluid.undissolved_air(p) <= 1
