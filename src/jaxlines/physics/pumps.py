"""Positive-displacement pumps: fixed with losses and flow ripple, and pressure-compensated."""

import equinox as eqx
import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, array_module, driven, port, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.pressure_valves import check_order, pressure_opening

ANGLE, DISPLACEMENT = State("angle", "rad", 1.0), State("swash", "1", 1.0)


def slip_coefficient(volumetric_efficiency, pressure, speed, viscosity):
    """Wilson's slip coefficient from one rated point: C_s = (1 - eta_v) mu w/p [-].

    Args: volumetric_efficiency eta_v [-] at pressure p [Pa], speed w [rad/s], dynamic viscosity mu [Pa s].
    Typical values: 1e-8..1e-7.
    Reference: Wilson, "Positive-Displacement Pumps and Fluid Motors", 1950; as in McCloy and Martin, "Control of
        Fluid Power", 1980 (both unverified: quoted from memory; the form is that of public simulation code).
    """
    return (1.0 - volumetric_efficiency) * viscosity * speed / pressure


def slip_flow(coefficient, displacement, fluid: Oil, p_inlet, p_outlet):
    """Leakage flow from outlet to inlet C_s D (p_outlet - p_inlet)/mu [m^3/s], at the viscosity of the mean pressure.

    Args: coefficient C_s [-]; displacement D [m^3/rad]; fluid; p_inlet, p_outlet [Pa].
    Reference: see `slip_coefficient`.
    """
    viscosity = fluid.dynamic_viscosity(0.5 * (p_inlet + p_outlet))
    return coefficient * displacement * (p_outlet - p_inlet) / viscosity


def viscous_coefficient(mechanical_efficiency, pressure, speed, viscosity):
    """Wilson's coefficient of viscous torque from one rated point: C_D = (1/eta_m - 1) p/(mu w) [-].

    Args: mechanical_efficiency eta_m [-]; others and reference as `slip_coefficient`.
    Typical values: 1e5..1e6.
    """
    return (1.0 / mechanical_efficiency - 1.0) * pressure / (viscosity * speed)


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


def _efficiency():
    return quantity("1", low=0.01, high=1.0, slip="was it given in percent?", default=1.0)


def _displacement():
    return quantity("m^3/rad", low=0.0, high=1.0, slip="was it given in cm^3/rev?")


def _rated(unit: str, low: float, high: float, slip: str, default: float):
    return quantity(unit, low=low, high=high, slip=slip, default=default)


class Pump(AbstractComponent):
    """A pump of fixed displacement with losses after Wilson and, where given, flow ripple.

    Q = D w (1 + sum_k a_k cos(k N theta)) - C_s D dp/mu,  theta' = w,  T = D dp + C_D mu D w

    Args: inlet, outlet: nodes; displacement D [m^3/rad]; speed w: number, signal or name of an input [rad/s];
        volumetric_efficiency, mechanical_efficiency at rated_pressure [Pa], rated_speed [rad/s] and rated_viscosity
        (dynamic) [Pa s], of which C_s and C_D follow; 1 means no loss; ripple_amplitudes a_k, shape (harmonics,),
        relative to the mean flow [-], None: no ripple and no state; pistons N.
    Raises: ValueError unless pistons is a number above zero.
    Validity: w >= 0, filled at the density of the inlet, slip laminar and straight from outlet to inlet, no
        cavitation. The angle grows without end: in float32 the ripple loses its phase after some 1e5 rad.
    Typical values: D 1e-6..1e-4 m^3/rad (6..600 cm^3/rev), efficiencies 0.9..0.97 at 10..20 MPa; N 7, 9, 11.
    Reference: see `slip_coefficient`, `viscous_coefficient`, `kinematic_ripple`.
    """

    inlet: str = port()
    outlet: str = port()
    displacement: Number = _displacement()
    speed: Number = _speed()
    volumetric_efficiency: Number = _efficiency()
    mechanical_efficiency: Number = _efficiency()
    rated_pressure: Number = _rated("Pa", 1e4, 1e9, "was it given in bar?", 1e7)
    rated_speed: Number = _rated("rad/s", 0.1, 3e3, "was it given in rpm?", 157.0)
    rated_viscosity: Number = _rated("Pa*s", 1e-5, 10.0, "was it given in mPa s (cP)?", 0.027)
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

    def slip(self, fluid: Oil, p_inlet, p_outlet) -> Number:
        """Leakage flow from outlet to inlet [m^3/s] at two pressures [Pa]."""
        rated = (self.rated_pressure, self.rated_speed, self.rated_viscosity)
        strength = slip_coefficient(self.volumetric_efficiency, *rated)
        return slip_flow(strength, self.displacement, fluid, p_inlet, p_outlet)

    def torque(self, fluid: Oil, p_inlet, p_outlet, speed) -> Number:
        """Mean torque T of the shaft [N m] at two pressures [Pa] and a speed [rad/s]."""
        rated = (self.rated_pressure, self.rated_speed, self.rated_viscosity)
        viscosity = fluid.dynamic_viscosity(0.5 * (p_inlet + p_outlet))
        drag = viscous_coefficient(self.mechanical_efficiency, *rated) * viscosity * speed
        return self.displacement * (p_outlet - p_inlet + drag)

    def evaluate(self, at: Situation) -> Contribution:
        p_inlet, p_outlet, speed = at.potential["inlet"], at.potential["outlet"], at.given["speed"]
        delivered = at.fluid.density_at(p_inlet) * self.displacement * speed
        rate = {}
        if self.ripple_amplitudes is not None:
            angle = at.state["angle"]
            delivered, rate = delivered * self.ripple(angle), {"angle": speed + 0.0 * angle}
        mass = delivered - at.fluid.mass_flow(self.slip(at.fluid, p_inlet, p_outlet), p_outlet, p_inlet)
        return Contribution(flow={"inlet": -mass, "outlet": mass}, rate=rate)


