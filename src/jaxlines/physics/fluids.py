"""Hydraulic oil with entrained free air: density and bulk modulus as functions of absolute pressure."""

import equinox as eqx

from jaxlines.physics.fields import ATMOSPHERE, Number, array_module, check_fields, quantity

GAS_DENSITY = 1.204
"""Density of dry air at 101325 Pa and 293.15 K [kg/m^3] (ideal gas, R = 287.05 J/(kg K))."""

_PRESSURE_FLOOR = 1.0
# The gas law has no value at p <= 0. Only a rejected trial step of the solver can get there, since a volume
# with air grows infinitely compliant as p -> 0; the floor keeps such a trial finite so it can be rejected.


class Oil(eqx.Module):
    """A liquid whose bulk modulus is constant or linear in pressure, with entrained free air.

    Per unit volume of liquid at p0 = 101325 Pa, with R = air_fraction / (1 - air_fraction):

        liquid           v_l(p) = (1 + m (p - p0)/K0)^(-1/m)       (m -> 0: exp(-(p - p0)/K0))
        with air         v(p)   = v_l + R (p0/p)^(1/n)
        density          rho(p) = (rho_l0 + R rho_air)/v
        bulk modulus     K(p)   = v / (v_l/K_l + (R/(n p)) (p0/p)^(1/n)),   K_l = K0 + m (p - p0)

    Args:
        bulk_modulus: K0, tangent modulus of the air-free liquid at p0 [Pa]. For fast events give the
            isentropic one, for slow filling the isothermal one (about 15 % lower).
        density: rho_l0, of the air-free liquid at p0 [kg/m^3].
        kinematic_viscosity: nu [m^2/s].
        air_fraction: volume of free air per volume of MIXTURE at p0 [-]; 0 is legal and exact.
        polytropic_index: n of the air [-]: 1 isothermal (slow, small bubbles) to 1.4 adiabatic.
        modulus_slope: m = dK_l/dp [-]; 0 is a constant modulus.
        vapour_pressure: [Pa]; below it an air-free liquid would be in tension, which is reported.
        atmospheric_pressure: what gauge pressures are relative to [Pa].
        mass: "conserved" (default), or "article": constant density, so that eq. (8) of the article holds
            exactly in volume flows (mass is then not conserved where the modulus varies).

    Validity: compression of air only, no dissolution. Pressures above 0 when there is air.
    Typical values: mineral oil K0 1.4e9..1.9e9 Pa, m 8..12, density 860, nu 32e-6..46e-6 at 40 C, air
    0.005..0.02. The oil of the DSN antennas: 1.379e9 Pa, 850 kg/m^3, 27.7e-6 m^2/s.
    Reference: with m = 0, Cho, Lee and Oh, "Estimation technique of air content in automatic transmission
    fluid by measuring effective bulk modulus", Int. J. Automotive Technology 3(2), 2002; Murnaghan, "The
    compressibility of media under extreme pressures", PNAS 30, 1944, for v_l.
    """

    bulk_modulus: Number = quantity("Pa", low=1e8, high=1e11, slip="was it given in bar or MPa?")
    density: Number = quantity("kg/m^3", low=100.0, high=3000.0, slip="was it given in g/cm^3?")
    kinematic_viscosity: Number = quantity(
        "m^2/s", low=1e-8, high=1e-2, slip="was it given in mm^2/s (cSt)?", default=30e-6
    )
    air_fraction: Number = quantity("1", low=0.0, high=0.5, slip="was it given in percent?", default=0.0)
    polytropic_index: Number = quantity("1", low=0.9, high=1.7, default=1.2)
    modulus_slope: Number = quantity("1", low=0.0, high=30.0, default=0.0)
    vapour_pressure: Number = quantity(
        "Pa", low=0.0, high=1e6, slip="it is an absolute pressure", level=True, default=100.0
    )
    atmospheric_pressure: Number = quantity(
        "Pa", low=3e4, high=1.2e5, slip="was it given in bar or hPa?", level=True, default=ATMOSPHERE
    )
    mass: str = eqx.field(static=True, default="conserved")

    def __check_init__(self):
        check_fields(self)
        if self.mass not in ("conserved", "article"):
            raise ValueError(f'mass must be "conserved" or "article", got {self.mass!r}')

    def _air_ratio(self):
        """R: volume of air per volume of liquid at p0 [-]."""
        return self.air_fraction / (1.0 - self.air_fraction)

    def _gas_volume(self, p):
        """(p0/p)^(1/n), without `pow`, which is slow in XLA's CPU code."""
        xp = array_module(self, p)
        return xp.exp(-xp.log(xp.maximum(p, _PRESSURE_FLOOR) / ATMOSPHERE) / self.polytropic_index)

    def _liquid_volume(self, p):
        """v_l(p) [-], smooth in m through 0."""
        xp = array_module(self, p)
        compression = (p - ATMOSPHERE) / self.bulk_modulus
        z = self.modulus_slope * compression
        small = xp.abs(z) < 1e-4
        series = 1.0 - z / 2.0 + z * z / 3.0 - z * z * z / 4.0
        safe = xp.where(small, 1.0, z)
        return xp.exp(-compression * xp.where(small, series, xp.log1p(safe) / safe))

    def specific_volume(self, p):
        """v(p): volume per unit volume of liquid at p0 [-], at absolute pressure p [Pa]."""
        return self._liquid_volume(p) + self._air_ratio() * self._gas_volume(p)

    def liquid_modulus(self, p):
        """Tangent modulus of the air-free liquid K_l(p) [Pa]."""
        return self.bulk_modulus + self.modulus_slope * (p - ATMOSPHERE)

    def mixture_modulus(self, p):
        """Tangent modulus of liquid and air K(p) = -v dp/dv [Pa]; without air the liquid's."""
        liquid = self._liquid_volume(p)
        gas = self._air_ratio() * self._gas_volume(p)
        index_pressure = self.polytropic_index * array_module(self, p).maximum(p, _PRESSURE_FLOOR)
        return (liquid + gas) / (liquid / self.liquid_modulus(p) + gas / index_pressure)

    def density_at(self, p):
        """Density of the mixture [kg/m^3] at absolute pressure p [Pa]; constant with mass="article"."""
        if self.mass == "article":
            return self.density + 0.0 * p
        return (self.density + self._air_ratio() * GAS_DENSITY) / self.specific_volume(p)

    def mass_flow(self, volume_flow, p_from, p_to):
        """Mass flow [kg/s] of a volume flow [m^3/s] between two pressures, at the density of their mean."""
        return self.density_at(0.5 * (p_from + p_to)) * volume_flow

    def dynamic_viscosity(self):
        """mu = nu rho_l0 [Pa s]."""
        return self.kinematic_viscosity * self.density
