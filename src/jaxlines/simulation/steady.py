"""Steady state: the potentials and states at which a circuit rests or runs evenly for given inputs."""

import dataclasses
import functools
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS
from jaxlines.physics.fields import HYDRAULIC, AbstractSignal, External, driven_of
from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.balance import Linear, balanced_state, imbalance
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.observation import observe, quantities, sensor_units
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.plan import Plan, Values, initial_names, ravel, scales, unravel
from jaxlines.simulation.precision import cast, computing_in, is_traced
from jaxlines.simulation.segments import choose_segments
from jaxlines.simulation.signals import Constant
from jaxlines.simulation.vector_field import starting_point


class SteadyState(eqx.Module):
    """Where a circuit is in balance.

    Fields: initial: name -> value in SI of every potential and state, fit for `simulate(..., initial=...)`; circuit
    and inputs it holds for (signals held, segments of lines chosen); residual: largest rate left, in typical sizes
    per second; free: names that the balance does not determine, so that the start did (a closed volume's pressure, a
    shaft's angle); drifting: those of them that run evenly, name -> rate in SI. Traced by JAX, `free` and `drifting`
    are unknown and empty, and the values are NaN where no balance was found.
    """

    initial: dict[str, Any]
    circuit: Circuit
    inputs: dict[str, Any]
    residual: Any
    free: tuple[str, ...] = eqx.field(static=True, default=())
    drifting: dict[str, Any] = eqx.field(default_factory=dict)

    def __getitem__(self, name: str):
        """A potential, state, flow or sensor reading in steady state, by name."""
        with computing_in("float64", self):
            plan, values = compile_circuit(self.circuit, self.initial, self.inputs)
            name = resolve(name, {**quantities(plan), **sensor_units(self.circuit, plan)}, "output")
            shown = self.initial[name] if name in self.initial else _shown(plan, name, values)
        return shown if is_traced(self) else float(shown)

    def sentences(self) -> list[str]:
        """What was not determined by the balance, in words."""
        said = [f"{n} is not determined by the balance: it follows from the start" for n in self.free]
        units = initial_names(compile_circuit(self.circuit, self.initial, self.inputs)[0]) if self.drifting else {}
        return said + [f"{name} runs on at {rate:.4g} {units[name]}/s" for name, rate in self.drifting.items()]


def steady_state(
    circuit: Circuit,
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    time: float = 0.0,
    precision: str = "float64",
) -> SteadyState:
    """The state in which all rates vanish while the inputs stay as they are.

    Newton's method with the exact Jacobian, damped, positive pressures kept positive; where it fails, the transient
    is followed to its end by implicit steps that grow. Differentiable in all numbers of the circuit, in the inputs and
    in `initial`, by the implicit function theorem.

    Args:
        circuit; inputs: name -> number or signal, as for `simulate`.
        initial: where the search starts, and what is held where the balance leaves something free: the states on
            which nothing depends keep their value, and closed volumes their content (to first order in the change).
        time: at which all signals are taken [s].
        precision: "float64" or "float32".
    Raises: ValueError and KeyError for a wrong call; RuntimeError, which names what will not balance, when there is no
        steady state or it was not found (in traced code the values are NaN instead).
    Validity: a circuit may have several steady states (a bistable valve), stable or not: see `linearise`.
    """
    traced = is_traced(circuit, inputs, initial, time)
    with computing_in(precision, circuit, inputs, initial, time):
        circuit, held = at_instant(circuit, inputs, time, initial)
        plan, values = compile_circuit(circuit, initial, held)
        values = cast(values, precision)
        told = tuple(f"{n}.{DOMAINS[d].potential}" in (initial or {}) for n, d in plan.free_nodes)
        y, linear = solve_balance(plan, told, values)
        worst = jnp.max(imbalance(linear), initial=0.0)
        if traced:
            return SteadyState(_named(plan, jnp.where(worst <= 1.0, y, jnp.nan)), circuit, held, worst)
        y, linear = jax.tree.map(np.asarray, (y, linear))
        if not worst <= 1.0:
            raise RuntimeError(_explanation(plan, values, y, linear))
        free, drifting = _undetermined(plan, linear)
        left = np.max(np.where(linear.drifting, 0.0, np.abs(linear.flow / linear.weights)), initial=0.0)
        named = jax.tree.map(np.asarray, _named(plan, jnp.asarray(y)))
        return SteadyState(named, circuit, jax.tree.map(np.asarray, held), left, free, drifting)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _shown(plan: Plan, name: str, values: Values):
    """One output where a circuit starts."""
    return observe(plan, values, (name,), 0.0, *starting_point(plan, values, 0.0))[0]


