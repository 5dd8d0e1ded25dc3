"""Values of expressions, for all lanes at once, and what of them is computed once before a loop."""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.fast_math import EXP2, INVERSE_FOURTH_ROOT, INVERSE_ROOT, LOG2
from jaxlines.simulation.node import Node


def evaluate(wanted: Sequence[Node], known: dict[Node, Any]) -> list:
    """Values of some nodes, shape () or (lanes,), given those of the inputs (and of any others)."""
    values, wholes = dict(known), {}
    for node in _in_order(wanted, values):
        if node.is_constant():
            values[node] = jnp.asarray(node.value, node.dtype)
        elif node.whole is not None:
            wholes[node] = _call_whole(node, [values[a] for a in node.args])
            values[node] = None
        elif node.pick is not None:
            values[node] = wholes[node.args[0]][node.pick[0]][node.pick[1]]
        elif node.primitive is not None:
            values[node] = _call(node, [values[a] for a in node.args])
        else:
            raise KeyError(f"no value is given for the input {node.name!r}")
    return [values[node] for node in wanted]


def _in_order(wanted: Sequence[Node], known: dict) -> list[Node]:
    """Nodes that are needed and not known, each after those it depends on."""
    order, seen, stack = [], set(known), [(node, False) for node in reversed(wanted)]
    while stack:
        node, done = stack.pop()
        if done:
            order.append(node)
        elif node not in seen:
            seen.add(node)
            stack.append((node, True))
            stack.extend((a, False) for a in node.args if a not in seen)
    return order


def _spread(args: list) -> list:
    """Numbers and lanes as arrays of one shape."""
    shape = max((jnp.shape(a) for a in args), key=len)
    return [jnp.broadcast_to(a, shape) for a in args]


def _call(node: Node, args: list):
    """The value of an element-wise operation."""
    return node.primitive.bind(*_spread(args), **node.params)


def _call_whole(node: Node, args: list) -> list:
    """The results of an operation on arrays, each with its numbers along the first axis."""
    assert node.whole is not None
    arrays, at = [], 0
    with_lanes = any(jnp.ndim(a) for a in args)
    for shape, dtype in node.whole:
        size = int(np.prod(shape))
        rows = _spread([*args[at : at + size], *args])[:size] if size else []
        lanes = rows[0].shape if size else ()
        arrays.append(jnp.stack(rows).astype(dtype).reshape(*shape, *lanes) if size else jnp.zeros(shape, dtype))
        at += size

    def bind(*arrays):
        found = node.primitive.bind(*arrays, **node.params)
        return list(found) if node.primitive.multiple_results else [found]

    found = jax.vmap(bind, in_axes=-1, out_axes=-1)(*arrays) if with_lanes else bind(*arrays)
    return [f.reshape(-1, f.shape[-1]) if with_lanes else f.ravel() for f in found]


COSTLY = frozenset(
    ("div", "exp", "log", "log1p", "expm1", "pow", "sqrt", "rsqrt", "cbrt", "sin", "cos", "tan", "tanh", "atan2")
) | {INVERSE_ROOT.name, INVERSE_FOURTH_ROOT.name, EXP2.name, LOG2.name}
"""Operations that cost more than reading their result."""


def boundary(wanted: Sequence[Node]) -> list[Node]:
    """What does not move and moving nodes behind some wanted ones need: to be evaluated once, before the loop.

    What is cheap to compute from as few arrays of lanes as it is itself stays in the loop, since the loop is bound
    by what it reads.
    """
    needed: dict[Node, None] = {}
    for node in _in_order(wanted, {}):
        if not node.moving and node in wanted and not node.is_constant():
            needed[node] = None
        if node.moving:
            needed.update(dict.fromkeys(a for a in node.args if not a.moving and not a.is_constant()))
    varied = _varied(needed)
    changed = True
    while changed:
        changed = False
        for node in list(needed):
            cheap = node.primitive is not None and node.primitive.name not in COSTLY and node.whole is None
            if not (cheap and node in varied):
                continue
            args = [a for a in node.args if not a.is_constant()]
            if len({a for a in args if a in varied} - set(needed)) <= 1:
                del needed[node]
                needed.update(dict.fromkeys(args))
                changed = True
    return list(needed)


