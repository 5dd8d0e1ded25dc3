"""Inputs of many lanes: the signals of a circuit, some of whose numbers differ from lane to lane."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.physics.fields import AbstractSignal, driven_of
from jaxlines.simulation.assembly import Location
from jaxlines.simulation.plan import Values
from jaxlines.simulation.signals import Constant


def own_signals(values: Values) -> list[tuple[int, str]]:
    """Kind and field of the signals that components have of their own."""
    return [
        (k, field)
        for k, kind in enumerate(values.kinds)
        for field in driven_of(kind)
        if isinstance(getattr(kind, field), AbstractSignal)
    ]


def every_signal(values: Values) -> list[AbstractSignal]:
    """The external inputs, then the own signals of components, one for each member of their kinds."""
    signals = list(values.signals)
    for k, field in own_signals(values):
        packed = getattr(values.kinds[k], field)
        for member in range(jax.tree.leaves(packed)[0].shape[-1]):
            signals.append(jax.tree.map(lambda leaf, member=member: leaf[..., member], packed))
    return signals


def with_numbers(values: Values, numbers: Sequence) -> Values:
    """The values with every signal replaced by a number, in the order of `every_signal`."""
    count = len(values.signals)
    signals, kinds, at = tuple(Constant(number) for number in numbers[:count]), list(values.kinds), count
    for k, field in own_signals(values):
        members = jax.tree.leaves(getattr(values.kinds[k], field))[0].shape[-1]
        stack = np.stack if all(isinstance(n, np.ndarray) for n in numbers) else jnp.stack
        number = stack(numbers[at : at + members])
        kinds[k] = eqx.tree_at(lambda kind, field=field: getattr(kind, field), kinds[k], number)
        at += members
    return eqx.tree_at(lambda v: (v.signals, v.kinds), values, (signals, tuple(kinds)))


def tagged(values: Values, columns: Sequence[Sequence[Location]]) -> tuple[list, Values]:
    """Names of all numbers of a circuit, and the tree of values with the position of each among these names.

    Names are ("column", c) for what column c varies, and ("leaf", position, index) for the rest.
    """
    names: list = [("column", c) for c in range(len(columns))]
    leaves, structure = jax.tree.flatten(values)
    tags = []
    for position, leaf in enumerate(leaves):
        size = int(np.prod(np.shape(leaf)))
        tags.append(np.arange(len(names), len(names) + size).reshape(np.shape(leaf)))
        names += [("leaf", position, i) for i in range(size)]
    for c, places in enumerate(columns):
        for position, index in places:
            tags[position][... if index is None else index] = c
    return names, jax.tree.unflatten(structure, tags)


class LaneSignals:
    """The signals of an ensemble as functions of time.

    Args: values: of the circuit; tags: the same tree with, in place of each number, the column that varies it, else
    one that is not below `count`; count: how many columns there are.
    """

    def __init__(self, values: Values, tags: Values, count: int):
        self._signals = every_signal(values)
        self._tags = [
            [
                int(tag.ravel()[0]) if np.size(tag) and tag.ravel()[0] < count else None
                for tag in jax.tree.leaves(signal)
            ]
            for signal in every_signal(tags)
        ]
        self.columns = sorted({c for tags in self._tags for c in tags if c is not None})
        """Columns that vary signals."""

    def moved_by(self, columns: Sequence[int]) -> list[int]:
        """Signals that some columns vary."""
        return [k for k, tags in enumerate(self._tags) if any(tag in columns for tag in tags if tag is not None)]

    def numbers(self, columns: Sequence, t) -> list:
        """What the signals are at time t: one number, or one for each lane."""
        return [self._number(signal, tags, columns, t) for signal, tags in zip(self._signals, self._tags, strict=True)]

    @staticmethod
    def _number(signal: AbstractSignal, tags: list, columns: Sequence, t):
        if all(tag is None for tag in tags):
            return jnp.asarray(signal(t))
        leaves, structure = jax.tree.flatten(signal)
        leaves = [leaf if tag is None else columns[tag] for leaf, tag in zip(leaves, tags, strict=True)]
        axes = [None if tag is None else -1 for tag in tags]
        return jax.vmap(lambda leaves: jax.tree.unflatten(structure, leaves)(t), in_axes=(axes,))(leaves)

    def pushed(self, columns: Sequence, t, wanted: Sequence[int]) -> list[dict[int, Any]]:
        """For each signal the derivatives in those of the wanted columns that vary it."""
        rows: list[dict[int, Any]] = [{} for _ in self._signals]
        for c in (c for c in self.columns if c in wanted):

            def along(column, c=c):
                return self.numbers([column if k == c else x for k, x in enumerate(columns)], t)

            slopes = jax.jvp(along, (columns[c],), (jnp.ones_like(columns[c]),))[1]
            for row, tags, slope in zip(rows, self._tags, slopes, strict=True):
                if c in tags:
                    row[c] = slope
        return rows

    def pulled(self, columns: Sequence, times, cotangents: Sequence) -> list:
        """Cotangents of the columns from those of the signals at some times, (times, lanes) each."""

        def every(columns):
            numbers = jax.vmap(lambda t: self.numbers(columns, t))(times)
            return [n for n, tags in zip(numbers, self._tags, strict=True) if self._is_varied(tags)]

        given = [c for c, tags in zip(cotangents, self._tags, strict=True) if self._is_varied(tags)]
        return jax.vjp(every, list(columns))[1](given)[0]

    @staticmethod
    def _is_varied(tags: list) -> bool:
        return any(tag is not None for tag in tags)
