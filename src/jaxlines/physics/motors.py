"""Hydraulic motors and the shaft they drive: mean torque, torque with piston ripple, inertia, load torque, brake."""

from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import ROTATIONAL, Number, array_module, driven, port, quantity
from jaxlines.physics.machine_losses import AbstractLosses
from jaxlines.physics.mechanics import smooth_sign


class AbstractMotor(AbstractComponent):
    """A displacement machine between the nodes a and b, with case drain: what those with and without ripple share."""

    if TYPE_CHECKING:  # fields of every final class; a type checker would take an AbstractVar for its first argument
        internal_leakage: ClassVar[Any]
        external_leakage: ClassVar[Any]
        viscous_friction: ClassVar[Any]
        pressure_friction: ClassVar[Any]
        coulomb_friction: ClassVar[Any]
        friction_speed: ClassVar[Any]
        losses: ClassVar[Any]

    def contribution(self, at: Situation, displacement, mean, rate: dict) -> Contribution:
        """Flows and torque of a machine that displaces so much now and on the mean [m^3/rad]; rates of its states."""
        p_a, p_b, p_case = at.potential["a"], at.potential["b"], at.potential["case"]
        speed, fluid, drop = at.potential["shaft"], at.fluid, p_a - p_b
        slip = self.internal_leakage * drop
        dry = 0.5 * self.pressure_friction * mean * (abs(p_a) + abs(p_b)) + self.coulomb_friction
        torque = displacement * drop - self.viscous_friction * speed - dry * smooth_sign(speed, self.friction_speed)
        if self.losses is not None:
            viscosity = fluid.dynamic_viscosity(0.5 * (p_a + p_b))
            slip = slip + self.losses.slip(mean, drop, viscosity)
            torque = torque - self.losses.torque(mean, drop, speed, viscosity)
        through = fluid.mass_flow(displacement * speed + slip, p_a, p_b)
        drain_a = fluid.mass_flow(self.external_leakage * (p_a - p_case), p_a, p_case)
        drain_b = fluid.mass_flow(self.external_leakage * (p_b - p_case), p_b, p_case)
        flow = {"a": -through - drain_a, "b": through - drain_b, "case": drain_a + drain_b, "shaft": torque}
        return Contribution(flow, rate=rate)


def _leakage(default: float):
    """Field: conductance of a leakage [m^3/(s Pa)]."""
    return quantity("m^3/(s*Pa)", low=0.0, high=1e-3, default=default)


def _pressure_friction():
    """Field: friction torque as a share of displacement times pressure [-]."""
    return quantity("1", low=0.0, high=1.0, slip="was it given in percent?", default=0.0)


class Motor(AbstractMotor):
    """Hydraulic motor (or pump) with internal and external leakage, case drain and friction.

    Q_a = D w + C_i (p_a - p_b) + C_e (p_a - p_case),  Q_b = -D w - C_i (p_a - p_b) + C_e (p_b - p_case)
    T = D (p_a - p_b) - B w - (f D (|p_a| + |p_b|)/2 + T_c) tanh(w/w_0)

    Args: a, b: working ports; case: node of the case drain; shaft: rotational node; displacement D
        [m^3/rad]; internal_leakage C_i, external_leakage C_e [m^3/(s Pa)]; viscous_friction B [N m s/rad];
        pressure_friction f [-]; coulomb_friction T_c [N m]; friction_speed w_0 [rad/s]; losses: `WilsonLosses`,
        with the viscosity of the fluid, in addition to those above (set internal_leakage to 0 where they replace it).
    Validity: mean torque and flow (no piston ripple; see `BentAxisMotor`).
    Typical values: D 1e-5..1e-4 m^3/rad, leakage 1e-12..1e-11 m^3/(s Pa), f 0.02..0.05.
    Reference: Merritt, "Hydraulic Control Systems", 1967, sec. 4-2 (standard form, quoted from memory).
    """

    a: str = port()
    b: str = port()
    case: str = port()
    shaft: str = port(ROTATIONAL)
    displacement: Number = quantity("m^3/rad", low=0.0, high=1.0, slip="was it given in cm^3/rev?")
    internal_leakage: Number = _leakage(1e-12)
    external_leakage: Number = _leakage(0.0)
    viscous_friction: Number = quantity("N*m*s/rad", low=0.0, default=0.0)
    pressure_friction: Number = _pressure_friction()
    coulomb_friction: Number = quantity("N*m", low=0.0, default=0.0)
    friction_speed: Number = quantity("rad/s", low=1e-6, high=1e3, default=0.1)
    losses: AbstractLosses | None = None

    def evaluate(self, at: Situation) -> Contribution:
        return self.contribution(at, self.displacement, self.displacement, {})


