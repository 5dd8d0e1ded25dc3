"""Which sensors to read and when, for an excitation that is known."""

import numpy as np

from jaxlines.inference.design_search import Search, Trial
from jaxlines.inference.design_selection import Selection, evenly as choose_evenly, select

Counts = np.ndarray
"""Number of measurements at each time of each sensor, shape (times, sensors)."""


def even_mask(everything: Counts, num_sensors: int | None, num_samples: int | None) -> Counts:
    """What is compared with: the first sensors, at evenly spread instants."""
    counts = np.zeros_like(everything)
    times, sensors = everything.shape
    at = np.arange(times) if num_samples is None else np.unique(np.linspace(0, times - 1, num_samples).round())
    counts[np.ix_(at.astype(int), np.arange(sensors if num_sensors is None else num_sensors))] = 1
    return counts


def _blocks(trial: Trial, counts: Counts, axis: int) -> np.ndarray:
    """Information of each time (axis 0) or sensor (axis 1) that is measured, shape (scenarios, candidates, n, n)."""
    rows = np.stack([outcome.rows * np.sqrt(counts)[..., None] for outcome in trial.outcomes])
    return np.einsum("stcp,stcq->stpq" if axis == 0 else "stcp,stcq->scpq", rows, rows)


def choose_measurements(
    search: Search,
    trial: Trial,
    everything: Counts,
    num_sensors: int | None,
    num_samples: int | None,
    evenly: bool,
) -> tuple[Counts, dict[str, Selection]]:
    """Choose sensors at all times, then the times of these sensors."""
    counts, found = everything.copy(), {}
    convex = not search.model.known and not any(criterion.holds for criterion in search.goal.criteria)
    if num_sensors is not None:
        found["sensors"] = select(_blocks(trial, counts, 1), search.goal, num_sensors, convex=convex)
        counts = counts * found["sensors"].counts
    if num_samples is None:
        return counts, found
    blocks = _blocks(trial, counts, 0)
    if evenly:
        return counts * choose_evenly(blocks, search.goal, num_samples)[0][:, None], found
    found["samples"] = select(blocks, search.goal, num_samples, convex=convex)
    return counts * found["samples"].counts[:, None], found
