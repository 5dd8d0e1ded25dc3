"""Directional valves: on/off or throttling 2/2 valve, proportional 4/3 valve."""

import equinox as eqx

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, driven, port, quantity
from jaxlines.physics.resistances import orifice_flow, passed, soft_clip, soft_positive
from jaxlines.physics.servovalve import (
    ORDERS,
    LandRating,
    Lands,
    check_choice,
    four_way_flow,
    land_gain,
    lapped_opening,
    spool_rates,
    spool_states,
)


class Valve22(AbstractComponent):
    """A 2/2 valve, on/off or throttling: Q = C_d A o(x) sqrt(2 dp/rho), tau x' = u - x.

    The opening o(x) is a smooth clip of the stroke to 0..1: tight at 0 and below, fully open at 1 and above, see
    `soft_clip`.

    Args: a, b: nodes; command u: stroke demanded, 0..1 (signal or input) [-]; area A when fully open [m^2];
        discharge_coefficient C_d [-]; natural_frequency w = 1/tau [rad/s]; damping_ratio [-], used in second order;
        width of the rounded ends of the opening [-]; transition [Pa], see `Orifice`; rate_limit of the stroke [1/s];
        order: "first" or "second", x'' + 2 zeta w x' + w^2 x = w^2 u.
    Raises: ValueError for an unknown order.
    Validity: opening proportional to stroke but for its rounded ends (within `width`), no flow forces, no leakage
        when closed (add an `AnnularLeak` or `LaminarLeak`), the same in both directions.
    Typical values: solenoid valve tau 0.02..0.05 s (unverified: quoted from memory), C_d 0.6..0.7.
    Reference: orifice equation with a filtered stroke, as the 2/2 valve of Hopsan (second order).
    """

    a: str = port()
    b: str = port()
    command: Number = driven("1", low=0.0, high=1.0, slip="was it given in percent?")
    area: Number = quantity("m^2", low=0.0, high=10.0, slip="was it given in mm^2?")
    discharge_coefficient: Number = quantity("1", low=0.01, high=2.0, default=0.62)
    natural_frequency: Number = quantity("rad/s", low=0.1, high=1e5, slip="was it given in Hz?", default=50.0)
    damping_ratio: Number = quantity("1", low=0.05, high=20.0, default=1.0)
    width: Number = quantity("1", low=1e-6, high=0.49, slip="was it given in percent?", default=0.01)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e4)
    rate_limit: Number = quantity("1/s", low=1e-3, slip="it is positive; infinite means none", default=float("inf"))
    order: str = eqx.field(static=True, default="first")

    states = spool_states("first")

    def __check_init__(self):
        check_choice("order", self.order, ORDERS)

    def states_in(self, fluid) -> tuple[State, ...]:
        return spool_states(self.order)

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density = at.fluid.density_at(0.5 * (p_a + p_b))
        area = self.area * soft_clip(at.state["spool"], self.width)
        through = passed(at, orifice_flow(area, self.discharge_coefficient, density, p_a, p_b, self.transition))
        dynamics = (self.natural_frequency, self.damping_ratio, self.rate_limit)
        rates = spool_rates(self.order, at.state, at.given["command"], *dynamics)
        return Contribution(flow=through.flow, rate=rates)


def beyond_deadband(command, deadband, width):
    """Command that is left beyond a deadband, 1 at full command: sign(u) max(|u| - d, 0)/(1 - d), smooth [-].

    Args: command u [-]; deadband d [-], 0 leaves the command as it is; width: half of each rounded corner [-].
    """
    rising, falling = soft_positive(command - deadband, width), soft_positive(-command - deadband, width)
    return (rising - falling) / (1.0 - deadband)


def _lap():
    """Field: lap of one land [-]."""
    return quantity("1", low=-0.9, high=0.9, slip="was it given in percent?", default=0.0)


