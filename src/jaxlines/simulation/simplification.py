"""Simpler expressions for operations on numbers, where there are some.

0 x = 0 also where x is not finite: whatever is not finite shows in the rate of its own state. A division by what
stays the same becomes a multiplication, and one by a square root avoids the reciprocal square root of float64, which
is slow on many processors and which XLA would use: a/sqrt(b) = a sqrt(b)/b.
"""

from typing import Any

import jax
import numpy as np

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


def simplified(graph: Graph, name: str, args: tuple, dtype) -> Node | None:
    """A simpler node for an operation, where there is one."""
    if name in RULES:
        found = RULES[name](graph, args, dtype)
        if found is not None:
            return found
    if name in CONSTANT_FOLDS and all(a.is_constant() for a in args):
        with np.errstate(all="ignore"):
            return graph.constant(CONSTANT_FOLDS[name](*(a.value for a in args)), dtype)
    return None


def _product(graph: Graph, args: tuple, dtype) -> Node | None:
    for one, other in (args, args[::-1]):
        if one.is_constant(0):
            return one
        if one.is_constant(1):
            return other
    return None


def _sum(graph: Graph, args: tuple, dtype) -> Node | None:
    for one, other in (args, args[::-1]):
        if one.is_constant(0):
            return other
    return None


def _difference(graph: Graph, args: tuple, dtype) -> Node | None:
    if args[1].is_constant(0):
        return args[0]
    if args[0].is_constant(0) and np.issubdtype(dtype, np.floating):
        return graph.lax(jax.lax.mul, graph.constant(-1.0, dtype), args[1])
    return None


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
    if not np.issubdtype(dtype, np.floating) or (above.is_constant() and below.is_constant()):
        return None
    if above.is_constant(0) or below.is_constant(1):
        return above
    if below.is_constant() and np.isinf(below.value):
        return graph.constant(0.0, dtype)
    if above.moving and not below.moving:
        return graph.lax(jax.lax.mul, above, graph.lax(jax.lax.div, graph.constant(1.0, dtype), below))
    is_root = below.primitive is not None and below.primitive.name == "sqrt"
    if below.moving and is_root and np.dtype(dtype) == np.float64:
        return graph.lax(jax.lax.div, graph.lax(jax.lax.mul, above, below), below.args[0])
    return None


def _inverse_root(graph: Graph, args: tuple, dtype) -> Node | None:
    if np.dtype(dtype) != np.float64:
        return None
    return graph.lax(jax.lax.div, graph.constant(1.0, dtype), graph.lax(jax.lax.sqrt, args[0]))


RULES = {
    "mul": _product,
    "add": _sum,
    "add_any": _sum,
    "sub": _difference,
    "stop_gradient": _same,
    "convert_element_type": _converted,
    "select_n": _selected,
    "div": _quotient,
    "rsqrt": _inverse_root,
}
"""Operation -> what makes it simpler: (graph, arguments, type of the result) -> node, or None."""
