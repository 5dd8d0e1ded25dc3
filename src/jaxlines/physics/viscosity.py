"""Viscosity of liquids as a function of temperature and pressure.

A law says how viscosity changes with temperature from what it is at the reference temperature of the fluid;
the factor of Barus for pressure goes with each of them. SI units (the parameters of Walther's equation belong
to mm^2/s, as in the literature), element by element.
"""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from jaxlines.physics.fields import ATMOSPHERE, Number, array_module, check_fields, quantity

_CENTISTOKES = 1e-6  # [m^2/s]


def walther_viscosity(temperature, A, B):
    """Kinematic viscosity by Walther's equation (ASTM D341) [m^2/s].

    log10 log10(nu + 0.7) = A - B log10 T, with nu in mm^2/s and T in K

    Args: temperature T [K]; A, B [-].
    Validity: mineral oils, 2 to 2e7 mm^2/s, between pour point and some 150 C.
    Typical values: an oil of ISO VG 46 with viscosity index 100: A 9.32, B 3.65.
    Reference: ASTM D341, "Viscosity-Temperature Charts for Liquid Petroleum Products" (range of validity
        unverified: quoted from memory).
    """
    xp = array_module(temperature, A, B)
    ten = np.log(10.0).item()
    inner = xp.exp(ten * (A - B * xp.log(temperature) / ten))
    return (xp.exp(ten * inner) - 0.7) * _CENTISTOKES


def walther_parameters(temperature_1, viscosity_1, temperature_2, viscosity_2):
    """The parameters (A, B) [-] of Walther's equation through two kinematic viscosities [m^2/s] at T [K]."""
    xp = array_module(temperature_1, viscosity_1, temperature_2, viscosity_2)
    y_1, y_2 = (xp.log10(xp.log10(v / _CENTISTOKES + 0.7)) for v in (viscosity_1, viscosity_2))
    B = (y_1 - y_2) / xp.log10(temperature_2 / temperature_1)
    return y_1 + B * xp.log10(temperature_1), B


def vogel_viscosity(temperature, a, b, c):
    """Viscosity by Vogel's equation, nu = a exp(b/(T - c)), in the unit of a.

    Args: temperature T [K]; a [m^2/s] or [Pa s]; b [K]; c [K].
    Validity: well above c, where the liquid would freeze to a glass. Through the same two points, 40 C and 100 C,
        it is within 2 % of Walther's from 20 C on, and 10 % above it at 0 C.
    Typical values: mineral oil of ISO VG 46 b 810 K, c 178 K; water b 571 K, c 140 K (unverified: c of the oil
        and both of water quoted from memory).
    Reference: Vogel, Physikalische Zeitschrift 22, 1921 (unverified: quoted from memory).
    """
    return a * array_module(temperature, a, b, c).exp(b / (temperature - c))


def barus_factor(p, coefficient, reference_pressure=ATMOSPHERE):
    """By how much pressure thickens a liquid, mu/mu0 = exp(alpha (p - p0)) [-].

    Args: p absolute [Pa]; coefficient alpha [1/Pa]; reference_pressure p0 [Pa].
    Validity: up to some 100 MPa, above which it overstates.
    Typical values: mineral oil 1.5e-8..2.5e-8 1/Pa (unverified: quoted from memory): 1.5 at 20 MPa.
    Reference: Barus, "Isothermals, isopiestics and isometrics relative to viscosity", Am. J. Science 45, 1893
        (unverified: quoted from memory).
    """
    return array_module(p, coefficient, reference_pressure).exp(coefficient * (p - reference_pressure))


class AbstractViscosity(eqx.Module):
    """How kinematic viscosity depends on temperature, from what it is at the reference temperature."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def kinematic(self, temperature, reference_viscosity, reference_temperature) -> Number:
        """nu [m^2/s] at a temperature [K], given nu [m^2/s] at the reference temperature [K]."""


class ConstantViscosity(AbstractViscosity):
    """Kinematic viscosity that does not depend on temperature."""

    def kinematic(self, temperature, reference_viscosity, reference_temperature) -> Number:
        return reference_viscosity


class Walther(AbstractViscosity):
    """Walther's equation (ASTM D341) through the viscosity at the reference temperature. See `walther_viscosity`.

    Args: slope: B of the equation [-]; the less, the less viscosity depends on temperature.
    Typical values: mineral oil 3.5..3.8, high viscosity index 3.0 (unverified: quoted from memory).
    """

    slope: Number = quantity("1", low=0.0, high=10.0, default=3.65)

    @staticmethod
    def from_two_viscosities(temperature_1, viscosity_1, temperature_2, viscosity_2) -> "Walther":
        """The law through two kinematic viscosities [m^2/s] at temperatures [K].

        One of the two pairs is the fluid's reference_temperature and kinematic_viscosity.
        Raises: ValueError when the temperatures are equal or a viscosity is below 0.31e-6 m^2/s.
        """
        if temperature_1 == temperature_2:
            raise ValueError(f"two different temperatures are needed, got {temperature_1:g} K twice")
        if min(viscosity_1, viscosity_2) < 0.31e-6:
            lowest = min(viscosity_1, viscosity_2)
            raise ValueError(f"viscosities must be 3.1e-07 m^2/s or more, got {lowest:g} m^2/s")
        return Walther(walther_parameters(temperature_1, viscosity_1, temperature_2, viscosity_2)[1])

    def kinematic(self, temperature, reference_viscosity, reference_temperature) -> Number:
        # ln(nu + 0.7) = ln(nu_ref + 0.7) (T_ref/T)^B, which is the equation with A eliminated.
        xp = array_module(self, temperature, reference_viscosity, reference_temperature)
        share = xp.exp(-self.slope * xp.log(temperature / reference_temperature))
        return (xp.exp(share * xp.log(reference_viscosity / _CENTISTOKES + 0.7)) - 0.7) * _CENTISTOKES


class Vogel(AbstractViscosity):
    """Vogel's equation through the viscosity at the reference temperature. See `vogel_viscosity`.

    Args: b [K]; c [K], below every temperature that occurs.
    """

    b: Number = quantity("K", low=0.0, high=1e4, default=810.0)
    c: Number = quantity("K", low=0.0, high=400.0, slip="was it given in C?", default=178.0)

    def kinematic(self, temperature, reference_viscosity, reference_temperature) -> Number:
        a = reference_viscosity / vogel_viscosity(reference_temperature, 1.0, self.b, self.c)
        return vogel_viscosity(temperature, a, self.b, self.c)
