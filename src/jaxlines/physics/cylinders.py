"""Cylinders and rotary actuators: two chambers of fluid on either side of a piston or a vane."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.containers import AbstractContainer
from jaxlines.physics.fields import ROTATIONAL, TRANSLATIONAL, Number, port, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.mechanics import stribeck_friction
from jaxlines.physics.stops import stop_force
from jaxlines.physics.storage import stored


class _Chamber(AbstractContainer):
    """A rigid chamber by the volume it has now [m^3]."""

    volume: Number = quantity("m^3")

    def reference_volume(self):
        return self.volume

    def container_modulus(self):
        return np.inf


def piston_area(diameter, rod_diameter=0.0) -> Number:
    """Area of a piston pi (D^2 - d^2)/4 [m^2], with a rod of diameter d through it. Args: diameters [m]."""
    return np.pi / 4.0 * (diameter * diameter - rod_diameter * rod_diameter)


class AbstractActuator(AbstractComponent):
    """What cylinders and rotary actuators share, x the position of piston or vane, 0..S, and v its velocity.

    Chambers   V_a = V_a0 + A_a x,   V_b = V_b0 + A_b (S - x): capacities rho V/K at the nodes, mass flows -+rho A v
    Leakage    G (p_a - p_b) across the piston
    Force      A_a (p_a - p_atm) - A_b (p_b - p_atm) - friction(v) - stops(x, v) on the moving node;   x' = v

    Mass m = rho(p) V is conserved exactly. The atmosphere acts on the outside of rod and piston.
    """

    if TYPE_CHECKING:  # fields of every final class; a type checker would take an AbstractVar for its first argument
        dead_volume_a: ClassVar[Any]
        dead_volume_b: ClassVar[Any]
        stroke: ClassVar[Any]
        leakage: ClassVar[Any]
        viscous_friction: ClassVar[Any]
        coulomb_friction: ClassVar[Any]
        stribeck_friction: ClassVar[Any]
        stribeck_speed: ClassVar[Any]
        friction_speed: ClassVar[Any]
        stop_stiffness: ClassVar[Any]
        stop_damping: ClassVar[Any]
        stop_width: ClassVar[Any]

    moving: ClassVar[str]  # the port that moves
    travel: ClassVar[State]  # the state that says how far it has moved

    @abstractmethod
    def areas(self) -> tuple[Number, Number]:
        """A_a and A_b: area of the piston on each side [m^2], or displacement of the vane [m^3/rad]."""

    @abstractmethod
    def inertia(self) -> Number | None:
        """Mass [kg] or moment of inertia [kg m^2] of what moves; None where it is left to other components."""

    def volumes(self, position) -> tuple[Number, Number]:
        """V_a and V_b [m^3] at a position [m or rad]."""
        area_a, area_b = self.areas()
        return self.dead_volume_a + area_a * position, self.dead_volume_b + area_b * (self.stroke - position)

    def states_in(self, fluid: Oil) -> tuple[State, ...]:
        slow = [State(f"undissolved_air_{side}", "1", 1.0) for side in "ab"] if fluid.air.kinetic else []
        return (self.travel, *slow)

    def start(self, at: Situation) -> dict:
        sides = "ab" if at.fluid.air.kinetic else ""
        return {f"undissolved_air_{side}": at.fluid.undissolved_air(at.potential[side]) for side in sides}

    def _resistance(self, position, velocity):
        """Friction and end stops against the motion [N or N m]."""
        dry = (self.coulomb_friction, self.stribeck_friction, self.viscous_friction)
        friction = stribeck_friction(velocity, *dry, self.stribeck_speed, self.friction_speed)
        stops = (0.0, self.stroke, self.stop_stiffness, self.stop_damping, self.stop_width)
        return friction + stop_force(position, velocity, *stops)

    def evaluate(self, at: Situation) -> Contribution:
        fluid, p_a, p_b = at.fluid, at.potential["a"], at.potential["b"]
        position, velocity = at.state[self.travel.name], at.potential[self.moving]
        (area_a, area_b), inertia = self.areas(), self.inertia()
        rates, flow, capacity = {self.travel.name: velocity}, {}, {}
        leak = fluid.mass_flow(self.leakage * (p_a - p_b), p_a, p_b)
        growth = {"a": area_a * velocity, "b": -area_b * velocity}
        for side, volume, out in zip("ab", self.volumes(position), (leak, -leak), strict=True):
            p, air = at.potential[side], at.state.get(f"undissolved_air_{side}")
            held = stored(_Chamber(volume), fluid, p, undissolved=air)
            capacity[side] = held.capacity
            flow[side] = held.release - out - fluid.density_at(p, air) * growth[side]
            rates |= {f"{name}_{side}": rate for name, rate in held.rates.items()}
        outside = fluid.atmospheric_pressure
        force = area_a * (p_a - outside) - area_b * (p_b - outside)
        flow[self.moving] = force - self._resistance(position, velocity)
        if inertia is not None:
            capacity[self.moving] = inertia + 0.0 * velocity
        return Contribution(flow, capacity, rates)


def _dead_volume():
    """Field: volume of a chamber with the piston at its end, ports and fittings included [m^3]."""
    return quantity("m^3", low=0.0, high=1e3, slip="was it given in litres or cm^3?", default=1e-5)


def _resisting(unit: str, default: float = 0.0, low: float = 0.0):
    """Field: a friction, stiffness or damping in the unit of its domain."""
    return quantity(unit, low=low, high=1e15, default=default)


def _speed(unit: str, default: float):
    """Field: a speed by which friction changes."""
    return quantity(unit, low=1e-7, high=1e3, slip="was it given in mm/s?" if unit == "m/s" else "", default=default)


class DoubleRodCylinder(AbstractActuator):
    """A cylinder with a rod on both sides and equal areas. Positive motion makes chamber a larger.

    Equations: see `AbstractActuator`; friction: `stribeck_friction`; end stops at 0 and S: `contact_force`.

    Args: a, b: hydraulic nodes of the chambers; rod: translational node; area A of the piston less the rod [m^2], see
        `piston_area`; stroke S [m]; dead_volume_a, dead_volume_b [m^3]; leakage G [m^3/(s Pa)]; mass of piston and rods
        [kg] (None: the node gets its capacity from a `Mass`); viscous_friction [N s/m]; coulomb_friction,
        stribeck_friction (excess at rest) [N]; stribeck_speed, friction_speed [m/s]; stop_stiffness [N/m],
        stop_damping [N s/m], stop_width [m] of the end stops.
    Position x is the state `position` [m], 0 at the start unless told otherwise ("initial").
    Validity: rigid walls (an elastic hose is a `Line` at the node); dead volumes larger than what the stops give way
        times the area; pressures above 0 only as the fluid's law says; gas takes no part in the flow between nodes.
    Typical values: leakage 1e-13..1e-11 m^3/(s Pa), friction see `stribeck_friction`, stops 1e7..1e9 N/m.
    Reference: Merritt, "Hydraulic Control Systems", 1967, ch. 6 (unverified: quoted from memory).
    """

    a: str = port()
    b: str = port()
    rod: str = port(TRANSLATIONAL)
    area: Number = quantity("m^2", low=1e-8, high=100.0, slip="was it given in mm^2 or cm^2?")
    stroke: Number = quantity("m", low=1e-6, high=100.0, slip="was it given in mm?")
    dead_volume_a: Number = _dead_volume()
    dead_volume_b: Number = _dead_volume()
    leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?", default=0.0)
    mass: Number | None = quantity("kg", low=1e-9, high=1e9, slip="was it given in g?", default=None)
    viscous_friction: Number = _resisting("N*s/m")
    coulomb_friction: Number = _resisting("N")
    stribeck_friction: Number = _resisting("N")
    stribeck_speed: Number = _speed("m/s", 0.02)
    friction_speed: Number = _speed("m/s", 1e-3)
    stop_stiffness: Number = _resisting("N/m", 1e8, low=1e-3)
    stop_damping: Number = _resisting("N*s/m", 1e5)
    stop_width: Number = quantity("m", low=1e-9, high=1.0, slip="was it given in mm?", default=1e-4)

    moving = "rod"
    travel = State("position", "m", 0.1)

    def areas(self):
        return self.area, self.area

    def inertia(self):
        return self.mass


class SingleRodCylinder(AbstractActuator):
    """A cylinder with a rod on side b: area_a of the piston, area_b of the ring around the rod.

    Args: as `DoubleRodCylinder`, but area_a, area_b [m^2] instead of area; see `piston_area`.
    Raises: ValueError when area_b exceeds area_a.
    Typical values, and the rest: as `DoubleRodCylinder`; areas 4:3 to 2:1.
    """

    a: str = port()
    b: str = port()
    rod: str = port(TRANSLATIONAL)
    area_a: Number = quantity("m^2", low=1e-8, high=100.0, slip="was it given in mm^2 or cm^2?")
    area_b: Number = quantity("m^2", low=1e-8, high=100.0, slip="was it given in mm^2 or cm^2?")
    stroke: Number = quantity("m", low=1e-6, high=100.0, slip="was it given in mm?")
    dead_volume_a: Number = _dead_volume()
    dead_volume_b: Number = _dead_volume()
    leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?", default=0.0)
    mass: Number | None = quantity("kg", low=1e-9, high=1e9, slip="was it given in g?", default=None)
    viscous_friction: Number = _resisting("N*s/m")
    coulomb_friction: Number = _resisting("N")
    stribeck_friction: Number = _resisting("N")
    stribeck_speed: Number = _speed("m/s", 0.02)
    friction_speed: Number = _speed("m/s", 1e-3)
    stop_stiffness: Number = _resisting("N/m", 1e8, low=1e-3)
    stop_damping: Number = _resisting("N*s/m", 1e5)
    stop_width: Number = quantity("m", low=1e-9, high=1.0, slip="was it given in mm?", default=1e-4)

    moving = "rod"
    travel = State("position", "m", 0.1)

    def __check_init__(self):
        larger, smaller = self.area_a, self.area_b
        if isinstance(larger, np.ndarray) and isinstance(smaller, np.ndarray) and np.any(smaller > larger):
            raise ValueError(f"area_b must not exceed area_a, got {smaller:g} and {larger:g} m^2: the rod is on side b")

    def areas(self):
        return self.area_a, self.area_b

    def inertia(self):
        return self.mass


class RotaryActuator(AbstractActuator):
    """A vane that turns through a limited angle between two chambers. Positive motion makes chamber a larger.

    Equations: see `AbstractActuator`, with the displacement D [m^3/rad] in place of the area and angles of positions.

    Args: a, b: hydraulic nodes; shaft: rotational node; displacement D [m^3/rad]; stroke S, the angle between the stops
        [rad]; dead volumes, leakage: as `DoubleRodCylinder`; moment_of_inertia [kg m^2] (None: from an `Inertia`);
        viscous_friction [N m s/rad]; coulomb_friction, stribeck_friction [N m]; stribeck_speed, friction_speed [rad/s];
        stop_stiffness [N m/rad], stop_damping [N m s/rad], stop_width [rad].
    Position is the state `angle` [rad], 0 at the start unless told otherwise.
    Validity, reference: as `DoubleRodCylinder`.
    Typical values: D 1e-5..1e-3 m^3/rad, stroke 1.5..4.9 rad (unverified: quoted from memory).
    """

    a: str = port()
    b: str = port()
    shaft: str = port(ROTATIONAL)
    displacement: Number = quantity("m^3/rad", low=1e-12, high=100.0, slip="was it given in cm^3/rev?")
    stroke: Number = quantity("rad", low=1e-3, high=100.0, slip="was it given in degrees?")
    dead_volume_a: Number = _dead_volume()
    dead_volume_b: Number = _dead_volume()
    leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?", default=0.0)
    moment_of_inertia: Number | None = quantity("kg*m^2", low=1e-12, high=1e12, default=None)
    viscous_friction: Number = _resisting("N*m*s/rad")
    coulomb_friction: Number = _resisting("N*m")
    stribeck_friction: Number = _resisting("N*m")
    stribeck_speed: Number = _speed("rad/s", 0.2)
    friction_speed: Number = _speed("rad/s", 0.01)
    stop_stiffness: Number = _resisting("N*m/rad", 1e6, low=1e-3)
    stop_damping: Number = _resisting("N*m*s/rad", 1e3)
    stop_width: Number = quantity("rad", low=1e-9, high=1.0, slip="was it given in degrees?", default=1e-3)

    moving = "shaft"
    travel = State("angle", "rad", 1.0)

    def areas(self):
        return self.displacement, self.displacement

    def inertia(self):
        return self.moment_of_inertia
