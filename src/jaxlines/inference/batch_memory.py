"""What batches were prepared from and what came of it, so that fits of the same kind prepare it once."""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import jax
import numpy as np

MOST_KEPT = 16
"""Prepared things that are kept; those not used for longest are forgotten."""

_kept: OrderedDict[Hashable, Any] = OrderedDict()


def content(*parts) -> Hashable:
    """A key that is equal for equal contents: structures, numbers of arrays by a hash of 256 bits, other leaves."""
    leaves, structure = jax.tree.flatten(parts)
    return structure, tuple(_leaf(leaf) for leaf in leaves)


def _leaf(leaf) -> Hashable:
    if not isinstance(leaf, np.ndarray | jax.Array):
        return type(leaf), leaf
    array = np.ascontiguousarray(leaf)
    return array.shape, array.dtype.str, hashlib.blake2b(array.tobytes(), digest_size=32).digest()


def remembered(parts, make: Callable[[], Any]) -> Any:
    """What `make` gives, or what it gave the last time that the parts had the same content.

    Parts that cannot be told apart (not hashable) are made anew each time. What is returned must not be changed, nor
    hold arrays of the caller, who may change them.
    """
    try:
        key = content(parts)
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key]
    except (TypeError, KeyError):  # not hashable, or forgotten by another thread just now
        return make()
    made = _kept[key] = make()
    while len(_kept) > MOST_KEPT:
        _kept.popitem(last=False)
    return made
