"""What holds the fluid: pipes, hoses and vessels with elastic walls.

A container has a volume at atmospheric pressure and a wall modulus K_c, so that
V(p) = V_ref exp((p - p_atm)/K_c). Wall elasticity appears here and nowhere else.
"""

from abc import abstractmethod
from dataclasses import MISSING
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import numpy as np

from jaxlines.physics.article import series_modulus
from jaxlines.physics.fields import Number, array_module, check_fields, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.walls import check_restraint, modulus_from_expansion, thick_wall_modulus, thin_wall_modulus


class AbstractContainer(eqx.Module):
    """A container by its volume at atmospheric pressure and the modulus of its wall."""

    delayed: ClassVar[bool] = False  # whether the wall has a delayed strain, which is a state of what holds it

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def reference_volume(self) -> Number:
        """Volume at atmospheric pressure [m^3]."""

    @abstractmethod
    def container_modulus(self) -> Number:
        """K_c = V dp/dV of the wall's immediate response [Pa]; infinite when rigid."""


class AbstractConduit(AbstractContainer):
    """A container of circular section that fluid flows through, with a length, a bore and its roughness."""

    length: eqx.AbstractVar[Number]
    inner_diameter: eqx.AbstractVar[Number]
    if TYPE_CHECKING:  # a type checker would take it for the third argument of every conduit
        roughness: ClassVar[Any]
    else:
        roughness: eqx.AbstractVar[Number]

    def reference_volume(self):
        return area(self) * self.length

    def laminar_resistance(self, fluid: Oil):
        """Hagen-Poiseuille resistance 128 mu L/(pi D^4) [Pa s/m^3]. Valid for Re < 2000."""
        return 128.0 * fluid.dynamic_viscosity() * self.length / (np.pi * self.inner_diameter**4)

    def inertance(self, fluid: Oil):
        """rho L/A [Pa s^2/m^3]."""
        return fluid.liquid_density() * self.length / area(self)


def area(conduit: AbstractConduit) -> Number:
    """Area of the bore pi D^2/4 [m^2]."""
    return np.pi / 4.0 * conduit.inner_diameter**2


def _length():
    return quantity("m", low=0.0, high=1e5, slip="was it given in mm?")


def _diameter(high: float):
    return quantity("m", low=1e-4, high=high, slip="was it given in mm?")


def _roughness():
    return quantity("m", low=0.0, high=0.1, slip="was it given in mm or micrometres?", default=0.0)


def _wall_modulus(default=MISSING):
    return quantity("Pa", low=1e5, slip="was it given in MPa or bar?", default=default)


class Pipe(AbstractConduit):
    """A circular pipe, whose wall modulus is eq. (4) of the article unless told otherwise.

    Args: length [m]; inner_diameter, outer_diameter [m]; youngs_modulus E [Pa]; poissons_ratio nu [-];
        roughness of the bore [m]; restraint along the axis: "expansion_joints" (eq. (4)), "upstream", "throughout",
        "capped", see `walls.RESTRAINTS`; wall: "thick" or "thin".
    Raises: ValueError when the outer diameter is not larger than the inner one, for an unknown restraint or wall.
    Typical values: steel E 2.07e11 Pa, nu 0.29, drawn tube roughness 1.5e-6 m (unverified: quoted from memory); the
        antennas' 2-in pipe 42.85 mm / 60.32 mm.
    Reference: eq. (4) of the article; Wylie and Streeter, "Fluid Transients in Systems", 1993, ch. 3.
    """

    length: Number = _length()
    inner_diameter: Number = _diameter(20.0)
    outer_diameter: Number = _diameter(25.0)
    youngs_modulus: Number = quantity("Pa", low=1e5, high=1e13, slip="was it given in GPa?", default=2.07e11)
    poissons_ratio: Number = quantity("1", low=0.0, high=0.5, default=0.29)
    roughness: Number = _roughness()
    restraint: str = eqx.field(static=True, default="expansion_joints")
    wall: str = eqx.field(static=True, default="thick")

    def __check_init__(self):
        inner, outer = self.inner_diameter, self.outer_diameter
        if isinstance(inner, np.ndarray) and isinstance(outer, np.ndarray) and np.any(outer <= inner):
            raise ValueError(
                f"outer_diameter must be larger than inner_diameter, got {outer:g} m and {inner:g} m: "
                "was a radius or the wall thickness given?"
            )
        check_restraint(self.restraint)
        if self.wall not in ("thick", "thin"):
            raise ValueError(f'wall must be "thick" or "thin", got {self.wall!r}')

    def container_modulus(self):
        thickness = 0.5 * (self.outer_diameter - self.inner_diameter)
        elasticity = (self.youngs_modulus, self.poissons_ratio, self.restraint)
        if self.wall == "thin":
            return thin_wall_modulus(self.inner_diameter, thickness, *elasticity)
        return thick_wall_modulus(0.5 * self.inner_diameter, thickness, *elasticity)


def _expanded(inner_diameter, expansion, pressure):
    """The wall modulus [Pa] behind an expansion [m^3/m] at a pressure above atmosphere [Pa]."""
    return modulus_from_expansion(np.pi / 4.0 * inner_diameter**2, expansion, pressure)


