"""Operations that only move numbers, done on the names of the numbers instead."""

import jax
import jax.numpy as jnp
import numpy as np


def objects(items: list, shape) -> np.ndarray:
    """Objects in an array of a shape."""
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array.reshape(shape)


def _spread(params: dict, args: list[np.ndarray]) -> np.ndarray:
    """Broadcast along new and single axes."""
    inner = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], args[0].shape, strict=True):
        inner[axis] = size
    return np.broadcast_to(args[0].reshape(inner), params["shape"])


def _sliced(params: dict, args: list[np.ndarray]) -> np.ndarray:
    """A slice at fixed places."""
    strides = params["strides"] or [1] * args[0].ndim
    ends = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return args[0][tuple(slice(*end) for end in ends)]


MOVES = {
    "reshape": lambda params, args: args[0],
    "squeeze": lambda params, args: args[0],
    "expand_dims": lambda params, args: args[0],
    "broadcast_in_dim": _spread,
    "slice": _sliced,
    "concatenate": lambda params, args: np.concatenate(args, axis=params["dimension"]),
    "stack": lambda params, args: np.stack(args, axis=params["axis"]),
    "transpose": lambda params, args: np.transpose(args[0], params["permutation"]),
    "rev": lambda params, args: np.flip(args[0], params["dimensions"]),
}
"""Operations on arrays of objects. The caller gives their results the shape they must have."""


PARTS = {
    "split": lambda params, array: np.split(array, np.cumsum(params["sizes"])[:-1], axis=params["axis"]),
    "unstack": lambda params, array: np.split(array, array.shape[params["axis"]], axis=params["axis"]),
}
"""Operations that take an array apart."""


def rearranged(name: str, params: dict, args: list[np.ndarray]) -> np.ndarray | None:
    """The result of an operation that only moves numbers, but for its shape; None for any other operation."""
    if name in MOVES:
        return MOVES[name](params, args)
    return _indexed(name, params, args) if name in PRIMITIVES else None


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
    return objects([every[i - 1] for i in found.ravel()], found.shape)


PRIMITIVES = {
    "gather": jax.lax.gather_p,
    "scatter": jax.lax.scatter_p,
    "dynamic_slice": jax.lax.dynamic_slice_p,
    "dynamic_update_slice": jax.lax.dynamic_update_slice_p,
    "pad": jax.lax.pad_p,
}


def added_at(params: dict, args: list[np.ndarray]) -> list[int | None] | None:
    """Where a scatter-add adds each of its numbers: flat positions, None for outside; None unless they are constant."""
    into, places, added = args
    if any(not node.is_constant() for node in places.ravel()):
        return None
    where = np.asarray([n.value for n in places.ravel()], dtype=np.int32).reshape(places.shape)
    kept = ("dimension_numbers", "indices_are_sorted", "unique_indices", "mode")
    options = {key: params[key] for key in kept}
    numbers = np.arange(1.0, 1.0 + into.size, dtype=np.float32).reshape(into.shape)
    with jax.ensure_compile_time_eval():
        nothing = jnp.zeros(into.shape, jnp.float32), jnp.zeros(added.shape, jnp.float32)
        pull = jax.vjp(lambda x: jax.lax.scatter_add(nothing[0], where, x, **options), nothing[1])[1]
        found = np.asarray(pull(jnp.asarray(numbers))[0]).ravel()
    return [int(x) - 1 if x else None for x in found]