def _varied(nodes) -> set[Node]:
    """Nodes, and those behind them, that differ from lane to lane: they depend on a column."""
    found: set[Node] = set()
    for node in _in_order(list(nodes), {}):
        if (node.name is not None and node.name[0] == "column") or any(a in found for a in node.args):
            found.add(node)
    return found


_COSTS = {EXP2.name: 22, LOG2.name: 30, INVERSE_ROOT.name: 16, INVERSE_FOURTH_ROOT.name: 20, "div": 8, "sqrt": 12}
"""Multiplications that an operation takes as long as; those not named: one."""

READING, WRITING = 2, 30
"""Multiplications that it takes as long as to read an array, and to write one down in a layer of its own."""


def layers(wanted: Sequence[Node]) -> list[list[Node]]:
    """Moving nodes that several of the wanted ones need, to be computed first, one layer after the other.

    XLA computes each result in a loop of its own, and what several need in each of these loops anew. Those nodes are
    chosen, the best first, that save more than it costs to write them down and to read them.
    """
    among = {n for n in _in_order(list(wanted), {}) if n.moving and n.args}
    chosen: dict[Node, set[Node]] = {}
    while True:
        cones = [_cone(result, among, chosen) for result in wanted] + list(chosen.values())
        counts = Counter(node for cone in cones for node in cone)
        better: dict[Node, tuple[float, set[Node]]] = {}
        for node, count in counts.items():
            if count > 1 and node not in wanted and node.whole is None and np.issubdtype(node.dtype, np.floating):
                cone = _cone(node, among, chosen)
                saved = (_cost(cone) - READING) * (count - 1) - READING - WRITING
                if saved > 0:
                    better[node] = saved, cone
        if not better:
            return _levels(chosen)
        taken: set[Node] = set()
        for node, (_, cone) in sorted(better.items(), key=lambda item: -item[1][0]):
            if not cone & taken:  # else what it saves has changed
                chosen[node] = cone
                taken |= {other for other, (_, behind) in better.items() if node in behind} | cone
        chosen = {node: _cone(node, among, chosen) for node in chosen}


def _levels(cones: dict[Node, set[Node]]) -> list[list[Node]]:
    """Nodes by how many of the others come before them; cones: what has to be computed for each of them."""
    level: dict[Node, int] = {}
    for node in _in_order(list(cones), {}):
        if node in cones:
            level[node] = 1 + max((level[a] for n in cones[node] for a in n.args if a in cones), default=-1)
    return [[n for n, k in level.items() if k == depth] for depth in range(1 + max(level.values(), default=-1))]


def _cone(node: Node, among, stops) -> set[Node]:
    """A node and what has to be computed for it, up to some nodes that are there."""
    cone, stack = set(), [node]
    while stack:
        one = stack.pop()
        if one in among and one not in cone and (one is node or one not in stops):
            cone.add(one)
            stack.extend(one.args)
    return cone


def _cost(nodes) -> int:
    return sum(_COSTS.get(n.primitive.name, 1) for n in nodes if n.primitive is not None)


def kept_apart(always, function, *arguments):
    """A function whose results are written down before they are used.

    XLA would otherwise compute cheap ones anew for each that uses them, and drops the barriers that are meant to say
    so. always: true, but not known to be.
    """
    shapes = jax.eval_shape(function, *arguments)
    return jax.lax.cond(
        always, function, lambda *_: jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes), *arguments
    )


def put_down(always, function: Callable[[], Sequence], room):
    """The same with each result, shape () or (lanes,), in a row of an array that there is, shape (results, lanes).

    For results that take long: XLA shares out a long loop among threads unless it writes to a part of an array, and
    all threads have lanes of their own.
    """

    def filled(room):
        for row, value in enumerate(function()):
            room = room.at[row].set(value)
        return room

    return jax.lax.cond(always, filled, lambda room: room, room)


def layer_by_layer(layers: Sequence[Sequence[Node]], known: dict[Node, Any], always) -> dict[Node, Any]:
    """What is known, and the nodes of some layers. always: see `kept_apart`."""
    known = dict(known)
    for layer in layers:
        found = kept_apart(always, lambda layer=layer, known=known: evaluate(layer, known))
        known |= dict(zip(layer, found, strict=True))
    return known