def at_instant(circuit: Circuit, inputs: dict | None, time, initial: dict | None = None):
    """A circuit and its inputs with every signal held at its value at a time [s], and segments of lines chosen."""
    bound = bind_inputs(circuit, inputs, np.asarray([0.0, 1.0]))
    parts = dict(circuit.components)
    for name, part in circuit.parts().items():
        own = {field: getattr(part, field) for field in driven_of(part)}
        own = {f: v for f, v in own.items() if isinstance(v, AbstractSignal) and not isinstance(v, External)}
        if own:
            parts[name] = dataclasses.replace(part, **{f: Constant(jnp.asarray(v(time))) for f, v in own.items()})
    held = {name: Constant(jnp.asarray(signal(time))) for name, signal in bound.items()}
    settled = choose_segments(Circuit(circuit.fluid, parts), np.asarray([0.0, 1.0]), held, initial=initial)
    return settled, held


@functools.partial(jax.jit, static_argnums=(0, 1))
def solve_balance(plan: Plan, told: tuple[bool, ...], values: Values):
    """The state in balance, from where the circuit starts, or from pressures between those of the sources."""
    first = starting_point(plan, values, 0.0)
    y, second = ravel(plan, *first), first
    fixed = tuple(f"{n.name}.{DOMAINS[n.domain].potential}" for n in plan.fixed_nodes if n.domain == HYDRAULIC)
    if fixed:
        middle = jnp.mean(observe(plan, values, fixed, 0.0, *first))
        kept = [given or domain != HYDRAULIC for given, (_, domain) in zip(told, plan.free_nodes, strict=True)]
        pressures = jnp.where(np.asarray(kept, dtype=bool), first[0], middle)
        second = starting_point(plan, eqx.tree_at(lambda v: v.initial.potentials, values, pressures), 0.0)
    units = [DOMAINS[d].unit for _, d in plan.free_nodes]
    units += [s.unit for k in plan.kinds for s in k.states for _ in range(math.prod(s.shape) * len(k.members))]
    positive = np.asarray([u in ("Pa", "K", "m^3") for u in units], dtype=bool) & (y > 0.0)
    return balanced_state(plan, values, jnp.stack([y, ravel(plan, *second)]), positive)


def _named(plan: Plan, y) -> dict[str, Any]:
    """Potentials and states in SI by name, as `simulate` takes them."""
    potentials, states = unravel(plan, y)
    named = {f"{n}.{DOMAINS[d].potential}": potentials[i] for i, (n, d) in enumerate(plan.free_nodes)}
    for kind, block in zip(plan.kinds, states, strict=True):
        for state in kind.states:
            named |= {f"{m}.{state.name}": block[state.name][..., i] for i, m in enumerate(kind.members)}
    return named


def state_labels(plan: Plan) -> list[str]:
    """The name of every scaled state, in the order of `ravel`."""
    labels = [f"{n}.{DOMAINS[d].potential}" for n, d in plan.free_nodes]
    for kind in plan.kinds:
        for state in kind.states:
            own = [".".join([state.name, *map(str, index)]) for index in np.ndindex(state.shape)]
            labels += [f"{member}.{name}" for name in own for member in kind.members]
    return labels


def _undetermined(plan: Plan, linear: Linear) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names of what the balance leaves free, and the rates of what runs on evenly, in SI."""
    size = np.abs(linear.right)
    null = np.any(size > 0.1 * np.maximum(np.max(size, axis=1, keepdims=True), 1e-300), axis=0)
    labels, rate = state_labels(plan), linear.flow / linear.weights
    free = tuple(label for label, i in zip(labels, null | linear.drifting, strict=True) if i)
    running = np.flatnonzero(linear.drifting & (np.abs(rate) > 1e-9))
    return free, {labels[i]: float(rate[i] * scales(plan)[i]) for i in running}


def _explanation(plan: Plan, values: Values, y, linear: Linear) -> str:
    """What will not balance, by how much, and why that may be."""
    labels, flow, distance = state_labels(plan), linear.flow, np.asarray(imbalance(linear))
    if not np.all(np.isfinite(distance)):
        bad = labels[int(np.argmin(np.isfinite(distance)))]
        return f"no steady state was found: {bad} is not finite; give `initial` values near where you expect it"
    worst = int(np.argmax(distance))
    at = float(np.asarray(y)[worst] * scales(plan)[worst])
    rest, nodes = float(flow[worst] * scales(plan)[worst]), plan.free_nodes
    if worst >= len(nodes):
        unit = initial_names(plan).get(labels[worst], "")
        return (
            f"no steady state was found: {labels[worst]} will not come to rest: it still changes by {rest:.4g} "
            f"{unit}/s at {at:.4g} {unit}; give `initial` values near the solution, or simulate to see what it does"
        )
    name, domain = nodes[worst]
    of = DOMAINS[domain]
    if domain == HYDRAULIC:
        rest = rest / float(values.fluid.density_at(np.asarray(at)))
    lone = not np.any(linear.matrix[worst]) or at > 1e9
    cause = {True: "nothing it is attached to takes up what flows in", False: "more is asked of it than can flow"}
    cause = cause[bool(lone or (domain == HYDRAULIC and rest > 0.0))]
    return (
        f"no steady state was found: node {name!r} will not balance: {rest:.4g} {of.flow_unit} more {of.flow} in "
        f"than out at a {of.potential} of {at:.4g} {of.unit}. Likely cause: {cause}; else give `initial` values near "
        "the solution"
    )
