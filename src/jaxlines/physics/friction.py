"""Steady friction of flow in a round pipe: Darcy's factor f, and f Re as an object that a line can carry.

The pressure gradient dp/dx = f rho V |V|/(2 D) is written as (f Re) mu V/(2 D^2): f Re is finite at rest
(64 in laminar flow), so that nothing divides by the velocity.
"""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from jaxlines.physics.fields import Number, array_module, check_fields, is_concrete, quantity

LAMINAR = 64.0
"""f Re of laminar flow in a round pipe (Hagen-Poiseuille)."""

_CREEPING = 100.0
# Below this Reynolds number the other terms of Churchill's formula are less than 1e-40 of the laminar one;
# holding it there keeps the logarithm away from its zero at Re = 7.


def reynolds_number(velocity, inner_diameter, kinematic_viscosity):
    """Reynolds number V D/nu [-], with the sign of the velocity.

    Args: velocity V [m/s], mean over the cross-section; inner_diameter D [m]; kinematic_viscosity nu [m^2/s].
    """
    return velocity * inner_diameter / kinematic_viscosity


def laminar_factor(reynolds):
    """Darcy's friction factor of laminar flow, f = 64/Re [-], for Re > 0; valid below about 2000."""
    return LAMINAR / reynolds


def haaland_factor(reynolds, relative_roughness):
    """Darcy's friction factor of turbulent flow, explicit: 1/sqrt(f) = -1.8 log10(6.9/Re + (e/(3.7 D))^1.11).

    Args: reynolds Re > 0 [-]; relative_roughness e/D [-].
    Validity: Re 4000..1e8, e/D 1e-6..0.05; within about 2 % of Colebrook. Not for laminar flow.
    Typical values: 0.0309 at Re 1e4 and 0.0178 at 1e5 in a smooth pipe; drawn tube e = 1.5e-6 m.
    Reference: Haaland, "Simple and explicit formulas for the friction factor in turbulent pipe flow",
    J. Fluids Engineering 105, 1983.
    """
    xp = array_module(reynolds, relative_roughness)
    rough = xp.asarray(relative_roughness) > 0.0
    log_roughness = xp.log(xp.where(rough, relative_roughness, 1.0) / 3.7)
    roughness = xp.where(rough, xp.exp(1.11 * log_roughness), 0.0)
    inverse_root = -1.8 / np.log(10.0) * xp.log(6.9 / reynolds + roughness)
    return 1.0 / (inverse_root * inverse_root)


def churchill_factor(reynolds, relative_roughness):
    """Darcy's friction factor over all regimes in one smooth formula [-], for Re > 0.

    f = 8 [(8/Re)^12 + (A + B)^(-3/2)]^(1/12),  A = [2.457 ln(1/((7/Re)^0.9 + 0.27 e/D))]^16,  B = (37530/Re)^16

    Args: reynolds Re > 0 [-]; relative_roughness e/D [-].
    Validity: all Re; within about 3 % of Colebrook above 4000, dips below both laws near 2300.
    Typical values: 0.064 at Re 1000, 0.0430 at 3000, 0.0310 at 1e4 (smooth pipe).
    Reference: Churchill, "Friction-factor equation spans all fluid-flow regimes", Chem. Eng. 84(24), 1977.
    """
    return _churchill_times_reynolds(reynolds, relative_roughness) / reynolds


def _churchill_times_reynolds(size, relative_roughness):
    """f Re by Churchill for |Re| = size >= 0, in logarithms so that no power overflows."""
    xp = array_module(size, relative_roughness)
    moving = xp.maximum(size, _CREEPING)
    log_reynolds = xp.log(moving)
    inverse_root = -xp.log(xp.exp(0.9 * (np.log(7.0) - log_reynolds)) + 0.27 * relative_roughness)
    log_a = 16.0 * xp.log(2.457 * inverse_root)
    log_b = 16.0 * (np.log(37530.0) - log_reynolds)
    log_turbulent = 12.0 * log_reynolds - 1.5 * xp.logaddexp(log_a, log_b)
    return 8.0 * xp.exp(xp.logaddexp(12.0 * np.log(8.0), log_turbulent) / 12.0)


