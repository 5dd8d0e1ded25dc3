"""Spools and their lands, and the four-way servovalve: what all valves with a spool share stands here."""

from typing import Any, NamedTuple

import equinox as eqx

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, array_module, driven, port, quantity
from jaxlines.physics.resistances import rated_orifice_flow

ORDERS, OPENINGS = ("first", "second"), ("smooth", "sharp")


def land_opening(stroke, underlap):
    """Opening of a land, max(stroke, 0) made smooth: (x + sqrt(x^2 + u^2))/2 [-].

    At the null it is underlap/2, which stands for the null leakage of a real valve as well.
    """
    return 0.5 * (stroke + array_module(stroke, underlap).sqrt(stroke * stroke + underlap * underlap))


def lapped_opening(stroke, lap, underlap, opening: str = "smooth"):
    """Opening of a land that the spool uncovers after its lap, 1 at full stroke: max((x - l)/(1 - l), 0) [-].

    Args: stroke x, positive when it opens this land [-]; lap l, overlap positive, underlap negative [-]; underlap u
        that makes the edge smooth [-]; opening: "smooth", see `land_opening`, or "sharp", max(x, 0) itself.
    """
    stroke = (stroke - lap) / (1.0 - lap)
    if opening == "sharp":
        return array_module(stroke).where(stroke > 0.0, stroke, 0.0)
    return land_opening(stroke, underlap)


def limited_rate(rate, limit):
    """A rate that saturates smoothly: v/(1 + (v/V)^4)^(1/4); V may be infinite. 0.84 V is reached at v = V."""
    ratio = rate / limit
    square = ratio * ratio
    xp = array_module(rate, limit)
    return rate / xp.sqrt(xp.sqrt(1.0 + square * square))


def spool_states(order: str) -> tuple[State, ...]:
    """States of a spool of first or second order, its stroke as a share of the full one."""
    return (State("spool", "1", 1.0), State("spool_rate", "1/s", 100.0))[: 2 if order == "second" else 1]


