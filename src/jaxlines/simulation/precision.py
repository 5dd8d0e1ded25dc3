"""Precision without a global switch: public calls run in float64 (or float32) whatever JAX's own setting is."""

import contextlib

import jax
import numpy as np
from jax.core import Tracer

PRECISIONS = ("float64", "float32")


def is_traced(*trees) -> bool:
    """Whether any leaf is being traced by JAX (inside the user's jit, grad or vmap)."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(trees))


def computing_in(precision: str, *trees):
    """A context in which JAX computes in a precision.

    Raises: ValueError for an unknown precision; RuntimeError when called inside the user's traced code while
    JAX is set to float32, since a trace cannot change precision half-way.
    """
    if precision not in PRECISIONS:
        raise ValueError(f'precision must be "float64" or "float32", got {precision!r}')
    if not is_traced(*trees):
        return jax.enable_x64(precision == "float64")
    if precision == "float64" and not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "this call is inside traced code (jit, grad or vmap) while JAX is set to float32; wrap the outer call "
            'in `with jax.enable_x64(True):`, or pass precision="float32" if that is what you want'
        )
    return contextlib.nullcontext()


def cast(tree, precision: str):
    """The concrete leaves of a tree in a precision; traced ones as they are."""
    return jax.tree.map(lambda x: np.asarray(x, dtype=precision) if isinstance(x, np.ndarray) else x, tree)
