"""Parts that touch or do not: end stops, backlash, gears with play; smooth, and without creating energy."""

import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import ROTATIONAL, TRANSLATIONAL, Number, array_module, port, quantity
from jaxlines.physics.mechanics import AbstractLink, smooth_sign
from jaxlines.physics.resistances import soft_positive

_SHARPNESS = 4.0  # of the softplus that keeps a stop from pulling; 1 - exp(-4) = 0.98 of the damping acts at rest


def contact_force(depth, approach, stiffness, damping, width):
    """Force with which a stop pushes back: k s (1 + y), made smooth and never negative; in N or N m.

    s = soft_positive(x, w),  y = c v/(k (s + w)),  (1 + y) as ln(1 + (e^4 - 1) e^(4 y))/4

    Args: depth x beyond the stop, negative in free travel [m or rad]; approach v = x' [m/s or rad/s]; stiffness k;
        damping c; width w, half the length over which contact sets in [m or rad].
    Validity: deep in contact (s >> w) it is k x + c v, within 2 % of the damping at small v, and zero instead of
        negative where the parts would stick; exactly zero for x < -w. The spring gives back what it took and the rest
        has the sign of v, so that no cycle creates energy.
    Typical values: k such that the load compresses it by less than a mm, c 0.1..0.5 of 2 sqrt(k m).
    Reference: own; like Hunt and Crossley, "Coefficient of restitution interpreted as damping in vibroimpact", J.
        Applied Mechanics 42(2), 1975 (unverified: quoted from memory), the damping sets in with the depth.
    """
    xp = array_module(depth, approach, stiffness, damping, width)
    pressed = soft_positive(depth, width)
    ratio = damping * approach / (stiffness * (pressed + width))
    share = xp.logaddexp(0.0, np.log(np.expm1(_SHARPNESS)) + _SHARPNESS * ratio) / _SHARPNESS
    return stiffness * pressed * share


def stop_force(position, velocity, lower, upper, stiffness, damping, width):
    """Force of two stops against a position, positive beyond the upper one; see `contact_force`; in N or N m."""
    above = contact_force(position - upper, velocity, stiffness, damping, width)
    below = contact_force(lower - position, -velocity, stiffness, damping, width)
    return above - below


def dead_zone(displacement, half_gap, width):
    """What is left of a displacement beyond a gap: x - g above g, x + g below -g, 0 between; smooth within w of both.

    Args: displacement x, half_gap g >= 0, width w, all in m or rad. With g = 0 it is x exactly.
    Validity: twice differentiable, odd, monotone.
    """
    return soft_positive(displacement - half_gap, width) - soft_positive(-displacement - half_gap, width)


def engagement(displacement, half_gap, width):
    """Slope of `dead_zone`: 0 inside the gap, 1 beyond it [-]. With half_gap = 0 it is 1 exactly."""
    xp = array_module(displacement, half_gap, width)

    def touching(depth):
        share = xp.clip(0.5 * (depth / width + 1.0), 0.0, 1.0)
        return share * share * (3.0 - 2.0 * share)

    return touching(displacement - half_gap) + touching(-displacement - half_gap)


def play_force(displacement, velocity, gap, stiffness, damping, width):
    """Force across a play, k z(x) + c z'(x) v in N or N m: z of `dead_zone` with half the gap [m or rad]."""
    place = (displacement, 0.5 * gap, width)
    return stiffness * dead_zone(*place) + damping * engagement(*place) * velocity


_FAR = 1e6  # m or rad: a limit that nothing reaches. An infinite one would have no gradient.


def _limit(unit: str, other: str, default: float):
    """Field: where a stop stands."""
    return quantity(unit, low=-_FAR, high=_FAR, slip=f"was it given in {other}?", default=default)


def check_limits(lower, upper) -> None:
    """Raise ValueError where a lower limit is not below the upper one."""
    if isinstance(lower, np.ndarray) and isinstance(upper, np.ndarray) and np.any(lower >= upper):
        raise ValueError(f"lower must be below upper, got {lower:g} and {upper:g}: were they swapped?")


