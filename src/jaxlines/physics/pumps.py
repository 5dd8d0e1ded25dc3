"""Positive-displacement pumps: fixed with losses and flow ripple, and pressure-compensated."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, array_module, driven, port, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.machine_losses import AbstractLosses, WilsonLosses
from jaxlines.physics.pressure_valves import check_order, pressure_opening

ANGLE, DISPLACEMENT = State("angle", "rad", 1.0), State("swash", "1", 1.0)


def kinematic_ripple(pistons: int, harmonics: int) -> np.ndarray:
    """Relative amplitudes a_k of the flow of equally spaced pistons that move as sines, shape (harmonics,) [-].

    sum_i max(sin(theta + 2 pi i/N), 0) = mean * (1 + sum_k a_k cos(k N theta)), a_k = -2/((k N)^2 - 1) where k N is
    even, else 0; the angle counts from where a piston starts to deliver.

    Validity: kinematics alone. Compressibility at the valve plate makes the ripple of a real pump several times larger.
    Typical values: N = 9: a_2 = -0.0062, a ripple of 1.5 % peak to peak.
    Reference: Fourier series of half-wave rectified sines, of which only multiples of N do not cancel.
    """
    order = pistons * np.arange(1, harmonics + 1)
    return np.where(order % 2 == 0, -2.0 / (order * order - 1.0 + (order == 1)), 0.0)


def _speed():
    return driven("rad/s", low=0.0, high=3e3, slip="was it given in rpm?")


def _displacement():
    return quantity("m^3/rad", low=0.0, high=1.0, slip="was it given in cm^3/rev?")


def loss_flow(pump: Any, fluid: Oil, p_inlet, p_outlet) -> Number:
    """Volume flow that slips from outlet to inlet of a pump [m^3/s] at two pressures [Pa], by its `losses`."""
    viscosity = fluid.dynamic_viscosity(0.5 * (p_inlet + p_outlet))
    return pump.losses.slip(pump.displacement, p_outlet - p_inlet, viscosity)


def _pumped(pump: Any, at: Situation, volume_flow) -> dict:
    """Mass flows into inlet and outlet: the volume displaced, at the inlet's density, less the slip."""
    p_inlet, p_outlet = at.potential["inlet"], at.potential["outlet"]
    slip = at.fluid.mass_flow(loss_flow(pump, at.fluid, p_inlet, p_outlet), p_outlet, p_inlet)
    mass = at.fluid.density_at(p_inlet) * volume_flow - slip
    return {"inlet": -mass, "outlet": mass}


class Pump(AbstractComponent):
    """A pump of fixed displacement, driven at a speed, with losses and, where given, flow ripple.

    Q = D w (1 + sum_k a_k cos(k N theta)) - Q_s,  theta' = w,  T = D dp + T_f

    Args: inlet, outlet: nodes; displacement D [m^3/rad]; speed w: number, signal or name of an input [rad/s]; losses:
        slip Q_s and friction T_f, such as `WilsonLosses.from_efficiencies(...)`, none by default; ripple_amplitudes
        a_k, shape (harmonics,), relative to the mean flow [-], None: no ripple and no state; pistons N.
    Raises: ValueError unless pistons is a number above zero.
    Validity: w >= 0, filled at the density of the inlet, slip straight from outlet to inlet, no cavitation. The angle
        grows without end: in float32 the ripple loses its phase after some 1e5 rad.
    Typical values: D 1e-6..1e-4 m^3/rad (6..600 cm^3/rev), efficiencies 0.9..0.97 at 10..20 MPa; N 7, 9, 11.
    Reference: see `WilsonLosses` and `kinematic_ripple`.
    """

    inlet: str = port()
    outlet: str = port()
    displacement: Number = _displacement()
    speed: Number = _speed()
    losses: AbstractLosses = WilsonLosses()
    ripple_amplitudes: Number | None = quantity("1", low=-1.0, high=1.0, slip="was it given in percent?", default=None)
    pistons: int = eqx.field(static=True, default=9)

    def __check_init__(self):
        if not isinstance(self.pistons, int) or self.pistons < 1:
            raise ValueError(f"pistons must be a number above zero, got {self.pistons!r}")
        if self.ripple_amplitudes is not None and np.ndim(self.ripple_amplitudes) < 1:
            raise ValueError("ripple_amplitudes must be a list, one for each harmonic of the piston frequency")

    def states_in(self, fluid) -> tuple[State, ...]:
        return () if self.ripple_amplitudes is None else (ANGLE,)

    def ripple(self, angle) -> Number:
        """Flow at a shaft angle [rad] relative to its mean [-]."""
        amplitudes, xp = self.ripple_amplitudes, array_module(self, angle)
        if amplitudes is None:
            return 1.0 + 0.0 * angle
        return 1.0 + sum(a * xp.cos(k * self.pistons * angle) for k, a in enumerate(amplitudes, start=1))

    def torque(self, fluid: Oil, p_inlet, p_outlet, speed) -> Number:
        """Mean torque T of the shaft [N m] at two pressures [Pa] and a speed [rad/s]."""
        viscosity, rise = fluid.dynamic_viscosity(0.5 * (p_inlet + p_outlet)), p_outlet - p_inlet
        return self.displacement * rise + self.losses.torque(self.displacement, rise, speed, viscosity)

    def evaluate(self, at: Situation) -> Contribution:
        delivered, rate = self.displacement * at.given["speed"], {}
        if self.ripple_amplitudes is not None:
            angle = at.state["angle"]
            delivered, rate = delivered * self.ripple(angle), {"angle": at.given["speed"] + 0.0 * angle}
        return Contribution(flow=_pumped(self, at, delivered), rate=rate)


