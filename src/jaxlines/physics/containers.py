"""What holds the fluid: pipes and vessels with elastic walls.

A container has a volume at atmospheric pressure and a wall modulus K_c, so that
V(p) = V_ref exp((p - p_atm)/K_c). Wall elasticity appears here and nowhere else.
"""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from jaxlines.physics.article import conduit_modulus, series_modulus
from jaxlines.physics.fields import Number, array_module, check_fields, quantity
from jaxlines.physics.fluids import Oil


class AbstractContainer(eqx.Module):
    """A container by its volume at atmospheric pressure and the modulus of its wall."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def reference_volume(self) -> Number:
        """Volume at atmospheric pressure [m^3]."""

    @abstractmethod
    def container_modulus(self) -> Number:
        """K_c = V dp/dV of the wall [Pa]; infinite when rigid."""


class Pipe(AbstractContainer):
    """A thick-walled circular pipe, whose wall modulus is eq. (4) of the article.

    Args: length [m]; inner_diameter, outer_diameter [m]; youngs_modulus E [Pa]; poissons_ratio nu [-].
    Raises: ValueError when the outer diameter is not larger than the inner one.
    Typical values: steel E 2.07e11 Pa, nu 0.29; the antennas' 2-in pipe 42.85 mm / 60.32 mm.
    Reference: eq. (4) of the article; Wylie and Streeter, "Fluid Transients in Systems", 1993, thick wall
    with expansion joints.
    """

    length: Number = quantity("m", low=0.0, high=1e5, slip="was it given in mm?")
    inner_diameter: Number = quantity("m", low=1e-4, high=20.0, slip="was it given in mm?")
    outer_diameter: Number = quantity("m", low=1e-4, high=25.0, slip="was it given in mm?")
    youngs_modulus: Number = quantity("Pa", low=1e5, high=1e13, slip="was it given in GPa?", default=2.07e11)
    poissons_ratio: Number = quantity("1", low=0.0, high=0.5, default=0.29)

    def __check_init__(self):
        inner, outer = self.inner_diameter, self.outer_diameter
        if isinstance(inner, np.ndarray) and isinstance(outer, np.ndarray) and np.any(outer <= inner):
            raise ValueError(
                f"outer_diameter must be larger than inner_diameter, got {outer:g} m and {inner:g} m: "
                "was a radius or the wall thickness given?"
            )

    def reference_volume(self):
        return np.pi / 4.0 * self.inner_diameter**2 * self.length

    def container_modulus(self):
        wall = 0.5 * (self.outer_diameter - self.inner_diameter)
        return conduit_modulus(0.5 * self.inner_diameter, wall, self.youngs_modulus, self.poissons_ratio)

    def laminar_resistance(self, fluid: Oil):
        """Hagen-Poiseuille resistance 128 mu L/(pi D^4) [Pa s/m^3]. Valid for Re < 2000."""
        return 128.0 * fluid.dynamic_viscosity() * self.length / (np.pi * self.inner_diameter**4)

    def inertance(self, fluid: Oil):
        """rho L/A [Pa s^2/m^3]."""
        return fluid.density * self.length / (np.pi / 4.0 * self.inner_diameter**2)


class Vessel(AbstractContainer):
    """A volume with a known wall modulus: a hose, a manifold, a dead volume.

    Args: volume at atmospheric pressure [m^3]; wall_modulus K_c of the CONTAINER alone [Pa] (rigid by
        default). A modulus that already contains the fluid's belongs to `from_effective_modulus`:
        giving it here would count the fluid's compliance twice.
    Typical values: hydraulic hose 5e7..1e9 Pa (the antennas' hose: 4.32e9 Pa, very stiff).
    """

    volume: Number = quantity("m^3", low=0.0, high=1e7, slip="was it given in litres or cm^3?")
    wall_modulus: Number = quantity("Pa", low=1e5, slip="was it given in MPa or bar?", default=np.inf)

    @staticmethod
    def from_effective_modulus(volume, effective_modulus, fluid_modulus) -> "Vessel":
        """A vessel of which the modulus of fluid and wall together is known, by eq. (2) solved for the wall.

        Args: volume [m^3]; effective_modulus beta and fluid_modulus beta_f [Pa].
        Raises: ValueError when the effective modulus exceeds the fluid's (no wall can make that).
        """
        if effective_modulus > fluid_modulus:
            raise ValueError(
                f"effective_modulus must not exceed the fluid's, got {effective_modulus:g} Pa and "
                f"{fluid_modulus:g} Pa: were they swapped?"
            )
        compliance = 1.0 / np.float64(effective_modulus) - 1.0 / np.float64(fluid_modulus)
        return Vessel(volume=volume, wall_modulus=np.inf if compliance == 0 else 1.0 / compliance)

    def reference_volume(self):
        return self.volume

    def container_modulus(self):
        return self.wall_modulus


def volume_at(container: AbstractContainer, fluid: Oil, p) -> Number:
    """Volume of a container at absolute pressure p [m^3]; the reference volume with mass="article"."""
    if fluid.mass == "article":
        return container.reference_volume() + 0.0 * p
    stretch = (p - fluid.atmospheric_pressure) / container.container_modulus()
    return container.reference_volume() * array_module(container, fluid, p).exp(stretch)


def capacity(container: AbstractContainer, fluid: Oil, p) -> Number:
    """dm/dp = d(rho V)/dp = rho V (1/K + 1/K_c) [kg/Pa] at absolute pressure p [Pa], with eq. (2)."""
    effective = series_modulus(container.container_modulus(), fluid.mixture_modulus(p))
    return fluid.density_at(p) * volume_at(container, fluid, p) / effective