class Hose(AbstractConduit):
    """A hose by the modulus of its wall.

    Args: length [m]; inner_diameter [m]; wall_modulus K_c of the hose alone [Pa]; roughness of the bore [m].
        A data sheet's volumetric expansion belongs to `from_expansion`.
    Validity: one modulus for all pressures and speeds; `ViscoelasticHose` has a static and a dynamic one.
    Typical values: 5e7..1e9 Pa (unverified: quoted from memory); the antennas' hose 4.32e9 Pa, very stiff.
    """

    length: Number = _length()
    inner_diameter: Number = _diameter(2.0)
    wall_modulus: Number = _wall_modulus()
    roughness: Number = _roughness()

    @staticmethod
    def from_expansion(length, inner_diameter, expansion, pressure, roughness=0.0) -> "Hose":
        """A hose by the expansion [m^3/m] at a pressure above atmosphere [Pa] of its data sheet (1 cm^3/m = 1e-6)."""
        return Hose(length, inner_diameter, _expanded(inner_diameter, expansion, pressure), roughness)

    def container_modulus(self):
        return self.wall_modulus


class ViscoelasticHose(AbstractConduit):
    """A hose whose wall gives at once and then creeps: the standard linear solid.

    V = V_ref exp((p - p_atm)/K_d + eps),   tau eps' + eps = (p - p_atm)(1/K_s - 1/K_d)

    Args: length [m]; inner_diameter [m]; static_modulus K_s after a long time, dynamic_modulus K_d at once [Pa]
        (infinite: the Kelvin-Voigt wall); relaxation_time tau of the creep at constant pressure [s]; roughness [m].
    Raises: ValueError when the dynamic modulus is below the static one.
    Validity: linear, one relaxation time; a real wall has a spectrum of them.
    Typical values: hoses are consistently stiffer in fast events than in the static test; take K_d/K_s from data.
    Reference: standard linear solid (Zener); as Kelvin-Voigt wall in the compliant cylinders of MapleSim and Simscape.
    """

    length: Number = _length()
    inner_diameter: Number = _diameter(2.0)
    static_modulus: Number = _wall_modulus()
    dynamic_modulus: Number = _wall_modulus()
    relaxation_time: Number = quantity("s", low=1e-6, high=1e6, slip="was it given in ms?")
    roughness: Number = _roughness()

    delayed = True

    def __check_init__(self):
        slow, fast = self.static_modulus, self.dynamic_modulus
        if isinstance(slow, np.ndarray) and isinstance(fast, np.ndarray) and np.any(fast < slow):
            raise ValueError(
                f"dynamic_modulus must not be below static_modulus, got {fast:g} Pa and {slow:g} Pa: were they swapped?"
            )

    @staticmethod
    def from_expansion(
        length, inner_diameter, static_expansion, dynamic_expansion, pressure, relaxation_time, roughness=0.0
    ) -> "ViscoelasticHose":
        """A hose by its slow and its fast expansion [m^3/m] at one pressure above atmosphere [Pa]."""
        slow, fast = (_expanded(inner_diameter, e, pressure) for e in (static_expansion, dynamic_expansion))
        return ViscoelasticHose(length, inner_diameter, slow, fast, relaxation_time, roughness)

    def container_modulus(self):
        return self.dynamic_modulus

    def delayed_compliance(self):
        """1/K_s - 1/K_d: delayed strain per pressure after a long time [1/Pa]."""
        return 1.0 / self.static_modulus - 1.0 / self.dynamic_modulus


class Vessel(AbstractContainer):
    """A volume with a known wall modulus: a manifold, a dead volume, a hose of which only the volume is known.

    Args: volume at atmospheric pressure [m^3]; wall_modulus K_c of the CONTAINER alone [Pa] (rigid by
        default). A modulus that already contains the fluid's belongs to `from_effective_modulus`:
        giving it here would count the fluid's compliance twice.
    """

    volume: Number = quantity("m^3", low=0.0, high=1e7, slip="was it given in litres or cm^3?")
    wall_modulus: Number = _wall_modulus(np.inf)

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


def volume_at(container: AbstractContainer, fluid: Oil, p, strain=0.0) -> Number:
    """Volume of a container at absolute pressure p [m^3]; the reference volume with mass="article".

    V = V_ref exp((p - p_atm)/K_c + eps), with the delayed strain eps [-] of a visco-elastic wall.
    """
    if fluid.mass == "article":
        return container.reference_volume() + 0.0 * p
    stretch = (p - fluid.atmospheric_pressure) / container.container_modulus() + strain
    return container.reference_volume() * array_module(container, fluid, p, strain).exp(stretch)


def capacity(container: AbstractContainer, fluid: Oil, p, strain=0.0, undissolved=None) -> Number:
    """dm/dp = d(rho V)/dp = rho V (1/K + 1/K_c) [kg/Pa] at absolute pressure p [Pa], with eq. (2).

    Args: strain: delayed strain of the wall [-]; undissolved: fraction of the air that is not dissolved [-], for
        a fluid whose air dissolves slowly. Both are held constant.
    """
    effective = series_modulus(container.container_modulus(), fluid.mixture_modulus(p, undissolved))
    return fluid.density_at(p, undissolved) * volume_at(container, fluid, p, strain) / effective


def delayed_strain_rate(container: ViscoelasticHose, fluid: Oil, p, strain) -> Number:
    """eps' = ((p - p_atm)(1/K_s - 1/K_d) - eps)/tau [1/s] of a visco-elastic wall at absolute pressure p [Pa]."""
    settled = (p - fluid.atmospheric_pressure) * container.delayed_compliance()
    return (settled - strain) / container.relaxation_time
