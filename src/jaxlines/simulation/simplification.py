"""Simpler expressions for operations on numbers, where there are some.

0 x = 0 also where x is not finite: whatever is not finite shows in the rate of its own state. Divisions are slow, so
that a/b becomes a (1/b) with one reciprocal for all that is divided by b, and reciprocals of products, roots and sums
with a quotient are made of those there are. Reciprocals of square and of fourth roots, powers of 2 and logarithms
are operations of their own, with hardly a division (`fast_math`). What stays the same in time is the first factor of
a product, so that it is put together before the loop.
"""

from typing import Any

import jax
import numpy as np

from jaxlines.simulation.fast_math import EXP2, INVERSE_FOURTH_ROOT, INVERSE_ROOT, LOG2
from jaxlines.simulation.node import Node

Graph = Any
"""The graph that the nodes belong to (`expression.Graph`, which knows these rules)."""

CONSTANT_FOLDS = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "max": np.maximum,
    "min": np.minimum,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "tanh": np.tanh,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.invert,
    "convert_element_type": lambda x: x,
}
"""Operations that are done at once where all their arguments are constants."""


def simplified(graph: Graph, name: str, args: tuple, dtype, params: dict) -> Node | None:
    """A simpler node for an operation, where there is one."""
    found = _power(graph, args[0], params["y"]) if name == "integer_pow" else None
    if name in RULES:
        found = RULES[name](graph, args, dtype)
    if found is None and name in CONSTANT_FOLDS and all(a.is_constant() for a in args):
        with np.errstate(all="ignore"):
            return graph.constant(CONSTANT_FOLDS[name](*(a.value for a in args)), dtype)
    return found


def _is(node: Node, name: str) -> bool:
    return node.primitive is not None and node.primitive.name == name


def _times(graph: Graph, a: Node, b: Node) -> Node:
    return graph.lax(jax.lax.mul, a, b)


def _one(graph: Graph, dtype) -> Node:
    return graph.constant(1.0, dtype)


def _product(graph: Graph, args: tuple, dtype) -> Node | None:
    for one, other in (args, args[::-1]):
        if one.is_constant(0):
            return one
        if one.is_constant(1):
            return other
    if not np.issubdtype(dtype, np.floating):
        return None
    a, b = args
    if b.moving and not a.moving and _is(b, "mul") and not b.args[0].moving:
        return _times(graph, _times(graph, a, b.args[0]), b.args[1])
    if not b.moving and a.moving:
        return _times(graph, b, a)
    if a.moving and b.moving:
        for one, other in (args, args[::-1]):
            if _is(one, "mul") and not one.args[0].moving:
                return _times(graph, one.args[0], _times(graph, one.args[1], other))
        return _cancelled(graph, args, dtype)
    return None


def _powers(graph: Graph, node: Node, sign: int = 1) -> dict[Node, int]:
    """The factors of a product that moves, with the powers that they have."""
    if _is(node, "mul"):
        found = _powers(graph, node.args[0], sign)
        for factor, power in _powers(graph, node.args[1], sign).items():
            found[factor] = found.get(factor, 0) + power
        return found
    below = _below(graph, node)
    return {node: sign} if below is None else _powers(graph, below, -sign)


def _below(graph: Graph, node: Node) -> Node | None:
    """x where a node is 1/x, else None."""
    if _is(node, "div") and node.args[0].is_constant(1):
        return node.args[1]
    if _is(node, INVERSE_ROOT.name):
        return graph.lax(jax.lax.sqrt, node.args[0])
    if _is(node, INVERSE_FOURTH_ROOT.name):
        return graph.lax(jax.lax.sqrt, graph.lax(jax.lax.sqrt, node.args[0]))
    return None


def _cancelled(graph: Graph, args: tuple, dtype) -> Node | None:
    """A product in which factors cancel, without them: x (1/x) = 1, sqrt(x) sqrt(x) = x."""
    a, b = (_powers(graph, x) for x in args)
    powers = {x: a.get(x, 0) + b.get(x, 0) for x in (*a, *b)}
    roots = [x for x, power in powers.items() if _is(x, "sqrt") and power > 1]
    if not roots and all(a[x] * b[x] > 0 for x in a if x in b):
        return None
    for root in roots:
        half, powers[root] = divmod(powers[root], 2)
        powers[root.args[0]] = powers.get(root.args[0], 0) + half
    found = _one(graph, dtype)
    for factor, power in powers.items():
        once = factor if power > 0 else graph.lax(jax.lax.div, _one(graph, dtype), factor)
        for _ in range(abs(power)):
            found = _times(graph, found, once)
    return found


