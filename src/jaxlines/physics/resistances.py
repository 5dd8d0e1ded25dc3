"""Elements that let fluid pass against a pressure difference: leaks, orifice, minor loss; smooth roots and clips."""

import equinox as eqx
import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import Number, array_module, driven, port, quantity


def regularised_root(x, transition):
    """A smooth, odd sign(x) sqrt(|x|) with finite slope at zero: x / (x^2 + transition^2)^(1/4).

    Within 0.25 % of the root for |x| > 10 transition. Infinitely differentiable, slope transition^(-1/2) at 0.
    Reference: Modelica Standard Library, Modelica.Fluid.Utilities.regRoot.
    """
    xp = array_module(x, transition)
    return x / xp.sqrt(xp.sqrt(x * x + transition * transition))


def two_regime_root(x, transition):
    """An odd root that is exact beyond the transition and a parabola within: (x/sqrt(t)) (3 - |x|/t)/2 for |x| < t.

    Once differentiable; slope 1.5 transition^(-1/2) at 0.
    Reference: Ellman and Piche, "A modified orifice flow formula for numerical simulation of fluid power systems",
    ASME J. Dyn. Syst. Meas. Control 121(4), 1999, pp. 721-724 (abstract seen; the polynomial as other codes quote it).
    """
    xp = array_module(x, transition)
    size = xp.where(x < 0.0, -x, x)
    share = xp.where(size < transition, size, transition) / transition
    laminar = 0.5 * x / xp.sqrt(transition) * (3.0 - share)
    turbulent = xp.sqrt(xp.where(size < transition, transition, size))
    return xp.where(size < transition, laminar, xp.where(x < 0.0, -turbulent, turbulent))


ROOTS = {"fourth_root": regularised_root, "two_regime": two_regime_root}
"""The published regularisations of the square root, by name."""


def transition_pressure(critical_reynolds, density, kinematic_viscosity, discharge_coefficient, diameter):
    """Pressure difference at which an orifice turns laminar: 9 Re_cr^2 rho nu^2/(8 C_d^2 D^2) [Pa].

    Args: critical_reynolds Re_cr [-]; density rho [kg/m^3]; kinematic_viscosity nu [m^2/s]; discharge_coefficient
        C_d [-]; diameter D = sqrt(4 A/pi) [m].
    Typical values: Re_cr 9.3, a few Pa; the transition of an `Orifice` may be larger to make equations less stiff.
    Reference: Ellman and Piche, see `two_regime_root`.
    """
    ratio = critical_reynolds * kinematic_viscosity / (discharge_coefficient * diameter)
    return 1.125 * density * ratio * ratio


def orifice_flow(opening_area, discharge_coefficient, density, p_from, p_to, transition, root=regularised_root):
    """Volume flow through a sharp-edged orifice [m^3/s]: Q = C_d A sqrt(2 dp/rho), smooth through dp = 0.

    Args: opening_area A [m^2]; discharge_coefficient C_d [-]; density rho [kg/m^3]; p_from, p_to [Pa];
        transition: pressure difference below which the flow turns laminar [Pa]; root: one of `ROOTS`.
    Reference: Merritt, "Hydraulic Control Systems", 1967, sec. 3-4.
    """
    head = 2.0 * (p_from - p_to) / density
    return discharge_coefficient * opening_area * root(head, 2.0 * transition / density)


def rated_orifice_flow(rated_flow, rated_drop, rated_density, density, p_from, p_to, transition):
    """Volume flow of an orifice known by one rated point [m^3/s]: Q = Q_N sqrt(dp/dp_N) sqrt(rho_N/rho).

    Args: rated_flow Q_N [m^3/s] at the pressure difference rated_drop dp_N [Pa] with a fluid of rated_density rho_N
        [kg/m^3]; density rho [kg/m^3]; p_from, p_to [Pa]; transition [Pa], see `regularised_root`.
    Reference: the orifice equation, see `orifice_flow`, divided by itself at the rated point.
    """
    gain = rated_flow * array_module(rated_drop, rated_density, density).sqrt(rated_density / (rated_drop * density))
    return gain * regularised_root(p_from - p_to, transition)


