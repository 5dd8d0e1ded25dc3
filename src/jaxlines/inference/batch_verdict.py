"""How batched searches ended: a status of every lane, and its standard deviations."""

from typing import NamedTuple

import numpy as np

from jaxlines.inference.batch_lanes import Batch
from jaxlines.inference.batch_search import Searches
from jaxlines.inference.batch_steps import on_bound
from jaxlines.inference.search import NEAR_FAILURE, OFFSET_LIMIT
from jaxlines.inference.uncertainty import UNINFORMED


class Verdict(NamedTuple):
    """How a search ended: its status and why."""

    status: str
    message: str


def judge(batch: Batch, state: Searches, lane: int, bounds: np.ndarray) -> Verdict:
    """Status of an end point from its own gradient, bounds and a second look, not from the optimiser's word."""
    if not state.alive[lane]:
        return Verdict(
            "failed", "the simulation fails at the start of the search, or a number of its own is not finite"
        )
    if not state.checked[lane]:
        return Verdict("stalled", "the end point could not be simulated with finer steps")
    offset = float(state.offset[lane])
    if offset > OFFSET_LIMIT and not _is_exact(state, lane, bounds):
        return Verdict("stalled", f"the search stopped before the optimum (relative offset {offset:.2g})")
    distance = _nearest_failure(state, lane)
    if distance < NEAR_FAILURE:
        return Verdict("near_failure", f"simulations fail {distance:.2g} standard errors away")
    x, factor = state.coordinates[[lane]], state.factor[[lane]]
    stuck = on_bound(factor, x, bounds, 1e-6)[0]
    if stuck.any():
        names = ", ".join(f.label for f, at in zip(batch.free, stuck, strict=True) if at)
        return Verdict("at_bound", f"the optimum lies on a bound: {names}")
    return Verdict("converged", f"the remaining step is {offset:.1e} of a standard error")


def _is_exact(state: Searches, lane: int, bounds: np.ndarray) -> bool:
    """Whether the remaining step is nothing, as for data without noise, whose standard errors are nothing too."""
    factor, widths = state.factor[lane], bounds[:, 1] - bounds[:, 0]
    stuck = on_bound(state.factor[[lane]], state.coordinates[[lane]], bounds, 1e-6)[0]
    step = np.linalg.lstsq(np.where(stuck, 0.0, factor[:, :-1] * widths), -factor[:, -1], rcond=1e-8)[0]
    return bool(np.all(np.abs(step) < 1e-7))


def _nearest_failure(state: Searches, lane: int) -> float:
    """Distance to the nearest simulation that failed, in standard errors; infinite without any."""
    if not state.failed[lane]:
        return np.inf
    away = np.array(state.failed[lane]) - state.coordinates[lane]
    return float(np.linalg.norm(state.factor[lane][:, :-1] @ away.T, axis=0).min())


def standard_deviations(batch: Batch, state: Searches, bounds: np.ndarray) -> np.ndarray:
    """Standard deviations of the values in SI, shape (lanes, free); see `uncertainty.covariance`, here of all lanes."""
    sd = np.full(state.coordinates.shape, np.nan)
    lanes, widths = np.flatnonzero(state.alive), bounds[:, 1] - bounds[:, 0]
    singular, right = np.linalg.svd(state.factor[lanes, :, :-1] * widths, full_matrices=False)[1:]
    known = singular > 1.0 / UNINFORMED
    variances = np.where(known, 1.0 / np.where(known, singular, 1.0) ** 2, UNINFORMED**2)
    spread = np.sqrt(((right * widths) ** 2 * variances[..., None]).sum(axis=1))
    values = batch.to_values(state.coordinates[lanes])
    sd[lanes] = spread * np.stack([f.slope(values[:, i]) for i, f in enumerate(batch.free)], axis=1)
    return sd