def commutated_lever(angle, pistons: int, width):
    """sum_i s(cos theta_i) cos theta_i over evenly spaced pistons [-]; s(x) = (1 + tanh(x/width))/2: share of port a.

    Args: angle of the shaft [rad]; pistons N; width of the commutation around the dead centres [rad].
    Validity: with a small width its mean is N/pi, less by the share pi^2 width^2/24.
    """
    xp = array_module(angle, width)
    shifts = 2.0 * np.pi / pistons * np.arange(pistons).reshape(-1, *[1] * np.ndim(angle))
    levers = xp.cos(angle + shifts)
    return (0.5 * (1.0 + xp.tanh(levers / width)) * levers).sum(axis=0)


class BentAxisMotor(AbstractMotor):
    """A bent-axis piston motor with the ripple of its torque and flow; the angle of its shaft is a state.

    T = sum_i A R P_i sin(gamma) cos(theta_i),   theta_i = theta + 2 pi i/N,   theta' = w

    with P_i = p_a while a piston moves out and p_b while it moves in, changing smoothly about the dead centres. As the
    sum of all cos(theta_i) is 0 this is T = D(theta) (p_a - p_b), and the same D(theta) w flows from a to b, so that
    without losses no energy is lost. Mean D = N A R sin(gamma)/pi; 2N ripples a revolution for odd N, N for even.

    Args: a, b, case, shaft: as `Motor`; piston_area A [m^2]; pitch_radius R, of the circle of the pistons' joints
        [m]; bend_angle gamma [rad]; pistons N; commutation_width w_c around the dead centres [rad]; leakages,
        frictions, losses: as `Motor`, friction with the mean displacement.
    Raises: ValueError for fewer than 3 pistons.
    Validity: no compressibility in the cylinders, no pre-compression; mean less by the share (pi w_c)^2/24.
    Typical values: N 7 or 9, gamma 25..40 degrees (0.44..0.70 rad), w_c 0.02..0.1 rad (the last two unverified: quoted
        from memory).
    Reference: Bartos, "Mathematical Modeling of Bent-Axis Hydraulic Piston Motors", TDA Progress Report 42-111, JPL,
        1992, eq. (1); flow and commutation are our own, from the balance of power.
    """

    a: str = port()
    b: str = port()
    case: str = port()
    shaft: str = port(ROTATIONAL)
    piston_area: Number = quantity("m^2", low=0.0, high=1.0, slip="was it given in cm^2?")
    pitch_radius: Number = quantity("m", low=0.0, high=10.0, slip="was it given in mm?")
    bend_angle: Number = quantity("rad", low=0.0, high=1.6, slip="was it given in degrees?")
    pistons: int = eqx.field(static=True, default=9)
    commutation_width: Number = quantity("rad", low=1e-3, high=1.0, slip="was it given in degrees?", default=0.05)
    internal_leakage: Number = _leakage(1e-12)
    external_leakage: Number = _leakage(0.0)
    viscous_friction: Number = quantity("N*m*s/rad", low=0.0, default=0.0)
    pressure_friction: Number = _pressure_friction()
    coulomb_friction: Number = quantity("N*m", low=0.0, default=0.0)
    friction_speed: Number = quantity("rad/s", low=1e-6, high=1e3, default=0.1)
    losses: AbstractLosses | None = None

    states = (State("angle", "rad", 1.0),)

    def __check_init__(self):
        if not isinstance(self.pistons, int) or self.pistons < 3:
            raise ValueError(f"pistons must be a whole number of at least 3, got {self.pistons!r}")

    def _per_piston(self):
        """A R sin(gamma) [m^3/rad]."""
        return self.piston_area * self.pitch_radius * array_module(self).sin(self.bend_angle)

    def displacement(self) -> Number:
        """Mean displacement of ideal commutation N A R sin(gamma)/pi [m^3/rad]."""
        return self.pistons / np.pi * self._per_piston()

    def displacement_at(self, angle) -> Number:
        """D(theta) [m^3/rad] at an angle of the shaft [rad]."""
        return self._per_piston() * commutated_lever(angle, self.pistons, self.commutation_width)

    def evaluate(self, at: Situation) -> Contribution:
        now = self.displacement_at(at.state["angle"])
        return self.contribution(at, now, self.displacement(), {"angle": at.potential["shaft"]})


