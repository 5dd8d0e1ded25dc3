"""The hydraulic motor and the shaft it drives: inertia, load torque, brake."""

import jax.numpy as jnp

from jaxlines.physics.component import AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import ROTATIONAL, Number, driven, port, quantity


def smooth_sign(x, width):
    """tanh(x/width): a sign that is smooth through zero, 0.96 at twice the width."""
    return jnp.tanh(x / width)


class Motor(AbstractComponent):
    """Hydraulic motor (or pump) with internal and external leakage, case drain and friction.

    Q_a = D w + C_i (p_a - p_b) + C_e (p_a - p_case),  Q_b = -D w - C_i (p_a - p_b) + C_e (p_b - p_case)
    T = D (p_a - p_b) - B w - (f D (|p_a| + |p_b|)/2 + T_c) tanh(w/w_0)

    Args: a, b: working ports; case: node of the case drain; shaft: rotational node; displacement D
        [m^3/rad]; internal_leakage C_i, external_leakage C_e [m^3/(s Pa)]; viscous_friction B [N m s/rad];
        pressure_friction f [-]; coulomb_friction T_c [N m]; friction_speed w_0 [rad/s].
    Validity: mean torque and flow (no piston ripple).
    Typical values: D 1e-5..1e-4 m^3/rad, leakage 1e-12..1e-11 m^3/(s Pa), f 0.02..0.05.
    Reference: Merritt, "Hydraulic Control Systems", 1967, sec. 4-2 (standard form, quoted from memory).
    """

    a: str = port()
    b: str = port()
    case: str = port()
    shaft: str = port(ROTATIONAL)
    displacement: Number = quantity("m^3/rad", low=0.0, high=1.0, slip="was it given in cm^3/rev?")
    internal_leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, default=1e-12)
    external_leakage: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, default=0.0)
    viscous_friction: Number = quantity("N*m*s/rad", low=0.0, default=0.0)
    pressure_friction: Number = quantity("1", low=0.0, high=1.0, slip="was it given in percent?", default=0.0)
    coulomb_friction: Number = quantity("N*m", low=0.0, default=0.0)
    friction_speed: Number = quantity("rad/s", low=1e-6, high=1e3, default=0.1)

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b, p_case = at.potential["a"], at.potential["b"], at.potential["case"]
        speed, fluid = at.potential["shaft"], at.fluid
        through = fluid.mass_flow(self.displacement * speed + self.internal_leakage * (p_a - p_b), p_a, p_b)
        drain_a = fluid.mass_flow(self.external_leakage * (p_a - p_case), p_a, p_case)
        drain_b = fluid.mass_flow(self.external_leakage * (p_b - p_case), p_b, p_case)
        dry = 0.5 * self.pressure_friction * self.displacement * (abs(p_a) + abs(p_b)) + self.coulomb_friction
        torque = (
            self.displacement * (p_a - p_b)
            - self.viscous_friction * speed
            - dry * smooth_sign(speed, self.friction_speed)
        )
        return Contribution(
            flow={"a": -through - drain_a, "b": through - drain_b, "case": drain_a + drain_b, "shaft": torque}
        )


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
