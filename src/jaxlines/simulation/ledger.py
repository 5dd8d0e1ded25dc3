"""What passed through the nodes of a simulated circuit and what they keep: the integrals behind an audit.

Time is cut into panels at jumps, kinks and saved times. In each, flows are integrated by Gauss and Kronrod's rule over
the solver's own dense output, and what a node stores by the path integral of capacity times the change of its
potential, so that both sides of each balance are integrals of the trajectory and differ by the solver's error.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxlines.physics.accumulators import Accumulator, NitrogenAccumulator
from jaxlines.physics.component import Situation
from jaxlines.physics.containers import volume_at
from jaxlines.physics.cylinders import AbstractActuator
from jaxlines.physics.fields import HYDRAULIC, AbstractSignal, External, driven_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.lines import Line
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.vector_field import situations

_HALF = [0.9914553711208126, 0.9491079123427585, 0.8648644233597691, 0.7415311855993945, 0.5860872354676911]
_HALF += [0.4058451513773972, 0.2077849550078985]
_KRONROD = [0.0229353220105292, 0.0630920926299786, 0.1047900103222502, 0.1406532597155259, 0.1690047266392679]
_KRONROD += [0.1903505780647854, 0.2044329400752989]
_GAUSS = [0.0, 0.1294849661688697, 0.0, 0.2797053914892767, 0.0, 0.3818300505051189, 0.0]
_MOST_PANELS = 8000
NODES = np.asarray([-x for x in _HALF] + [0.0] + _HALF[::-1])
"""Nodes of Kronrod's rule with 15 points on -1..1, seven of which are Gauss's (Piessens et al., QUADPACK, 1983)."""
KRONROD = np.asarray([*_KRONROD, 0.2094821410847278, *_KRONROD[::-1]])
GAUSS = np.asarray([*_GAUSS, 0.4179591836734694, *_GAUSS[::-1]])


def panel_edges(circuit: Circuit, times, inputs: dict, periods, num_steps: int) -> np.ndarray:
    """Edges of the panels: saved times, jumps and kinks of signals, sampling instants; two to a solver's step."""
    times, signals = np.asarray(times), list(inputs.values())
    for part in circuit.parts().values():
        own = [getattr(part, field) for field in driven_of(part)]
        signals += [value for value in own if isinstance(value, AbstractSignal) and not isinstance(value, External)]
    breaks = [np.ravel(kind) for s in signals for kind in (s.jump_times(), s.knot_times())]
    breaks += [times[0] + period * np.arange(1, (times[-1] - times[0]) / period + 1) for period in periods]
    edges = np.unique(np.concatenate([times, *breaks]))
    edges = edges[(edges >= times[0]) & (edges <= times[-1])]
    keep = np.diff(edges, prepend=-np.inf) > 1e-9 * (times[-1] - times[0])
    edges = edges[keep]
    cut = int(np.ceil(min(2 * num_steps, _MOST_PANELS) / (edges.size - 1)))
    return np.append(np.linspace(edges[:-1], edges[1:], cut, endpoint=False, axis=1).ravel(), edges[-1])


def panel_times(edges):
    """All times of panels with these edges [s]: edge, inner nodes, edge, inner nodes, ..., edge."""
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    inner = middle[:, None] + half[:, None] * NODES
    return np.append(np.concatenate([edges[:-1, None], inner], axis=1).ravel(), edges[-1])


def inner_nodes(samples):
    """Samples at the inner nodes of the panels, shape (panels, 15, ...)."""
    return samples[:-1].reshape(-1, NODES.size + 1, *samples.shape[1:])[:, 1:]


@functools.cache
def _slopes():
    """Matrix from values at the 17 points of a panel on -1..1 to slopes at its inner nodes (of their polynomial)."""
    points = np.concatenate([[-1.0], NODES, [1.0]])
    gaps = points[:, None] - points + np.eye(points.size)
    weights = 1.0 / np.prod(gaps, axis=1)
    matrix = weights / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -np.sum(matrix, axis=1))
    return matrix[1:-1]


def slopes_at_nodes(edges, samples):
    """Time derivative of samples (times, ...) at the inner nodes of the panels, shape (panels, 15, ...)."""
    starts = samples[:-1].reshape(-1, NODES.size + 1, *samples.shape[1:])
    ends = np.concatenate([starts[1:, :1], samples[None, -1:]])
    points = np.concatenate([starts, ends], axis=1)
    return np.einsum("ij,pj...->pi...", _slopes(), points) / (0.5 * np.diff(edges)).reshape(
        -1, 1, *[1] * (points.ndim - 2)
    )


class Integral(NamedTuple):
    """An integral over time, and an estimate of its own error."""

    value: Any
    error: Any


def integrate_nodes(edges, inner) -> Integral:
    """Integral over all panels of what was sampled at the inner nodes (panels, 15, ...), with QUADPACK's estimate."""
    half = (0.5 * np.diff(edges)).reshape(-1, *[1] * (inner.ndim - 2))
    fine, coarse = (half * np.einsum("i,pi...->p...", w, inner) for w in (KRONROD, GAUSS))
    spread = half * np.einsum("i,pi...->p...", KRONROD, np.abs(inner - (fine / (2.0 * half))[:, None]))
    share = np.abs(fine - coarse) / np.where(spread > 0.0, spread, 1.0)
    error = spread * np.minimum(1.0, (200.0 * share) ** 1.5)
    return Integral(np.sum(fine, axis=0), np.sum(error, axis=0))


