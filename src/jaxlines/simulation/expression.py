"""A function of a few small arrays as a graph of operations on single numbers.

XLA's CPU compiler turns the small gathers, stacks and sums of a vector field into loops that it cannot vectorise
over lanes. Here the jaxpr of a function is taken apart, so that every number becomes one array of lanes and only
element-wise operations are left. On the way, what does not change in time is told from what does, equal terms are
shared, and zeros and ones are followed: the derivative in a direction keeps only the terms that depend on it.
"""

import functools

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from jaxlines.simulation.node import Node
from jaxlines.simulation.rearrangement import PARTS, added_at, objects, rearranged
from jaxlines.simulation.simplification import simplified

_NAMES = (
    "abs add and atan2 ceil clamp cos cosh div eq erf erf_inv erfc exp exp2 expm1 floor ge gt integer_pow is_finite le "
    "log log1p logistic lt max min mul ne neg nextafter not or pow rem round rsqrt cbrt select_n sign sin sinh sqrt "
    "square sub tan tanh acos asin atan acosh asinh atanh xor convert_element_type stop_gradient add_any"
)
ELEMENTWISE = frozenset(_NAMES.split())
CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr"}
CALLS |= {"custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "remat": "jaxpr", "checkpoint": "jaxpr"}
SUMS = {"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and", "reduce_or": "or"}


class Graph:
    """The operations of one or several functions, with equal ones shared."""

    def __init__(self):
        self._known: dict = {}

    def constant(self, value, dtype) -> Node:
        """The node of a constant."""
        value = np.asarray(value, dtype=dtype)[()]
        return self._shared(("constant", value.tobytes(), np.dtype(dtype).name), lambda: Node(dtype, False, value))

    def input(self, name, dtype, moving: bool) -> Node:
        """The node of an input, known by a hashable name."""
        return self._shared(("input", name), lambda: Node(np.dtype(dtype), moving, name=name))

    def _shared(self, key, make) -> Node:
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def constants(self, array) -> np.ndarray:
        """An array of constants as nodes."""
        array = np.asarray(array)
        return objects([self.constant(x, array.dtype) for x in array.ravel()], array.shape)

    def operation(self, primitive, params: dict, dtype, args: tuple) -> Node:
        """The node of an element-wise operation, simplified."""
        simple = simplified(self, primitive.name, args, dtype, params)
        if simple is not None:
            return simple
        key = _key(primitive, params, dtype, args)
        moving = any(a.moving for a in args)
        return self._shared(
            key, lambda: Node(np.dtype(dtype), moving, primitive=primitive, params=params, args=tuple(args))
        )

    def known(self, primitive, params: dict, dtype, args: tuple) -> Node | None:
        """The node of an operation, if there is one already."""
        return self._known.get(_key(primitive, params, dtype, args))

    def lax(self, function, *args: Node) -> Node:
        """An operation of `jax.lax` whose result has the type of its first argument."""
        return self.operation(_primitive(function), {}, args[0].dtype, args)

    def outputs(self, closed: ClosedJaxpr, *arguments: np.ndarray) -> list[np.ndarray]:
        """The outputs of a jaxpr for arguments that are arrays of nodes."""
        jaxpr = closed.jaxpr
        known: dict = dict(zip(jaxpr.constvars, map(self.constants, closed.consts), strict=True))
        known |= dict(zip(jaxpr.invars, arguments, strict=True))

        def read(atom):
            if isinstance(atom, Literal):
                return self.constants(np.asarray(atom.val, getattr(atom.aval, "dtype", None)))
            return known[atom]

        for eqn in jaxpr.eqns:
            results = self._equation(eqn, [read(atom) for atom in eqn.invars])
            for variable, result in zip(eqn.outvars, results, strict=True):
                known[variable] = result
        return [read(atom) for atom in jaxpr.outvars]

    def _equation(self, eqn, args: list[np.ndarray]) -> list[np.ndarray]:
        name, params = eqn.primitive.name, eqn.params
        shape, dtype = eqn.outvars[0].aval.shape, eqn.outvars[0].aval.dtype
        if name in CALLS and CALLS[name] in params:
            inner = params[CALLS[name]]
            inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
            return self.outputs(inner, *args)
        if name in ELEMENTWISE:
            spread = np.broadcast_arrays(*args, subok=True) if len({a.shape for a in args}) > 1 else args
            flat = [
                self.operation(eqn.primitive, params, dtype, tuple(row))
                for row in zip(*(a.ravel() for a in spread), strict=True)
            ]
            return [objects(flat, shape)]
        if name in SUMS and "axes" in params:
            return [self._reduced(SUMS[name], args[0], params["axes"], dtype)]
        if name in PARTS:
            parts = PARTS[name](params, args[0])
            return [part.reshape(v.aval.shape) for part, v in zip(parts, eqn.outvars, strict=True)]
        moved = self._added(eqn, args) if eqn.primitive is jax.lax.scatter_add_p else rearranged(name, params, args)
        return self._whole(eqn, args) if moved is None else [moved.reshape(shape)]

    def _reduced(self, operation: str, array: np.ndarray, axes, dtype) -> np.ndarray:
        primitive = _primitive({"add": jax.lax.add, "max": jax.lax.max, "min": jax.lax.min}.get(operation))
        if operation in ("and", "or"):
            primitive = _primitive(jax.lax.bitwise_and if operation == "and" else jax.lax.bitwise_or)
        rest = [i for i in range(array.ndim) if i not in axes]
        rows = np.transpose(array, [*rest, *axes]).reshape(*(array.shape[i] for i in rest), -1)
        result = objects([None] * int(np.prod(rows.shape[:-1])), rows.shape[:-1])
        for index in np.ndindex(rows.shape[:-1]):
            result[index] = functools.reduce(lambda a, b: self.operation(primitive, {}, dtype, (a, b)), rows[index])
        return result

    def _added(self, eqn, args: list[np.ndarray]) -> np.ndarray | None:
        """Numbers added to others at constant places, which is what a gather is backwards; None for other places."""
        targets = added_at(eqn.params, args)
        if targets is None:
            return None
        flat = list(args[0].ravel())
        for number, target in zip(args[2].ravel(), targets, strict=True):
            if target is not None:
                flat[target] = self.lax(jax.lax.add, flat[target], number)
        return objects(flat, args[0].shape)

    def _whole(self, eqn, args: list[np.ndarray]) -> list[np.ndarray]:
        """An operation that is left as it is, on arrays put together for it."""
        flat = tuple(node for a in args for node in a.ravel())
        moving = any(node.moving for node in flat)
        kinds = tuple((a.shape, atom.aval.dtype) for a, atom in zip(args, eqn.invars, strict=True))
        whole = Node(None, moving, primitive=eqn.primitive, params=eqn.params, args=flat, whole=kinds)
        results = []
        for k, variable in enumerate(eqn.outvars):
            shape, size = variable.aval.shape, int(np.prod(variable.aval.shape))
            picks = [Node(np.dtype(variable.aval.dtype), moving, args=(whole,), pick=(k, i)) for i in range(size)]
            results.append(objects(picks, shape))
        return results


def _key(primitive, params: dict, dtype, args: tuple) -> tuple:
    return (primitive.name, str(sorted(params.items(), key=str)), str(dtype), tuple(map(id, args)))


@functools.cache
def _primitive(function):
    """The primitive behind a function of `jax.lax`."""
    count = 1 if function in (jax.lax.sqrt, jax.lax.exp, jax.lax.log) else 2
    kind = np.dtype(bool) if function in (jax.lax.bitwise_and, jax.lax.bitwise_or) else np.float32
    return jax.make_jaxpr(function)(*[np.zeros((), kind)] * count).jaxpr.eqns[0].primitive
