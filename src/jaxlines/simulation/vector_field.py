"""The vector field of a compiled circuit: what every kind of component sees and does, summed at the nodes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import Contribution, Situation
from jaxlines.physics.controllers import AbstractController, AbstractSampledController
from jaxlines.physics.fields import AbstractSignal, driven_of
from jaxlines.simulation.plan import Incidence, Plan, Quantity, Reading, SensorPlan, Values
from jaxlines.simulation.quantities import FEW, pick, take


class Sight(NamedTuple):
    """External inputs and controllers' outputs, potentials of the fixed nodes, and what every kind sees."""

    inputs: Any
    fixed: Any
    seen: list[Situation]


def _fixed_potentials(plan: Plan, given: list[dict]):
    """Potentials of the fixed nodes, shape (fixed nodes, [lanes]), from the driven fields of every kind."""
    if not plan.fixed_nodes:
        return jnp.zeros(0)
    places = [Quantity("given", node.kind, node.field, (node.member,), "") for node in plan.fixed_nodes]
    return pick(places, lambda place: given[place.kind][place.name])


def _given(plan: Plan, values: Values, k: int, t, inputs) -> dict:
    """The driven fields of kind k at time t: numbers, signals of its members' own, or inputs."""
    given = {field: getattr(values.kinds[k], field) for field in driven_of(values.kinds[k])}
    for field, value in given.items():
        if isinstance(value, AbstractSignal):
            given[field] = jax.vmap(lambda signal: signal(t), in_axes=-1)(value)
    return given | {field: take(inputs, index) for field, index in plan.kinds[k].signals}


def _look(plan: Plan, values: Values, t, potentials, states, inputs, read: dict) -> Sight:
    """What every kind sees with given inputs, and with what its members read."""
    given = [_given(plan, values, k, t, inputs) | read.get(k, {}) for k in range(len(values.kinds))]
    fixed, seen = _fixed_potentials(plan, given), []
    for k, kind in enumerate(plan.kinds[: len(values.kinds)]):
        at_ports = {p.name: take(fixed if p.fixed else potentials, p.index) for p in kind.ports}
        seen.append(Situation(values.fluid, at_ports, states[k], given[k]))
    return Sight(inputs, fixed, seen)


def array_of(sight: Sight, potentials, states, flow_of: Callable[[int], dict]) -> Callable[[Quantity], Any]:
    """What gives the array that holds a quantity; flow_of(kind, port): mass flow, torque or force into the nodes."""

    def find(place: Quantity):
        if place.room == "state":
            return states[place.kind][place.name]
        if place.room != "port":
            return {"free": potentials, "fixed": sight.fixed, "input": sight.inputs}[place.room]
        at, flow = sight.seen[place.kind], flow_of(place.kind).get(place.name)
        p = at.potential[place.name]
        if flow is None:
            return 0.0 * p
        return -flow / at.fluid.density_at(p) if place.unit == "m^3/s" else -flow

    return find


def at_once(values: Values, sensor: SensorPlan, find: Callable[[Quantity], Any]):
    """What a sensor would show without lag and delay, shape (1, [lanes])."""
    value = pick([sensor.read], find)
    if sensor.subtracted is not None:
        value = value - pick([sensor.subtracted], find)
    return values.sensors[sensor.name].read(value, values.fluid)


def shown_by(values: Values, sensor: SensorPlan, find: Callable[[Quantity], Any]):
    """What a sensor shows, but for its delay, shape (1, [lanes])."""
    return at_once(values, sensor, find) if sensor.reading is None else find(sensor.reading)


def _readings(values: Values, readings: tuple[Reading, ...], find: Callable[[Quantity], Any]) -> dict:
    """What a kind reads, by field."""
    found = {}
    for reading in readings:
        found[reading.field] = pick(reading.places, find)
        for member, sensor in reading.sensors:
            found[reading.field] = found[reading.field].at[member].set(shown_by(values, sensor, find)[0])
    return found


def look(plan: Plan, values: Values, t, potentials, states) -> Sight:
    """What every kind sees at time t."""
    lanes = jnp.shape(potentials)[1:]
    external = [jnp.broadcast_to(jnp.asarray(signal(t)), lanes) for signal in values.signals]
    outputs = [jnp.zeros(lanes)] * sum(len(controller.outputs) for controller in plan.controllers)
    inputs = jnp.stack([*external, *outputs]) if external or outputs else jnp.zeros((0, *lanes))
    read: dict[int, dict] = {}
    for controller in plan.controllers:  # each after those whose outputs it needs
        sight, k = _look(plan, values, t, potentials, states, inputs, read), controller.kind
        law = values.kinds[k]
        assert isinstance(law, AbstractController)
        read[k] = _readings(values, controller.readings, array_of(sight, potentials, states, lambda k: {}))
        output = law.output(sight.seen[k]._replace(given=sight.seen[k].given | read[k]))
        inputs = inputs.at[np.asarray(controller.outputs)].set(output)
    return _look(plan, values, t, potentials, states, inputs, read)


def situations(plan: Plan, values: Values, t, potentials, states) -> list[Situation]:
    """What the members of every kind of components see at time t."""
    return look(plan, values, t, potentials, states).seen


