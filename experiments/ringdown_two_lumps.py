"""The two lumps behind a ring-down: line and hose from the supply, then the passage into the actuator's chamber.

Also the flow that an actuator takes from its port until the end stop arrests it.
"""

import jax.numpy as jnp

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, driven, port, quantity


class TwoLumpLine(AbstractComponent):
    """Line and hose as one lump, the passage from the hose to the actuator's port as the second.

        I_1 dQ_1/dt = p_a - p_h - R_1 Q_1 - K Q_1|Q_1|      I_2 dQ_2/dt = p_h - p_b - R_2 Q_2
        V_h/beta(p_h) dp_h/dt = Q_1 - Q_2

    K is such that the steady flow Q_s loses the measured pressure: p_a - p_b = (R_1 + R_2) Q_s + K Q_s^2, which is
    also how it starts.

    Args: a, b: nodes of supply and port; inertance I_1, I_2 [Pa s^2/m^3] and resistance R_1, R_2 [Pa s/m^3] of line
        and passage; hose_volume V_h [m^3], walls included in beta; steady_flow Q_s [m^3/s] and steady_drop [Pa].
    Validity: events slower than the wave time of either lump; the friction of both does not depend on frequency.
    Reference: Merritt, "Hydraulic Control Systems", 1967, ch. 3; `jaxlines.FluidInertia` is one such column.
    """

    a: str = port()
    b: str = port()
    inertance: Number = quantity("Pa*s^2/m^3", low=0.0)
    resistance: Number = quantity("Pa*s/m^3", low=0.0)
    passage_inertance: Number = quantity("Pa*s^2/m^3", low=0.0)
    passage_resistance: Number = quantity("Pa*s/m^3", low=0.0)
    hose_volume: Number = quantity("m^3", low=0.0)
    steady_flow: Number = quantity("m^3/s", low=0.0)
    steady_drop: Number = quantity("Pa")

    states = (
        State("volume_flow", "m^3/s", 1e-4),
        State("hose_pressure", "Pa", 1e6),
        State("passage_flow", "m^3/s", 1e-4),
    )

    def start(self, at: Situation) -> dict:
        raised = self.passage_resistance * self.steady_flow
        return {
            "volume_flow": self.steady_flow,
            "hose_pressure": at.potential["b"] + raised,
            "passage_flow": self.steady_flow,
        }

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b, p_h = at.potential["a"], at.potential["b"], at.state["hose_pressure"]
        flow, passing = at.state["volume_flow"], at.state["passage_flow"]
        share, laminar = flow / self.steady_flow, (self.resistance + self.passage_resistance) * self.steady_flow
        drop = self.resistance * flow + (self.steady_drop - laminar) * share * abs(share)
        rates = {
            "volume_flow": (p_a - p_h - drop) / self.inertance,
            "hose_pressure": (flow - passing) * at.fluid.mixture_modulus(p_h) / self.hose_volume,
            "passage_flow": (p_h - p_b - self.passage_resistance * passing) / self.passage_inertance,
        }
        taken, given = at.fluid.mass_flow(flow, p_a, p_h), at.fluid.mass_flow(passing, p_h, p_b)
        return Contribution({"a": -taken, "b": given}, {}, rates)


class ArrestedFlow(AbstractComponent):
    """What an actuator takes from its port until it meets its end stop: Q = Q_0(t) / (1 + exp(4 (t' - d)/T)).

    Args: node; approach Q_0: flow without a stop [m^3/s]; clock t': time since the stop [s]; delay d: when the flow is
        half arrested [s]; duration T: the flow falls by Q_0/T per second there [s].
    Validity: a stop that does not throw the shaft back.
    Typical values: T 2e-3..5e-3 s for a vane actuator on a metal stop.
    """

    node: str = port()
    approach: Number = driven("m^3/s", low=-1e3, high=1e3)
    clock: Number = driven("s", low=-1e4, high=1e4)
    delay: Number = quantity("s", low=-1.0, high=1.0)
    duration: Number = quantity("s", low=1e-5, high=1.0)

    def evaluate(self, at: Situation) -> Contribution:
        late = jnp.clip(4.0 * (at.given["clock"] - self.delay) / self.duration, -60.0, 60.0)
        flow = at.given["approach"] / (1.0 + jnp.exp(late))
        return Contribution(flow={"node": -at.fluid.density_at(at.potential["node"]) * flow})