def spool_rates(order: str, state: dict, demand, frequency, damping_ratio, rate_limit) -> dict:
    """Rates of the states of a spool, with its velocity limited to V.

    First order: x' = sat(w (u - x)). Second order: x' = sat(v), v' = w^2 (u - x) - 2 zeta w v. See `limited_rate`.

    Args: demand u [-]; frequency w [rad/s]; damping_ratio zeta [-], not used in first order; rate_limit V [1/s].
    Reference: Merritt, "Hydraulic Control Systems", 1967, sec. 7-4; the limit is a smooth saturation.
    """
    spool = state["spool"]
    if order == "first":
        return {"spool": limited_rate(frequency * (demand - spool), rate_limit)}
    rate = state["spool_rate"]
    acceleration = frequency * frequency * (demand - spool) - 2.0 * damping_ratio * frequency * rate
    return {"spool": limited_rate(rate, rate_limit), "spool_rate": acceleration}


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Raise ValueError unless a static choice is one of those that exist."""
    if value not in choices:
        raise ValueError(f"{name} must be {' or '.join(map(repr, choices))}, got {value!r}")


class Lands(NamedTuple):
    """The openings of the four lands of a four-way valve, times their gains [-]."""

    supply_a: Any
    supply_b: Any
    a_tank: Any
    b_tank: Any


class LandRating(NamedTuple):
    """What the lands of a four-way valve have in common.

    flow Q_N [m^3/s] through one land at the pressure difference drop [Pa] and opening 1 with a fluid of density
    [kg/m^3]; transition [Pa]; leakage conductance of each land, whatever the opening [m^3/(s Pa)].
    """

    flow: Any
    drop: Any
    density: Any
    transition: Any
    leakage: Any


def land_flow(rating: LandRating, at: Situation, opening, upstream: str, downstream: str):
    """Mass flow through one land, from one port to another [kg/s]."""
    p_from, p_to = at.potential[upstream], at.potential[downstream]
    density = at.fluid.density_at(0.5 * (p_from + p_to))
    rated = (rating.flow, rating.drop, rating.density)
    through = opening * rated_orifice_flow(*rated, density, p_from, p_to, rating.transition)
    return density * (through + rating.leakage * (p_from - p_to))


def four_way_flow(rating: LandRating, at: Situation, lands: Lands) -> dict:
    """Mass flows into the nodes of a four-way valve with the ports supply, tank, a, b [kg/s]."""
    supply_a = land_flow(rating, at, lands.supply_a, "supply", "a")
    supply_b = land_flow(rating, at, lands.supply_b, "supply", "b")
    a_tank, b_tank = (land_flow(rating, at, getattr(lands, f"{p}_tank"), p, "tank") for p in ("a", "b"))
    return {
        "supply": -supply_a - supply_b,
        "tank": a_tank + b_tank,
        "a": supply_a - a_tank,
        "b": supply_b - b_tank,
    }


def land_gain():
    """Field: flow of one land relative to the rated one [-]."""
    return quantity("1", low=0.0, high=100.0, slip="was it given in percent?", default=1.0)


class Servovalve(AbstractComponent):
    """Four-way valve around a critical centre, rated flow, spool of second or first order.

    Rated form per land: Q = Q_N/sqrt(dp_N/2) * gain * opening * sqrt(dp) + G dp, with supply -> a and b -> tank open
    for positive spool, supply -> b and a -> tank for negative; spool x'' + 2 zeta w x' + w^2 x = w^2 u.

    Args: supply, tank, a, b: nodes; command u: stroke demanded, -1..1 (signal or input) [-]; rated_flow
        Q_N [m^3/s] through two lands at rated_pressure_drop dp_N [Pa] and full stroke; natural_frequency
        w [rad/s] (first order: 1/time constant); damping_ratio zeta [-]; underlap: smoothing and null opening, share
        of the stroke [-]; rated_density [kg/m^3] of the rating; transition [Pa]: laminar below this pressure
        difference; lap of all four lands [-], positive is a deadband; gain_...: of each land, where unmatched [-];
        null_leakage G: flow from supply to tank at null with closed ports per pressure difference, beside that of
        the underlap [m^3/(s Pa)]; rate_limit: largest velocity of the spool, smooth, see `limited_rate` [1/s];
        order: "second" or "first"; opening: "smooth", see `land_opening`, or "sharp", max(x, 0).
    Raises: ValueError for an unknown order or opening.
    Validity: no flow forces, leakage that does not depend on the stroke. With mass="article" and the fluid's density
        as rated_density no density plays a role. Laps and limits act as `lapped_opening` and `spool_rates` say.
    Typical values: dp_N 7e6 Pa, zeta 0.7..1, w 2 pi (50..200 Hz), underlap 0.01..0.03, null leakage 0.02 Q_N/dp_N,
        rate limit 50..200 1/s (the last two unverified: quoted from memory).
    Reference: Merritt, "Hydraulic Control Systems", 1967, secs. 5-2 and 7-4 (quoted from memory of the
        book; the orifice law behind it is tested against closed forms).
    """

    supply: str = port()
    tank: str = port()
    a: str = port()
    b: str = port()
    command: Number = driven("1", low=-1.5, high=1.5, slip="was it given in percent?")
    rated_flow: Number = quantity("m^3/s", low=0.0, high=10.0, slip="was it given in L/min?")
    rated_pressure_drop: Number = quantity("Pa", low=1e4, high=1e9, slip="was it given in bar?", default=7e6)
    natural_frequency: Number = quantity("rad/s", low=0.1, high=1e5, slip="was it given in Hz?", default=628.0)
    damping_ratio: Number = quantity("1", low=0.05, high=20.0, default=0.8)
    underlap: Number = quantity("1", low=1e-6, high=0.5, slip="was it given in percent?", default=0.01)
    rated_density: Number = quantity("kg/m^3", low=100.0, high=3000.0, slip="was it given in g/cm^3?", default=850.0)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e4)
    lap: Number = quantity("1", low=-0.9, high=0.9, slip="was it given in percent?", default=0.0)
    gain_supply_a: Number = land_gain()
    gain_supply_b: Number = land_gain()
    gain_a_tank: Number = land_gain()
    gain_b_tank: Number = land_gain()
    null_leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?", default=0.0)
    rate_limit: Number = quantity("1/s", low=1e-3, slip="it is positive; infinite means none", default=float("inf"))
    order: str = eqx.field(static=True, default="second")
    opening: str = eqx.field(static=True, default="smooth")

    states = spool_states("second")

    def __check_init__(self):
        check_choice("order", self.order, ORDERS)
        check_choice("opening", self.opening, OPENINGS)

    def states_in(self, fluid) -> tuple[State, ...]:
        return spool_states(self.order)

    def evaluate(self, at: Situation) -> Contribution:
        spool = at.state["spool"]
        forward, reverse = (lapped_opening(x, self.lap, self.underlap, self.opening) for x in (spool, -spool))
        lands = Lands(
            self.gain_supply_a * forward,
            self.gain_supply_b * reverse,
            self.gain_a_tank * reverse,
            self.gain_b_tank * forward,
        )
        drop = 0.5 * self.rated_pressure_drop
        rating = LandRating(self.rated_flow, drop, self.rated_density, self.transition, self.null_leakage)
        dynamics = (self.natural_frequency, self.damping_ratio, self.rate_limit)
        rates = spool_rates(self.order, at.state, at.given["command"], *dynamics)
        return Contribution(flow=four_way_flow(rating, at, lands), rate=rates)