def flow_energy(fluid: Oil, p):
    """Mechanical energy that a mass of fluid carries into a node: h = integral of dp/rho from atmosphere to p [J/kg].

    Valid for a fluid whose density follows from its pressure; air that dissolves slowly counts as in equilibrium.
    """
    low = fluid.atmospheric_pressure
    at, weights = np.polynomial.legendre.leggauss(24)
    positive = jnp.maximum(p, 1.0)
    logs = 0.5 * (jnp.log(positive) + jnp.log(low))[..., None] + 0.5 * jnp.log(positive / low)[..., None] * at
    pressures = jnp.exp(logs)
    whole = 0.5 * jnp.log(positive / low) * jnp.sum(weights * pressures / fluid.density_at(pressures), axis=-1)
    return whole - (positive - p) / fluid.density_at(positive)


class Seen(NamedTuple):
    """What happens at one instant, in SI.

    flow, gross, capacity: net flow, sum of the sizes of flows, and capacity at each free node; outflow: net flow into
    each fixed node; energy: energy carried by a unit of flow at each free node; given, power: mass flow and power that
    each component of each kind gives to nodes; filling: capacity at each port (kind, port); content: mass of fluid in
    components that know it, by kind.
    """

    flow: Any
    gross: Any
    capacity: Any
    outflow: Any
    energy: Any
    lost: Any
    given: list
    power: list
    filling: dict
    content: dict


def see(plan: Plan, values: Values, t, potentials, states) -> Seen:
    """Everything the audit needs of one instant."""
    free, fixed = len(plan.free_nodes), len(plan.fixed_nodes)
    flow, gross, capacity = jnp.zeros(free), jnp.zeros(free), jnp.zeros(free)
    outflow, lost, given, power, filling, content = jnp.zeros(fixed), jnp.zeros(fixed), [], [], {}, {}
    for k, at in enumerate(situations(plan, values, t, potentials, states)):
        kind, packed = plan.kinds[k], values.kinds[k]
        done, zero = packed.evaluate(at), jnp.zeros(len(kind.members))
        mass, work = zero, zero
        for port in kind.ports:
            index, amount = np.asarray(port.index), zero + done.flow.get(port.name, 0.0)
            potential = at.potential[port.name]
            carried = amount * (flow_energy(values.fluid, potential) if port.domain == HYDRAULIC else potential)
            mass, work = mass + amount * (port.domain == HYDRAULIC), work + carried
            if port.fixed:
                outflow, lost = outflow.at[index].add(amount), lost.at[index].add(carried)
                continue
            flow, gross = flow.at[index].add(amount), gross.at[index].add(jnp.abs(amount))
            if port.name in done.capacity:
                added = zero + done.capacity[port.name]
                capacity = capacity.at[index].add(added)
                if port.domain == HYDRAULIC:
                    filling[k, port.name] = added
        given, power = [*given, mass], [*power, work]
        inside = fluid_inside(packed, at)
        if inside is not None:
            content[k] = zero + inside
    hydraulic = np.asarray([domain == HYDRAULIC for _, domain in plan.free_nodes], dtype=bool)
    energy = jnp.where(hydraulic, flow_energy(values.fluid, potentials), potentials)
    return Seen(flow, gross, capacity, outflow, energy, lost, given, power, filling, content)


def fluid_inside(part, at: Situation):
    """Mass of the fluid in a component that holds some [kg], from its state alone; None where that is not known."""
    fluid = at.fluid
    if fluid.mass == "article":
        return None  # its density does not say how much fluid there is
    if isinstance(part, Accumulator):
        return part.oil_mass(fluid, at.potential["node"])
    if isinstance(part, NitrogenAccumulator):
        return part.oil_mass(fluid, at.state["gas_volume"], at.state["gas_temperature"])
    if isinstance(part, AbstractActuator):
        volumes = zip("ab", part.volumes(at.state[part.travel.name]), strict=True)
        return sum(fluid.density_at(at.potential[s], at.state.get(f"undissolved_air_{s}")) * v for s, v in volumes)
    return _fluid_in_line(part, at) if isinstance(part, Line) else None


def _fluid_in_line(line: Line, at: Situation):
    """Mass of the fluid in a line, lumped or in segments [kg]."""
    air = at.state.get("undissolved_air")
    if line.to is None:
        p, strains = (
            at.potential["node"],
            [at.state.get(f"parts.{i}.delayed_strain", 0.0) for i in range(len(line.parts))],
        )
        volume = sum(volume_at(part, at.fluid, p, strain) for part, strain in zip(line.parts, strains, strict=True))
        return at.fluid.density_at(p, air) * volume
    ladder, ends = line.ladder(), [at.potential["node"][None], at.potential["to"][None]]
    pressures = jnp.concatenate([ends[0], *([at.state["pressure"]] if "pressure" in at.state else []), ends[1]])
    held = pressures if ladder.ends_store else pressures[1:-1]
    share = jnp.asarray(ladder.volumes()).reshape(-1, *[1] * (held.ndim - 1))
    volume = volume_at(ladder.conduit, at.fluid, held, at.state.get("delayed_strain", 0.0))
    return jnp.sum(share * at.fluid.density_at(held, air) * volume, axis=0)
