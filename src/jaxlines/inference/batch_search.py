"""Many least-squares searches side by side: one batched call of simulations an iteration, all else per lane.

A search begins with few steps between samples and ends with as many as leave the optimum where it is. Far from the
optimum every trial computes slopes; within a fraction of a standard error, where slopes hardly change, outputs alone
are computed, at a fraction of the cost, and the last slopes serve as long as they bring the optimum nearer.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxlines.inference.batch_lanes import Batch
from jaxlines.inference.batch_rows import evaluate
from jaxlines.inference.batch_steps import first_radius, next_radius, offsets, steps_of
from jaxlines.inference.search import OFFSET_GOAL, OFFSET_LIMIT

CHECK_GOAL = 0.5 * OFFSET_LIMIT
"""Relative offset that finer steps and the final weights may leave, in standard errors; else the search goes on."""

LEVELS_TO_START = 3
"""Levels of accuracy at which a start is tried."""

FIRST_GOAL = 0.3
"""Relative offset, in standard errors, at which a search with the first steps ends."""

INEXACT, LATER_GOAL = 0.1, 0.5 * CHECK_GOAL
"""Later ones end at this share of what finer steps last moved the optimum, and at most at this offset."""

CLOSE, USEFUL = 0.5, 0.3
"""Relative offset below which slopes are kept, and what a step with such may leave of it; else they are made anew."""

MOST_LEVELS = 7
"""Levels of accuracy at which searches run; one more is only looked at."""


@dataclasses.dataclass
class Searches:
    """The state of all searches.

    Where they are: coordinates (lanes, free); simulated (lanes, times, channels) there; sigma, same shape; slopes by
    the coordinates (last axis); factor: R of [J r], shape (lanes, free + 1, free + 1); cost (lanes,): half the sum of
    squares; moved: whether slopes are those of another point; slope_level (lanes,): of their accuracy.
    How they go on: size (lanes, free): longest each column of J has been; radius (lanes,): of the trust region, of
    steps times size; remaining (lanes,): relative offset; keep: whether the next trial does without new slopes; goal
    (lanes,): offset at which a search pauses; level (lanes,): of accuracy; iterations (lanes,).
    What came of them: alive: whether the start could be simulated; offset (lanes,): see `offsets`, at the last look
    with finer steps; checked: whether there was one; failed: for each lane the coordinates at which its simulation
    failed.
    """

    coordinates: np.ndarray
    simulated: np.ndarray
    sigma: np.ndarray
    slopes: np.ndarray
    factor: np.ndarray
    cost: np.ndarray
    moved: np.ndarray
    slope_level: np.ndarray
    size: np.ndarray
    radius: np.ndarray
    remaining: np.ndarray
    keep: np.ndarray
    goal: np.ndarray
    level: np.ndarray
    iterations: np.ndarray
    alive: np.ndarray
    offset: np.ndarray
    checked: np.ndarray
    failed: list[list[np.ndarray]]


def bounds_of(batch: Batch) -> np.ndarray:
    """Bounds of the coordinates, shape (free, 2)."""
    return np.array([f.coordinate_bounds() for f in batch.free])


def samples_of(batch: Batch, lanes) -> np.ndarray:
    """How many samples count in each lane."""
    return batch.used[lanes].sum(axis=(1, 2))


def begin(batch: Batch, coordinates: np.ndarray) -> Searches:
    """All searches at their starts."""
    lanes, level = np.arange(batch.lanes), np.zeros(batch.lanes, int)
    seen = evaluate(batch, coordinates, lanes, batch.sigma, 0)
    for finer in range(1, LEVELS_TO_START):  # a start that is stiffer than those of the pilot may need them
        left = np.flatnonzero(~np.isfinite(seen.cost))
        if left.size:
            again = evaluate(batch, coordinates[left], left, batch.sigma[left], finer)
            for all_lanes, some in zip(seen, again, strict=True):
                all_lanes[left] = some
            level[left] = finer
    return Searches(
        coordinates=coordinates.copy(),
        simulated=seen.simulated,
        sigma=batch.sigma.copy(),
        slopes=seen.slopes,
        factor=seen.factor,
        cost=seen.cost,
        moved=np.zeros(lanes.size, bool),
        slope_level=np.array([batch.engine.slope_level(own) for own in level]),
        size=np.zeros(coordinates.shape),
        radius=np.full(lanes.size, np.inf),
        remaining=np.full(lanes.size, np.inf),
        keep=np.zeros(lanes.size, bool),
        goal=np.full(lanes.size, FIRST_GOAL),
        level=level,
        iterations=np.zeros(lanes.size, int),
        alive=np.isfinite(seen.cost),
        offset=np.full(lanes.size, np.nan),
        checked=np.zeros(lanes.size, bool),
        failed=[[] for _ in lanes],
    )


def advance(batch: Batch, state: Searches, active: np.ndarray, level: int, bounds: np.ndarray) -> np.ndarray:
    """One trial step of the active lanes; returns which of them are finished."""
    done = np.zeros(active.size, bool)
    for keep in (False, True):
        these = np.flatnonzero(state.keep[active] == keep)
        if these.size:
            done[these] = _advance(batch, state, active[these], level, bounds, keep)
    return done


def _advance(batch: Batch, state: Searches, active, level: int, bounds, keep: bool) -> np.ndarray:
    """One trial step of lanes that keep their slopes, or of lanes that do not."""
    factor = state.factor[active]
    state.size[active] = size = np.maximum(state.size[active], np.sqrt((factor[:, :, :-1] ** 2).sum(axis=1)))
    first = state.iterations[active] == 0
    if first.any():
        state.radius[active[first]] = first_radius(factor[first], size[first], state.coordinates[active[first]], bounds)
    steps = steps_of(factor, size, state.radius[active], state.coordinates[active], bounds)
    trial = state.coordinates[active] + steps
    seen = evaluate(batch, trial, active, state.sigma[active], level, slopes=state.slopes[active] if keep else None)
    for i in np.flatnonzero(~np.isfinite(seen.cost)):
        state.failed[active[i]].append(trial[i])
    moved = np.einsum("lri,li->lr", factor[:, :, :-1], steps)
    predicted = -(factor[:, :, -1] * moved).sum(axis=1) - 0.5 * (moved**2).sum(axis=1)
    better = np.isfinite(seen.cost) & (seen.cost < state.cost[active])
    gained = np.where(better, state.cost[active] - np.where(better, seen.cost, 0.0), 0.0)
    state.radius[active] = next_radius(gained / np.maximum(predicted, 1e-300), steps * size, state.radius[active])
    state.iterations[active] += 1
    _accept(batch, state, active, trial, seen, better, level, bounds, keep)
    tiny = np.all(np.abs(steps) < 1e-9 * (bounds[:, 1] - bounds[:, 0]), axis=1)
    return tiny | (better & (state.remaining[active] < state.goal[active]))


def _accept(batch: Batch, state: Searches, active, trial, seen, better, level: int, bounds, keep: bool) -> None:
    """Move the lanes that are better, and decide whether their slopes still serve."""
    lanes = active[better]
    state.coordinates[lanes], state.cost[lanes] = trial[better], seen.cost[better]
    state.simulated[lanes], state.factor[lanes] = seen.simulated[better], seen.factor[better]
    state.moved[lanes] = keep
    before = state.remaining[lanes]
    state.remaining[lanes] = offsets(state.factor[lanes], trial[better], bounds, samples_of(batch, lanes))
    if not keep:
        state.slopes[lanes], state.slope_level[lanes] = seen.slopes[better], batch.engine.slope_level(level)
        state.keep[lanes] = (level > 0) & (state.remaining[lanes] < CLOSE)
        return
    useless = np.concatenate([active[~better], lanes[state.remaining[lanes] > USEFUL * before]])
    if useless.size:
        _renew(batch, state, useless, level, bounds)
        state.keep[useless] = False


def _renew(batch: Batch, state: Searches, lanes, level: int, bounds) -> None:
    """New slopes where lanes are; a lane whose slopes cannot be computed keeps the old ones."""
    known, sigma = state.simulated[lanes], state.sigma[lanes]
    seen = evaluate(batch, state.coordinates[lanes], lanes, sigma, level, simulated=known)
    good = np.isfinite(seen.cost)
    lanes = lanes[good]
    state.slopes[lanes], state.factor[lanes] = seen.slopes[good], seen.factor[good]
    state.moved[lanes], state.slope_level[lanes] = False, batch.engine.slope_level(level)
    state.remaining[lanes] = offsets(seen.factor[good], state.coordinates[lanes], bounds, samples_of(batch, lanes))


def look_again(batch: Batch, state: Searches, lanes: np.ndarray, level: int, bounds: np.ndarray) -> np.ndarray:
    """End points simulated again at another level of accuracy, with noise levels from the search so far.

    Lanes that stay where they are get slopes of their own point and of the accuracy of their search.
    Returns which lanes are not at the optimum of what is now seen.
    """
    sigma = batch.levels(state.simulated[lanes], lanes)
    seen = evaluate(batch, state.coordinates[lanes], lanes, sigma, level, slopes=state.slopes[lanes])
    good = np.isfinite(seen.cost)
    kept, state.level[lanes] = lanes[good], level
    state.sigma[kept], state.simulated[kept] = sigma[good], seen.simulated[good]
    state.factor[kept], state.cost[kept] = seen.factor[good], seen.cost[good]
    state.checked[lanes] = good
    state.remaining[kept] = offsets(seen.factor[good], state.coordinates[kept], bounds, samples_of(batch, kept))
    coarse = state.slope_level[kept] < batch.engine.slope_level(level - 1)
    ending = kept[(state.remaining[kept] <= CHECK_GOAL) & (state.moved[kept] | coarse)]
    if ending.size:
        _renew(batch, state, ending, level - 1, bounds)
    state.offset[kept] = state.remaining[kept]
    state.goal[kept] = np.clip(INEXACT * state.offset[kept], OFFSET_GOAL, LATER_GOAL)
    state.keep[kept] = state.offset[kept] < CLOSE
    state.radius[lanes] = np.inf
    return kept[state.offset[kept] > CHECK_GOAL]


def search(batch: Batch, state: Searches, max_iterations: int, say: Callable[[str, float], None]) -> None:
    """Search in all lanes until finer steps no longer move the optimum, or the iterations are used up."""
    bounds, active, first_level = bounds_of(batch), np.zeros(0, int), state.level.copy()
    for level in range(MOST_LEVELS):
        stage = active = np.concatenate([active, np.flatnonzero(state.alive & (first_level == level))])
        while active.size:
            active = active[state.iterations[active] < max_iterations]
            if active.size:
                active = active[~advance(batch, state, active, level, bounds)]
            share = 1.0 - active.size / batch.lanes
            say(f"iteration {state.iterations.max()}, {active.size} fits under way ({batch.engine.name})", share)
        active = look_again(batch, state, stage, level + 1, bounds) if stage.size else stage
        for lane in active:
            state.failed[lane].clear()  # finer steps may succeed