class ProportionalValve43(AbstractComponent):
    """A 4/3 proportional valve: four lands with laps and gains of their own, spool of first or second order.

    Per land Q = Q_N/sqrt(dp_N/2) gain max((s - lap)/(1 - lap), 0) sqrt(dp) + G dp, with s = x for supply -> a and
    b -> tank, s = -x for supply -> b and a -> tank; the spool follows the command beyond its deadband.

    Args: supply, tank, a, b: nodes; command u, -1..1 (signal or input) [-]; rated_flow Q_N [m^3/s] through two
        lands at rated_pressure_drop dp_N [Pa] and full stroke; natural_frequency w [rad/s] (first order: 1/time
        constant); damping_ratio [-]; rate_limit of the spool [1/s]; deadband of the command [-], rounded within
        `width` [-]; lap_...: of each land, overlap positive (flow starts late), underlap negative (open centre) [-];
        gain_...: of each land [-]; underlap: smoothing of the edges, null opening with zero lap [-]; null_leakage G
        [m^3/(s Pa)]; rated_density, transition, as in `Servovalve`; order: "second" or "first".
    Raises: ValueError for an unknown order.
    Validity: no flow forces, leakage that does not depend on the stroke.
    Typical values: lap 0.05..0.2 for closed centre, gain 0.5 of one pair for a 2:1 cylinder, w 2 pi (10..70 Hz), rate
        limit 10..50 1/s (unverified: quoted from memory).
    Reference: as `Servovalve`; laps of each flow path as in the 4/3 valve of Hopsan.
    """

    supply: str = port()
    tank: str = port()
    a: str = port()
    b: str = port()
    command: Number = driven("1", low=-1.5, high=1.5, slip="was it given in percent?")
    rated_flow: Number = quantity("m^3/s", low=0.0, high=10.0, slip="was it given in L/min?")
    rated_pressure_drop: Number = quantity("Pa", low=1e4, high=1e9, slip="was it given in bar?", default=1e6)
    natural_frequency: Number = quantity("rad/s", low=0.1, high=1e5, slip="was it given in Hz?", default=120.0)
    damping_ratio: Number = quantity("1", low=0.05, high=20.0, default=0.8)
    rate_limit: Number = quantity("1/s", low=1e-3, slip="it is positive; infinite means none", default=float("inf"))
    deadband: Number = quantity("1", low=0.0, high=0.9, slip="was it given in percent?", default=0.0)
    width: Number = quantity("1", low=1e-6, high=0.5, slip="was it given in percent?", default=0.01)
    lap_supply_a: Number = _lap()
    lap_supply_b: Number = _lap()
    lap_a_tank: Number = _lap()
    lap_b_tank: Number = _lap()
    gain_supply_a: Number = land_gain()
    gain_supply_b: Number = land_gain()
    gain_a_tank: Number = land_gain()
    gain_b_tank: Number = land_gain()
    underlap: Number = quantity("1", low=1e-6, high=0.5, slip="was it given in percent?", default=0.01)
    null_leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?", default=0.0)
    rated_density: Number = quantity("kg/m^3", low=100.0, high=3000.0, slip="was it given in g/cm^3?", default=850.0)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e4)
    order: str = eqx.field(static=True, default="second")

    states = spool_states("second")

    def __check_init__(self):
        check_choice("order", self.order, ORDERS)

    def states_in(self, fluid) -> tuple[State, ...]:
        return spool_states(self.order)

    def evaluate(self, at: Situation) -> Contribution:
        spool = at.state["spool"]
        lands = Lands(
            self.gain_supply_a * lapped_opening(spool, self.lap_supply_a, self.underlap),
            self.gain_supply_b * lapped_opening(-spool, self.lap_supply_b, self.underlap),
            self.gain_a_tank * lapped_opening(-spool, self.lap_a_tank, self.underlap),
            self.gain_b_tank * lapped_opening(spool, self.lap_b_tank, self.underlap),
        )
        drop = 0.5 * self.rated_pressure_drop
        rating = LandRating(self.rated_flow, drop, self.rated_density, self.transition, self.null_leakage)
        demand = beyond_deadband(at.given["command"], self.deadband, self.width)
        dynamics = (self.natural_frequency, self.damping_ratio, self.rate_limit)
        rates = spool_rates(self.order, at.state, demand, *dynamics)
        return Contribution(flow=four_way_flow(rating, at, lands), rate=rates)
