"""The varied numbers of an ensemble: where they go, and which lanes have numbers that are out of range."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from jaxlines.simulation.assembly import Location
from jaxlines.simulation.circuit import Circuit, field_metadata
from jaxlines.simulation.paths import resolve

Varied = Mapping[Any, Any]
"""Path of a number, or a tuple of paths that take the same -> its values, (lanes,)."""


def places_of(varied: Varied, known: dict[str, Location]) -> dict[tuple[str, ...], tuple[Location, ...]]:
    """Full paths of each varied number, and where they are. Raises: KeyError for an unknown, ValueError for a
    repeated path."""
    found, seen = {}, set()
    for key in varied:
        paths = tuple(resolve(path, known) for path in ((key,) if isinstance(key, str) else key))
        for path in paths:
            if path in seen:
                raise ValueError(f"{path} is varied twice")
            seen.add(path)
        found[paths] = tuple(known[path] for path in paths)
    if not found:
        raise ValueError('an ensemble varies at least one number, such as {"fluid.air_fraction": numbers}')
    return found


def columns_of(varied: Varied) -> list[np.ndarray]:
    """The varied numbers, lanes last. Raises: ValueError unless all have the same number of lanes."""
    columns = []
    for key, values in varied.items():
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"{key} must be numbers in SI, one for each lane, got {values!r}") from None
        if array.ndim == 0 or array.shape[0] == 0:
            raise ValueError(f"{key} must have one number for each lane, got {values!r}: set it in the circuit instead")
        columns.append(np.ascontiguousarray(np.moveaxis(array, 0, -1)))
    lanes = {str(key): column.shape[-1] for key, column in zip(varied, columns, strict=True)}
    if len(set(lanes.values())) > 1:
        raise ValueError(f"all varied numbers need the same number of lanes, got {lanes}")
    return columns


def out_of_range(circuit: Circuit, paths: list[tuple[str, ...]], columns: list[np.ndarray]) -> np.ndarray:
    """Which lanes have a number that is not finite or outside the range declared for it, shape (lanes,)."""
    bad = np.zeros(columns[0].shape[-1], dtype=bool)
    for names, column in zip(paths, columns, strict=True):
        rows = column.reshape(-1, column.shape[-1])
        bad |= ~np.isfinite(rows).all(axis=0)
        for name in names:
            owner = name.partition(".")[0]
            if owner == "fluid" or owner in circuit.components:
                metadata = field_metadata(circuit, name)
                bad |= ~((rows >= metadata.get("low", -np.inf)) & (rows <= metadata.get("high", np.inf))).all(axis=0)
            elif owner == "initial" and name.endswith(".pressure"):
                bad |= ~(rows > 0.0).all(axis=0)
    return bad


def check_shapes(values, places: dict[tuple[str, ...], tuple[Location, ...]], columns: list[np.ndarray]) -> None:
    """Raise ValueError unless each varied number is one number a lane, or a record as long as that of the circuit."""
    leaves = jax.tree.leaves(values)
    for (paths, found), column in zip(places.items(), columns, strict=True):
        for path, (position, index) in zip(paths, found, strict=True):
            wanted = np.shape(leaves[position] if index is None else np.asarray(leaves[position])[index])
            if column.shape[:-1] != wanted:
                shown = ", ".join(map(str, ("lanes", *wanted)))
                raise ValueError(f"{path} must have the shape ({shown}), got {(column.shape[-1], *column.shape[:-1])}")


def why_out_of_range(circuit: Circuit, paths: list[tuple[str, ...]], columns: list[np.ndarray]) -> str:
    """The first varied number that is out of range in the first lane, in words."""
    for names, column in zip(paths, columns, strict=True):
        if out_of_range(circuit, [names], [column])[0]:
            owner = names[0].partition(".")[0]
            known = owner == "fluid" or owner in circuit.components
            about = field_metadata(circuit, names[0]) if known else {"low": 0.0, "high": np.inf, "unit": "Pa"}
            slip = f": {about['slip']}" if about.get("slip") else ""
            unit = "" if about.get("unit", "1") == "1" else f" {about['unit']}"
            ends = f"{about.get('low', -np.inf):g}..{about.get('high', np.inf):g}{unit}"
            return f"{names[0]} must be {ends}, got {column.ravel()[0]:g}{slip}"
    return "several"


def extreme_lanes(columns: list[np.ndarray], count: int, seed: int) -> np.ndarray:
    """Lanes with the smallest and largest value of each varied number, filled up with random ones."""
    lanes = columns[0].shape[-1]
    extremes = [pick(column.reshape(-1, lanes).mean(axis=0)) for column in columns for pick in (np.argmin, np.argmax)]
    chosen = list(dict.fromkeys(int(i) for i in extremes))[:count]
    for lane in np.random.default_rng(seed).permutation(lanes)[: count + len(chosen)]:
        if len(chosen) < min(count, lanes) and int(lane) not in chosen:
            chosen.append(int(lane))
    return np.asarray(chosen)


def as_slice(lanes: np.ndarray) -> slice | np.ndarray:
    """Lanes as a slice where they follow one another, which is much faster to read and write."""
    if lanes.size and lanes[-1] - lanes[0] == lanes.size - 1 and np.all(np.diff(lanes) == 1):
        return slice(int(lanes[0]), int(lanes[-1]) + 1)
    return lanes