def _sum(graph: Graph, args: tuple, dtype) -> Node | None:
    for one, other in (args, args[::-1]):
        if one.is_constant(0):
            return other
    if not np.issubdtype(dtype, np.floating):
        return None
    for one, other in (args, args[::-1]):  # a x + b x = (a + b) x, which derivatives of squares are full of
        (a, x), (b, y) = _scaled(graph, one), _scaled(graph, other)
        if x is y and x.moving:
            return _times(graph, graph.lax(jax.lax.add, a, b), x)
        if _is(one, "add") or _is(one, "add_any"):
            for inner, rest in (one.args, one.args[::-1]):
                a, x = _scaled(graph, inner)
                if x is y and x.moving:
                    return graph.lax(jax.lax.add, rest, _times(graph, graph.lax(jax.lax.add, a, b), x))
    return None


def _scaled(graph: Graph, node: Node) -> tuple[Node, Node]:
    """A factor that does not move, and what it multiplies."""
    if _is(node, "mul") and not node.args[0].moving:
        return node.args
    return _one(graph, node.dtype), node


def _difference(graph: Graph, args: tuple, dtype) -> Node | None:
    if args[1].is_constant(0):
        return args[0]
    if args[0].is_constant(0):
        return _negative(graph, args[1:], dtype)
    return None


def _negative(graph: Graph, args: tuple, dtype) -> Node | None:
    if not np.issubdtype(dtype, np.floating):
        return None
    return _times(graph, graph.constant(-1.0, dtype), args[0])


def _same(graph: Graph, args: tuple, dtype) -> Node | None:
    return args[0]


def _converted(graph: Graph, args: tuple, dtype) -> Node | None:
    return args[0] if args[0].dtype == dtype else None


def _selected(graph: Graph, args: tuple, dtype) -> Node | None:
    which, *cases = args
    if all(case is cases[0] for case in cases[1:]):
        return cases[0]
    return cases[int(which.value)] if which.is_constant() else None


def _quotient(graph: Graph, args: tuple, dtype) -> Node | None:
    above, below = args
    if not np.issubdtype(dtype, np.floating):
        return None
    if above.is_constant(0) or below.is_constant(1):
        return above
    if below.is_constant() and np.isinf(below.value):
        return graph.constant(0.0, dtype)
    if above.is_constant(1):
        return _reciprocal(graph, below, dtype)
    if not above.moving and not below.moving:
        return None
    return _times(graph, above, graph.lax(jax.lax.div, _one(graph, dtype), below))


def _reciprocal(graph: Graph, x: Node, dtype) -> Node | None:
    """1/x from other reciprocals, where there are some."""

    def inverse(y: Node) -> Node:
        return graph.lax(jax.lax.div, _one(graph, dtype), y)

    if not x.moving:
        return None
    below = _below(graph, x)
    if below is not None:
        return below
    if _is(x, "mul"):
        for a, b in (x.args, x.args[::-1]):
            if not a.moving or _below(graph, a) is not None:
                return _times(graph, inverse(a), inverse(b))
    if _is(x, "sqrt"):
        return _inverse_root(graph, x.args, dtype)
    if _is(x, "select_n") and all(case.is_constant() for case in x.args[1:]):
        return graph.operation(jax.lax.select_n_p, {}, dtype, (x.args[0], *map(inverse, x.args[1:])))
    return None


def _inverse_root(graph: Graph, args: tuple, dtype) -> Node | None:
    """1/sqrt(x), from that of the fourth root where there is one."""
    (x,) = args
    if _is(x, "sqrt"):
        return graph.operation(INVERSE_FOURTH_ROOT, {}, dtype, x.args)
    fourth = graph.known(INVERSE_FOURTH_ROOT, {}, dtype, args)
    return graph.operation(INVERSE_ROOT, {}, dtype, args) if fourth is None else _times(graph, fourth, fourth)


def _exponential(graph: Graph, args: tuple, dtype) -> Node | None:
    """exp(x) = 2^(x/log 2) of what moves."""
    if not args[0].moving:
        return None
    return graph.operation(EXP2, {}, dtype, (_times(graph, graph.constant(1.0 / np.log(2.0), dtype), args[0]),))


def _logarithm(graph: Graph, args: tuple, dtype) -> Node | None:
    """log(x) = log 2 log2(x) of what moves."""
    if not args[0].moving:
        return None
    return _times(graph, graph.constant(np.log(2.0), dtype), graph.operation(LOG2, {}, dtype, args))


def _power(graph: Graph, x: Node, exponent: int) -> Node | None:
    """Small whole powers as products."""
    if exponent < 0:
        return _power(graph, graph.lax(jax.lax.div, _one(graph, x.dtype), x), -exponent)
    if exponent == 1:
        return x
    return _times(graph, x, x) if exponent == 2 else None


RULES = {
    "mul": _product,
    "add": _sum,
    "add_any": _sum,
    "sub": _difference,
    "neg": _negative,
    "stop_gradient": _same,
    "convert_element_type": _converted,
    "select_n": _selected,
    "div": _quotient,
    "rsqrt": _inverse_root,
    "exp": _exponential,
    "log": _logarithm,
}
"""Operation -> what makes it simpler: (graph, arguments, type of the result) -> node, or None."""
