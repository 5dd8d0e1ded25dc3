"""Hydraulic fluid with entrained air: density, bulk modulus and viscosity as functions of absolute pressure."""

import equinox as eqx
import numpy as np

from jaxlines.physics.air import AbstractAir, FreeAir, gas_modulus, gas_volume
from jaxlines.physics.fields import ATMOSPHERE, Number, array_module, check_fields, quantity
from jaxlines.physics.liquids import AbstractLiquid, Murnaghan
from jaxlines.physics.viscosity import AbstractViscosity, ConstantViscosity, barus_factor

GAS_DENSITY = 1.204
"""Density of dry air at 101325 Pa and 293.15 K [kg/m^3] (ideal gas, R = 287.05 J/(kg K))."""


class Oil(eqx.Module):
    """A liquid with entrained air, by a law for the liquid, one for the air and one for viscosity.

    Per unit volume of liquid at p0 = 101325 Pa, with R = air_fraction / (1 - air_fraction), with the
    undissolved fraction theta of the air (1 for free air), and with v_l and K_l by the law of the liquid:

        with air         v(p)   = v_l + R theta (p0/p)^(1/n)
        density          rho(p) = (rho_l0 + R rho_air)/v
        bulk modulus     K(p)   = -v dp/dv = v / (v_l/K_l + R theta/(n p) (p0/p)^(1/n)),   for free air
        temperature      K0(T)  = K0 exp(-c (T - T_r)),   rho_l0(T) = rho_l0/(1 + a (T - T_r))

    Args:
        bulk_modulus: K0, tangent modulus of the air-free liquid at p0 and T_r [Pa]. For fast events give the
            isentropic one, for slow filling the isothermal one (about 15 % lower).
        density: rho_l0, of the air-free liquid at p0 and T_r [kg/m^3].
        kinematic_viscosity: nu at p0 and T_r [m^2/s].
        air_fraction: volume of free air per volume of MIXTURE at p0 [-]; 0 is legal and exact.
        polytropic_index: n of the air [-]: 1 isothermal (slow, small bubbles) to 1.4 adiabatic.
        modulus_slope: m = dK_l/dp at p0 [-]; 0 is a constant modulus with the law of Murnaghan.
        vapour_pressure: [Pa]; below it an air-free liquid would be in tension, which is reported.
        atmospheric_pressure: what gauge pressures are relative to [Pa].
        mass: "conserved" (default), or "article": constant density, so that eq. (8) of the article holds
            exactly in volume flows (mass is then not conserved where the modulus varies).
        liquid: law of the air-free liquid: `Murnaghan` (default), `Tait`, `DowsonHigginson`.
        viscosity: law of temperature: `ConstantViscosity` (default), `Walther`, `Vogel`.
        air: `FreeAir` (default), `DissolvingAir`, `KineticAir`, `LegacySimscapeAir`.
        temperature: T, of the fluid, the same everywhere [K].
        reference_temperature: T_r, at which the numbers above hold [K].
        thermal_expansion: a [1/K]; 0 leaves the density as it is.
        modulus_temperature_coefficient: c [1/K]; 0 leaves the modulus as it is.
        viscosity_pressure_coefficient: of the equation of Barus [1/Pa]; 0 leaves the viscosity as it is.

    Where the law of the air is kinetic, theta is a state of each volume and handed to the methods as
    `undissolved`; without it they take theta at equilibrium, and the modulus does not count its change.

    Validity: isothermal or isentropic as the modulus is; pressures above 0 when there is air, above the vapour
    pressure where the air law puts vapour in the bubbles.
    Typical values: mineral oil K0 1.4e9..1.9e9 Pa, m 8..12, density 860, nu 32e-6..46e-6 at 40 C, air
    0.005..0.02, a 7e-4, c 0.005..0.006 1/K. The oil of the DSN antennas: 1.379e9 Pa, 850 kg/m^3,
    27.7e-6 m^2/s. Others are in `jaxlines.catalogue.oils`.
    Reference: with m = 0, Cho, Lee and Oh, "Estimation technique of air content in automatic transmission
    fluid by measuring effective bulk modulus", Int. J. Automotive Technology 3(2), 2002; see the laws.
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
    liquid: AbstractLiquid = Murnaghan()
    viscosity: AbstractViscosity = ConstantViscosity()
    air: AbstractAir = FreeAir()
    temperature: Number = quantity("K", low=150.0, high=700.0, slip="was it given in C?", default=313.15)
    reference_temperature: Number = quantity("K", low=150.0, high=700.0, slip="was it given in C?", default=313.15)
    thermal_expansion: Number = quantity("1/K", low=-1e-3, high=1e-2, default=0.0)
    modulus_temperature_coefficient: Number = quantity("1/K", low=-0.05, high=0.05, default=0.0)
    viscosity_pressure_coefficient: Number = quantity(
        "1/Pa", low=0.0, high=1e-6, slip="was it given in 1/GPa or 1/bar?", default=0.0
    )

    def __check_init__(self):
        check_fields(self)
        if self.mass not in ("conserved", "article"):
            raise ValueError(f'mass must be "conserved" or "article", got {self.mass!r}')
        if self.air.liquid_frozen and self.mass != "article":
            raise ValueError(
                f'air law {type(self.air).__name__} needs mass="article": it holds the volume of the liquid in its '
                "modulus, so that no density is consistent with it and mass could not be conserved"
            )
        vapour = self.air.vapour_pressure(self.vapour_pressure)
        if isinstance(vapour, np.ndarray) and np.any(vapour >= ATMOSPHERE):
            raise ValueError(f"vapour_pressure in bubbles must be below {ATMOSPHERE:g} Pa, got {np.max(vapour):g} Pa")

    def _air_ratio(self):
        """R: volume of free air per volume of liquid at p0 [-]."""
        return self.air_fraction / (1.0 - self.air_fraction)

    def _warming(self):
        """T - T_r [K]."""
        return self.temperature - self.reference_temperature

    def _modulus_at_reference(self):
        """K0 at the temperature of the fluid [Pa]."""
        xp = array_module(self)
        return self.bulk_modulus * xp.exp(-self.modulus_temperature_coefficient * self._warming())

    def _density_at_reference(self):
        """rho_l0 at the temperature of the fluid [kg/m^3]."""
        return self.density / (1.0 + self.thermal_expansion * self._warming())

    def _liquid_volume(self, p):
        """v_l(p) [-]."""
        return self.liquid.volume(p, self._modulus_at_reference(), self.modulus_slope)

    def _air_state(self, p, undissolved):
        """The undissolved fraction theta [-], and the part of -d theta/dp that is compliance [1/Pa]."""
        if undissolved is not None:
            return undissolved, 0.0
        ratio = self._air_ratio()
        return self.air.undissolved(p, ratio), self.air.dissolving(p, ratio)

    def air_content(self):
        """Volume at p0 of all air that can be in bubbles, per volume of liquid [-]; R where none is dissolved."""
        return self.air.air_content(self._air_ratio())

    def gas_volume(self, p):
        """Volume of gas per volume of liquid at p0 if no air were dissolved [-]: dv/d theta."""
        vapour = self.air.vapour_pressure(self.vapour_pressure)
        return self.air_content() * gas_volume(self.air.gas_pressure(p), self.polytropic_index, vapour)

    def undissolved_air(self, p):
        """Undissolved fraction theta of the air at equilibrium [-], at absolute pressure p [Pa]."""
        return self.air.undissolved(p, self._air_ratio()) + 0.0 * p

    def undissolved_rate(self, p, undissolved):
        """d theta/dt [1/s] at absolute pressure p [Pa], where theta is a state (`air.kinetic`); else 0."""
        return self.air.rate(p, undissolved, self._air_ratio())

    def specific_volume(self, p, undissolved=None):
        """v(p): volume per unit volume of liquid at p0 [-], at absolute pressure p [Pa]."""
        fraction, _ = self._air_state(p, undissolved)
        return self._liquid_volume(p) + fraction * self.gas_volume(p)

    def liquid_modulus(self, p):
        """Tangent modulus of the air-free liquid K_l(p) [Pa]."""
        return self.liquid.modulus(p, self._modulus_at_reference(), self.modulus_slope)

    def mixture_modulus(self, p, undissolved=None):
        """Tangent modulus of liquid and air K(p) = -v dp/dv [Pa]; without air the liquid's."""
        fraction, dissolving = self._air_state(p, undissolved)
        liquid = 1.0 if self.air.liquid_frozen else self._liquid_volume(p)
        vapour = self.air.vapour_pressure(self.vapour_pressure)
        stiffness = gas_modulus(self.air.gas_pressure(p), self.polytropic_index, vapour)
        all_gas = self.gas_volume(p)
        gas = fraction * all_gas
        return (liquid + gas) / (liquid / self.liquid_modulus(p) + gas / stiffness + all_gas * dissolving)

    def liquid_density(self, p=ATMOSPHERE):
        """Density of the air-free liquid [kg/m^3] at absolute pressure p [Pa]; constant with mass="article"."""
        reference = self._density_at_reference()
        return reference + 0.0 * p if self.mass == "article" else reference / self._liquid_volume(p)

    def density_at(self, p, undissolved=None):
        """Density of the mixture [kg/m^3] at absolute pressure p [Pa]; constant with mass="article"."""
        reference = self._density_at_reference()
        if self.mass == "article":
            return reference + 0.0 * p
        return (reference + self._air_ratio() * GAS_DENSITY) / self.specific_volume(p, undissolved)

    def mass_flow(self, volume_flow, p_from, p_to):
        """Mass flow [kg/s] of a volume flow [m^3/s] between two pressures, at the density of their mean."""
        return self.density_at(0.5 * (p_from + p_to)) * volume_flow

    def dynamic_viscosity(self, p=ATMOSPHERE):
        """mu of the liquid [Pa s] at absolute pressure p [Pa]: nu(T) rho_l0(T), times the factor of Barus."""
        kinematic = self.viscosity.kinematic(self.temperature, self.kinematic_viscosity, self.reference_temperature)
        reference = self._density_at_reference()
        return kinematic * reference * barus_factor(p, self.viscosity_pressure_coefficient)
