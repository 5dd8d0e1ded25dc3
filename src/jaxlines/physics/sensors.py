"""Sensors: what an instrument reads from the circuit, with gain and offset."""

from abc import abstractmethod

import equinox as eqx

from jaxlines.physics.fields import Number, check_fields, quantity
from jaxlines.physics.fluids import Oil

REFERENCES = ("absolute", "gauge")


class AbstractSensor(eqx.Module):
    """Reads one quantity of the circuit."""

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def quantity_read(self) -> str:
        """The name of the quantity it reads, such as "A.pressure" or "leak.a.flow"."""

    @abstractmethod
    def read(self, value, fluid: Oil) -> Number:
        """What it shows when the quantity has this value."""

    def slope(self, fluid: Oil) -> Number:
        """Change of the reading with the quantity."""
        return self.read(1.0, fluid) - self.read(0.0, fluid)


class PressureSensor(AbstractSensor):
    """Pressure at a node: gain * p + offset, with p absolute or gauge [Pa].

    Args: node; gain [-]; offset [Pa]; reference: "absolute" (default) or "gauge".
    Typical values: gain within 0.5 % of 1, offset within 0.2 % of full scale.
    """

    node: str = eqx.field(static=True)
    gain: Number = quantity("1", low=-1e6, high=1e6, default=1.0)
    offset: Number = quantity("Pa", low=-1e9, high=1e9, default=0.0)
    reference: str = eqx.field(static=True, default="absolute")

    def __check_init__(self):
        if self.reference not in REFERENCES:
            raise ValueError(f'reference must be "absolute" or "gauge", got {self.reference!r}')

    def quantity_read(self) -> str:
        return f"{self.node}.pressure"

    def read(self, value, fluid: Oil):
        zero = fluid.atmospheric_pressure if self.reference == "gauge" else 0.0
        return self.gain * (value - zero) + self.offset


class FlowSensor(AbstractSensor):
    """Volume flow through a port of a component: gain * Q + offset, at the density of the port's pressure.

    Args: port: component and port, such as "valve.a"; positive INTO the component there; gain [-] (-1
        turns the direction); offset [m^3/s].
    """

    port: str = eqx.field(static=True)
    gain: Number = quantity("1", low=-1e6, high=1e6, default=1.0)
    offset: Number = quantity("m^3/s", low=-1e3, high=1e3, slip="was it given in L/min?", default=0.0)

    def quantity_read(self) -> str:
        return f"{self.port}.flow"

    def read(self, value, fluid: Oil):
        return self.gain * value + self.offset
