"""The four-way servovalve with a second-order spool."""

import jax.numpy as jnp

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, driven, port, quantity
from jaxlines.physics.resistances import regularised_root


def land_opening(stroke, underlap):
    """Opening of a land, max(stroke, 0) made smooth: (x + sqrt(x^2 + u^2))/2 [-].

    At the null it is underlap/2, which stands for the null leakage of a real valve as well.
    """
    return 0.5 * (stroke + jnp.sqrt(stroke * stroke + underlap * underlap))


class Servovalve(AbstractComponent):
    """Four-way valve, four equal lands, rated flow, spool of second order.

    Rated form per land: Q = Q_N/sqrt(dp_N/2) * opening * sqrt(dp), with supply -> a and b -> tank open for
    positive spool, supply -> b and a -> tank for negative; spool x'' + 2 zeta w x' + w^2 x = w^2 u.

    Args: supply, tank, a, b: nodes; command u: stroke demanded, -1..1 (signal or input) [-]; rated_flow
        Q_N [m^3/s] through two lands at rated_pressure_drop dp_N [Pa] and full stroke; natural_frequency
        w [rad/s]; damping_ratio zeta [-]; underlap: smoothing and null opening, share of the stroke [-];
        rated_density [kg/m^3] of the rating; transition [Pa]: laminar below this pressure difference.
    Validity: matched symmetrical lands, critical centre within the underlap, no flow forces, no rate limit.
    Typical values: dp_N 7e6 Pa, zeta 0.7..1, w 2 pi (50..200 Hz), underlap 0.01..0.03.
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

    states = (State("spool", "1", 1.0), State("spool_rate", "1/s", 100.0))

    def _land(self, at: Situation, opening, upstream: str, downstream: str):
        """Mass flow through one land, from one port to another [kg/s]."""
        p_from, p_to = at.potential[upstream], at.potential[downstream]
        density = at.fluid.density_at(0.5 * (p_from + p_to))
        gain = self.rated_flow * jnp.sqrt(2.0 * self.rated_density / (self.rated_pressure_drop * density))
        return density * gain * opening * regularised_root(p_from - p_to, self.transition)

    def evaluate(self, at: Situation) -> Contribution:
        spool, rate, w = at.state["spool"], at.state["spool_rate"], self.natural_frequency
        forward, reverse = land_opening(spool, self.underlap), land_opening(-spool, self.underlap)
        supply_a, b_tank = self._land(at, forward, "supply", "a"), self._land(at, forward, "b", "tank")
        supply_b, a_tank = self._land(at, reverse, "supply", "b"), self._land(at, reverse, "a", "tank")
        return Contribution(
            flow={
                "supply": -supply_a - supply_b,
                "tank": a_tank + b_tank,
                "a": supply_a - a_tank,
                "b": supply_b - b_tank,
            },
            rate={
                "spool": rate,
                "spool_rate": w * w * (at.given["command"] - spool) - 2.0 * self.damping_ratio * w * rate,
            },
        )
