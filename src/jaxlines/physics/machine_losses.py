"""Losses of displacement machines (pumps and motors): slip past the pistons, viscous and dry friction."""

from abc import abstractmethod

import equinox as eqx

from jaxlines.physics.fields import Number, check_fields, quantity
from jaxlines.physics.mechanics import smooth_sign


def wilson_slip(slip_coefficient, displacement, drop, viscosity):
    """Laminar slip past the displacing elements [m^3/s]: Q_s = C_s D dp/mu.

    Args: slip_coefficient C_s [-]; displacement D [m^3/rad]; drop dp between the working ports [Pa]; viscosity mu,
        dynamic [Pa s].
    Validity: laminar gaps of constant height; no compressibility.
    Typical values: C_s 1e-9..1e-7.
    Reference: Wilson, "Positive-Displacement Pumps and Fluid Motors", 1950 (unverified: quoted from memory; the form is
        that of public models of pumps).
    """
    return slip_coefficient * displacement * drop / viscosity


def wilson_torque(viscous_coefficient, dry_coefficient, displacement, drop, speed, viscosity, speed_width, drop_width):
    """Friction torque against the rotation [N m]: T_f = C_v mu D w + C_f D |dp| sign(w), smooth in w and dp.

    Args: viscous_coefficient C_v, dry_coefficient C_f [-]; displacement D [m^3/rad]; drop dp [Pa]; speed w [rad/s];
        viscosity mu [Pa s]; speed_width w_0 [rad/s], drop_width dp_0 [Pa] of the tanh in place of both signs.
    Validity: never gives energy.
    Typical values: C_v 1e4..1e6, C_f 0.01..0.05 (unverified: quoted from memory).
    Reference: see `wilson_slip`.
    """
    pressed = displacement * drop * smooth_sign(drop, drop_width)
    viscous = viscous_coefficient * viscosity * displacement * speed
    return viscous + dry_coefficient * pressed * smooth_sign(speed, speed_width)


class AbstractLosses(eqx.Module):
    """What a displacement machine loses in flow and in torque."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def slip(self, displacement, drop, viscosity) -> Number:
        """Flow from the first working port to the second past the pistons [m^3/s].

        Args: displacement [m^3/rad]; drop between the ports [Pa]; viscosity, dynamic [Pa s].
        """

    @abstractmethod
    def torque(self, displacement, drop, speed, viscosity) -> Number:
        """Friction torque against the rotation [N m]; speed [rad/s], the rest as in `slip`."""


class WilsonLosses(AbstractLosses):
    """The losses of a pump or motor after Wilson, see `wilson_slip` and `wilson_torque`.

    Args: slip_coefficient C_s, viscous_coefficient C_v, dry_coefficient C_f [-]; friction_speed w_0 [rad/s] and
        friction_pressure dp_0 [Pa]: widths within which friction turns with speed and pressure.
    """

    slip_coefficient: Number = quantity("1", low=0.0, high=1e-3, default=0.0)
    viscous_coefficient: Number = quantity("1", low=0.0, high=1e9, default=0.0)
    dry_coefficient: Number = quantity("1", low=0.0, high=1.0, slip="was it given in percent?", default=0.0)
    friction_speed: Number = quantity("rad/s", low=1e-6, high=1e3, slip="was it given in rpm?", default=0.1)
    friction_pressure: Number = quantity("Pa", low=1.0, high=1e8, slip="was it given in bar?", default=1e5)

    @staticmethod
    def from_efficiencies(volumetric, mechanical, pressure, speed, viscosity, dry_coefficient=0.0) -> "WilsonLosses":
        """The losses of a PUMP with these efficiencies at one point.

        C_s = (1 - eta_v) mu w/dp,   C_v = ((1/eta_m - 1) - C_f) dp/(mu w)

        Args: volumetric eta_v, mechanical eta_m [-] at the pressure difference dp [Pa], speed w [rad/s] and dynamic
            viscosity mu [Pa s]; dry_coefficient C_f [-], the part of the friction that does not depend on speed.
        Raises: ValueError when the dry friction alone is more than the mechanical efficiency leaves.
        """
        lost = 1.0 / mechanical - 1.0
        if dry_coefficient > lost:
            raise ValueError(f"dry_coefficient must not exceed 1/mechanical - 1 = {lost:g}, got {dry_coefficient:g}")
        ratio = viscosity * speed / pressure
        return WilsonLosses((1.0 - volumetric) * ratio, (lost - dry_coefficient) / ratio, dry_coefficient)

    def slip(self, displacement, drop, viscosity):
        return wilson_slip(self.slip_coefficient, displacement, drop, viscosity)

    def torque(self, displacement, drop, speed, viscosity):
        coefficients = (self.viscous_coefficient, self.dry_coefficient)
        widths = (self.friction_speed, self.friction_pressure)
        return wilson_torque(*coefficients, displacement, drop, speed, viscosity, *widths)
