"""Lumped lines: one pressure, the capacitance of all parts together, and the fluid's inertia as an element."""

import equinox as eqx

from jaxlines.physics.article import line_constant, round_trip_time, wave_speed
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.containers import AbstractContainer, Pipe, Vessel, capacity, volume_at
from jaxlines.physics.fields import Number, port, quantity
from jaxlines.physics.fluids import Oil


def _as_parts(parts) -> tuple[AbstractContainer, ...]:
    """One container or several, as a tuple."""
    return (parts,) if isinstance(parts, AbstractContainer) else tuple(parts)


class Line(AbstractComponent):
    """A short line as one capacitance: eq. (8) of the article with eqs. (2), (4) and (5).

    Mass balance: dp/dt sum_i d(rho V_i)/dp = sum of mass flows, V_i(p) = V_ref,i exp((p - p_atm)/K_c,i).

    Args:
        node: the node whose pressure this line has.
        parts: the containers it is made of (`Pipe`, `Vessel`), or a single one.
        path_length: longest fluid path through it [m], for the validity check of eqs. (10) and (11);
            0 for a plain volume.
    Raises: TypeError when a part is not a container.
    Validity: 2 L/c_0 < 1/f (necessary), error of the input impedance as `simulate(...).validity()`
    reports; friction and inertia drops small against the pressure.
    Typical values: the antennas' control lines 0.025 m^3, 1.29e9 Pa effective, 20.83 m.
    """

    node: str = port()
    parts: tuple[AbstractContainer, ...] = eqx.field(converter=_as_parts)  # pyright: ignore[reportGeneralTypeIssues]
    path_length: Number = quantity("m", low=0.0, high=1e5, slip="was it given in mm?", default=0.0)

    def __check_init__(self):
        wrong = [part for part in self.parts if not isinstance(part, AbstractContainer)]
        if wrong or not self.parts:
            raise TypeError(f"parts of a Line are containers (Pipe, Vessel), got {wrong[0] if wrong else 'none'!r}")

    @staticmethod
    def from_effective_modulus(node: str, volume, effective_modulus, fluid_modulus, path_length=0.0) -> "Line":
        """A line of which volume and effective modulus are known together with the fluid modulus behind them."""
        return Line(node, Vessel.from_effective_modulus(volume, effective_modulus, fluid_modulus), path_length)

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(capacity={"node": self.capacity(at.fluid, at.potential["node"])})

    def capacity(self, fluid: Oil, p) -> Number:
        """dm/dp of the whole line [kg/Pa] at absolute pressure p [Pa]."""
        return sum(capacity(part, fluid, p) for part in self.parts)

    def volume(self) -> Number:
        """V_0 at atmospheric pressure [m^3]."""
        return sum(part.reference_volume() for part in self.parts)

    def effective_bulk_modulus(self, fluid: Oil, p) -> Number:
        """beta of fluid, air and walls together [Pa] at absolute pressure p, eqs. (2) and (5)."""
        mass = fluid.density_at(p) * sum(volume_at(part, fluid, p) for part in self.parts)
        return mass / self.capacity(fluid, p)

    def wave_speed(self, fluid: Oil, p) -> Number:
        """c_0 [m/s] at absolute pressure p [Pa], eq. (9)."""
        return wave_speed(self.effective_bulk_modulus(fluid, p), fluid.density_at(p))

    def round_trip_time(self, fluid: Oil, p) -> Number:
        """2 L/c_0 [s] at absolute pressure p [Pa], eq. (10)."""
        return round_trip_time(self.path_length, self.wave_speed(fluid, p))

    def line_constant(self, fluid: Oil, p) -> Number:
        """K = beta/V_0 of eq. (12) [N/m^5] at absolute pressure p [Pa]."""
        return line_constant(self.effective_bulk_modulus(fluid, p), self.volume())

    def laminar_resistance(self, fluid: Oil) -> Number:
        """Laminar resistance of its pipes in series [Pa s/m^3]; 0 for vessels. Valid for Re < 2000."""
        return sum(part.laminar_resistance(fluid) for part in self.parts if isinstance(part, Pipe))

    def inertance(self, fluid: Oil) -> Number:
        """Inertance of its pipes in series [Pa s^2/m^3]; 0 for vessels."""
        return sum(part.inertance(fluid) for part in self.parts if isinstance(part, Pipe))


class FluidInertia(AbstractComponent):
    """The column of fluid in a line between two nodes: inertance and resistance, no compressibility.

    I dQ/dt = p_a - p_b - R Q - R_2 Q |Q|

    Args: a, b: nodes, flow positive from a to b; inertance I = rho L/A [Pa s^2/m^3]; resistance R
        [Pa s/m^3] (laminar: 128 mu L/(pi D^4)); quadratic_resistance R_2 [Pa s^2/m^6].
    Validity: rigid column, events slower than the line's own wave time.
    Typical values: 10 m of 20 mm hose: I 2.8e7 Pa s^2/m^3, R 7.6e7 Pa s/m^3.
    Reference: Merritt, "Hydraulic Control Systems", 1967, ch. 3.
    """

    a: str = port()
    b: str = port()
    inertance: Number = quantity("Pa*s^2/m^3", low=1e-3, high=1e15)
    resistance: Number = quantity("Pa*s/m^3", low=0.0, default=0.0)
    quadratic_resistance: Number = quantity("Pa*s^2/m^6", low=0.0, default=0.0)

    states = (State("volume_flow", "m^3/s", 1e-4),)

    def evaluate(self, at: Situation) -> Contribution:
        q = at.state["volume_flow"]
        p_a, p_b = at.potential["a"], at.potential["b"]
        drop = (self.resistance + self.quadratic_resistance * abs(q)) * q
        mass = at.fluid.mass_flow(q, p_a, p_b)
        return Contribution(flow={"a": -mass, "b": mass}, rate={"volume_flow": (p_a - p_b - drop) / self.inertance})
