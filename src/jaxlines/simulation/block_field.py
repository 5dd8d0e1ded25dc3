"""The vector field of many lanes in blocks, (own axes, count, lanes), as the components are written.

For circuits of any size: its program does not grow with the number of members of a kind.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.assembly import Location
from jaxlines.simulation.lane_signals import LaneSignals, every_signal, tagged, with_numbers
from jaxlines.simulation.observation import observe
from jaxlines.simulation.paths import leaf_paths
from jaxlines.simulation.plan import Plan, Values, scales, unravel
from jaxlines.simulation.signals import Constant
from jaxlines.simulation.vector_field import rates, starting_point


class BlockField:
    """Rates, start and outputs of a circuit for many lanes.

    Args: plan; values; places: for each varied number where it is; wanted: names of the outputs; columns: the
    varied numbers, (lanes,) each; t: when it starts [s].
    """

    def __init__(
        self, plan: Plan, values: Values, places: Sequence[Sequence[Location]], wanted: tuple[str, ...], columns, t
    ):
        self.plan, self.wanted, self.columns, self.shape = plan, wanted, columns, columns[0].shape[-1:]
        self._names, tags = tagged(values, places)
        self._signals = LaneSignals(values, tags, len(columns))
        first = len(self._names)
        held = with_numbers(tags, [np.asarray(first + k) for k in range(len(every_signal(tags)))])
        leaves, self._structure = jax.tree.flatten(held)
        originals = jax.tree.leaves(values)
        self._leaves = [self._filled(tag, path, originals) for tag, path in zip(leaves, leaf_paths(held), strict=True)]
        self._tags = leaves
        start = starting_point(plan, self.held(self.signals(t)), t)
        start = jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], *self.shape)), start)
        self._start, self._state_structure = jax.tree.flatten(start)
        # Potentials of no free node have no axis of lanes to begin with.
        sizes = unravel(plan, np.ones_like(scales(plan)))
        self._scales = [jnp.asarray(s, self._start[0].dtype)[..., None] for s in jax.tree.leaves(sizes)]

    def _filled(self, tag: np.ndarray, path: str, originals: list):
        """A leaf with its axis of lanes, or None where it is the number of a signal."""
        count = len(self.columns)
        if tag.size and int(tag.max()) >= len(self._names):
            return None
        kept = [int(x) for x in tag.ravel() if x >= count]
        if not kept and tag.ndim == 0:
            return self.columns[int(tag)]
        if kept:
            leaf = jnp.asarray(originals[self._names[kept[0]][1]])
            if leaf.shape != tag.shape:
                raise ValueError(f"{path} cannot be varied from lane to lane")
        else:
            leaf = jnp.zeros(tag.shape, self.columns[0].dtype)
        room = path.split(".")[0]
        if room in ("fluid", "sensors") and len(kept) == tag.size:
            return leaf
        if room == "kinds" and len(kept) == tag.size:
            return leaf[..., None]
        leaf = jnp.broadcast_to(leaf[..., None], (*leaf.shape, *self.shape))
        for index in np.argwhere(tag < count):
            leaf = leaf.at[tuple(index)].set(self.columns[int(tag[tuple(index)])])
        return leaf

    def signals(self, t) -> list:
        """What the signals are at time t."""
        return self._signals.numbers(self.columns, t)

    def held(self, numbers: Sequence) -> Values:
        """The values with signals replaced by numbers."""
        spread = [jnp.broadcast_to(n, self.shape) for n in numbers]
        first, leaves = len(self._names), []
        for leaf, tag in zip(self._leaves, self._tags, strict=True):
            if leaf is None:
                rows = [spread[int(k) - first] for k in tag.ravel()]
                leaf = rows[0] if tag.ndim == 0 else jnp.stack(rows).reshape(*tag.shape, *self.shape)
            leaves.append(leaf)
        return jax.tree.unflatten(self._structure, leaves)

    def start(self) -> tuple:
        """The state at the start: arrays (own axes, count, lanes)."""
        return tuple(self._start)

    def tree(self, state: Sequence) -> Any:
        """Potentials and states of components from the arrays."""
        return jax.tree.unflatten(self._state_structure, state)

    def rates(self, signals, state: tuple) -> tuple:
        """The rates of a state."""
        zero = jnp.zeros((), self.columns[0].dtype)
        found = jax.tree.leaves(rates(self.plan, self.held(signals), zero, *self.tree(state)))
        return tuple(jnp.broadcast_to(f, y.shape) for f, y in zip(found, state, strict=True))

    def outputs(self, signals, state: tuple):
        """The wanted outputs in a state, shape (wanted, lanes)."""
        zero = jnp.zeros((), self.columns[0].dtype)
        shown = observe(self.plan, self.held(signals), self.wanted, zero, *self.tree(state))
        return jnp.broadcast_to(shown, (len(self.wanted), *self.shape))

    def total(self, slopes: Sequence):
        """The sum of a state's rates, each in units of its typical size, for every lane."""
        rows = [
            jnp.sum((f / s).reshape(-1, *self.shape), axis=0)
            for f, s in zip(slopes, self._scales, strict=True)
            if f.size
        ]
        return jnp.sum(jnp.stack(rows), axis=0)

    def implicit(self, t) -> tuple[Values, Callable]:
        """What the linearly implicit scheme integrates (see `rosenbrock`): values, and a function for their rates."""

        def rate(plan, values, t, potentials, states):
            state = tuple(jax.tree.leaves((potentials, states)))
            return self.tree(self.rates(self.signals(t), state))

        # The pattern of the Jacobian comes from these values; the signals that act are those of `rate`.
        held = self.held(self.signals(t))
        return eqx.tree_at(lambda v: v.signals, held, tuple(Constant(t) for _ in held.signals)), rate