class Inertia(AbstractComponent):
    """Moment of inertia J on a shaft [kg m^2]: the capacity of a rotational node."""

    shaft: str = port(ROTATIONAL)
    moment_of_inertia: Number = quantity("kg*m^2", low=1e-9, high=1e12)

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(capacity={"shaft": self.moment_of_inertia + 0.0 * at.potential["shaft"]})


class LoadTorque(AbstractComponent):
    """External torque on a shaft, positive in the direction of positive speed [N m]; signal or input."""

    shaft: str = port(ROTATIONAL)
    torque: Number = driven("N*m")

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(flow={"shaft": at.given["torque"] + 0.0 * at.potential["shaft"]})


class Brake(AbstractComponent):
    """Friction brake, released by pressure: holds with T_b (1 - r) tanh(w/w_0), r its smooth release 0..1.

    r = 1/(1 + exp(-4 (p - p_release)/p_width)), so that it is half released at p_release.

    Args: shaft; port a: node whose pressure releases the brake (P_B of the article); holding_torque T_b
        [N m]; release_pressure [Pa absolute]; release_width p_width [Pa]; slip_speed w_0 [rad/s].
    Validity: a braked shaft creeps at up to about w_0 under load (smooth friction has no true sticking).
    """

    shaft: str = port(ROTATIONAL)
    a: str = port()
    holding_torque: Number = quantity("N*m", low=0.0)
    release_pressure: Number = quantity("Pa", low=0.0, high=1e9, slip="was it given in bar?", level=True, default=2e6)
    release_width: Number = quantity("Pa", low=1e2, high=1e9, slip="was it given in bar?", default=4e5)
    slip_speed: Number = quantity("rad/s", low=1e-6, high=1e3, default=0.01)

    def evaluate(self, at: Situation) -> Contribution:
        # 1 - r as a tanh, which neither overflows nor loses its derivative where the brake is far from release.
        engaged = 0.5 - 0.5 * jnp.tanh(2.0 * (at.potential["a"] - self.release_pressure) / self.release_width)
        speed = at.potential["shaft"]
        return Contribution(flow={"shaft": -self.holding_torque * engaged * smooth_sign(speed, self.slip_speed)})


class Supercharge(AbstractComponent):
    """Supercharge of a working line through a check valve: keeps it from falling below the supercharge pressure.

    Q = G w ln(1 + exp((p_supply - p_line - p_crack)/w)): linear in the pressure difference once open,
    smooth through the crack, never backwards.

    Args: supply: node of the supercharge pressure (P_SC of the article); line: node kept filled;
        conductance G when open [m^3/(s Pa)]; cracking_pressure p_crack [Pa]; width w [Pa] of the transition.
    Typical values: supercharge 1e6..2e6 Pa, cracking 3e4 Pa, G 1e-9 m^3/(s Pa).
    """

    supply: str = port()
    line: str = port()
    conductance: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, default=1e-9)
    cracking_pressure: Number = quantity("Pa", low=0.0, high=1e8, slip="was it given in bar?", default=3e4)
    width: Number = quantity("Pa", low=1.0, high=1e7, default=5e3)

    def evaluate(self, at: Situation) -> Contribution:
        p_supply, p_line = at.potential["supply"], at.potential["line"]
        excess = (p_supply - p_line - self.cracking_pressure) / self.width
        mass = at.fluid.mass_flow(self.conductance * self.width * jnp.logaddexp(excess, 0.0), p_supply, p_line)
        return Contribution(flow={"supply": -mass, "line": mass})
