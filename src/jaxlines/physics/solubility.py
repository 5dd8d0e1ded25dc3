"""How much of the air in a liquid is undissolved at equilibrium, as a function of absolute pressure.

The undissolved fraction theta is 1 in bubbles and 0 where all air is dissolved. SI units, element by element.
"""

from abc import abstractmethod

import equinox as eqx
import numpy as np

from jaxlines.physics.fields import ATMOSPHERE, Number, array_module, check_fields, quantity


def linear_undissolved(p, saturation_pressure):
    """Undissolved fraction of air, linear in pressure: 1 up to p0, (p_c - p)/(p_c - p0), 0 from p_c on [-].

    Args: p absolute [Pa]; saturation_pressure p_c, above 101325 Pa [Pa].
    Typical values: 0.2e6..10e6 Pa; 3e6 Pa is the default of Simscape. See `henry_saturation_pressure`.
    Reference: MathWorks, Simscape, "Isothermal Liquid Modeling Options" (entrained air dissolves linearly).
    """
    xp = array_module(p, saturation_pressure)
    share = (saturation_pressure - p) / (saturation_pressure - ATMOSPHERE)
    return xp.where(p <= ATMOSPHERE, 1.0, xp.where(p < saturation_pressure, share, 0.0))


def polynomial_undissolved(p, saturation_pressure, vapour_pressure_high):
    """Undissolved fraction of air by the polynomial of five terms, four times differentiable [-].

    theta = (1 - x)^5 (1 + 5 x + 15 x^2 + 35 x^3 + 70 x^4),  x = (p - p_vh)/(p_sat - p_vh) within 0..1

    Args: p absolute [Pa]; saturation_pressure p_sat, above which all air is dissolved [Pa];
        vapour_pressure_high p_vh, below which none is [Pa].
    Reference: Imagine, AMESim technical bulletin 117 (unverified: quoted from memory).
    """
    x = _polynomial_place(p, saturation_pressure, vapour_pressure_high)
    y = 1.0 - x
    return y * y * y * y * y * (1.0 + x * (5.0 + x * (15.0 + x * (35.0 + x * 70.0))))


def _polynomial_place(p, saturation_pressure, vapour_pressure_high):
    """x of `polynomial_undissolved`, within 0..1."""
    xp = array_module(p, saturation_pressure, vapour_pressure_high)
    return xp.clip((p - vapour_pressure_high) / (saturation_pressure - vapour_pressure_high), 0.0, 1.0)


def henry_saturation_pressure(air_ratio, bunsen_coefficient):
    """Pressure above which all air is dissolved by Henry's law, p_c = p0 (1 + R/a_B) [Pa].

    Args: air_ratio R, free air per volume of liquid at p0 [-]; bunsen_coefficient a_B, dissolved air (as volume
        at p0) per volume of liquid and p/p0 [-].
    Validity: at equilibrium. Pressures of MPa in other tools are effective ones of fast events.
    Typical values: a_B 0.08..0.09 for mineral oil (unverified: quoted from memory): 1 % air is gone at 0.113 MPa.
    """
    return ATMOSPHERE * (1.0 + air_ratio / bunsen_coefficient)


class AbstractSolubility(eqx.Module):
    """How much of the air is undissolved at equilibrium, as a function of pressure."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def undissolved(self, p, air_ratio) -> Number:
        """theta(p) [-] at absolute pressure p [Pa], with the free air at p0 per volume of liquid [-]."""

    @abstractmethod
    def dissolving(self, p, air_ratio) -> Number:
        """-d theta/dp [1/Pa]."""

    def air_content(self, air_ratio):
        """Volume at p0 of all air that can be in bubbles, per volume of liquid [-]; the default: the free air."""
        return air_ratio


class LinearSolubility(AbstractSolubility):
    """Linear in pressure, with corners at p0 and at the saturation pressure. See `linear_undissolved`."""

    saturation_pressure: Number = quantity(
        "Pa", low=1.02e5, high=1e9, slip="it is absolute and above atmospheric pressure", level=True, default=3e6
    )

    def undissolved(self, p, air_ratio) -> Number:
        return linear_undissolved(p, self.saturation_pressure)

    def dissolving(self, p, air_ratio) -> Number:
        between = (p > ATMOSPHERE) & (p < self.saturation_pressure)
        return array_module(self, p).where(between, 1.0 / (self.saturation_pressure - ATMOSPHERE), 0.0)


class PolynomialSolubility(AbstractSolubility):
    """Smooth in pressure. See `polynomial_undissolved`.

    The air fraction of the fluid is here that of all its air; at p0 a little of it is already dissolved.
    Raises: ValueError when the pressures are in the wrong order.
    """

    saturation_pressure: Number = quantity(
        "Pa", low=1e3, high=1e9, slip="it is an absolute pressure", level=True, default=3e6
    )
    vapour_pressure_high: Number = quantity(
        "Pa", low=0.0, high=1e6, slip="it is an absolute pressure", level=True, default=2e3
    )

    def __check_init__(self):
        low, high = self.vapour_pressure_high, self.saturation_pressure
        if isinstance(low, np.ndarray) and isinstance(high, np.ndarray) and np.any(low >= high):
            raise ValueError("vapour_pressure_high must be below saturation_pressure: were they swapped?")

    def undissolved(self, p, air_ratio) -> Number:
        return polynomial_undissolved(p, self.saturation_pressure, self.vapour_pressure_high)

    def dissolving(self, p, air_ratio) -> Number:
        x = _polynomial_place(p, self.saturation_pressure, self.vapour_pressure_high)
        bell = x * (1.0 - x)
        return 630.0 * bell * bell * bell * bell / (self.saturation_pressure - self.vapour_pressure_high)


class HenrySolubility(AbstractSolubility):
    """Henry's law for a liquid that is saturated at p0: the dissolved volume is a_B p/p0 per volume of liquid.

    All air, free and dissolved, is R + a_B at p0 and stays the same:

        (R + a_B) theta(p) + a_B p/p0 = R + a_B,   so that   theta(p) = 1 - p/p_c,   p_c = p0 (1 + R/a_B)

    The undissolved fraction of ALL air is linear from 1 in vacuum over R/(R + a_B) at p0 to 0 at p_c. Below p0
    air that was dissolved comes out, even where there are no bubbles at p0. A liquid that is not saturated at
    p0 is better described by `LinearSolubility`. Vapour pressure is neglected against p in theta.
    """

    bunsen_coefficient: Number = quantity("1", low=1e-4, high=1.0, slip="was it given in percent?", default=0.09)

    def undissolved(self, p, air_ratio) -> Number:
        saturation = henry_saturation_pressure(air_ratio, self.bunsen_coefficient)
        return array_module(self, p, air_ratio).where(p < saturation, 1.0 - p / saturation, 0.0)

    def dissolving(self, p, air_ratio) -> Number:
        saturation = henry_saturation_pressure(air_ratio, self.bunsen_coefficient)
        return array_module(self, p, air_ratio).where(p < saturation, 1.0 / saturation, 0.0)

    def air_content(self, air_ratio):
        return air_ratio + self.bunsen_coefficient
