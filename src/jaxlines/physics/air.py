"""Air in oil: the volume of its bubbles, how it dissolves and comes out again, and vapour as the lower end.

Per unit volume of liquid at p0 = 101325 Pa the gas takes the volume R theta(p) (p0/p)^(1/n), where theta is
the undissolved fraction of the air and R the volume of all air that can be in bubbles. How theta follows the
pressure is what the laws differ in; where dissolution is slow, theta is a state of its own in each volume.

`vapour="in_bubbles"` adds the lower end: a bubble holds air at the partial pressure p - p_v and saturated
vapour at p_v (Dalton), so that its volume grows without bound as p falls to p_v, and no clamp is needed to
hold the pressure above it. The mass of the vapour is counted as liquid. It takes some air to have a bubble.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from jaxlines.physics.fields import ATMOSPHERE, Number, array_module, check_fields, quantity
from jaxlines.physics.solubility import AbstractSolubility, LinearSolubility

_PRESSURE_FLOOR = 1.0
# The gas law has no value at p <= 0. Only a rejected trial step of the solver can get there, since a volume
# with air grows infinitely compliant as p -> 0; the floor keeps such a trial finite so it can be rejected.


def _at_least(x, floor):
    """The larger of two numbers, with the derivative of x where they are equal: one selection, as is its derivative."""
    return array_module(x, floor).where(x < floor, floor, x)


def gas_modulus(p, polytropic_index, vapour_pressure=0.0):
    """Tangent modulus of a bubble, n (p - p_v) [Pa].

    Args: p absolute [Pa]; polytropic_index n [-]; vapour_pressure p_v of the liquid [Pa], 0 for a bubble of
        air alone.
    """
    return polytropic_index * _at_least(p - vapour_pressure, _PRESSURE_FLOOR)


def gas_volume(p, polytropic_index, vapour_pressure=0.0):
    """Volume of a bubble relative to that at p0 = 101325 Pa, ((p0 - p_v)/(p - p_v))^(1/n) [-].

    Args: as for `gas_modulus`, which is the derivative.
    Validity: ideal gas; n = 1 isothermal (slow, small bubbles) to 1.4 adiabatic (above some 10 Hz).
    Reference: with p_v = 0 Cho, Lee and Oh 2002; with p_v and n = 1 Wylie, "Simulation of vaporous and gaseous
        cavitation", J. Fluids Engineering 106, 1984 (unverified: quoted from memory).
    """
    xp = array_module(p, polytropic_index, vapour_pressure)
    air = _at_least(p - vapour_pressure, _PRESSURE_FLOOR)
    return xp.exp(-xp.log(air / (ATMOSPHERE - vapour_pressure)) / polytropic_index)


class AbstractAir(eqx.Module):
    """What the air of a fluid does. `Oil` makes volume, modulus and density of it."""

    vapour: str = eqx.field(static=True, default="ignored", kw_only=True)
    """Whether vapour is in the bubbles; see the head of this file."""
    kinetic: ClassVar[bool] = False
    """Whether the undissolved fraction is a state that lives in each volume."""
    liquid_frozen: ClassVar[bool] = False
    """Whether the modulus holds the volume of the liquid at 1, so that no density goes with it."""

    def __check_init__(self):
        check_fields(self)
        if self.vapour not in ("ignored", "in_bubbles"):
            raise ValueError(f'vapour must be "ignored" or "in_bubbles", got {self.vapour!r}')

    @abstractmethod
    def undissolved(self, p, air_ratio) -> Number:
        """theta(p) at equilibrium [-], with the free air at p0 per volume of liquid [-]."""

    @abstractmethod
    def dissolving(self, p, air_ratio) -> Number:
        """The part of -d theta/dp that counts as compliance [1/Pa]."""

    def air_content(self, air_ratio):
        """Volume at p0 of all air that can be in bubbles, per volume of liquid [-]; the default: the free air."""
        return air_ratio

    def rate(self, p, undissolved, air_ratio):
        """d theta/dt [1/s] where theta is a state; the default: it stays."""
        return 0.0 * undissolved + 0.0 * p

    def gas_pressure(self, p):
        """Pressure that the gas is under [Pa]; the default: that of the liquid."""
        return p

    def vapour_pressure(self, vapour_pressure):
        """What of the liquid's vapour pressure is in the bubbles [Pa]."""
        return vapour_pressure if self.vapour == "in_bubbles" else 0.0