class PressureCompensatedPump(AbstractComponent):
    """A pump whose displacement falls from full at the cut-off pressure to zero at dead head.

    alpha_ss = 1 - clip((dp - p_cut)/(p_dead - p_cut)), tau alpha' = alpha_ss - alpha,
    Q = alpha D w - Q_s

    Args: inlet, outlet: nodes; displacement D, full [m^3/rad]; speed w: number, signal or name of an input [rad/s];
        cut_off_pressure p_cut, dead_head_pressure p_dead [Pa], rises p_outlet - p_inlet; time_constant tau of the
        swash plate [s]; width of the rounded ends of the clip, see `soft_clip` [-]; losses: slip Q_s at full
        displacement, such as `WilsonLosses.from_efficiencies(...)`, none by default.
    Raises: ValueError unless p_dead is above p_cut.
    Validity: as `Pump`, without ripple; linear between cut-off and dead head; slip that does not fall with alpha, so
        that at no flow the pressure settles below dead head. Starts at the steady displacement of its pressures.
    Typical values: p_dead - p_cut 0.3..1 MPa, tau 0.02..0.1 s (unverified: quoted from memory).
    Reference: standard compensator with a proportional spring; see `WilsonLosses`.
    """

    inlet: str = port()
    outlet: str = port()
    displacement: Number = _displacement()
    speed: Number = _speed()
    cut_off_pressure: Number = quantity("Pa", low=0.0, high=1e9, slip="was it given in bar?")
    dead_head_pressure: Number = quantity("Pa", low=0.0, high=1e9, slip="was it given in bar?")
    time_constant: Number = quantity("s", low=1e-6, high=1e3, slip="was it given in ms?", default=0.03)
    width: Number = quantity("1", low=1e-6, high=0.49, slip="was it given in percent or Pa?", default=0.1)
    losses: AbstractLosses = WilsonLosses()

    states = (DISPLACEMENT,)

    def __check_init__(self):
        check_order("cut_off_pressure", self.cut_off_pressure, "dead_head_pressure", self.dead_head_pressure)

    def steady_swash(self, rise) -> Number:
        """alpha_ss, displacement as a share of the full one [-], at a rise of pressure [Pa]."""
        return 1.0 - pressure_opening(rise, self.cut_off_pressure, self.dead_head_pressure, self.width)

    def start(self, at: Situation) -> dict:
        return {"swash": self.steady_swash(at.potential["outlet"] - at.potential["inlet"])}

    def evaluate(self, at: Situation) -> Contribution:
        swash, rise = at.state["swash"], at.potential["outlet"] - at.potential["inlet"]
        flow = _pumped(self, at, swash * self.displacement * at.given["speed"])
        return Contribution(flow=flow, rate={"swash": (self.steady_swash(rise) - swash) / self.time_constant})
