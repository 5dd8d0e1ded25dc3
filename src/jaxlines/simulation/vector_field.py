"""The vector field of a compiled circuit: what every kind of component sees and does, summed at the nodes."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import Contribution, Situation
from jaxlines.physics.fields import driven_of
from jaxlines.simulation.plan import Plan, Values


def fixed_potentials(plan: Plan, values: Values, signals):
    """Potentials of the fixed nodes, shape (fixed nodes, [lanes])."""
    given = [
        signals[node.index] if node.kind < 0 else getattr(values.kinds[node.kind], node.field)[node.index]
        for node in plan.fixed_nodes
    ]
    return jnp.stack([jnp.asarray(p) for p in given]) if given else jnp.zeros(0)


def _situation(plan: Plan, values: Values, k: int, t_signals, fixed, potentials, states) -> Situation:
    """What the members of kind k see."""
    kind, packed = plan.kinds[k], values.kinds[k]
    at_ports = {p.name: (fixed if p.fixed else potentials)[np.asarray(p.index)] for p in kind.ports}
    given = {field: getattr(packed, field) for field in driven_of(packed)}
    given |= {field: t_signals[np.asarray(index)] for field, index in kind.signals}
    return Situation(values.fluid, at_ports, states[k], given)


def situations(plan: Plan, values: Values, t, potentials, states) -> list[Situation]:
    """What the members of every kind see at time t."""
    t_signals = jnp.stack([jnp.asarray(s(t)) for s in values.signals]) if values.signals else jnp.zeros(0)
    fixed = fixed_potentials(plan, values, t_signals)
    return [_situation(plan, values, k, t_signals, fixed, potentials, states) for k in range(len(plan.kinds))]


def contributions(plan: Plan, values: Values, t, potentials, states) -> list[Contribution]:
    """What every kind does to its nodes and states at time t."""
    seen = situations(plan, values, t, potentials, states)
    return [packed.evaluate(at) for packed, at in zip(values.kinds, seen, strict=True)]


def starting_point(plan: Plan, values: Values, t) -> tuple[Any, tuple[dict, ...]]:
    """Potentials and states at the start: what was given, else what each component says of its states."""
    potentials, states = values.initial.potentials, []
    seen = situations(plan, values, t, jnp.asarray(potentials), tuple({} for _ in plan.kinds))
    for packed, at, given in zip(values.kinds, seen, values.initial.states, strict=True):
        derived = packed.start(at) if given else {}
        states.append({n: jnp.where(jnp.isnan(v), derived.get(n, 0.0), v) for n, v in given.items()})
    return potentials, tuple(states)


def _gather(terms: list, incidence):
    """Sum of the terms of each node, by padded positions, shape (nodes, [lanes])."""
    flat = jnp.concatenate([*terms, jnp.zeros_like(terms[0][:1])])
    return flat[np.asarray(incidence)].sum(axis=1)


def rates(plan: Plan, values: Values, t, potentials, states) -> tuple[Any, tuple[dict, ...]]:
    """The vector field: rates of the potentials, flow / capacity, and of the states of each kind, in SI."""
    done = contributions(plan, values, t, potentials, states)
    state_rates = tuple(c.rate for c in done)
    if not plan.free_nodes:
        return jnp.zeros(0), state_rates
    capacity = _gather([done[k].capacity[port] for k, port in plan.capacity_ports], plan.capacity_incidence)
    if not plan.flow_ports:
        return jnp.zeros_like(capacity), state_rates
    flow = _gather([done[k].flow[port] for k, port in plan.flow_ports], plan.flow_incidence)
    return flow / capacity, state_rates
