"""Values of expressions, for all lanes at once, and what of them is computed once before a loop."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.fast_math import FAST
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
    spread = _spread(args)
    fast = FAST.get(node.primitive.name) if node.dtype == np.float64 else None
    return fast(*spread) if fast else node.primitive.bind(*spread, **node.params)


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
)
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
