"""Where fluid comes from and goes to: pressure source, tank, flow source."""

from jaxlines.physics.component import AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import ATMOSPHERE, Number, driven, port, quantity


class PressureSource(AbstractComponent):
    """Holds its node at a pressure, whatever the flow.

    Args: node; pressure: absolute, a number, a signal or the name of an input [Pa].
    Typical values: supply of the antennas' drives about 20.7e6 Pa.
    """

    node: str = port()
    pressure: Number = driven("Pa", low=0.0, high=1e9, slip="pressures are absolute and in Pa", level=True)

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution()

    def sets(self) -> dict:
        return {"node": "pressure"}


class Tank(AbstractComponent):
    """A reservoir: a pressure source at atmospheric pressure unless another is given [Pa absolute]."""

    node: str = port()
    pressure: Number = driven(
        "Pa", low=0.0, high=1e9, slip="pressures are absolute and in Pa", level=True, default=ATMOSPHERE
    )

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution()

    def sets(self) -> dict:
        return {"node": "pressure"}


class FlowSource(AbstractComponent):
    """Feeds its node with a volume flow, taken at the density of that node's pressure.

    Args: node; flow: positive into the node, a number, a signal or the name of an input [m^3/s]; gain: of
        the flow meter when the flow is a measured one [-].
    Raises: ValueError for flows beyond 1e3 m^3/s.
    Typical values: 1e-5..1e-3 m^3/s (0.6..60 L/min).
    """

    node: str = port()
    flow: Number = driven("m^3/s", low=-1e3, high=1e3, slip="was it given in L/min?")
    gain: Number = quantity("1", low=-1e6, high=1e6, default=1.0)

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(flow={"node": at.fluid.density_at(at.potential["node"]) * self.gain * at.given["flow"]})
