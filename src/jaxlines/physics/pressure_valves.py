"""Valves that pressure opens or closes: check, relief, counterbalance, pressure-reducing.

All have the same laws: an opening x between 0 and 1 that follows its steady value x_ss, a smooth clip of a pressure
ratio (`soft_clip`: exactly closed and exactly open beyond its ends), with a lag of first order, and the flow of an
orifice that is rated when fully open, Q = x Q_N sqrt(dp/dp_N) sqrt(rho_N/rho).

What is left out: hysteresis (friction of the poppet), flow forces (their effect is in the override p_full - p_set),
and the mass of the poppet.
"""

from dataclasses import MISSING
from typing import Any

import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, port, quantity
from jaxlines.physics.resistances import passed, rated_orifice_flow, soft_clip

OPENING = State("opening", "1", 1.0)


def pressure_opening(pressure, from_pressure, to_pressure, width):
    """Steady opening of a valve that a pressure opens [-]: 0 up to from_pressure, 1 from to_pressure on [Pa], smooth.

    Args: width of the rounded ends, see `soft_clip` [-].
    Reference: clip((p - p_set)/(p_full - p_set), 0, 1) of OpenHydraulics and Simscape Fluids, here with rounded ends.
    """
    return soft_clip((pressure - from_pressure) / (to_pressure - from_pressure), width)


def _pressure(default: Any = MISSING):
    """Field: a pressure difference above zero [Pa]."""
    return quantity("Pa", low=0.0, high=1e9, slip="was it given in bar?", default=default)


def _rated_flow():
    return quantity("m^3/s", low=0.0, high=10.0, slip="was it given in L/min?")


def _time_constant(default):
    return quantity("s", low=1e-6, high=1e3, slip="was it given in ms?", default=default)


def _width():
    return quantity("1", low=1e-6, high=0.49, slip="was it given in percent or Pa?", default=0.1)


def _density():
    return quantity("kg/m^3", low=100.0, high=3000.0, slip="was it given in g/cm^3?", default=850.0)


def _transition(default):
    return quantity("Pa", low=1e-3, high=1e7, default=default)


def check_order(low_name: str, low, high_name: str, high) -> None:
    """Raise ValueError unless one concrete pressure is above another."""
    if isinstance(low, np.ndarray) and isinstance(high, np.ndarray) and np.any(high <= low):
        raise ValueError(f"{high_name} must be above {low_name}, got {high:g} Pa and {low:g} Pa: were they swapped?")


def _rated_pass(valve: Any, at: Situation, opening, rated_drop) -> dict:
    """Mass flows into a and b through an opening, from the rated point of the valve."""
    p_a, p_b = at.potential["a"], at.potential["b"]
    density = at.fluid.density_at(0.5 * (p_a + p_b))
    rating = (valve.rated_flow, rated_drop, valve.rated_density)
    return passed(at, opening * rated_orifice_flow(*rating, density, p_a, p_b, valve.transition)).flow


class CheckValve(AbstractComponent):
    """A check valve from a to b: x_ss = clip((dp - p_crack)/(p_full - p_crack)), Q = x Q_N sqrt(dp/p_full).

    Args: a, b: nodes; rated_flow Q_N [m^3/s] at full_opening_pressure p_full, at which it is fully open [Pa];
        cracking_pressure p_crack, below which it is tight [Pa] (differences both); time_constant of the poppet [s],
        None: it follows at once and has no state; width of the rounded ends of the clip [-]; rated_density of the
        rating [kg/m^3]; transition [Pa], see `Orifice`.
    Raises: ValueError unless p_full is above p_crack.
    Validity: no leakage backwards; with a time constant flow runs backwards while it closes.
    Typical values: cracking 0.5e5 Pa, fully open at 1..3e5 Pa, a few ms (unverified: quoted from memory).
    Reference: check valve of OpenHydraulics, with rounded ends, see `pressure_opening`.
    """

    a: str = port()
    b: str = port()
    rated_flow: Number = _rated_flow()
    cracking_pressure: Number = _pressure(0.5e5)
    full_opening_pressure: Number = _pressure(2e5)
    time_constant: Number | None = _time_constant(None)
    width: Number = _width()
    rated_density: Number = _density()
    transition: Number = _transition(1e3)

    def __check_init__(self):
        names = ("cracking_pressure", "full_opening_pressure")
        check_order(names[0], self.cracking_pressure, names[1], self.full_opening_pressure)

    def states_in(self, fluid) -> tuple[State, ...]:
        return () if self.time_constant is None else (OPENING,)

    def steady_opening(self, drop) -> Number:
        """x_ss [-] at a pressure difference p_a - p_b [Pa]."""
        return pressure_opening(drop, self.cracking_pressure, self.full_opening_pressure, self.width)

    def start(self, at: Situation) -> dict:
        steady = self.steady_opening(at.potential["a"] - at.potential["b"])
        return {} if self.time_constant is None else {"opening": steady}

    def evaluate(self, at: Situation) -> Contribution:
        steady = self.steady_opening(at.potential["a"] - at.potential["b"])
        if self.time_constant is None:
            return Contribution(flow=_rated_pass(self, at, steady, self.full_opening_pressure))
        opening = at.state["opening"]
        flow = _rated_pass(self, at, opening, self.full_opening_pressure)
        return Contribution(flow=flow, rate={"opening": (steady - opening) / self.time_constant})


