"""Equations of state of liquids without air: volume and tangent modulus as functions of absolute pressure.

All laws share two natural numbers, the tangent bulk modulus K0 = -V dp/dV and its slope m = dK/dp, both at a
reference pressure, so that one law can take the place of another with the numbers of a fluid unchanged; they
differ in curvature only, which shows above some 50 MPa. A law gives the volume per unit volume at the
reference pressure; its modulus is the exact derivative of that. SI units, element by element.

A data sheet often states a secant modulus, p V0/(V0 - V): its slope is (m + 1)/2 where the tangent's is m.
"""

from abc import abstractmethod

import equinox as eqx

from jaxlines.physics.fields import ATMOSPHERE, Number, array_module, check_fields, quantity


def murnaghan_volume(p, modulus, slope, reference_pressure=ATMOSPHERE):
    """Volume of a liquid whose modulus is linear in pressure, relative to that at the reference pressure [-].

    v(p) = (1 + m (p - p0)/K0)^(-1/m);  m = 0: exp(-(p - p0)/K0);  m = 1: density linear in pressure.

    Args: p absolute [Pa]; modulus K0 at p0 [Pa]; slope m = dK/dp [-]; reference_pressure p0 [Pa].
    Validity: p - p0 > -K0/m; smooth in m through 0. Usual up to 100 MPa.
    Typical values: mineral oil K0 1.4e9..1.9e9 Pa, m 8..12; water 2.18e9 Pa, 6.
    Reference: Murnaghan, "The compressibility of media under extreme pressures", PNAS 30, 1944.
    """
    xp = array_module(p, modulus, slope, reference_pressure)
    compression = (p - reference_pressure) / modulus
    z = slope * compression
    small = xp.abs(z) < 1e-4
    series = 1.0 - z / 2.0 + z * z / 3.0 - z * z * z / 4.0
    safe = xp.where(small, 1.0, z)
    return xp.exp(-compression * xp.where(small, series, xp.log1p(safe) / safe))


def murnaghan_modulus(p, modulus, slope, reference_pressure=ATMOSPHERE):
    """Tangent modulus linear in pressure, K = K0 + m (p - p0) [Pa]. Arguments as for `murnaghan_volume`."""
    return modulus + slope * (p - reference_pressure)


def tait_volume(p, modulus, slope, reference_pressure=0.0):
    """Volume by Tait's equation relative to that at the reference pressure [-].

    v(p) = 1 - ln(1 + (1 + K0') (p - p_r)/K0)/(1 + K0')

    Args: p absolute [Pa]; modulus K0 at p_r [Pa]; slope K0' = dK/dp at p_r [-]; reference_pressure p_r [Pa], in
        the literature 0.
    Validity: liquids up to several 100 MPa, better than a linear modulus above 100 MPa.
    Typical values: mineral oil K0 1.5e9 Pa at 20 C, K0' 10.9.
    Reference: Dymond and Malhotra, "The Tait equation: 100 years on", Int. J. Thermophysics 9, 1988
        (unverified: quoted from memory); the parameters above are those of the open library OpenHydraulics.
    """
    xp = array_module(p, modulus, slope, reference_pressure)
    steepness = 1.0 + slope
    return 1.0 - xp.log1p(steepness * (p - reference_pressure) / modulus) / steepness


def tait_modulus(p, modulus, slope, reference_pressure=0.0):
    """Tangent modulus of Tait's equation, K = v (K0 + (1 + K0')(p - p_r)) [Pa]. Arguments as for `tait_volume`."""
    stiffening = modulus + (1.0 + slope) * (p - reference_pressure)
    return tait_volume(p, modulus, slope, reference_pressure) * stiffening


def dowson_higginson_volume(p, a, b, reference_pressure=ATMOSPHERE):
    """Volume by Dowson and Higginson relative to that at the reference pressure [-].

    v(p) = 1/(1 + a (p - p0)/(1 + b (p - p0)))

    Args: p absolute [Pa]; a, b [1/Pa]; reference_pressure p0 [Pa] (the literature counts p from atmosphere).
    Validity: fitted to mineral oil up to 400 MPa; density is at most (1 + a/b) of that at p0.
    Typical values: a 0.6e-9, b 1.7e-9 1/Pa, that is K0 1.67e9 Pa with slope 6.7.
    Reference: Dowson and Higginson, "Elasto-Hydrodynamic Lubrication", 1966 (unverified: quoted from memory).
    """
    gauge = p - reference_pressure
    return (1.0 + b * gauge) / (1.0 + (a + b) * gauge)


def dowson_higginson_modulus(p, a, b, reference_pressure=ATMOSPHERE):
    """Tangent modulus K = (1 + b p_g)(1 + (a + b) p_g)/a, p_g = p - p0 [Pa]; see `dowson_higginson_volume`."""
    gauge = p - reference_pressure
    return (1.0 + b * gauge) * (1.0 + (a + b) * gauge) / a


def dowson_higginson_parameters(modulus, slope):
    """The parameters (a, b) [1/Pa] that give a modulus K0 [Pa] and slope m [-]: a = 1/K0, b = (m - 1)/(2 K0)."""
    return 1.0 / modulus, 0.5 * (slope - 1.0) / modulus


class AbstractLiquid(eqx.Module):
    """How the volume of a liquid without air depends on pressure, given its modulus and slope."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def volume(self, p, modulus, slope) -> Number:
        """Volume relative to that at the reference pressure [-], at absolute pressure p [Pa]."""

    @abstractmethod
    def modulus(self, p, modulus, slope) -> Number:
        """Tangent modulus -v dp/dv [Pa] at absolute pressure p [Pa]."""


class Murnaghan(AbstractLiquid):
    """Modulus linear in pressure, constant where the slope is 0. See `murnaghan_volume`."""

    def volume(self, p, modulus, slope) -> Number:
        return murnaghan_volume(p, modulus, slope)

    def modulus(self, p, modulus, slope) -> Number:
        return murnaghan_modulus(p, modulus, slope)


class Tait(AbstractLiquid):
    """Tait's equation. See `tait_volume`.

    Args: reference_pressure: where modulus, slope and density of the fluid are stated [Pa absolute]. Like
        those of the other laws at 101325 Pa; 0 for parameters from the literature. (Air is then counted per
        volume of liquid at 0 instead of 101325 Pa: a difference of 1e-4 of itself.)
    """

    reference_pressure: Number = quantity(
        "Pa", low=0.0, high=1e6, slip="it is an absolute pressure", level=True, default=ATMOSPHERE
    )

    def volume(self, p, modulus, slope) -> Number:
        return tait_volume(p, modulus, slope, self.reference_pressure)

    def modulus(self, p, modulus, slope) -> Number:
        return tait_modulus(p, modulus, slope, self.reference_pressure)


class DowsonHigginson(AbstractLiquid):
    """The equation of Dowson and Higginson, with b = (m - 1)/(2 K0). See `dowson_higginson_volume`."""

    def volume(self, p, modulus, slope) -> Number:
        return dowson_higginson_volume(p, *dowson_higginson_parameters(modulus, slope))

    def modulus(self, p, modulus, slope) -> Number:
        return dowson_higginson_modulus(p, *dowson_higginson_parameters(modulus, slope))
