"""A line cut into segments: a staggered chain of volumes, each with a pressure, and columns of fluid, each with a flow.

The pi model has half a volume at each end and a column in every segment; the T model half a column at each end
and a volume in every segment. Lengths of the columns and shares of the volumes add up to the line's, whatever
the number of segments. The angular frequencies of a lossless pi ladder are exactly (2 N c/L) sin(k L/(2 N)).
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import Contribution, Situation, State
from jaxlines.physics.containers import AbstractConduit, area
from jaxlines.physics.fields import GRAVITY
from jaxlines.physics.fluids import Oil
from jaxlines.physics.friction import AbstractFriction, minor_loss_drop
from jaxlines.physics.storage import Stored, resting_strain, stored
from jaxlines.physics.weighting import AbstractWeighting

MODELS = ("pi", "T")


class Cut(NamedTuple):
    """Shares of the length in each column of fluid, and of the volume at each pressure, both ends included."""

    columns: np.ndarray
    volumes: np.ndarray

    def positions(self) -> np.ndarray:
        """Where the pressures are along the line, 0 to 1."""
        return np.concatenate([[0.0], np.cumsum(self.columns)])


def cut(segments: int, model: str) -> Cut:
    """The shares of a line of N segments."""
    whole, split = np.full(segments, 1.0 / segments), np.full(segments + 1, 1.0 / segments)
    split[[0, -1]] = 0.5 / segments
    return Cut(whole, split) if model == "pi" else Cut(split, np.concatenate([[0.0], whole, [0.0]]))


class Ladder(NamedTuple):
    """Everything that the equations of a segmented line need."""

    conduit: AbstractConduit
    cut: Cut
    friction: AbstractFriction
    weights: AbstractWeighting | None
    loss_coefficient: Any
    elevation: Any

    @property
    def ends_store(self) -> bool:
        """Whether the line adds capacity to the nodes at its ends (pi)."""
        return bool(self.cut.volumes[0] > 0.0)

    def volumes(self) -> np.ndarray:
        """Shares of the volumes that exist."""
        return self.cut.volumes if self.ends_store else self.cut.volumes[1:-1]


def ladder_states(ladder: Ladder, fluid: Oil) -> tuple[State, ...]:
    """The states of a segmented line: inner pressures, flows, and what slow walls, air and friction remember."""
    columns, volumes = ladder.cut.columns.size, ladder.volumes().size
    inner = ladder.cut.volumes.size - 2
    states = [State("volume_flow", "m^3/s", 1e-4, (columns,))]
    states += [State("pressure", "Pa", 1e6, (inner,))] if inner else []
    states += [State("delayed_strain", "1", 1e-3, (volumes,))] if ladder.conduit.delayed else []
    states += [State("undissolved_air", "1", 1.0, (volumes,))] if fluid.air.kinetic else []
    if ladder.weights is not None:
        states.append(State("friction_memory", "m/s", 1.0, (ladder.weights.coefficients()[0].shape[0], columns)))
    return tuple(states)


def ladder_start(ladder: Ladder, at: Situation) -> dict:
    """At rest: pressures linear between the ends, walls and air long settled, no flow, no memory of one."""
    p_a, p_b = at.potential["node"], at.potential["to"]
    along = _column(ladder.cut.positions(), p_a)
    pressures = p_a + along * (p_b - p_a)
    start = {"pressure": pressures[1:-1]}
    held = pressures if ladder.ends_store else pressures[1:-1]
    if ladder.conduit.delayed:
        start["delayed_strain"] = resting_strain(ladder.conduit, at.fluid, held)
    if at.fluid.air.kinetic:
        start["undissolved_air"] = at.fluid.undissolved_air(held)
    return start


def ladder_contribution(ladder: Ladder, at: Situation) -> Contribution:
    """Flows into the end nodes, their half volumes (pi), and the rates of all inner states."""
    ends = [at.potential["node"][None], at.potential["to"][None]]
    pressures = jnp.concatenate([ends[0], *([at.state["pressure"]] if "pressure" in at.state else []), ends[1]])
    mass, rates = _columns(ladder, at, pressures)
    held = pressures if ladder.ends_store else pressures[1:-1]
    kept = _volumes(ladder, at, held)
    rates |= kept.rates
    inner = slice(1, -1) if ladder.ends_store else slice(None)
    if "pressure" in at.state:
        rates["pressure"] = (mass[:-1] - mass[1:] + kept.release[inner]) / kept.capacity[inner]
    if not ladder.ends_store:
        return Contribution({"node": -mass[0], "to": mass[-1]}, {}, rates)
    flow = {"node": kept.release[0] - mass[0], "to": kept.release[-1] + mass[-1]}
    return Contribution(flow, {"node": kept.capacity[0], "to": kept.capacity[-1]}, rates)


def _column(numbers: np.ndarray, like):
    """Numbers along the line, shaped to stand in front of the axes of another array."""
    return jnp.asarray(numbers, jnp.result_type(like)).reshape(-1, *(1,) * jnp.ndim(like))


def _term(coefficients, like):
    """Coefficients (terms, own axes), shaped to stand in front of an array along the line (columns, own axes)."""
    own, rest = coefficients.shape[1:], jnp.ndim(like) - coefficients.ndim
    return jnp.asarray(coefficients).reshape(coefficients.shape[0], 1, *own, *(1,) * rest)


def _volumes(ladder: Ladder, at: Situation, pressures) -> Stored:
    """What the volumes along the line store."""
    strain, air = at.state.get("delayed_strain"), at.state.get("undissolved_air")
    share = _column(ladder.volumes(), pressures[0])
    return stored(ladder.conduit, at.fluid, pressures, strain, air, share)


def _columns(ladder: Ladder, at: Situation, pressures) -> tuple[Any, dict]:
    """Mass flows through the columns of fluid, and the rates of their flows and of their memory.

    (rho dx/A) dQ/dt = p_i - p_i+1 - (f Re) mu V dx/(2 D^2) - K rho V |V|/2 - rho g dz - (4 mu dx/R^2) sum_k y_k,
    dy_k/dt = -(n_k nu/R^2) y_k + m_k dV/dt   (Zielke's integral with weights sum m_k exp(-n_k tau))
    """
    conduit, fluid, flow = ladder.conduit, at.fluid, at.state["volume_flow"]
    upstream, downstream = pressures[:-1], pressures[1:]
    middle, share = 0.5 * (upstream + downstream), _column(ladder.cut.columns, pressures[0])
    density, viscosity = fluid.density_at(middle), fluid.dynamic_viscosity(middle)
    section, bore, length = area(conduit), conduit.inner_diameter, share * conduit.length
    velocity = flow / section
    drop = length * ladder.friction.gradient(velocity, bore, density, viscosity / density, conduit.roughness / bore)
    drop = drop + share * minor_loss_drop(ladder.loss_coefficient, density, velocity)
    drop = drop + share * density * GRAVITY * ladder.elevation
    if ladder.weights is None:
        return density * flow, {"volume_flow": (upstream - downstream - drop) * section / (density * length)}
    memory, radius = at.state["friction_memory"], 0.5 * bore
    drop = drop + 4.0 * viscosity * length / (radius * radius) * jnp.sum(memory, axis=0)
    rate = (upstream - downstream - drop) * section / (density * length)
    strengths, decays = (_term(c, rate) for c in ladder.weights.coefficients())
    fading = decays * (viscosity / density) / (radius * radius)
    return density * flow, {"volume_flow": rate, "friction_memory": strengths * rate / section - fading * memory}
