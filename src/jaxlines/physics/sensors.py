"""Sensors: what an instrument reads from the circuit, with gain, offset, first-order lag and delay."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import numpy as np

from jaxlines.physics.component import State
from jaxlines.physics.fields import Number, check_fields, is_concrete, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.tanks import depth_of_water

REFERENCES = ("absolute", "gauge")


def _gain():
    """Field: reading per quantity [-]."""
    return quantity("1", low=-1e6, high=1e6, default=1.0)


def _offset(unit: str, size: float, slip: str = ""):
    """Field: reading where the quantity is zero."""
    return quantity(unit, low=-size, high=size, slip=slip, default=0.0)


def _lag():
    """Field: time constant of the first-order lag [s]; 0 is an instrument without one."""
    return quantity("s", low=0.0, high=1e4, slip="was it given in ms?", default=0.0)


def _delay():
    """Field: how long ago the quantity had the value that is shown now [s]."""
    return quantity("s", low=0.0, high=1e4, slip="was it given in ms?", default=0.0)


class AbstractSensor(eqx.Module):
    """Reads one quantity of the circuit, or the difference of two: gain * quantity + offset.

    With a lag tau it shows y with tau y' + y = gain * quantity + offset, which starts in equilibrium; with a delay T
    it shows at time t what it would have shown at t - T without one (before T: what it showed at the start).
    """

    if TYPE_CHECKING:  # fields of every final class; a type checker would take an AbstractVar for its first argument
        gain: ClassVar[Any]
        offset: ClassVar[Any]
        lag: ClassVar[Any]
        delay: ClassVar[Any]

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def quantity_read(self) -> str:
        """The name of the quantity it reads, such as "A.pressure" or "leak.a.flow"."""

    def quantity_subtracted(self) -> str | None:
        """The name of the quantity that is subtracted from the one it reads; None for most sensors."""
        return None

    def unit(self, unit_read: str) -> str:
        """Unit of what it shows when what it reads has the unit `unit_read`; the same for most sensors."""
        return unit_read

    def measured(self, value, fluid: Oil) -> Number:
        """The quantity as this instrument counts it, such as gauge pressure; as it is for most sensors."""
        return value

    def read(self, value, fluid: Oil) -> Number:
        """What it shows, after its lag and delay, while the quantity (the difference of two) has this value."""
        return self.gain * self.measured(value, fluid) + self.offset

    def slope(self, fluid: Oil) -> Number:
        """Change of the reading with the quantity."""
        return self.read(1.0, fluid) - self.read(0.0, fluid)

    def lag_states(self, unit: str, scale: float) -> tuple[State, ...]:
        """The state that its lag needs, in the unit of what it shows and of a typical size; none where lag is 0.

        The state is the reading; it starts as `read` says, and its rate is `lag_rate`.
        """
        none = is_concrete(self.lag) and not np.any(np.asarray(self.lag))
        return () if none else (State("reading", unit, scale),)

    def lag_rate(self, reading, shown) -> Number:
        """y' = (u - y)/tau, with u what `read` says and y what is shown [1/s]; for a lag above 0."""
        return (reading - shown) / self.lag


class PressureSensor(AbstractSensor):
    """Pressure at a node: gain * p + offset, with p absolute or gauge [Pa].

    Args: node; gain [-]; offset [Pa]; reference: "absolute" (default) or "gauge"; lag, delay [s], see `AbstractSensor`.
    Typical values: gain within 0.5 % of 1, offset within 0.2 % of full scale.
    """

    node: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("Pa", 1e9)
    reference: str = eqx.field(static=True, default="absolute")
    lag: Number = _lag()
    delay: Number = _delay()

    def __check_init__(self):
        if self.reference not in REFERENCES:
            raise ValueError(f'reference must be "absolute" or "gauge", got {self.reference!r}')

    def quantity_read(self) -> str:
        return f"{self.node}.pressure"

    def measured(self, value, fluid: Oil):
        return value - fluid.atmospheric_pressure if self.reference == "gauge" else value


class DifferentialPressureSensor(AbstractSensor):
    """Pressure difference between two nodes: gain * (p_node - p_against) + offset.

    Args: node, against: nodes at its plus and its minus side; gain [-]; offset [Pa]; lag, delay [s].
    Typical values: as `PressureSensor`; lag 1e-3..0.1 s (unverified: quoted from memory).
    """

    node: str = eqx.field(static=True)
    against: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("Pa", 1e9)
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return f"{self.node}.pressure"

    def quantity_subtracted(self) -> str:
        return f"{self.against}.pressure"


class LevelSensor(AbstractSensor):
    """Free surface above datum of an open tank, from the pressure at its foot: gain * z + offset [m].

    z = (p - p_atm)/(rho g) + bottom, with the density rho at atmospheric pressure.
    Args: node: at the foot of the tank; bottom: elevation of the foot [m]; gain [-]; offset [m]; lag, delay [s].
    """

    node: str = eqx.field(static=True)
    bottom: Number = quantity("m", low=-1e4, high=1e4, default=0.0)
    gain: Number = _gain()
    offset: Number = _offset("m", 1e4)
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return f"{self.node}.pressure"

    def unit(self, unit_read: str) -> str:
        return "m"

    def measured(self, value, fluid: Oil):
        return depth_of_water(fluid, value) + self.bottom


class FlowSensor(AbstractSensor):
    """Volume flow through a port of a component: gain * Q + offset, at the density of the port's pressure.

    Args: port: component and port, such as "valve.a"; positive INTO the component there; gain [-] (-1
        turns the direction); offset [m^3/s]; lag, delay [s].
    Typical values: lag 0.01..1 s (unverified: quoted from memory).
    """

    port: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("m^3/s", 1e3, slip="was it given in L/min?")
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return f"{self.port}.flow"


class SpeedSensor(AbstractSensor):
    """Speed of a shaft: gain * w + offset. Args: node: the shaft; gain [-]; offset [rad/s]; lag, delay [s]."""

    node: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("rad/s", 1e6, slip="was it given in rpm?")
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return f"{self.node}.speed"


class VelocitySensor(AbstractSensor):
    """Velocity of a translational node: gain * v + offset. Args: node; gain [-]; offset [m/s]; lag, delay [s]."""

    node: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("m/s", 1e6, slip="was it given in mm/s?")
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return f"{self.node}.velocity"


class PositionSensor(AbstractSensor):
    """A position that is the state of a component: gain * x + offset.

    Args: state: such as "cylinder.position", of a node without such a component that of a `Position`; gain [-];
        offset [m]; lag, delay [s].
    """

    state: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("m", 1e6, slip="was it given in mm?")
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return self.state


class AngleSensor(AbstractSensor):
    """An angle that is the state of a component: gain * angle + offset.

    Args: state: such as "motor.angle", of a shaft without such a component that of an `Angle`; gain [-]; offset
        [rad]; lag, delay [s].
    """

    state: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("rad", 1e6, slip="was it given in degrees?")
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return self.state


class StateSensor(AbstractSensor):
    """Any state of a component, as it is: gain * state + offset, the offset in the state's own SI unit.

    Args: state: component and state, such as "valve.spool"; gain [-]; offset; lag, delay [s].
    """

    state: str = eqx.field(static=True)
    gain: Number = _gain()
    offset: Number = _offset("1", 1e12)
    lag: Number = _lag()
    delay: Number = _delay()

    def quantity_read(self) -> str:
        return self.state
