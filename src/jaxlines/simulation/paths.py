"""Names of numbers in a circuit: "line.parts.0.volume", or shorter where that is clear ("line.volume")."""

import difflib
from collections.abc import Iterable

import jax


def leaf_paths(tree) -> list[str]:
    """The dotted path of every leaf of a tree, in the order of `jax.tree.leaves`."""
    keyed, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in keyed]


def replace_leaves(tree, changes: dict):
    """A copy of a tree with other leaves at some full paths."""
    positions = {path: position for position, path in enumerate(leaf_paths(tree))}
    leaves, structure = jax.tree.flatten(tree)
    for path, value in changes.items():
        leaves[positions[path]] = value
    return jax.tree.unflatten(structure, leaves)


def resolve(name: str, known: Iterable[str], what: str = "number") -> str:
    """The one known path that a name means.

    A name means a path when it is equal to it, or when it has the same first word and the same last word
    and no other path has. Raises: KeyError that lists what was probably meant.
    """
    known = list(known)
    if name in known:
        return name
    first, _, last = name.partition(".")
    matches = [path for path in known if path.startswith(f"{first}.") and path.endswith(f".{last}")]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise KeyError(f"{name!r} could mean several: {', '.join(matches)}")
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5) or sorted(p for p in known if p.startswith(first))
    hint = f"did you mean {', '.join(close[:6])}?" if close else f"known: {', '.join(sorted(known)[:12])}"
    raise KeyError(f"no {what} is called {name!r}; {hint}")