class ReliefValve(AbstractComponent):
    """A relief valve from a to b: x_ss = clip((p_a - p_b - p_set)/(p_full - p_set)), tau x' = x_ss - x.

    Q = x Q_N sqrt(dp/p_full): tight up to p_set, the rated flow at p_full.

    Args: a: node that is protected; b: node it relieves to; rated_flow Q_N [m^3/s] at full_flow_pressure p_full;
        set_pressure p_set, full_flow_pressure [Pa], both differences p_a - p_b; time_constant tau [s]; width of the
        rounded ends of the clip [-]; rated_density of the rating [kg/m^3]; transition [Pa], see `Orifice`.
    Raises: ValueError unless p_full is above p_set.
    Validity: no hysteresis: opens and closes at the same pressures (Hopsan's has 0.5 MPa by default). Beyond p_full
        it is an orifice. Starts at its steady opening.
    Typical values: p_full 1.05 p_set (pilot operated) to 1.2 p_set (direct), tau 0.01 s.
    Reference: relief valve of OpenHydraulics (p_full = 1.05 p_set, tau 0.01 s), see `pressure_opening`.
    """

    a: str = port()
    b: str = port()
    rated_flow: Number = _rated_flow()
    set_pressure: Number = _pressure()
    full_flow_pressure: Number = _pressure()
    time_constant: Number = _time_constant(0.01)
    width: Number = _width()
    rated_density: Number = _density()
    transition: Number = _transition(1e4)

    states = (OPENING,)

    def __check_init__(self):
        check_order("set_pressure", self.set_pressure, "full_flow_pressure", self.full_flow_pressure)

    def steady_opening(self, drop) -> Number:
        """x_ss [-] at a pressure difference p_a - p_b [Pa]."""
        return pressure_opening(drop, self.set_pressure, self.full_flow_pressure, self.width)

    def start(self, at: Situation) -> dict:
        return {"opening": self.steady_opening(at.potential["a"] - at.potential["b"])}

    def evaluate(self, at: Situation) -> Contribution:
        steady, opening = self.steady_opening(at.potential["a"] - at.potential["b"]), at.state["opening"]
        flow = _rated_pass(self, at, opening, self.full_flow_pressure)
        return Contribution(flow=flow, rate={"opening": (steady - opening) / self.time_constant})