def minor_loss_flow(loss_coefficient, area, density, p_from, p_to, transition):
    """Volume flow through a fitting with the drop dp = K rho V|V|/2 [m^3/s]: Q = A sqrt(2 dp/(K rho)).

    Args: loss_coefficient K [-], of the velocity in the area A [m^2]; density rho [kg/m^3]; p_from, p_to [Pa];
        transition [Pa], see `regularised_root`.
    Validity: turbulent flow, |dp| >> transition.
    Typical values: bend 0.2..1, sudden expansion (1 - A_1/A_2)^2 (Borda-Carnot, exact for uniform flow).
    Reference: Idelchik, "Handbook of Hydraulic Resistance" (definition of K).
    """
    coefficient = 1.0 / array_module(loss_coefficient).sqrt(loss_coefficient)
    return orifice_flow(area, coefficient, density, p_from, p_to, transition)


def annular_leak_flow(diameter, clearance, length, eccentricity, viscosity, drop):
    """Laminar flow through the gap between piston and bore [m^3/s]: Q = pi D h^3 dp/(12 mu L) (1 + 1.5 eps^2).

    Args: diameter D [m]; clearance h, radial, of the centred piston [m]; length L of the gap [m]; eccentricity eps
        [-]: 0 centred, 1 touching; viscosity mu, dynamic [Pa s]; drop dp [Pa].
    Validity: h << D, laminar, no motion of the piston; the factor is the mean of (1 + eps cos phi)^3.
    Typical values: h 5e-6..2e-5 m.
    Reference: plane Poiseuille flow around the gap; Merritt, "Hydraulic Control Systems", 1967, sec. 3-3 (section
        unverified: quoted from memory).
    """
    gap = np.pi * diameter * clearance * clearance * clearance / (12.0 * viscosity * length)
    return gap * (1.0 + 1.5 * eccentricity * eccentricity) * drop


def passed(at: Situation, volume_flow) -> Contribution:
    """A volume flow from port a to port b at the density of their mean pressure, mass conserved."""
    mass = at.fluid.mass_flow(volume_flow, at.potential["a"], at.potential["b"])
    return Contribution(flow={"a": -mass, "b": mass})


def soft_positive(x, width):
    """A smooth max(x, 0): exactly 0 below -width, exactly x above +width, a quartic between (twice differentiable)."""
    xp = array_module(x, width)
    share = xp.clip(0.5 * (x / width + 1.0), 0.0, 1.0)
    return xp.where(x >= width, x, width * share * share * share * (2.0 - share))


def soft_clip(x, width):
    """A smooth clip of x to 0..1: exactly 0 below 0, exactly 1 above 1, a straight line but for its rounded ends.

    Args: x; width of each rounded end is 2 width, below 0.5 [-]. Twice differentiable, monotone, within `width` of
        the sharp clip; slope 1/(1 - 2 width) in the middle.
    """
    inside = array_module(x, width).clip(x, 0.0, 1.0)  # its halved derivative at the ends meets a slope of zero
    risen = soft_positive(inside - width, width) - soft_positive(inside - 1.0 + width, width)
    return risen / (1.0 - 2.0 * width)


class LaminarLeak(AbstractComponent):
    """A leakage proportional to the pressure difference: Q = G (p_a - p_b).

    Args: a, b: nodes; conductance G [m^3/(s Pa)].
    Validity: Re below about 1000 in the gap. Zero conductance is legal.
    Typical values: motor leakage 1e-12..1e-11 m^3/(s Pa).
    """

    a: str = port()
    b: str = port()
    conductance: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?")

    def evaluate(self, at: Situation) -> Contribution:
        return passed(at, self.conductance * (at.potential["a"] - at.potential["b"]))