class FreeAir(AbstractAir):
    """Air that does not dissolve: theta = 1.

    Args: vapour: "ignored", or "in_bubbles" for the vapour pressure as lower end.
    Validity: events faster than dissolution (seconds), pressures where bubbles do not vanish.
    Reference: Cho, Lee and Oh, Int. J. Automotive Technology 3(2), 2002.
    """

    def undissolved(self, p, air_ratio) -> Number:
        return 1.0

    def dissolving(self, p, air_ratio) -> Number:
        return 0.0


class DissolvingAir(AbstractAir):
    """Air that is dissolved at equilibrium with the pressure at every instant.

    Args:
        solubility: a law for theta(p).
        convention: "equilibrium": dissolution is compliance too, K = -v dp/dv; where theta has a corner, K
            jumps and it may fall with pressure. "frozen": theta is that of the pressure, but waves are too
            fast for it to change, so that K is higher. In a simulation only the first conserves mass; what
            is between the two is `KineticAir`.
        vapour: "ignored", or "in_bubbles" for the vapour pressure as lower end.
    """

    solubility: AbstractSolubility = LinearSolubility()
    convention: str = eqx.field(static=True, default="equilibrium")

    def __check_init__(self):
        if self.convention not in ("equilibrium", "frozen"):
            raise ValueError(f'convention must be "equilibrium" or "frozen", got {self.convention!r}')

    def undissolved(self, p, air_ratio) -> Number:
        return self.solubility.undissolved(p, air_ratio)

    def dissolving(self, p, air_ratio) -> Number:
        return self.solubility.dissolving(p, air_ratio) if self.convention == "equilibrium" else 0.0

    def air_content(self, air_ratio):
        return self.solubility.air_content(air_ratio)


class KineticAir(AbstractAir):
    """Air that comes out fast and dissolves slowly: theta is a state of each volume.

    d theta/dt = (theta_eq(p) - theta)/tau,  tau = release_time where air comes out, absorption_time where it
    dissolves, with a smooth switch s = (1 + tanh((theta_eq - theta)/w))/2 between the two rates.

    Args: solubility: a law for theta_eq(p); release_time, absorption_time [s]; transition: w, the distance
        from equilibrium over which the rate switches [-]; vapour: as for the other laws.
    Validity: a well mixed volume; the times depend on bubble size and agitation, so they are to be fitted.
        Where no state is known, at ports, theta is that of equilibrium.
    Typical values: release 0.1..1 s, absorption 10..100 s (unverified: quoted from memory).
    """

    solubility: AbstractSolubility = LinearSolubility()
    release_time: Number = quantity("s", low=1e-6, high=1e6, slip="was it given in ms?", default=0.5)
    absorption_time: Number = quantity("s", low=1e-6, high=1e6, slip="was it given in ms?", default=30.0)
    transition: Number = quantity("1", low=1e-6, high=1.0, default=0.01)

    kinetic: ClassVar[bool] = True

    def undissolved(self, p, air_ratio) -> Number:
        return self.solubility.undissolved(p, air_ratio)

    def dissolving(self, p, air_ratio) -> Number:
        return 0.0

    def air_content(self, air_ratio):
        return self.solubility.air_content(air_ratio)

    def rate(self, p, undissolved, air_ratio):
        missing = self.solubility.undissolved(p, air_ratio) - undissolved
        switch = 0.5 * (1.0 + array_module(self, p, undissolved).tanh(missing / self.transition))
        slow, fast = 1.0 / self.absorption_time, 1.0 / self.release_time
        return missing * (slow + (fast - slow) * switch)


class LegacySimscapeAir(AbstractAir):
    """The modulus of SimHydraulics and Simscape's former hydraulic blocks, which MapleSim has too.

    K = K_l (1 + r)/(1 + r K_l/(n p)),  r = R (p0/p)^(1/n)

    The liquid's volume is held at 1, so that no density is consistent with it: it is for `mass="article"` only,
    to repeat results of those tools. Air does not dissolve.

    Args: pressure_floor: the modulus is that of this pressure below it [Pa absolute].
    Reference: MathWorks, SimHydraulics, block "Hydraulic Fluid"; see `published_moduli.simhydraulics_modulus`.
    """

    pressure_floor: Number = quantity("Pa", low=1.0, high=1e5, slip="it is an absolute pressure", default=1e4)

    liquid_frozen: ClassVar[bool] = True

    def __check_init__(self):
        if self.vapour != "ignored":
            raise ValueError("LegacySimscapeAir knows no vapour pressure: leave vapour as it is")

    def undissolved(self, p, air_ratio) -> Number:
        return 1.0

    def dissolving(self, p, air_ratio) -> Number:
        return 0.0

    def gas_pressure(self, p):
        return _at_least(p, self.pressure_floor)
