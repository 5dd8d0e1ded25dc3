"""Which rates depend on which states: found once from the program of a function, and columns to be pushed together.

The pattern follows from the operations alone, not from values at some points: both branches of a choice count,
so that no entry is missed where a valve is shut or a stop is out of reach.
Reference: Curtis, Powell and Reid, "On the estimation of sparse Jacobian matrices", J. Inst. Maths Applics 13, 1974.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal

CALLS = ("jaxpr", "call_jaxpr", "fun_jaxpr")
"""Parameters under which operations that call a program keep it."""

MOVES = {
    "reshape", "squeeze", "expand_dims", "broadcast_in_dim", "slice", "concatenate", "transpose", "rev", "gather",
    "dynamic_slice", "copy", "stack",
}  # fmt: skip
"""Operations that only move numbers; all arguments after the first are places, except where every one is moved."""

ALL_MOVED = {"concatenate", "stack"}

REDUCTIONS = {"reduce_sum", "reduce_max", "reduce_min", "reduce_prod"}

ELEMENTWISE = {
    "abs", "add", "add_any", "and", "atan2", "cbrt", "ceil", "clamp", "convert_element_type", "copy_p", "cos",
    "cosh", "div", "erf", "erf_inv", "erfc", "exp", "exp2", "expm1", "floor", "integer_pow", "lgamma", "digamma",
    "log", "log1p", "logistic", "max", "min", "mul", "neg", "nextafter", "not", "or", "pow", "reduce_precision",
    "rem", "round", "rsqrt", "select_n", "sign", "sin", "sinh", "sqrt", "square", "stop_gradient", "sub", "tan",
    "tanh", "acos", "asin", "atan", "acosh", "asinh", "atanh", "xor",
}  # fmt: skip
"""Operations whose result depends, number by number, on its arguments at the same place (or on single numbers)."""


class Known(NamedTuple):
    """What is known of an array: its numbers where they are constant, and which inputs each number depends on.

    depends: shape (*array's, inputs), or None where there is no dependence.
    """

    value: Any = None
    depends: np.ndarray | None = None


def jacobian_pattern(function, state, *others) -> np.ndarray:
    """Where the derivatives of function(state, *others) in state can differ from zero, shape (outputs, inputs).

    Args: function: pure, of pytrees of arrays, gives one of floating-point arrays; state: such a pytree; others:
        further arguments, whatever their values. Shapes will do for all. Numbers of pytrees are counted leaf by leaf
        in the order of `jax.tree.leaves`.
    Validity: never misses an entry; operations it does not know (loops, matrix products) make all of their outputs
        depend on whatever any of their inputs depends on.
    """
    leaves = jax.tree.leaves(state)
    closed = jax.make_jaxpr(lambda *given: jax.tree.leaves(function(*given)))(state, *others)
    sizes = [math.prod(leaf.shape) for leaf in leaves]
    eye = np.eye(sum(sizes), dtype=bool)
    parts = np.split(eye, np.cumsum(sizes)[:-1]) if sizes else []
    seeds = [Known(None, p.reshape(*leaf.shape, len(eye))) for p, leaf in zip(parts, leaves, strict=True)]
    found = _follow(closed, seeds + [Known()] * (len(closed.jaxpr.invars) - len(seeds)))
    shapes = [atom.aval.shape for atom in closed.jaxpr.outvars]
    rows = [_spread(k.depends, s, len(eye)).reshape(-1, len(eye)) for k, s in zip(found, shapes, strict=True)]
    return np.concatenate(rows) if rows else np.zeros((0, len(eye)), dtype=bool)


def colours(pattern: np.ndarray) -> np.ndarray:
    """A colour for every column, such that no row has entries in two columns of a colour; largest columns first.

    The derivative along the sum of the columns of a colour then holds all of their entries.
    """
    meets = (pattern.astype(int).T @ pattern.astype(int)) > 0
    found = np.full(pattern.shape[1], -1)
    for column in np.argsort(-meets.sum(axis=0), kind="stable"):
        taken = set(found[meets[column]])
        found[column] = next(c for c in range(len(found) + 1) if c not in taken)
    return found


def _spread(depends: np.ndarray | None, shape, inputs: int) -> np.ndarray:
    """Dependence of an array, with zeros where there is none."""
    return np.zeros((*shape, inputs), dtype=bool) if depends is None else np.broadcast_to(depends, (*shape, inputs))


def _follow(closed: ClosedJaxpr, arguments: list[Known]) -> list[Known]:
    """What is known of the outputs of a program."""
    jaxpr = closed.jaxpr
    known: dict = dict(zip(jaxpr.invars, arguments, strict=True))
    known |= {variable: _constant(value) for variable, value in zip(jaxpr.constvars, closed.consts, strict=True)}

    def read(atom) -> Known:
        return Known(np.asarray(atom.val)) if isinstance(atom, Literal) else known[atom]

    for eqn in jaxpr.eqns:
        results = _equation(eqn, [read(atom) for atom in eqn.invars])
        for variable, result in zip(eqn.outvars, results, strict=True):
            # Whole numbers and truth values have no derivative.
            smooth = jnp.issubdtype(variable.aval.dtype, jnp.inexact)
            known[variable] = result if smooth else result._replace(depends=None)
    return [read(atom) for atom in jaxpr.outvars]


def _constant(value) -> Known:
    return Known() if isinstance(value, Tracer) else Known(np.asarray(value))


def _equation(eqn, args: list[Known]) -> list[Known]:
    """What is known of the results of one operation."""
    name, params = eqn.primitive.name, eqn.params
    inner = next((params[key] for key in CALLS if key in params), None)
    if inner is not None and name not in ("while", "scan"):
        closed = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
        if len(closed.jaxpr.invars) == len(args):
            return _follow(closed, args)
    inputs = next((k.depends.shape[-1] for k in args if k.depends is not None), 0)
    if not inputs:
        return _evaluated(eqn, args)
    if name == "cond":
        return _either([_follow(branch, args[1:]) for branch in params["branches"]], eqn, inputs)
    shape = eqn.outvars[0].aval.shape
    if name in ELEMENTWISE:
        return [Known(None, _union([k.depends for k in args if k.depends is not None], shape, inputs))]
    if name in REDUCTIONS:
        return [Known(None, np.any(_full(eqn, args, 0, inputs), axis=tuple(params["axes"])))]
    if name in MOVES:
        moved = _moved(eqn, args, inputs)
        if moved is not None:
            return [Known(None, moved)]
    anything = np.any([np.any(k.depends.reshape(-1, inputs), axis=0) for k in args if k.depends is not None], axis=0)
    return [Known(None, np.broadcast_to(anything, (*v.aval.shape, inputs))) for v in eqn.outvars]


def _evaluated(eqn, args: list[Known]) -> list[Known]:
    """The results of an operation that depends on no input; numbers where all of its arguments are constant."""
    if any(k.value is None for k in args) or any(isinstance(v, ClosedJaxpr) for v in eqn.params.values()):
        return [Known() for _ in eqn.outvars]
    with jax.ensure_compile_time_eval():
        found = eqn.primitive.bind(*(jnp.asarray(k.value) for k in args), **eqn.params)
    return [Known(np.asarray(x)) for x in (found if eqn.primitive.multiple_results else [found])]


def _either(branches: list[list[Known]], eqn, inputs: int) -> list[Known]:
    """What is known of the outcome of a choice of programs."""
    return [
        Known(None, np.any([_spread(b[i].depends, v.aval.shape, inputs) for b in branches], axis=0))
        for i, v in enumerate(eqn.outvars)
    ]


def _union(parts: list, shape, inputs: int) -> np.ndarray:
    """Dependence of numbers made element by element of others (of the same shape, or single ones)."""
    found = np.zeros((*shape, inputs), dtype=bool)
    for part in parts:
        found |= part
    return found


def _full(eqn, args: list[Known], i: int, inputs: int) -> np.ndarray:
    return _spread(args[i].depends, eqn.invars[i].aval.shape, inputs)


def _moved(eqn, args: list[Known], inputs: int) -> np.ndarray | None:
    """Dependence of moved numbers: the operation is done on their positions; None when places are not constant."""
    name, count = eqn.primitive.name, len(args)
    moved = range(count) if name in ALL_MOVED else range(1)
    if any(args[i].value is None for i in range(count) if i not in moved):
        return None
    rows, numbered = [np.zeros((1, inputs), dtype=bool)], []
    for i in range(count):
        if i not in moved:
            numbered.append(args[i].value)
            continue
        rows.append(_full(eqn, args, i, inputs).reshape(-1, inputs))
        begin = sum(len(r) for r in rows[:-1])
        numbered.append(np.arange(begin, begin + len(rows[-1]), dtype=np.int32).reshape(eqn.invars[i].aval.shape))
    params = eqn.params | ({"fill_value": 0} if "fill_value" in eqn.params else {})
    with jax.ensure_compile_time_eval():
        places = np.asarray(eqn.primitive.bind(*map(jnp.asarray, numbered), **params))
    return np.concatenate(rows)[places]
