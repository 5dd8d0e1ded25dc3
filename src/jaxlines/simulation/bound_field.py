"""A lane field with its numbers: rates, outputs and partial derivatives of many lanes inside a traced program."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from jaxlines.simulation.evaluation import boundary, evaluate, layer_by_layer, layers
from jaxlines.simulation.lane_signals import LaneSignals
from jaxlines.simulation.node import Node

LaneField = Any
"""What is bound (`lane_field.LaneField`, which makes bound fields)."""


class BoundField:
    """A lane field with its numbers; see `LaneField.bind`.

    A state is a tuple of arrays (lanes,), in the order of `LaneField.state_names`.
    """

    def __init__(
        self, field: LaneField, values, columns, known: dict, t, shape, derivatives: str, differentiated: tuple
    ):
        self.field, self.columns, self.shape, self.differentiated = field, columns, shape, differentiated
        self._signals = LaneSignals(values, field.tags, len(columns))
        self._places = [i for i, name in enumerate(field.inputs()) if self._is_wanted(name)]
        kinds = ("rates", "outputs")
        rows = [self._partials(which) if derivatives == "partials" else [] for which in kinds]
        self.rate_partials, self.output_partials = rows
        self._pulled = {which: self._pull(which) for which in kinds} if derivatives == "pulled" else {}
        self._start_known = known | field.moving(self.signals(t))
        nodes = [*field.rates, *field.outputs, *(node for part in rows for row in part for node in row.values())]
        nodes += [node for part in self._pulled.values() for node in part.values()]
        behind = [node for row in self.rate_partials for node in row.values()]
        behind += self._pulled.get("rates", {}).values()
        self._layers = layers([*field.rates, *behind]) if behind else []
        once = boundary(nodes)
        self._once = dict(zip(once, evaluate(once, known), strict=True))

    def _is_wanted(self, name) -> bool:
        """Whether derivatives in an input are needed: those in other columns are not."""
        return name[1] in (self.differentiated if name[0] == "column" else self._signals.moved_by(self.differentiated))

    def _partials(self, which: str) -> list[dict[int, Node]]:
        """Partial derivatives in the states (0..) and in those inputs after them that are needed."""
        size, inputs = self.field.size, self.field.inputs()
        places = [*range(size), *(size + i for i in self._places)]
        rows = self.field.partials(which, [*self.field.state_names, *(inputs[i] for i in self._places)])
        return [{places[k]: node for k, node in row.items()} for row in rows]

    def _pull(self, which: str) -> dict[int, Node]:
        """Derivatives of weighted sums in the states (0..), the columns and, after them, the signals."""
        return self.field.pulled(which, [*self.field.state_names, *self.field.inputs()])

    def signals(self, t) -> list:
        """What the signals are at time t."""
        return self._signals.numbers(self.columns, t)

    def start(self) -> tuple:
        """The state at the start."""
        return self._broadcast(evaluate(self.field.start, self._start_known))

    def start_partials(self) -> list[dict[int, Any]]:
        """For each state the derivatives of its start in the columns and, after them, in the signals."""
        inputs = self.field.inputs()
        rows = self.field.partials("start", [inputs[i] for i in self._places])
        nodes = [node for row in rows for node in row.values()]
        found = iter(self._broadcast(evaluate(nodes, self._start_known)))
        return [{self._places[k]: next(found) for k in row} for row in rows]

    def _broadcast(self, numbers) -> tuple:
        return tuple(jnp.broadcast_to(x, self.shape) for x in numbers)

    def _known(self, signals, state) -> dict:
        return self._once | self.field.moving(signals, state)

    def rates(self, signals, state: tuple) -> tuple:
        """The rates of a state."""
        return self._broadcast(evaluate(self.field.rates, self._known(signals, state)))

    def outputs(self, signals, state: tuple):
        """The wanted outputs in a state, shape (wanted, lanes)."""
        return jnp.stack(self._broadcast(evaluate(self.field.outputs, self._known(signals, state))))

    def rates_and_partials(self, signals, state: tuple, always) -> tuple[tuple, list[dict[int, Any]]]:
        """The rates, and for each the derivatives in the states (0..) and in the inputs after them.

        always: see `kept_apart`.
        """
        known = layer_by_layer(self._layers, self._known(signals, state), always)
        return self._with_partials(self.field.rates, self.rate_partials, known)

    def outputs_and_partials(self, signals, state: tuple) -> tuple[tuple, list[dict[int, Any]]]:
        """The outputs, and for each the derivatives in the states and in the inputs after them."""
        return self._with_partials(self.field.outputs, self.output_partials, self._known(signals, state))

    def _with_partials(self, nodes, rows, known: dict):
        found = self._broadcast(evaluate([*nodes, *(node for row in rows for node in row.values())], known))
        values, rest = tuple(found[: len(nodes)]), iter(found[len(nodes) :])
        return values, [{k: next(rest) for k in row} for row in rows]

    def rates_and_pulled(self, signals, state: tuple, weights: tuple, always) -> tuple[tuple, dict[int, Any]]:
        """The rates, and the derivatives of their weighted sum in the states (0..), the columns and the signals.

        always: see `kept_apart`.
        """
        known = self._known(signals, state) | self.field.weighed("rates", weights)
        known = layer_by_layer(self._layers, known, always)
        pulled = self._pulled["rates"]
        found = self._broadcast(evaluate([*self.field.rates, *pulled.values()], known))
        return found[: self.field.size], dict(zip(pulled, found[self.field.size :], strict=True))

    def pull_outputs(self, signals, state: tuple, weights: tuple) -> dict[int, Any]:
        """Derivatives of a weighted sum of the outputs in the states (0..), the columns and the signals."""
        return self._pull_known(self._pulled["outputs"], "outputs", self._known(signals, state), weights)

    def pull_start(self, weights: tuple) -> dict[int, Any]:
        """The same for a weighted sum of the states at the start, which depend on columns and signals."""
        return self._pull_known(self._pull("start"), "start", self._start_known, weights)

    def _pull_known(self, pulled: dict[int, Node], which: str, known: dict, weights: tuple) -> dict[int, Any]:
        found = evaluate(list(pulled.values()), known | self.field.weighed(which, weights))
        return dict(zip(pulled, self._broadcast(found), strict=True))

    @property
    def varies_signals(self) -> bool:
        """Whether a column varies a signal."""
        return bool(self._signals.columns)

    def pushed(self, t) -> list[dict[int, Any]]:
        """For each signal its derivatives in the columns that are differentiated."""
        return self._signals.pushed(self.columns, t, self.differentiated)

    def pulled(self, times, cotangents: Sequence) -> list:
        """Cotangents of the columns from those of the signals at some times, (times, lanes) each."""
        return self._signals.pulled(self.columns, times, cotangents)

    def total(self, slopes: Sequence):
        """The sum of a state's rates, each in units of its typical size, for every lane."""
        terms = [f * (1.0 / scale) for f, scale in zip(slopes, self.field.scales, strict=True)]
        total = terms[0]
        for term in terms[1:]:
            total = total + term
        return total
