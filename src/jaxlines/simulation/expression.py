"""A function of a few small arrays as a graph of operations on single numbers.

XLA's CPU compiler turns the small gathers, stacks and sums of a vector field into loops that it cannot vectorise
over lanes. Here the jaxpr of a function is taken apart, so that every number becomes one array of lanes and only
element-wise operations are left. On the way, what does not change in time is told from what does, equal terms are
shared, and zeros and ones are followed: the derivative in a direction keeps only the terms that depend on it.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from jaxlines.simulation.fast_math import FAST

ELEMENTWISE = frozenset(
    "abs add and atan2 ceil clamp cos cosh div eq erf erf_inv erfc exp exp2 expm1 floor ge gt integer_pow is_finite le "
    "log log1p logistic lt max min mul ne neg nextafter not or pow rem round rsqrt cbrt select_n sign sin sinh sqrt "
    "square sub tan tanh acos asin atan acosh asinh atanh xor convert_element_type stop_gradient add_any".split()
)
CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr"}
CALLS |= {"custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr", "remat": "jaxpr", "checkpoint": "jaxpr"}
SUMS = {"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and", "reduce_or": "or"}


@dataclasses.dataclass(eq=False, slots=True)
class Node:
    """A number: a constant (`value`), an input (`name`), or what an operation makes of others (`args`).

    moving: whether it changes while time goes on; whole: for an operation on arrays, shapes of its arguments.
    """

    dtype: Any
    moving: bool
    value: Any = None
    name: Any = None
    primitive: Any = None
    params: dict = dataclasses.field(default_factory=dict)
    args: tuple = ()
    whole: tuple | None = None
    pick: tuple[int, int] | None = None

    def is_constant(self, number=None) -> bool:
        """Whether it is a constant, or this constant."""
        return self.value is not None and (number is None or bool(self.value == number))


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
        return _objects([self.constant(x, array.dtype) for x in array.ravel()], array.shape)

    def operation(self, primitive, params: dict, dtype, args: tuple) -> Node:
        """The node of an element-wise operation, simplified."""
        simple = _simplified(self, primitive.name, args, dtype)
        if simple is not None:
            return simple
        key = (primitive.name, str(sorted(params.items(), key=str)), str(dtype), tuple(map(id, args)))
        moving = any(a.moving for a in args)
        return self._shared(
            key, lambda: Node(np.dtype(dtype), moving, primitive=primitive, params=params, args=tuple(args))
        )

    def lax(self, function, *args: Node) -> Node:
        """An operation of `jax.lax` whose result has the type of its first argument."""
        return self.operation(_primitive(function), {}, args[0].dtype, args)

    def outputs(self, closed: ClosedJaxpr, *arguments: np.ndarray) -> list[np.ndarray]:
        """The outputs of a jaxpr for arguments that are arrays of nodes."""
        jaxpr = closed.jaxpr
        known: dict = dict(zip(jaxpr.constvars, map(self.constants, closed.consts), strict=True))
        known |= dict(zip(jaxpr.invars, arguments, strict=True))

        def read(atom):
            return self.constants(np.asarray(atom.val, atom.aval.dtype)) if isinstance(atom, Literal) else known[atom]

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
            return [_objects(flat, shape)]
        if name in SUMS and "axes" in params:
            return [self._reduced(SUMS[name], args[0], params["axes"], dtype)]
        moved = _rearranged(name, params, args)
        if moved is not None:
            return [moved.reshape(shape)]
        return self._whole(eqn, args)

    def _reduced(self, operation: str, array: np.ndarray, axes, dtype) -> np.ndarray:
        primitive = _primitive({"add": jax.lax.add, "max": jax.lax.max, "min": jax.lax.min}.get(operation))
        if operation in ("and", "or"):
            primitive = _primitive(jax.lax.bitwise_and if operation == "and" else jax.lax.bitwise_or)
        rest = [i for i in range(array.ndim) if i not in axes]
        rows = np.transpose(array, [*rest, *axes]).reshape(*(array.shape[i] for i in rest), -1)
        result = _objects([None] * int(np.prod(rows.shape[:-1])), rows.shape[:-1])
        for index in np.ndindex(rows.shape[:-1]):
            result[index] = functools.reduce(lambda a, b: self.operation(primitive, {}, dtype, (a, b)), rows[index])
        return result

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
            results.append(_objects(picks, shape))
        return results


@functools.cache
def _primitive(function):
    """The primitive behind a function of `jax.lax`."""
    count = 1 if function in (jax.lax.sqrt, jax.lax.exp, jax.lax.log) else 2
    kind = np.dtype(bool) if function in (jax.lax.bitwise_and, jax.lax.bitwise_or) else np.float32
    return jax.make_jaxpr(function)(*[np.zeros((), kind)] * count).jaxpr.eqns[0].primitive


def _objects(items: list, shape) -> np.ndarray:
    """Objects in an array of a shape."""
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array.reshape(shape)


def _simplified(graph: Graph, name: str, args: tuple, dtype) -> Node | None:
    """A simpler node for an operation, where there is one.

    0 x = 0 also where x is not finite: whatever is not finite shows in the rate of its own state. A division by
    what stays the same becomes a multiplication, and one by a square root avoids the slow reciprocal square root
    of float64 on CPUs, which XLA would use: a/sqrt(b) = a sqrt(b)/b.
    """
    first = args[0]
    if name in ("mul", "div") and first.is_constant(0):
        return first
    if name == "mul":
        other = args[1]
        if other.is_constant(0):
            return other
        if first.is_constant(1):
            return other
        if other.is_constant(1):
            return first
    if name in ("add", "add_any", "sub"):
        if args[1].is_constant(0):
            return first
        if first.is_constant(0):
            return args[1] if name != "sub" else graph.lax(jax.lax.mul, graph.constant(-1.0, dtype), args[1])
    if name in ("neg", "stop_gradient", "convert_element_type", "sqrt") and first.is_constant(0):
        return graph.constant(0, dtype)
    if name == "stop_gradient" or (name == "convert_element_type" and first.dtype == dtype):
        return first
    if name == "select_n":
        if all(case is args[1] for case in args[2:]):
            return args[1]
        if first.is_constant():
            return args[1 + int(first.value)]
    if name == "div":
        return _divided(graph, first, args[1], dtype)
    if name == "rsqrt" and np.dtype(dtype) == np.float64:
        return _divided(graph, graph.constant(1.0, dtype), graph.lax(jax.lax.sqrt, first), dtype)
    if name in CONSTANT_FOLDS and all(a.is_constant() for a in args):
        with np.errstate(all="ignore"):
            return graph.constant(CONSTANT_FOLDS[name](*(a.value for a in args)), dtype)
    return None


CONSTANT_FOLDS = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
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
    "select_n": lambda which, *cases: cases[int(which)],
}
"""Operations that are done at once where all their arguments are constants."""


def _divided(graph: Graph, above: Node, below: Node, dtype) -> Node | None:
    """The node of a quotient, simplified where that is faster."""
    if not np.issubdtype(dtype, np.floating):
        return None
    if below.is_constant(1):
        return above
    if above.is_constant() and below.is_constant():
        with np.errstate(all="ignore"):
            return graph.constant(above.value / below.value, dtype)
    if below.is_constant() and np.isinf(below.value):
        return graph.constant(0.0, dtype)
    if above.moving and not below.moving:
        return graph.lax(
            jax.lax.mul, above, graph.operation(_primitive(jax.lax.div), {}, dtype, (_one(graph, dtype), below))
        )
    if (
        below.moving
        and below.primitive is not None
        and below.primitive.name == "sqrt"
        and np.dtype(dtype) == np.float64
    ):
        return _divided_by_root(graph, above, below, dtype)
    return None


def _one(graph: Graph, dtype) -> Node:
    return graph.constant(1.0, dtype)


def _divided_by_root(graph: Graph, above: Node, root: Node, dtype) -> Node:
    """a/sqrt(b) as a sqrt(b)/b; b may be a root itself."""
    inside = root.args[0]
    product = graph.lax(jax.lax.mul, above, root)
    return graph.operation(_primitive(jax.lax.div), {}, dtype, (product, inside))


def _rearranged(name: str, params: dict, args: list[np.ndarray]) -> np.ndarray | None:
    """The result of an operation that only moves numbers, else None."""
    first = args[0]
    if name in ("reshape", "squeeze", "expand_dims"):
        return first
    if name == "broadcast_in_dim":
        inner = [1] * len(params["shape"])
        for axis, size in zip(params["broadcast_dimensions"], first.shape, strict=True):
            inner[axis] = size
        return np.broadcast_to(first.reshape(inner), params["shape"])
    if name == "slice":
        strides = params["strides"] or [1] * first.ndim
        return first[
            tuple(slice(*s) for s in zip(params["start_indices"], params["limit_indices"], strides, strict=True))
        ]
    if name == "concatenate":
        return np.concatenate(args, axis=params["dimension"])
    if name == "stack":
        return np.stack(args, axis=params["axis"])
    if name == "transpose":
        return np.transpose(first, params["permutation"])
    if name == "rev":
        return np.flip(first, params["dimensions"])
    if name == "iota":
        return None
    if name in ("gather", "scatter", "dynamic_slice", "pad", "dynamic_update_slice"):
        return _indexed(name, params, args)
    return None


def _indexed(name: str, params: dict, args: list[np.ndarray]) -> np.ndarray | None:
    """A gather, scatter or slice at constant places, done on the positions of the numbers instead of on them."""
    positions = {"gather": (1,), "dynamic_slice": range(1, len(args)), "scatter": (1,), "pad": ()}
    places = positions.get(name, range(2, len(args)))
    if any(not node.is_constant() for k in places for node in args[k].ravel()):
        return None
    offset, numbered, every = 1, [], []
    for k, array in enumerate(args):
        if k in places:
            numbered.append(np.asarray([n.value for n in array.ravel()], dtype=np.int32).reshape(array.shape))
        else:
            numbered.append(np.arange(offset, offset + array.size, dtype=np.int32).reshape(array.shape))
            every += list(array.ravel())
            offset += array.size
    function = PRIMITIVES[name]
    params = {k: v for k, v in params.items() if k != "fill_value"} | ({"fill_value": 0} if name == "gather" else {})
    with jax.ensure_compile_time_eval():
        found = np.asarray(function.bind(*map(jnp.asarray, numbered), **params))
    if found.size and (found.min() < 1 or found.max() >= offset):
        return None
    return _objects([every[i - 1] for i in found.ravel()], found.shape)


PRIMITIVES = {
    "gather": jax.lax.gather_p,
    "scatter": jax.lax.scatter_p,
    "dynamic_slice": jax.lax.dynamic_slice_p,
    "dynamic_update_slice": jax.lax.dynamic_update_slice_p,
    "pad": jax.lax.pad_p,
}


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


COSTLY = frozenset("div exp log log1p expm1 pow sqrt rsqrt cbrt sin cos tan tanh asin acos atan atan2 exp2".split())
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
