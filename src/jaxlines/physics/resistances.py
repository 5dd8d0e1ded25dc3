"""Elements that let fluid pass against a pressure difference: laminar leak and orifice."""

import jax.numpy as jnp

from jaxlines.physics.component import AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import Number, driven, port, quantity


def regularised_root(x, transition):
    """A smooth, odd sign(x) sqrt(|x|) with finite slope at zero: x / (x^2 + transition^2)^(1/4).

    Within 0.25 % of the root for |x| > 10 transition. Infinitely differentiable, slope transition^(-1/2) at 0.
    Reference: Modelica Standard Library, Modelica.Fluid.Utilities.regRoot.
    """
    return x / jnp.sqrt(jnp.sqrt(x * x + transition * transition))


def orifice_flow(opening_area, discharge_coefficient, density, p_from, p_to, transition):
    """Volume flow through a sharp-edged orifice [m^3/s]: Q = C_d A sqrt(2 dp/rho), smooth through dp = 0.

    Args: opening_area A [m^2]; discharge_coefficient C_d [-]; density rho [kg/m^3]; p_from, p_to [Pa];
        transition: pressure difference below which the flow turns laminar [Pa].
    Reference: Merritt, "Hydraulic Control Systems", 1967, sec. 3-4.
    """
    head = 2.0 * (p_from - p_to) / density
    return discharge_coefficient * opening_area * regularised_root(head, 2.0 * transition / density)


def _pass(at: Situation, volume_flow) -> Contribution:
    """A volume flow from port a to port b, mass conserved."""
    mass = at.fluid.mass_flow(volume_flow, at.potential["a"], at.potential["b"])
    return Contribution(flow={"a": -mass, "b": mass})


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
        return _pass(at, self.conductance * (at.potential["a"] - at.potential["b"]))


class Orifice(AbstractComponent):
    """A sharp-edged orifice with a regularised square root: Q = C_d A dp/(dp^2 + dp_t^2)^(1/4) sqrt(2/rho).

    Args: a, b: nodes; area A, a number or an input [m^2]; discharge_coefficient C_d [-];
        transition: dp_t, below which the flow turns laminar [Pa].
    Validity: turbulent flow at |dp| >> transition (0.25 % low at 10 transition).
    Typical values: C_d 0.6..0.7; a transition of 1e3..1e4 Pa suits calibration (the physical one is often
        a few Pa, which makes the equations stiff and changes nothing else).
    Reference: see `orifice_flow` and `regularised_root`.
    """

    a: str = port()
    b: str = port()
    area: Number = driven("m^2", low=0.0, high=100.0, slip="was it given in mm^2?")
    discharge_coefficient: Number = quantity("1", low=0.01, high=2.0, default=0.62)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e3)

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density = at.fluid.density_at(0.5 * (p_a + p_b))
        area, coefficient = at.given["area"], self.discharge_coefficient
        return _pass(at, orifice_flow(area, coefficient, density, p_a, p_b, self.transition))
