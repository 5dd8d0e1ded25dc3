"""The vector field of a small circuit with every number a lane array of its own, and its partial derivatives.

The functions of a circuit (rates, start, outputs) are taken apart once, when a program is traced (`expression`).
What does not change in time is computed before the loop; the partial derivatives are exact, those of JAX, and only
the ones that are not zero by structure are kept.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.component import DOMAINS
from jaxlines.simulation.assembly import Location
from jaxlines.simulation.bound_field import BoundField
from jaxlines.simulation.expression import Graph
from jaxlines.simulation.lane_signals import every_signal, tagged, with_numbers
from jaxlines.simulation.node import Node
from jaxlines.simulation.observation import observe
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.rearrangement import objects
from jaxlines.simulation.vector_field import rates, starting_point


def _scales_of_leaves(plan: Plan, start) -> list[float]:
    """Typical size of every number of the potentials and states, in the order of the leaves."""
    potentials, states = start
    sizes = [DOMAINS[domain].scale for _, domain in plan.free_nodes]
    found = [np.asarray(sizes)] if potentials.size else []
    for kind, block in zip(plan.kinds, states, strict=True):
        size = {state.name: state.scale for state in kind.states}
        found += [np.full(block[name].size, size[name]) for name in sorted(block)]
    return [float(x) for x in np.concatenate(found)]


def special_numbers(values: Values, columns: Sequence[Sequence[Location]]) -> tuple[tuple[int, int, float], ...]:
    """Zeros, ones and infinities among the numbers that are not varied: position of the leaf, index in it, value.

    A program that knows them leaves out what they switch off: a leakage of zero, a rate limit that is none, a
    coefficient of friction that is not there. Another value of a number that is none of these is the same program.
    """
    names, _ = tagged(values, columns)
    leaves, found = jax.tree.leaves(values), []
    for name in names:
        if name[0] == "leaf":
            value = float(np.ravel(leaves[name[1]])[name[2]])
            if value in (0.0, 1.0) or np.isinf(value):
                found.append((name[1], name[2], value))
    return tuple(found)


class LaneField:
    """Rates, start and outputs of a circuit for many lanes, and the partial derivatives of these.

    Args: plan; values: with abstract or concrete leaves; columns: for each varied number the places that it takes;
    wanted: names of the outputs; fixed: numbers that the program may rely on (see `special_numbers`).
    """

    def __init__(
        self,
        plan: Plan,
        values: Values,
        columns: Sequence[Sequence[Location]],
        wanted: tuple[str, ...],
        fixed: tuple[tuple[int, int, float], ...] = (),
    ):
        self.plan, self.wanted, self.columns = plan, wanted, columns
        self.graph = Graph()
        self._fixed = {("leaf", position, index): value for position, index, value in fixed}
        self._dtype = jnp.result_type(*jax.tree.leaves(values))
        self._names, self.tags = tagged(values, columns)
        self.signal_names = [("signal", k) for k in range(len(every_signal(self.tags)))]
        first = len(self._names)
        held = with_numbers(self.tags, [np.asarray(first + k) for k in range(len(self.signal_names))])
        self._names += self.signal_names
        self._held_tags, self._held_structure = jax.tree.flatten(held)
        start = jax.eval_shape(lambda v: starting_point(plan, v, 0.0), self._abstract(self._held_tags))
        self._state_leaves, self._state_structure = jax.tree.flatten(start)
        self.size = sum(leaf.size for leaf in self._state_leaves)
        self.state_names = [("state", i) for i in range(self.size)]
        self._jaxprs: dict[str, Any] = {}
        self.rates = self._trace("rates")
        self.start = self._trace("start")
        self.outputs = self._trace("outputs")
        self.scales = _scales_of_leaves(plan, start)

    def _abstract(self, tags):
        leaves = [jax.ShapeDtypeStruct(tag.shape, self._dtype) for tag in tags]
        return jax.tree.unflatten(self._held_structure, leaves)

    def _node(self, name) -> Node:
        if name in self._fixed:
            return self.graph.constant(self._fixed[name], self._dtype)
        return self.graph.input(name, self._dtype, name[0] in ("state", "signal", "weight"))

    def _function(self, which: str) -> Callable:
        """rates, start or outputs as a function of held leaves and state leaves."""

        def call(held_leaves, state_leaves):
            held = jax.tree.unflatten(self._held_structure, held_leaves)
            zero = jnp.zeros((), self._dtype)
            if which == "start":
                return jax.tree.leaves(starting_point(self.plan, held, zero))
            state = jax.tree.unflatten(self._state_structure, state_leaves)
            if which == "rates":
                return jax.tree.leaves(rates(self.plan, held, zero, *state))
            return [observe(self.plan, held, self.wanted, zero, *state)]

        return call

    def _arguments(self):
        """Nodes of the held leaves and of the state leaves."""
        make = np.vectorize(lambda tag: self._node(self._names[tag]), otypes=[object])
        held = [make(tag) if tag.size else np.empty(tag.shape, object) for tag in self._held_tags]
        states, at = [], 0
        for leaf in self._state_leaves:
            block = np.empty(leaf.size, dtype=object)
            block[:] = [self._node(name) for name in self.state_names[at : at + leaf.size]]
            states.append(block.reshape(leaf.shape))
            at += leaf.size
        return held, states

    def _shapes(self):
        held = [jax.ShapeDtypeStruct(tag.shape, self._dtype) for tag in self._held_tags]
        return held, [jax.ShapeDtypeStruct(leaf.shape, self._dtype) for leaf in self._state_leaves]

    def _trace(self, which: str) -> list[Node]:
        """The nodes of a function, one for every number of its result."""
        held, states = self._arguments()
        jaxpr = jax.make_jaxpr(self._function(which))(*self._shapes())
        results = self.graph.outputs(jaxpr, *held, *states)
        return [node for array in results for node in array.ravel()]

    def partials(self, which: str, names: Sequence) -> list[dict[int, Node]]:
        """For each number of a result: which of some inputs it depends on, and the derivative in them.

        Each row is found backwards from its result, so that it costs little more than the result itself.
        """
        pull, count = self._pull(which, names), len(getattr(self, which))
        return [pull([self.graph.constant(float(k == row), self._dtype) for k in range(count)]) for row in range(count)]

    def pulled(self, which: str, names: Sequence) -> dict[int, Node]:
        """Derivatives of a weighted sum of all numbers of a result in those of some inputs that it depends on."""
        return self._pull(which, names)([self._node(name) for name in self.weight_names(which)])

    def weight_names(self, which: str) -> list:
        """Names of the weights of `pulled`."""
        return [("weight", k) for k in range(len(getattr(self, which)))]

    def _pull(self, which: str, names: Sequence) -> Callable[[list[Node]], dict[int, Node]]:
        """A function of the weights of the numbers of a result; see `pulled`."""
        function = self._function(which)
        shapes, results = self._shapes(), jax.eval_shape(self._function(which), *self._shapes())
        jaxpr = jax.make_jaxpr(lambda p, q, weights: jax.vjp(function, p, q)[1](weights))(*shapes, results)
        held, states = self._arguments()
        inputs = {name: k for k, name in enumerate(names)}
        owners = [inputs.get(name) for array in (*self._held_names(), self.state_names) for name in array]

        def pull(weights: list[Node]) -> dict[int, Node]:
            arrays, at = [], 0
            for result in results:
                arrays.append(objects(weights[at : at + result.size], result.shape))
                at += result.size
            pulled = [node for array in self.graph.outputs(jaxpr, *held, *states, *arrays) for node in array.ravel()]
            found: dict[int, Node] = {}
            for owner, node in zip(owners, pulled, strict=True):
                if owner is not None and not node.is_constant(0):
                    known = found.get(owner)
                    found[owner] = node if known is None else self.graph.lax(jax.lax.add, known, node)
            return found

        return pull

    def _held_names(self) -> list[list]:
        """Names of the numbers of the held leaves."""
        return [[self._names[tag] for tag in tags.ravel()] for tags in self._held_tags]

    def bind(
        self, values: Values, columns: Sequence, t, derivatives: str = "", differentiated: Sequence[int] | None = None
    ) -> BoundField:
        """The field with numbers: those of the circuit, and the columns of the varied ones, (lanes,) each.

        derivatives: which will be asked for: "partials", "pulled", or none; differentiated: the columns that partial
        derivatives are taken in (all by default).
        """
        known = {self._node(("column", c)): column for c, column in enumerate(columns)}
        for position, leaf in enumerate(jax.tree.leaves(values)):
            for i in range(int(np.prod(np.shape(leaf)))):
                if ("leaf", position, i) not in self._fixed:
                    known[self._node(("leaf", position, i))] = jnp.ravel(jnp.asarray(leaf))[i]
        wanted = range(len(columns)) if differentiated is None else differentiated
        return BoundField(self, values, columns, known, t, columns[0].shape[-1:], derivatives, tuple(wanted))

    def inputs(self) -> list:
        """Names of what a derivative is taken in, beside the states: columns, then signals."""
        return [*(("column", c) for c in range(len(self.columns))), *self.signal_names]

    def moving(self, numbers: Sequence, state: Sequence = ()) -> dict[Node, Any]:
        """Signals and states by their nodes."""
        found = {self._node(name): value for name, value in zip(self.signal_names, numbers, strict=True)}
        return found | {self._node(name): value for name, value in zip(self.state_names, state, strict=False)}

    def weighed(self, which: str, weights: Sequence) -> dict[Node, Any]:
        """Weights of the numbers of a result by their nodes."""
        return {self._node(name): weight for name, weight in zip(self.weight_names(which), weights, strict=True)}