class CounterbalanceValve(AbstractComponent):
    """A counterbalance (over-centre) valve from the load a to b, opened by the load and, R times as well, by a pilot.

    x_ss = clip((p_a + R p_pilot - (1 + R) p_b - p_set)/(p_full - p_set)), tau x' = x_ss - x,
    Q = x Q_N sqrt(dp/dp_N)

    Args: a: node of the load; b: node it flows to; pilot: node that helps to open, it takes no flow; rated_flow Q_N
        [m^3/s] at rated_pressure_drop dp_N [Pa] when fully open; set_pressure p_set [Pa] at which the load alone
        opens it; full_opening_pressure p_full [Pa]; pilot_ratio R, pilot area over seat area [-]; time_constant tau
        [s]; width of the rounded ends of the clip [-]; rated_density of the rating [kg/m^3]; transition [Pa].
    Raises: ValueError unless p_full is above p_set.
    Validity: not vented: the spring chamber is at p_b, so that back pressure closes it. Free flow from b to a needs
        a `CheckValve` beside it. No hysteresis.
    Typical values: R 3..10, p_set 1.3 times the highest load pressure (unverified: quoted from memory).
    Reference: balance of forces on the poppet, with the areas 1, R and 1 + R at a, pilot and spring chamber.
    """

    a: str = port()
    b: str = port()
    pilot: str = port()
    rated_flow: Number = _rated_flow()
    set_pressure: Number = _pressure()
    full_opening_pressure: Number = _pressure()
    pilot_ratio: Number = quantity("1", low=0.0, high=50.0, default=4.0)
    rated_pressure_drop: Number = quantity("Pa", low=1e4, high=1e9, slip="was it given in bar?", default=1e6)
    time_constant: Number = _time_constant(0.01)
    width: Number = _width()
    rated_density: Number = _density()
    transition: Number = _transition(1e4)

    states = (OPENING,)

    def __check_init__(self):
        check_order("set_pressure", self.set_pressure, "full_opening_pressure", self.full_opening_pressure)

    def steady_opening(self, p_a, p_b, p_pilot) -> Number:
        """x_ss [-] at the pressures of load, outlet and pilot [Pa]."""
        opening = p_a - p_b + self.pilot_ratio * (p_pilot - p_b)
        return pressure_opening(opening, self.set_pressure, self.full_opening_pressure, self.width)

    def start(self, at: Situation) -> dict:
        return {"opening": self.steady_opening(*(at.potential[p] for p in ("a", "b", "pilot")))}

    def evaluate(self, at: Situation) -> Contribution:
        steady = self.steady_opening(*(at.potential[p] for p in ("a", "b", "pilot")))
        flow = _rated_pass(self, at, at.state["opening"], self.rated_pressure_drop)
        return Contribution(flow=flow, rate={"opening": (steady - at.state["opening"]) / self.time_constant})


class ReducingValve(AbstractComponent):
    """A pressure-reducing valve from a to b: closes as the pressure at b reaches what it is set to.

    x_ss = clip((p_set - (p_b - p_drain))/p_band), tau x' = x_ss - x, Q = x Q_N sqrt(dp/dp_N)

    Args: a: supply; b: node whose pressure is held; drain: node of the spring chamber, usually the tank, it takes no
        flow; rated_flow Q_N [m^3/s] at rated_pressure_drop dp_N [Pa] when fully open; set_pressure p_set [Pa], of b
        above the drain, at which it is closed; pressure_band p_band [Pa] below p_set, over which it opens fully;
        time_constant tau [s]; width of the rounded ends of the clip [-]; rated_density of the rating [kg/m^3];
        transition [Pa].
    Validity: two-port: does not relieve b when that is pushed above p_set from outside. No hysteresis.
    Typical values: band 0.05..0.2 p_set, tau 0.005..0.02 s (unverified: quoted from memory).
    Reference: pressure-compensated orifice with a proportional spring, the mirror image of `ReliefValve`; Merritt,
        "Hydraulic Control Systems", 1967 (treats single-stage reducing valves; unverified: quoted from memory).
    """

    a: str = port()
    b: str = port()
    drain: str = port()
    rated_flow: Number = _rated_flow()
    set_pressure: Number = _pressure()
    pressure_band: Number = quantity("Pa", low=1e2, high=1e9, slip="was it given in bar?", default=5e5)
    rated_pressure_drop: Number = quantity("Pa", low=1e4, high=1e9, slip="was it given in bar?", default=1e6)
    time_constant: Number = _time_constant(0.01)
    width: Number = _width()
    rated_density: Number = _density()
    transition: Number = _transition(1e4)

    states = (OPENING,)

    def steady_opening(self, held) -> Number:
        """x_ss [-] at the pressure of b above the drain [Pa]."""
        return soft_clip((self.set_pressure - held) / self.pressure_band, self.width)

    def start(self, at: Situation) -> dict:
        return {"opening": self.steady_opening(at.potential["b"] - at.potential["drain"])}

    def evaluate(self, at: Situation) -> Contribution:
        steady = self.steady_opening(at.potential["b"] - at.potential["drain"])
        flow = _rated_pass(self, at, at.state["opening"], self.rated_pressure_drop)
        return Contribution(flow=flow, rate={"opening": (steady - at.state["opening"]) / self.time_constant})
