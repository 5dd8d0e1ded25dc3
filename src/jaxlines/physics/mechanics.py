"""Mechanics along a line and on a shaft: mass, spring, damper, dry friction, and what measures a position.

What resists relative motion is written once, as an `AbstractLink` between a node and another one or the ground; the
classes differ by domain only in units and names.
"""

from abc import abstractmethod

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import ROTATIONAL, TRANSLATIONAL, Number, array_module, driven, port, quantity


def smooth_sign(x, width):
    """tanh(x/width): a sign that is smooth through zero, 0.96 at twice the width."""
    return array_module(x, width).tanh(x / width)


def stribeck_friction(speed, coulomb, excess, viscous, stribeck_speed, width):
    """Friction against the motion: B v + (F_c + F_e exp(-(v/v_s)^2)) tanh(v/v_0), in N or N m.

    Args: speed v [m/s or rad/s]; coulomb F_c, excess F_e by which breaking away needs more than sliding [N or N m];
        viscous B [N s/m or N m s/rad]; stribeck_speed v_s at which the excess is gone; width v_0 << v_s.
    Validity: odd in v, never gives energy; smooth friction creeps at up to about v_0 under load, it does not stick. The
        largest value before sliding is a little below F_c + F_e.
    Typical values: cylinder seals F_c 1..5 % of area times supply pressure, v_s 1e-3..0.05 m/s (unverified: quoted from
        memory).
    Reference: Armstrong-Helouvry, Dupont and Canudas de Wit, "A survey of models, analysis tools and compensation
        methods for the control of machines with friction", Automatica 30(7), 1994 (unverified: quoted from memory).
    """
    ratio = speed / stribeck_speed
    dry = coulomb + excess * array_module(speed, stribeck_speed).exp(-ratio * ratio)
    return viscous * speed + dry * smooth_sign(speed, width)


class AbstractLink(AbstractComponent):
    """Resists the motion of a node relative to another one, or to the ground where `to` is None.

    A link with a state keeps the relative displacement in it; it is zero at the start unless told otherwise.
    """

    @abstractmethod
    def resistance(self, displacement, velocity) -> Number:
        """Force [N] or torque [N m] against a displacement (None for a link without state) and a velocity."""

    def evaluate(self, at: Situation) -> Contribution:
        velocity = at.potential["node"] - at.potential.get("to", 0.0)
        name = self.states[0].name if self.states else ""
        force = self.resistance(at.state.get(name), velocity)
        flow = {"node": -force, "to": force} if "to" in at.potential else {"node": -force}
        return Contribution(flow, rate={name: velocity} if self.states else {})


class Mass(AbstractComponent):
    """A mass m that moves along a line [kg]: the capacity of a translational node."""

    node: str = port(TRANSLATIONAL)
    mass: Number = quantity("kg", low=1e-9, high=1e12, slip="was it given in g?")

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(capacity={"node": self.mass + 0.0 * at.potential["node"]})


class Force(AbstractComponent):
    """External force on a node, positive in the direction of positive velocity [N]; a number, signal or input."""

    node: str = port(TRANSLATIONAL)
    force: Number = driven("N", slip="was it given in kN?")

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(flow={"node": at.given["force"] + 0.0 * at.potential["node"]})


class Spring(AbstractLink):
    """A linear spring between two nodes or to the ground: F = F_0 + k x, pulling `node` back when x > 0.

    Args: node, to: the ends (`to` None: the ground); stiffness k [N/m]; preload F_0 at extension 0 [N].
    Extension x is a state, with x' = v_node - v_to; zero at the start.
    """

    node: str = port(TRANSLATIONAL)
    stiffness: Number = quantity("N/m", low=0.0, high=1e15, slip="was it given in N/mm?")
    preload: Number = quantity("N", default=0.0)
    to: str | None = port(TRANSLATIONAL, optional=True)

    states = (State("extension", "m", 1e-2),)

    def resistance(self, displacement, velocity):
        return self.preload + self.stiffness * displacement


class RotarySpring(AbstractLink):
    """A torsion spring between two shafts or to the ground: T = T_0 + k x, turning `node` back when x > 0.

    Args: node, to: the shafts (`to` None: the ground); stiffness k [N m/rad]; preload T_0 at twist 0 [N m].
    Twist x is a state, with x' = w_node - w_to; zero at the start.
    """

    node: str = port(ROTATIONAL)
    stiffness: Number = quantity("N*m/rad", low=0.0, high=1e15, slip="was it given per degree?")
    preload: Number = quantity("N*m", default=0.0)
    to: str | None = port(ROTATIONAL, optional=True)

    states = (State("twist", "rad", 1e-2),)

    def resistance(self, displacement, velocity):
        return self.preload + self.stiffness * displacement


