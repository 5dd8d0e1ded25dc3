"""Rows of many least-squares problems side by side: simulated channels, their slopes, and what a search needs of both.

A search works with the triangular factor of the weighted rows of a lane, [J r] = Q R, which holds J'J, J'r and r'r
without squaring anything. Slopes are kept, so that outputs by finer steps or at a point nearby need no new ones.
"""

from typing import NamedTuple

import numpy as np

from jaxlines.inference.batch_lanes import Batch
from jaxlines.inference.priors import Prior


class Seen(NamedTuple):
    """Of some lanes: simulated channels (m, times, channels), their slopes by the coordinates (last axis), factors
    (m, free + 1, free + 1) of the weighted rows, and costs, half the sum of squares, (m,); NaN for failed lanes."""

    simulated: np.ndarray
    slopes: np.ndarray
    factor: np.ndarray
    cost: np.ndarray


def evaluate(batch: Batch, coordinates, lanes, sigma, level: int, *, simulated=None, slopes=None) -> Seen:
    """Rows of lanes at coordinates (m, free), with weights sigma (m, times, channels), at a level of accuracy.

    simulated, slopes: what is known already and is not computed, as in `Seen`.
    """
    values, shape = batch.to_values(coordinates), (lanes.size, *batch.measured.shape[1:])
    steps = np.stack([f.slope(values[:, i]) for i, f in enumerate(batch.free)], axis=1)
    prior, prior_slopes = _prior_rows(batch, values)
    wanted = {"outputs": simulated is None, "slopes": slopes is None}
    seen = Seen(
        np.empty(shape) if simulated is None else simulated,
        np.empty((*shape, len(batch.free)), np.float32) if slopes is None else slopes,
        np.full((lanes.size, len(batch.free) + 1, len(batch.free) + 1), np.nan),
        np.full(lanes.size, np.nan),
    )

    def take(part, shown, partials) -> None:
        if shown is not None:
            seen.simulated[part] = shown
        if partials is not None:
            seen.slopes[part] = partials * steps[part][:, None, None, :]
        good = np.isfinite(seen.simulated[part]).all(axis=(1, 2)) & np.isfinite(seen.slopes[part]).all(axis=(1, 2, 3))
        part = part[good]
        weight, own = np.where(batch.used[lanes[part]], 1.0 / sigma[part], 0.0), lanes[part]
        misfit = np.where(batch.used[own], seen.simulated[part] - batch.measured[own], 0.0) * weight
        rows = _rows(misfit, seen.slopes[part] * weight[..., None], prior[part], prior_slopes[part] * steps[part, None])
        seen.factor[part] = _triangle(rows)
        seen.cost[part] = 0.5 * (rows[..., -1] ** 2).sum(axis=1)

    batch.engine.run(values, lanes, level, take, **wanted)
    return seen


def _rows(misfit, slopes, prior, prior_slopes) -> np.ndarray:
    """[J r] of lanes, shape (m, samples + priors, free + 1)."""
    count, size = slopes.shape[-1], misfit.shape[1] * misfit.shape[2]
    rows = np.empty((len(misfit), size + prior.shape[1], count + 1))
    rows[:, :size, count], rows[:, :size, :count] = misfit.reshape(-1, size), slopes.reshape(-1, size, count)
    rows[:, size:, count], rows[:, size:, :count] = prior, prior_slopes
    return rows


def _triangle(rows: np.ndarray) -> np.ndarray:
    """R of rows (lanes, samples, columns), shape (lanes, columns, columns)."""
    missing = rows.shape[2] - rows.shape[1]
    if missing > 0:
        rows = np.concatenate([rows, np.zeros((rows.shape[0], missing, rows.shape[2]))], axis=1)
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _prior_rows(batch: Batch, values) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the priors (lanes, priors) and their slopes in the values, (lanes, priors, free)."""
    priors = [(i, f.prior) for i, f in enumerate(batch.free)]
    held = [(i, prior) for i, prior in priors if isinstance(prior, Prior) and not prior.flat]
    rows, slopes = np.zeros((len(values), len(held))), np.zeros((len(values), len(held), len(batch.free)))
    for k, (i, prior) in enumerate(held):
        rows[:, k] = [prior.residual(value) for value in values[:, i]]
        slopes[:, k, i] = [prior.slope(value) for value in values[:, i]]
    return rows, slopes