def colebrook_factor(reynolds, relative_roughness):
    """Darcy's friction factor of turbulent flow, implicit: 1/sqrt(f) = -2 log10(e/(3.7 D) + 2.51/(Re sqrt(f))).

    Args: reynolds Re > 0 [-]; relative_roughness e/D [-]; plain numbers or NumPy arrays (on the host).
    Validity: turbulent flow, Re above 4000. Solved by Newton's method to rounding.
    Typical values: 0.0309 at Re 1e4, 0.0180 at 1e5 in a smooth pipe.
    Reference: Colebrook, "Turbulent flow in pipes, with particular reference to the transition region
    between the smooth and rough pipe laws", J. Institution of Civil Engineers 11, 1939.
    """
    reynolds, relative_roughness = np.asarray(reynolds, dtype=float), np.asarray(relative_roughness, dtype=float)
    root = 1.0 / np.sqrt(haaland_factor(reynolds, relative_roughness))
    for _ in range(12):
        argument = relative_roughness / 3.7 + 2.51 * root / reynolds
        residual = root + 2.0 * np.log10(argument)
        root = root - residual / (1.0 + 2.0 / np.log(10.0) * 2.51 / (reynolds * argument))
    return 1.0 / (root * root)


def minor_loss_drop(loss_coefficient, density, velocity):
    """Pressure drop of fittings, bends and ends: K rho V |V|/2 [Pa], with the sign of the velocity.

    Args: loss_coefficient K, summed over the fittings [-]; density rho [kg/m^3]; velocity V [m/s] in the
        cross-section to which K refers.
    Validity: turbulent flow; K grows at Re below about 1000. Its slope is continuous through rest.
    Typical values: sharp inlet 0.5, outlet 1.0, elbow 0.3..1.5, tee 0.2..1.8.
    Reference: White, "Fluid Mechanics", ch. 6.
    """
    return 0.5 * density * loss_coefficient * velocity * abs(velocity)


class AbstractFriction(eqx.Module):
    """A law of steady friction, by f Re as a function of Reynolds number and roughness."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def factor_times_reynolds(self, reynolds, relative_roughness) -> Number:
        """f Re [-]: even and smooth in the Reynolds number, 64 at rest; relative_roughness e/D [-]."""

    def gradient(self, velocity, inner_diameter, density, kinematic_viscosity, relative_roughness=0.0) -> Number:
        """Pressure drop per length, (f Re) mu V/(2 D^2) [Pa/m], odd and increasing in the velocity [m/s]."""
        reynolds = reynolds_number(velocity, inner_diameter, kinematic_viscosity)
        viscous = 0.5 * density * kinematic_viscosity * velocity / (inner_diameter * inner_diameter)
        return self.factor_times_reynolds(reynolds, relative_roughness) * viscous


class LaminarFriction(AbstractFriction):
    """Hagen and Poiseuille's law at every Reynolds number: f Re = 64.

    Validity: Re below about 2000; roughness has no effect.
    Reference: White, "Viscous Fluid Flow", sec. 3-3.
    """

    def factor_times_reynolds(self, reynolds, relative_roughness):
        return LAMINAR + 0.0 * (reynolds + relative_roughness)


class HaalandFriction(AbstractFriction):
    """Laminar below one Reynolds number, Haaland's turbulent law above another, a smooth blend between.

    f Re = 64 + s(x) (f_H Re - 64),  x = (|Re| - laminar_limit)/(turbulent_limit - laminar_limit) in [0, 1],
    s(x) = x^3 (10 - 15 x + 6 x^2), so that value, slope and curvature are continuous.

    Args: laminar_limit, turbulent_limit: Reynolds numbers where the blend begins and ends [-].
    Raises: ValueError when the limits are not in order.
    Validity: see `haaland_factor`. What flow does between the limits is not settled by theory; the blend is
        monotone, as a drop must be for a steady state to be unique.
    Typical values: 2000 and 4000.
    Reference: see `haaland_factor`; the blend is this package's own.
    """

    laminar_limit: Number = quantity("1", low=1000.0, high=1e5, default=2000.0)
    turbulent_limit: Number = quantity("1", low=1200.0, high=1e6, default=4000.0)

    def __check_init__(self):
        begin, end = self.laminar_limit, self.turbulent_limit
        if is_concrete(begin) and is_concrete(end) and np.any(np.asarray(end) <= np.asarray(begin)):
            raise ValueError(f"turbulent_limit must be above laminar_limit, got {end:g} and {begin:g}")

    def factor_times_reynolds(self, reynolds, relative_roughness):
        xp = array_module(self, reynolds, relative_roughness)
        size = xp.abs(reynolds)
        x = xp.clip((size - self.laminar_limit) / (self.turbulent_limit - self.laminar_limit), 0.0, 1.0)
        share = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
        moving = xp.maximum(size, self.laminar_limit)
        return LAMINAR + share * (haaland_factor(moving, relative_roughness) * moving - LAMINAR)


class ChurchillFriction(AbstractFriction):
    """Churchill's single formula for laminar, transitional and turbulent flow; see `churchill_factor`.

    Validity: every Reynolds number, from rest on; 64 to 1e-13 below Re = 1000.
    """

    def factor_times_reynolds(self, reynolds, relative_roughness):
        size = array_module(reynolds, relative_roughness).abs(reynolds)
        return _churchill_times_reynolds(size, relative_roughness)