class EndStop(AbstractLink):
    """Limits the position of a node, relative to another one or to the ground, between two stops.

    Args: node, to (None: the ground); lower, upper limit, out of reach where left out [m]; stiffness k [N/m]; damping c
        [N s/m]; width: contact sets in this far before the limit, and is full this far beyond [m].
    Position x is a state, with x' = v_node - v_to; zero at the start unless told otherwise.
    Raises: ValueError when lower is not below upper.
    Validity, typical values, reference: see `contact_force`.
    """

    node: str = port(TRANSLATIONAL)
    lower: Number = _limit("m", "mm", -_FAR)
    upper: Number = _limit("m", "mm", _FAR)
    stiffness: Number = quantity("N/m", low=1e-3, high=1e15, slip="was it given in N/mm?", default=1e8)
    damping: Number = quantity("N*s/m", low=0.0, high=1e12, default=1e5)
    width: Number = quantity("m", low=1e-9, high=1.0, slip="was it given in mm?", default=1e-4)
    to: str | None = port(TRANSLATIONAL, optional=True)

    states = (State("position", "m", 1e-2),)

    def __check_init__(self):
        check_limits(self.lower, self.upper)

    def resistance(self, displacement, velocity):
        return stop_force(displacement, velocity, self.lower, self.upper, self.stiffness, self.damping, self.width)


class RotaryEndStop(AbstractLink):
    """Limits the angle of a shaft, relative to another one or to the ground, between two stops.

    Args: node, to (None: the ground); lower, upper limit, out of reach where left out [rad]; stiffness k [N m/rad];
        damping c [N m s/rad]; width: contact sets in this far before the limit, and is full this far beyond [rad].
    Angle is a state, with rate w_node - w_to; zero at the start unless told otherwise.
    Raises: ValueError when lower is not below upper.
    Validity, typical values, reference: see `contact_force`.
    """

    node: str = port(ROTATIONAL)
    lower: Number = _limit("rad", "degrees", -_FAR)
    upper: Number = _limit("rad", "degrees", _FAR)
    stiffness: Number = quantity("N*m/rad", low=1e-3, high=1e15, slip="was it given per degree?", default=1e6)
    damping: Number = quantity("N*m*s/rad", low=0.0, high=1e12, default=1e3)
    width: Number = quantity("rad", low=1e-9, high=1.0, slip="was it given in degrees?", default=1e-3)
    to: str | None = port(ROTATIONAL, optional=True)

    states = (State("angle", "rad", 1.0),)

    def __check_init__(self):
        check_limits(self.lower, self.upper)

    def resistance(self, displacement, velocity):
        return stop_force(displacement, velocity, self.lower, self.upper, self.stiffness, self.damping, self.width)


class Backlash(AbstractLink):
    """Play between two nodes, or a node and the ground: F = k z(x) + c z'(x) v, z = `dead_zone` of half the gap.

    Args: node, to (None: the ground); gap: the whole play [m]; stiffness k [N/m]; damping c [N s/m] in contact; width
        over which contact sets in, on both sides of its edge [m].
    Displacement x is a state, with x' = v_node - v_to; zero, the middle of the play, at the start.
    Validity: damping may hold the parts back for an instant when they separate; no cycle creates energy.
    """

    node: str = port(TRANSLATIONAL)
    gap: Number = quantity("m", low=0.0, high=10.0, slip="was it given in mm?")
    stiffness: Number = quantity("N/m", low=0.0, high=1e15, slip="was it given in N/mm?")
    damping: Number = quantity("N*s/m", low=0.0, high=1e12, default=0.0)
    width: Number = quantity("m", low=1e-9, high=1.0, slip="was it given in mm?", default=1e-5)
    to: str | None = port(TRANSLATIONAL, optional=True)

    states = (State("displacement", "m", 1e-3),)

    def resistance(self, displacement, velocity):
        return play_force(displacement, velocity, self.gap, self.stiffness, self.damping, self.width)