def contributions(plan: Plan, values: Values, t, potentials, states) -> list[Contribution]:
    """What every kind does to its nodes and states at time t."""
    sight = look(plan, values, t, potentials, states)
    done = [packed.evaluate(at) for packed, at in zip(values.kinds, sight.seen, strict=True)]
    find = array_of(sight, potentials, states, lambda k: done[k].flow)
    lags = [sensor for sensor in plan.sensors if sensor.reading is not None]
    return done + [Contribution(rate={"reading": _lag_rate(values, sensor, find)}) for sensor in lags]


def _lag_rate(values: Values, sensor: SensorPlan, find: Callable[[Quantity], Any]):
    """Rate of the reading of a sensor with a lag, shape (1, [lanes])."""
    assert sensor.reading is not None
    return values.sensors[sensor.name].lag_rate(at_once(values, sensor, find), find(sensor.reading))


def starting_point(plan: Plan, values: Values, t) -> tuple[Any, tuple[dict, ...]]:
    """Potentials and states at the start: what was given, else what each component says of its states.

    Controllers may read states, so that they look again once those are there; sensors with a lag are in equilibrium.
    """
    potentials, given = jnp.asarray(values.initial.potentials), values.initial.states
    states = tuple({n: jnp.where(jnp.isnan(v), 0.0, v) for n, v in block.items()} for block in given)
    for _ in range(2 if plan.controllers else 1):
        seen = situations(plan, values, t, potentials, states)
        starts = [p.start(at._replace(state={})) if at.state else {} for p, at in zip(values.kinds, seen, strict=True)]
        blocks = zip(starts + [{}] * (len(given) - len(starts)), given, strict=True)
        states = tuple(
            {n: jnp.where(jnp.isnan(v), start.get(n, 0.0), v) for n, v in block.items()} for start, block in blocks
        )
    lags = [sensor for sensor in plan.sensors if sensor.reading is not None]
    if lags:
        sight = look(plan, values, t, potentials, states)
        find = array_of(sight, potentials, states, lambda k: values.kinds[k].evaluate(sight.seen[k]).flow)
        told = [given[sensor.reading.kind]["reading"] for sensor in lags if sensor.reading]
        shown = [at_once(values, sensor, find) for sensor in lags]
        settled = [{"reading": jnp.where(jnp.isnan(v), s, v)} for v, s in zip(told, shown, strict=True)]
        states = (*states[: len(values.kinds)], *settled)
    return potentials, states


def sampled(plan: Plan, values: Values, t, due, potentials, states) -> tuple[dict, ...]:
    """States after the sampling instants at time t; due(period): whether there is one."""
    kinds = [controller.kind for controller in plan.controllers if controller.sampled]
    seen, states = situations(plan, values, t, potentials, states) if kinds else [], list(states)
    for k in kinds:
        law = values.kinds[k]
        assert isinstance(law, AbstractSampledController)
        now, new = due(law.sampling_period()), law.sampled(seen[k])
        states[k] = {name: jnp.where(now, new[name], old) for name, old in states[k].items()}
    return tuple(states)


def _sum_at_nodes(done: list[dict], incidence: Incidence):
    """Sum of the terms of each node, shape (nodes, [lanes])."""
    terms = [done[k][port] for k, port in incidence.ports]
    flat = jnp.concatenate([*terms, jnp.zeros_like(terms[0][:1])])
    if len(incidence.order) <= FEW:
        zero = flat.shape[0] - 1
        rows = [[i for i in row if i < zero] or [zero] for row in incidence.tables[0]]
        return jnp.stack([sum(flat[i] for i in row[1:]) + flat[row[0]] for row in rows])
    sums = [flat[np.asarray(table)].sum(axis=1) for table in incidence.tables]
    return sums[0] if len(sums) == 1 else jnp.concatenate(sums)[np.asarray(incidence.order)]


class Balance(NamedTuple):
    """Capacities of the free nodes and flows into them, shape (nodes, [lanes]); rates of the states of each kind."""

    capacity: Any
    flow: Any
    state_rates: tuple[dict, ...]


def balances(plan: Plan, values: Values, t, potentials, states) -> Balance:
    """The sums at the free nodes and the rates of the states, in SI."""
    done = contributions(plan, values, t, potentials, states)
    state_rates = tuple(
        {name: c.rate.get(name, jnp.zeros_like(value)) for name, value in block.items()}
        for c, block in zip(done, states, strict=True)
    )
    if not plan.free_nodes:
        return Balance(jnp.zeros(0), jnp.zeros(0), state_rates)
    capacity = _sum_at_nodes([c.capacity for c in done], plan.capacity)
    flow = _sum_at_nodes([c.flow for c in done], plan.flow) if plan.flow.ports else jnp.zeros_like(capacity)
    return Balance(capacity, flow, state_rates)


def rates(plan: Plan, values: Values, t, potentials, states) -> tuple[Any, tuple[dict, ...]]:
    """The vector field: rates of the potentials, flow / capacity, and of the states of each kind, in SI."""
    capacity, flow, state_rates = balances(plan, values, t, potentials, states)
    return flow / capacity, state_rates