class AnnularLeak(AbstractComponent):
    """The leakage along a piston or spool in its bore, by dimensions and the fluid's viscosity.

    Args: a, b: nodes; diameter D [m]; clearance h, radial [m]; length L [m]; eccentricity eps [-], 0 centred to 1
        touching. Viscosity is taken at the mean of both pressures.
    Validity, typical values, reference: see `annular_leak_flow`.
    """

    a: str = port()
    b: str = port()
    diameter: Number = quantity("m", low=1e-4, high=10.0, slip="was it given in mm?")
    clearance: Number = quantity("m", low=0.0, high=1e-3, slip="was it given in micrometres or mm?")
    length: Number = quantity("m", low=1e-5, high=10.0, slip="was it given in mm?")
    eccentricity: Number = quantity("1", low=0.0, high=1.0, slip="was it given in percent or m?", default=0.0)

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        viscosity = at.fluid.dynamic_viscosity(0.5 * (p_a + p_b))
        gap = (self.diameter, self.clearance, self.length, self.eccentricity)
        return passed(at, annular_leak_flow(*gap, viscosity, p_a - p_b))


class Orifice(AbstractComponent):
    """A sharp-edged orifice with a regularised square root: Q = C_d A sqrt(2 dp/rho).

    Args: a, b: nodes; area A, a number or an input [m^2]; discharge_coefficient C_d [-];
        transition: dp_t, below which the flow turns laminar [Pa]; regularisation: "fourth_root" (default),
        dp/(dp^2 + dp_t^2)^(1/4) in place of the root, or "two_regime" of Ellman and Piche: exact above dp_t.
    Raises: ValueError for an unknown regularisation.
    Validity: turbulent flow at |dp| >> transition (fourth root: 0.25 % low at 10 transition).
    Typical values: C_d 0.6..0.7; a transition of 1e3..1e4 Pa suits calibration (the physical one, see
        `transition_pressure`, is often a few Pa, which makes the equations stiff and changes nothing else).
    Reference: see `orifice_flow`, `regularised_root` and `two_regime_root`.
    """

    a: str = port()
    b: str = port()
    area: Number = driven("m^2", low=0.0, high=100.0, slip="was it given in mm^2?")
    discharge_coefficient: Number = quantity("1", low=0.01, high=2.0, default=0.62)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e3)
    regularisation: str = eqx.field(static=True, default="fourth_root")

    def __check_init__(self):
        if self.regularisation not in ROOTS:
            raise ValueError(f"regularisation must be one of {', '.join(ROOTS)}, got {self.regularisation!r}")

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density, root = at.fluid.density_at(0.5 * (p_a + p_b)), ROOTS[self.regularisation]
        area, coefficient = at.given["area"], self.discharge_coefficient
        return passed(at, orifice_flow(area, coefficient, density, p_a, p_b, self.transition, root))


class MinorLoss(AbstractComponent):
    """The loss of a bend, a fitting or a change of section: dp = K rho V|V|/2, solved for the flow.

    Args: a, b: nodes; loss_coefficient K [-], of the velocity V = Q/A in the area A [m^2]; transition [Pa]: below it
        the flow turns laminar. It is an orifice with C_d = 1/sqrt(K).
    Validity: turbulent; the same K in both directions. Losses inside a line belong to its loss_coefficient.
    Typical values, reference: see `minor_loss_flow`.
    """

    a: str = port()
    b: str = port()
    loss_coefficient: Number = quantity("1", low=1e-6, high=1e9)
    area: Number = quantity("m^2", low=0.0, high=1e3, slip="was it given in mm^2?")
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e3)

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density = at.fluid.density_at(0.5 * (p_a + p_b))
        return passed(at, minor_loss_flow(self.loss_coefficient, self.area, density, p_a, p_b, self.transition))