class PressureCompensatedPump(AbstractComponent):
    """A pump whose displacement falls from full at the cut-off pressure to zero at dead head.

    alpha_ss = 1 - clip((dp - p_cut)/(p_dead - p_cut)), tau alpha' = alpha_ss - alpha,
    Q = alpha D w - C_s D dp/mu

    Args: inlet, outlet: nodes; displacement D, full [m^3/rad]; speed w: number, signal or name of an input [rad/s];
        cut_off_pressure p_cut, dead_head_pressure p_dead [Pa], rises p_outlet - p_inlet; time_constant tau of the
        swash plate [s]; width of the rounded ends of the clip, see `soft_clip` [-]; volumetric_efficiency at
        rated_pressure [Pa], rated_speed [rad/s] and rated_viscosity [Pa s] at full displacement, gives the slip C_s.
    Raises: ValueError unless p_dead is above p_cut.
    Validity: as `Pump`, without ripple; linear between cut-off and dead head; the slip is then what little flow the
        pump must deliver at dead head less. Starts at the steady displacement of its pressures.
    Typical values: p_dead - p_cut 0.3..1 MPa, tau 0.02..0.1 s (unverified: quoted from memory).
    Reference: standard compensator with a proportional spring; slip as `slip_coefficient`.
    """

    inlet: str = port()
    outlet: str = port()
    displacement: Number = _displacement()
    speed: Number = _speed()
    cut_off_pressure: Number = quantity("Pa", low=0.0, high=1e9, slip="was it given in bar?")
    dead_head_pressure: Number = quantity("Pa", low=0.0, high=1e9, slip="was it given in bar?")
    time_constant: Number = quantity("s", low=1e-6, high=1e3, slip="was it given in ms?", default=0.03)
    width: Number = quantity("1", low=1e-6, high=0.49, slip="was it given in percent or Pa?", default=0.1)
    volumetric_efficiency: Number = _efficiency()
    rated_pressure: Number = _rated("Pa", 1e4, 1e9, "was it given in bar?", 1e7)
    rated_speed: Number = _rated("rad/s", 0.1, 3e3, "was it given in rpm?", 157.0)
    rated_viscosity: Number = _rated("Pa*s", 1e-5, 10.0, "was it given in mPa s (cP)?", 0.027)

    states = (DISPLACEMENT,)

    def __check_init__(self):
        check_order("cut_off_pressure", self.cut_off_pressure, "dead_head_pressure", self.dead_head_pressure)

    def steady_swash(self, rise) -> Number:
        """alpha_ss, displacement as a share of the full one [-], at a rise of pressure [Pa]."""
        return 1.0 - pressure_opening(rise, self.cut_off_pressure, self.dead_head_pressure, self.width)

    def slip(self, fluid: Oil, p_inlet, p_outlet) -> Number:
        """Leakage flow from outlet to inlet [m^3/s] at two pressures [Pa]."""
        rated = (self.rated_pressure, self.rated_speed, self.rated_viscosity)
        strength = slip_coefficient(self.volumetric_efficiency, *rated)
        return slip_flow(strength, self.displacement, fluid, p_inlet, p_outlet)

    def start(self, at: Situation) -> dict:
        return {"swash": self.steady_swash(at.potential["outlet"] - at.potential["inlet"])}

    def evaluate(self, at: Situation) -> Contribution:
        p_inlet, p_outlet, swash = at.potential["inlet"], at.potential["outlet"], at.state["swash"]
        delivered = at.fluid.density_at(p_inlet) * swash * self.displacement * at.given["speed"]
        mass = delivered - at.fluid.mass_flow(self.slip(at.fluid, p_inlet, p_outlet), p_outlet, p_inlet)
        rate = {"swash": (self.steady_swash(p_outlet - p_inlet) - swash) / self.time_constant}
        return Contribution(flow={"inlet": -mass, "outlet": mass}, rate=rate)
