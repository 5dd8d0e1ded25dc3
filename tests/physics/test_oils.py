"""Named fluids: every number has a source, and what can be checked of them."""

import dataclasses

import numpy as np
import pytest

from jaxlines.catalogue import dsn70m
from jaxlines.catalogue.oils import OILS, PSI
from jaxlines.physics.fluids import Oil

DEFAULTS = {f.name: f.default for f in dataclasses.fields(Oil) if f.default is not dataclasses.MISSING}


@pytest.mark.parametrize("name", OILS)
def test_every_number_has_a_source(name):
    """Each field that differs from the default of `Oil` is listed."""
    oil, sources = OILS[name]
    differs = {
        f.name
        for f in dataclasses.fields(oil)
        if f.name not in DEFAULTS or not bool(getattr(oil, f.name) == DEFAULTS[f.name])
    }
    assert differs <= set(sources) <= {f.name for f in dataclasses.fields(oil)}
    assert all(len(text) > 20 for text in sources.values())


def test_the_fluids():
    assert set(OILS) == {
        "DSN 70-m antennas",
        "HLP 32",
        "HLP 46",
        "MIL-PRF-5606",
        "MIL-PRF-83282",
        "water",
        "water-glycol",
    }
    assert OILS["DSN 70-m antennas"].oil is dsn70m.OIL


@pytest.mark.parametrize(("name", "grade"), [("HLP 32", 32), ("HLP 46", 46)])
def test_mineral_oils(name, grade):
    """ISO grade at 40 C; modulus of Hayward's estimate with its viscosity at 20 C, 1 % close."""
    oil = OILS[name].oil
    assert oil.dynamic_viscosity() / oil.density_at(101325.0) == pytest.approx(grade * 1e-6, rel=1e-12)
    at_20 = oil.viscosity.kinematic(293.15, oil.kinematic_viscosity, oil.reference_temperature) * 1e6
    hayward = (1.57 + 0.15 * np.log10(at_20)) * 1e9
    cold = dataclasses.replace(oil, temperature=293.15)
    assert cold.mixture_modulus(101325.0) == pytest.approx(hayward, rel=0.01)
    secant_slope = 5.6  # Hayward's
    p = 20e6
    secant = p / (1 - cold.specific_volume(101325.0 + p))
    assert secant == pytest.approx(hayward + secant_slope * p, rel=0.01)


def test_mil_prf_83282_by_lees_charts():
    """Effective moduli with 2 % air: 240,000 psi at 500 psi and 60 F, 248,000 psi at 2000 psi and 160 F."""
    for psi, fahrenheit, expected in ((500, 60, 240e3), (2000, 160, 248e3)):
        oil = dataclasses.replace(
            OILS["MIL-PRF-83282"].oil,
            air_fraction=0.02,
            polytropic_index=1.0,
            temperature=(fahrenheit + 459.67) / 1.8,
        )
        assert oil.mixture_modulus(101325.0 + psi * PSI) / PSI == pytest.approx(expected, rel=0.1)


def test_water():
    """About 0.658 mm^2/s at 40 C, and the speed of sound of some 1480 m/s at 20 C."""
    water = OILS["water"].oil
    assert water.viscosity.kinematic(313.15, 1.0034e-6, 293.15) == pytest.approx(0.658e-6, rel=0.02)
    speed = np.sqrt(water.mixture_modulus(101325.0) / water.density_at(101325.0))
    assert speed == pytest.approx(1480, rel=0.01)
