"""The times at which lanes in step stop: where they are saved, and where inputs jump or bend."""

import itertools

import numpy as np

from jaxlines.simulation.plan import Values


def input_times(values: Values) -> np.ndarray:
    """Times at which an input jumps or bends [s], sorted."""
    found = [np.ravel(np.asarray(t)) for s in values.every_signal() for t in (s.jump_times(), s.knot_times())]
    return np.unique(np.concatenate([np.zeros(0), *found]))


def step_grid(times, stops) -> np.ndarray:
    """Ends of the pieces of every interval between saved times, shape (samples, pieces + 1).

    Row 0 is the start. Every stop within an interval ends a piece; intervals with fewer stops are cut where they
    are widest, so that all have as many pieces.

    Args: times [s] to save at, increasing; stops [s]: where the field is not smooth.
    """
    times = np.asarray(times, dtype=float)
    least = 1e-9 * np.diff(times).min()
    inner = [stops[(stops > a + least) & (stops < b - least)] for a, b in itertools.pairwise(times)]
    pieces = 1 + max(len(x) for x in inner)
    rows = [np.full(pieces + 1, times[0])]
    for a, b, x in zip(times[:-1], times[1:], inner, strict=True):
        ends = np.concatenate([[a], x, [b]])
        while len(ends) <= pieces:
            widest = int(np.argmax(np.diff(ends)))
            ends = np.insert(ends, widest + 1, 0.5 * (ends[widest] + ends[widest + 1]))
        rows.append(ends)
    return np.stack(rows)
