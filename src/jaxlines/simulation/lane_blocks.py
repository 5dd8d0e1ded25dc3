"""Lanes a few at a time, so that all their numbers stay in the nearest cache, as one compiled function.

XLA's CPU runtime hands out every small loop of a program one by one, which costs some 0.1 us each: as much as the loop
itself where few lanes take part, so that lanes must be many and their numbers leave the cache. A computation that is
marked as a small call is compiled into one function instead, without any such cost. Then a block of few lanes can go
through a whole simulation before the next begins.
"""

from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun

BLOCK_BYTES = 512
"""Bytes of one number of a block of lanes: 8 of the widest vectors, so that loops over them are unrolled fourfold, and
100 numbers fit into a cache of 48 KiB. The lanes of a chunk are a multiple (see `ensemble.FEWEST`)."""

ONE_FUNCTION = {"xla_cpu_small_call": "true", "inlineable": "false"}
"""What tells XLA to compile a call into one function. Where it knows no such thing, it is a call like any other."""

_SIMPLE = (
    "abs acos acosh add add_any and argmax argmin asin asinh atan atan2 atanh bitcast_convert_type broadcast_in_dim "
    "cbrt ceil clamp closed_call concatenate cond convert_element_type copy cos cosh custom_jvp_call "
    "custom_vjp_call div dynamic_slice dynamic_update_slice eq erf exp exp2 expm1 floor gather ge gt integer_pow "
    "iota is_finite jit le log log1p logistic lt max min mul ne neg not or pad pow reduce_and reduce_max reduce_min "
    "reduce_or reduce_prod reduce_sum rem reshape rev round rsqrt scan select_n shift_left shift_right_arithmetic "
    "shift_right_logical sign sin sinh slice split sqrt square squeeze stack stop_gradient sub tan tanh tile "
    "transpose while xor"
)
SIMPLE = frozenset(_SIMPLE.split())
"""Operations that XLA can compile into one function: no sorting, scattering, linear algebra, calls of libraries."""


def in_blocks(function: Callable, *lanes: Any) -> Any:
    """function(*lanes) for blocks of lanes, one after the other.

    On other devices than CPUs, where the lanes do not make whole blocks, and for operations that need a library, it
    is called with all of them at once.

    Args: function: of trees of arrays with lanes last, to such a tree, lane by lane; lanes: the trees.
    """
    leaves, structure = jax.tree.flatten(lanes)
    count = leaves[0].shape[-1]
    block = min(count, BLOCK_BYTES // leaves[0].dtype.itemsize)
    if jax.default_backend() != "cpu" or count % block:
        return function(*lanes)

    def every(*parts):
        return jax.lax.map(lambda part: function(*jax.tree.unflatten(structure, part)), parts)

    split = [jnp.moveaxis(x.reshape(*x.shape[:-1], count // block, block), -2, 0) for x in leaves]
    program, shape = jax.make_jaxpr(every, return_shape=True)(*split)
    if not _is_simple(program.jaxpr):
        return function(*lanes)
    found: Any = set_xla_metadata(jax.jit(jaxpr_as_fun(program))(*split), **ONE_FUNCTION)  # of the call itself
    joined = [jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], count) for x in found]
    return jax.tree.unflatten(jax.tree.structure(shape), joined)


def _is_simple(jaxpr: Jaxpr) -> bool:
    """Whether a program holds nothing but simple operations."""
    return all(eqn.primitive.name in SIMPLE and all(map(_is_simple, _inner(eqn))) for eqn in jaxpr.eqns)


def _inner(eqn) -> Iterable[Jaxpr]:
    """The programs within an operation."""
    for value in eqn.params.values():
        for item in value if isinstance(value, tuple | list) else (value,):
            if isinstance(item, ClosedJaxpr | Jaxpr):
                yield item.jaxpr if isinstance(item, ClosedJaxpr) else item