class Damper(AbstractLink):
    """A linear damper between two nodes or to the ground: F = B (v_node - v_to), B the damping [N s/m]."""

    node: str = port(TRANSLATIONAL)
    damping: Number = quantity("N*s/m", low=0.0, high=1e12)
    to: str | None = port(TRANSLATIONAL, optional=True)

    def resistance(self, displacement, velocity):
        return self.damping * velocity


class RotaryDamper(AbstractLink):
    """A linear damper between two shafts or to the ground: T = B (w_node - w_to), B the damping [N m s/rad]."""

    node: str = port(ROTATIONAL)
    damping: Number = quantity("N*m*s/rad", low=0.0, high=1e12)
    to: str | None = port(ROTATIONAL, optional=True)

    def resistance(self, displacement, velocity):
        return self.damping * velocity


class SlidingFriction(AbstractLink):
    """Friction of a guide or a seal: F = B v + (F_c + F_e exp(-(v/v_s)^2)) tanh(v/v_0).

    Args: node, to (None: the ground); coulomb_friction F_c, stribeck_friction F_e (excess at rest) [N];
        viscous_friction B [N s/m]; stribeck_speed v_s, friction_speed v_0 [m/s].
    Validity, typical values, reference: see the function `stribeck_friction`.
    """

    node: str = port(TRANSLATIONAL)
    coulomb_friction: Number = quantity("N", low=0.0)
    stribeck_friction: Number = quantity("N", low=0.0, default=0.0)
    viscous_friction: Number = quantity("N*s/m", low=0.0, default=0.0)
    stribeck_speed: Number = quantity("m/s", low=1e-6, high=1e3, slip="was it given in mm/s?", default=0.02)
    friction_speed: Number = quantity("m/s", low=1e-7, high=1e3, slip="was it given in mm/s?", default=1e-3)
    to: str | None = port(TRANSLATIONAL, optional=True)

    def resistance(self, displacement, velocity):
        dry = (self.coulomb_friction, self.stribeck_friction, self.viscous_friction)
        return stribeck_friction(velocity, *dry, self.stribeck_speed, self.friction_speed)


class RotaryFriction(AbstractLink):
    """Friction of a bearing or a seal on a shaft: T = B w + (T_c + T_e exp(-(w/w_s)^2)) tanh(w/w_0).

    Args: node, to (None: the ground); coulomb_friction T_c, stribeck_friction T_e (excess at rest) [N m];
        viscous_friction B [N m s/rad]; stribeck_speed w_s, friction_speed w_0 [rad/s].
    Validity, typical values, reference: see the function `stribeck_friction`.
    """

    node: str = port(ROTATIONAL)
    coulomb_friction: Number = quantity("N*m", low=0.0)
    stribeck_friction: Number = quantity("N*m", low=0.0, default=0.0)
    viscous_friction: Number = quantity("N*m*s/rad", low=0.0, default=0.0)
    stribeck_speed: Number = quantity("rad/s", low=1e-6, high=1e4, slip="was it given in rpm?", default=0.2)
    friction_speed: Number = quantity("rad/s", low=1e-7, high=1e3, slip="was it given in rpm?", default=0.01)
    to: str | None = port(ROTATIONAL, optional=True)

    def resistance(self, displacement, velocity):
        dry = (self.coulomb_friction, self.stribeck_friction, self.viscous_friction)
        return stribeck_friction(velocity, *dry, self.stribeck_speed, self.friction_speed)


class Position(AbstractLink):
    """Keeps the position of a node, relative to another one or the ground, as the state `position` [m]; no force."""

    node: str = port(TRANSLATIONAL)
    to: str | None = port(TRANSLATIONAL, optional=True)

    states = (State("position", "m", 1e-2),)

    def resistance(self, displacement, velocity):
        return 0.0 * velocity


class Angle(AbstractLink):
    """Keeps the angle of a shaft, relative to another one or the ground, as the state `angle` [rad]; no torque."""

    node: str = port(ROTATIONAL)
    to: str | None = port(ROTATIONAL, optional=True)

    states = (State("angle", "rad", 1.0),)

    def resistance(self, displacement, velocity):
        return 0.0 * velocity