class RotaryBacklash(AbstractLink):
    """Play between two shafts, or a shaft and the ground: T = k z(x) + c z'(x) w, z = `dead_zone` of half the gap.

    Args: node, to (None: the ground); gap: the whole play [rad]; stiffness k [N m/rad]; damping c [N m s/rad] in
        contact; width over which contact sets in, on both sides of its edge [rad].
    Twist x is a state, with x' = w_node - w_to; zero, the middle of the play, at the start.
    Validity: as `Backlash`.
    """

    node: str = port(ROTATIONAL)
    gap: Number = quantity("rad", low=0.0, high=10.0, slip="was it given in degrees?")
    stiffness: Number = quantity("N*m/rad", low=0.0, high=1e15, slip="was it given per degree?")
    damping: Number = quantity("N*m*s/rad", low=0.0, high=1e12, default=0.0)
    width: Number = quantity("rad", low=1e-9, high=1.0, slip="was it given in degrees?", default=1e-4)
    to: str | None = port(ROTATIONAL, optional=True)

    states = (State("twist", "rad", 1e-3),)

    def resistance(self, displacement, velocity):
        return play_force(displacement, velocity, self.gap, self.stiffness, self.damping, self.width)


class Gear(AbstractComponent):
    """A gear between two shafts with elastic teeth, play and losses; the twist of the teeth is a state.

    x' = w_a/i - w_b,   T = k z(x) + c z'(x) x' on shaft b,   T_a = -(T/i) exp(-ln(eta) tanh(T w_a/(i P_0)))

    so that steadily w_b = w_a/i, and b gets eta of the power that a gives, or a eta of what b gives. (A rigid gear
    would bind two nodes together; the teeth are made stiff instead.)

    Args: a, b: the shafts; ratio i = w_a/w_b, negative where they turn against each other [-]; stiffness k [N m/rad],
        damping c [N m s/rad], both seen at shaft b; backlash: the whole play, seen at shaft b [rad]; width over which
        contact sets in [rad]; efficiency eta [-], the same both ways; loss_power P_0 over which the loss reverses with
        the direction of power [W].
    Raises: ValueError for a ratio of 0.
    Validity: frequencies well below sqrt(k/J) of the smaller inertia seen at b; losses in proportion to the torque.
    Typical values: eta 0.97..0.99 a stage (unverified: quoted from memory), backlash 1e-4..1e-3 rad.
    Reference: own, from the balance of power; loss after the definition of efficiency.
    """

    a: str = port(ROTATIONAL)
    b: str = port(ROTATIONAL)
    ratio: Number = quantity("1", low=-1e6, high=1e6)
    stiffness: Number = quantity("N*m/rad", low=0.0, high=1e15, slip="was it given per degree?")
    damping: Number = quantity("N*m*s/rad", low=0.0, high=1e12, default=0.0)
    backlash: Number = quantity("rad", low=0.0, high=10.0, slip="was it given in degrees?", default=0.0)
    width: Number = quantity("rad", low=1e-9, high=1.0, slip="was it given in degrees?", default=1e-5)
    efficiency: Number = quantity("1", low=0.01, high=1.0, slip="was it given in percent?", default=1.0)
    loss_power: Number = quantity("W", low=1e-6, high=1e9, default=10.0)

    states = (State("twist", "rad", 1e-3),)

    def __check_init__(self):
        if isinstance(self.ratio, np.ndarray) and np.any(self.ratio == 0.0):
            raise ValueError("ratio must not be 0: it is the speed of shaft a over that of shaft b")

    def evaluate(self, at: Situation) -> Contribution:
        xp = array_module(self, at)
        sliding = at.potential["a"] / self.ratio - at.potential["b"]
        torque = play_force(at.state["twist"], sliding, self.backlash, self.stiffness, self.damping, self.width)
        ideal = torque / self.ratio
        loss = xp.exp(-xp.log(self.efficiency) * smooth_sign(ideal * at.potential["a"], self.loss_power))
        return Contribution(flow={"a": -ideal * loss, "b": torque}, rate={"twist": sliding})
