"""Lumped lines: one pressure, the capacitance of all parts together, and the fluid's inertia as an element."""

import equinox as eqx

from jaxlines.physics.article import line_constant, round_trip_time, wave_speed
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.containers import (
    AbstractConduit,
    AbstractContainer,
    Vessel,
    capacity,
    volume_at,
)
from jaxlines.physics.fields import Number, port, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.friction import AbstractFriction, LaminarFriction
from jaxlines.physics.ladder import MODELS, Ladder, cut, ladder_contribution, ladder_start, ladder_states
from jaxlines.physics.storage import resting_strain, stored
from jaxlines.physics.weighting import AbstractWeighting


def _as_parts(parts) -> tuple[AbstractContainer, ...]:
    """One container or several, as a tuple."""
    return (parts,) if isinstance(parts, AbstractContainer) else tuple(parts)


class Line(AbstractComponent):
    """A line: one capacitance at a node (the article's model), or a chain of segments between two nodes.

    Without `to`, eq. (8) of the article with eqs. (2), (4) and (5): dp/dt sum_i d(rho V_i)/dp = sum of mass flows,
    V_i(p) = V_ref,i exp((p - p_atm)/K_c,i); no friction, no inertia.

    With `to`, resistance, inertance and capacitance in N segments (see `jaxlines.physics.ladder`): waves up to
    some N/20 wavelengths long are right within 0.4 %.

    Args:
        node: the node whose pressure this line has, or the node at its first end.
        parts: the containers it is made of (`Pipe`, `Hose`, `Vessel`), or a single one. With `to` exactly one conduit:
            join different ones end to end at nodes of their own.
        path_length: longest fluid path through it [m], for the validity check of eqs. (10) and (11);
            0 for a plain volume. With `to` it is the conduit's length.
        to: the node at the other end; flows are positive from `node` to `to`.
        segments: number of segments N, or "auto": chosen from wave speed and highest frequency when simulated.
        model: "pi" (half a volume at each end, adds capacity to both nodes) or "T" (half a column of fluid at each
            end, adds none).
        friction: steady friction law; laminar by default.
        weights: weighting function of frequency-dependent friction; None is steady friction only.
        loss_coefficient: K of bends and fittings together, drop K rho V|V|/2, spread along the line [-].
        elevation: height of `to` above `node` [m].
    Raises: TypeError when a part is not a container; ValueError for a wrong choice, or detail without `to`.
    Validity: without `to` 2 L/c_0 < 1/f (necessary), error of the input impedance as `simulate(...).validity()`
    reports; with it one-dimensional flow, Mach number V/c << 1, steps ring at the shortest wave of the ladder.
    Typical values: the antennas' control lines 0.025 m^3, 1.29e9 Pa effective, 20.83 m; 20 segments per wavelength.
    """

    node: str = port()
    parts: tuple[AbstractContainer, ...] = eqx.field(converter=_as_parts)  # pyright: ignore[reportGeneralTypeIssues]
    path_length: Number = quantity("m", low=0.0, high=1e5, slip="was it given in mm?", default=0.0)
    to: str | None = port(optional=True)
    segments: int | str = eqx.field(static=True, default="auto")
    model: str = eqx.field(static=True, default="pi")
    friction: AbstractFriction = eqx.field(default=LaminarFriction())
    weights: AbstractWeighting | None = None
    loss_coefficient: Number = quantity("1", low=0.0, high=1e6, default=0.0)
    elevation: Number = quantity("m", low=-1e4, high=1e4, slip="was it given in mm?", default=0.0)

    def __check_init__(self):
        wrong = [part for part in self.parts if not isinstance(part, AbstractContainer)]
        if wrong or not self.parts:
            raise TypeError(f"parts of a Line are containers (Pipe, Vessel), got {wrong[0] if wrong else 'none'!r}")
        if self.model not in MODELS:
            raise ValueError(f'model must be "pi" or "T", got {self.model!r}')
        if self.segments != "auto" and not (type(self.segments) is int and 1 <= self.segments <= 10_000):
            raise ValueError(f'segments must be "auto" or a number from 1 to 10000, got {self.segments!r}')
        if self.to is None and (self.segments != "auto" or self.weights is not None):
            raise ValueError("segments and weights need the node at the line's other end: give it as to=...")
        if self.to is not None and [isinstance(part, AbstractConduit) for part in self.parts] != [True]:
            kinds = ", ".join(type(part).__name__ for part in self.parts)
            raise ValueError(
                f"a Line between two nodes is one conduit (Pipe, Hose), got {kinds}: join several Lines at nodes, "
                "and give a vessel a Line of its own"
            )

    @staticmethod
    def from_effective_modulus(node: str, volume, effective_modulus, fluid_modulus, path_length=0.0) -> "Line":
        """A line of which volume and effective modulus are known together with the fluid modulus behind them."""
        return Line(node, Vessel.from_effective_modulus(volume, effective_modulus, fluid_modulus), path_length)

    def ladder(self) -> Ladder:
        """The segments of a line between two nodes. Raises: ValueError while their number is "auto"."""
        conduit = self.parts[0]
        if isinstance(self.segments, str) or not isinstance(conduit, AbstractConduit):
            raise ValueError('segments="auto" must be settled before: see jaxlines.choose_segments')
        pieces = cut(self.segments, self.model)
        return Ladder(conduit, pieces, self.friction, self.weights, self.loss_coefficient, self.elevation)

    def states_in(self, fluid: Oil) -> tuple[State, ...]:
        if self.to is not None:
            return ladder_states(self.ladder(), fluid)
        slow = [State(f"parts.{i}.delayed_strain", "1", 1e-3) for i, part in enumerate(self.parts) if part.delayed]
        return (*slow, *([State("undissolved_air", "1", 1.0)] if fluid.air.kinetic else []))

    def start(self, at: Situation) -> dict:
        if self.to is not None:
            return ladder_start(self.ladder(), at)
        p, fluid = at.potential["node"], at.fluid
        slow = {f"parts.{i}.delayed_strain": resting_strain(x, fluid, p) for i, x in enumerate(self.parts) if x.delayed}
        return slow | ({"undissolved_air": fluid.undissolved_air(p)} if fluid.air.kinetic else {})

    def evaluate(self, at: Situation) -> Contribution:
        if self.to is not None:
            return ladder_contribution(self.ladder(), at)
        p, air, rates = at.potential["node"], at.state.get("undissolved_air"), {}
        kept = []
        for i, part in enumerate(self.parts):
            strain = at.state.get(f"parts.{i}.delayed_strain")
            kept.append(stored(part, at.fluid, p, strain, air))
            if strain is not None:
                rates[f"parts.{i}.delayed_strain"] = kept[-1].rates["delayed_strain"]
        capacity = sum(part.capacity for part in kept)
        if air is not None:
            rates["undissolved_air"] = kept[0].rates["undissolved_air"]
        flow = {"node": sum(part.release for part in kept)} if rates else {}
        return Contribution(flow, {"node": capacity}, rates)

    def capacity(self, fluid: Oil, p) -> Number:
        """dm/dp of the whole line [kg/Pa] at absolute pressure p [Pa], walls and air settled as they are at once."""
        return sum(capacity(part, fluid, p) for part in self.parts)

    def length(self) -> Number:
        """Length of the fluid path [m]: the conduit's between two nodes, else `path_length`."""
        return self.path_length if self.to is None else self.parts[0].length  # pyright: ignore[reportAttributeAccessIssue]

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
        return round_trip_time(self.length(), self.wave_speed(fluid, p))

    def line_constant(self, fluid: Oil, p) -> Number:
        """K = beta/V_0 of eq. (12) [N/m^5] at absolute pressure p [Pa]."""
        return line_constant(self.effective_bulk_modulus(fluid, p), self.volume())

    def laminar_resistance(self, fluid: Oil) -> Number:
        """Laminar resistance of its conduits in series [Pa s/m^3]; 0 for vessels. Valid for Re < 2000."""
        return sum(part.laminar_resistance(fluid) for part in self.parts if isinstance(part, AbstractConduit))

    def inertance(self, fluid: Oil) -> Number:
        """Inertance of its conduits in series [Pa s^2/m^3]; 0 for vessels."""
        return sum(part.inertance(fluid) for part in self.parts if isinstance(part, AbstractConduit))


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
