"""Many least-squares searches side by side: one batched residual-and-Jacobian call an iteration, all else per lane.

Of every lane only the triangular factor of its weighted rows is kept, [J r] = Q R, which holds J'J, J'r and r'r
without squaring anything: residuals and Jacobians of thousands of recordings need not fit into memory.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxlines.inference.batch_lanes import Batch
from jaxlines.inference.priors import Prior
from jaxlines.inference.search import OFFSET_GOAL, OFFSET_LIMIT
from jaxlines.inference.uncertainty import UNINFORMED

POOR, GOOD = 0.25, 0.75
"""Ratios of actual to predicted decrease below which the trust region shrinks, and above which it grows."""

CHECK_GOAL = 0.5 * OFFSET_LIMIT
"""Relative offset that finer steps and the final weights may leave, in standard errors; else the search goes on."""

LEVELS_TO_START = 3
"""Levels of accuracy at which a start is tried."""

INEXACT, FIRST_GOAL = 0.1, 0.1
"""A search with steps that finer ones will correct ends at this share of what they last moved the optimum, and at
this relative offset with the first steps."""

MOST_LEVELS = 8
"""Levels of accuracy at which searches run; one more is only looked at."""


@dataclasses.dataclass
class Searches:
    """The state of all searches.

    Fields: coordinates (lanes, free); simulated (lanes, times, channels); sigma, same shape; factor: R of [J r],
    shape (lanes, free + 1, free + 1), of weighted rows by coordinates; cost (lanes,): half the sum of squares;
    size (lanes, free): longest each column of J has been; radius (lanes,): of the trust region, of steps times size;
    alive: whether the start could be simulated; offset (lanes,): see `offsets`, at the last look
    with finer steps; checked: whether there was one; goal (lanes,): offset at which a search pauses; level (lanes,): of
    accuracy; failed: for each lane the
    coordinates at which its simulation failed; iterations (lanes,).
    """

    coordinates: np.ndarray
    simulated: np.ndarray
    sigma: np.ndarray
    factor: np.ndarray
    cost: np.ndarray
    size: np.ndarray
    radius: np.ndarray
    alive: np.ndarray
    offset: np.ndarray
    checked: np.ndarray
    goal: np.ndarray
    level: np.ndarray
    failed: list[list[np.ndarray]]
    iterations: np.ndarray


class Seen(NamedTuple):
    """Simulated channels of some lanes, factors of their rows and costs; NaN for failed lanes."""

    simulated: np.ndarray
    factor: np.ndarray
    cost: np.ndarray


def evaluate(batch: Batch, coordinates, lanes, sigma, level: int) -> Seen:
    """Simulate lanes at coordinates, (m, free), with weights sigma, (m, times, channels)."""
    count, values = len(batch.free), batch.to_values(coordinates)
    steps = np.stack([f.slope(values[:, i]) for i, f in enumerate(batch.free)], axis=1)
    prior, prior_slopes = _prior_rows(batch, values)
    seen = Seen(
        np.empty((lanes.size, *batch.measured.shape[1:])),
        np.full((lanes.size, count + 1, count + 1), np.nan),
        np.full(lanes.size, np.nan),
    )

    def take(part, shown, slopes) -> None:
        seen.simulated[part] = shown
        good = np.isfinite(shown).all(axis=(1, 2))
        part, shown, slopes = part[good], shown[good], slopes[good]
        own = lanes[part]
        weight = np.where(batch.used[own], 1.0 / sigma[part], 0.0)
        rows = np.empty((part.size, shown.shape[1] * shown.shape[2] + prior.shape[1], count + 1))
        size = rows.shape[1] - prior.shape[1]
        misfit = np.where(batch.used[own], shown - batch.measured[own], 0.0)
        rows[:, :size, count] = (misfit * weight).reshape(part.size, size)
        rows[:, :size, :count] = (slopes * weight[..., None]).reshape(part.size, size, count)
        rows[:, size:, count], rows[:, size:, :count] = prior[part], prior_slopes[part]
        rows[:, :, :count] *= steps[part, None]
        seen.factor[part] = _triangle(rows)
        seen.cost[part] = 0.5 * (rows[..., count] ** 2).sum(axis=1)

    batch.engine.run(values, lanes, level, True, take)
    return seen


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


def bounds_of(batch: Batch) -> np.ndarray:
    """Bounds of the coordinates, shape (free, 2)."""
    return np.array([f.coordinate_bounds() for f in batch.free])


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
        factor=seen.factor,
        cost=seen.cost,
        size=np.zeros(coordinates.shape),
        radius=np.full(lanes.size, np.inf),
        alive=np.isfinite(seen.cost),
        offset=np.full(lanes.size, np.nan),
        checked=np.zeros(lanes.size, bool),
        goal=np.full(lanes.size, FIRST_GOAL),
        level=level,
        failed=[[] for _ in lanes],
        iterations=np.zeros(lanes.size, int),
    )


def on_bound(factor, coordinates, bounds, share: float) -> np.ndarray:
    """Which coordinates are at a bound (within a share of the widths) that the gradient pushes against."""
    count, margin = coordinates.shape[1], share * (bounds[:, 1] - bounds[:, 0])
    gradient = np.einsum("lri,lr->li", factor[:, :, :count], factor[:, :, count])
    low = (coordinates <= bounds[:, 0] + margin) & (gradient > 0)
    return low | ((coordinates >= bounds[:, 1] - margin) & (gradient < 0))


def damping_of(singular, inside, radius) -> np.ndarray:
    """Damping with which steps are no longer than a radius, (lanes,); zero where the undamped one is not.

    Newton's method on 1/|step(d)| = 1/radius, which is concave and nearly linear in d: from zero the iterates rise
    to the root (More, "The Levenberg-Marquardt algorithm", 1978).
    """
    known = singular > 1e-12 * singular.max(axis=1, keepdims=True)
    safe, parts = np.where(known, singular**2, 1.0), np.where(known, singular * inside, 0.0)
    damping = np.zeros(radius.size)
    for _ in range(12):
        shifted = safe + damping[:, None]
        length = np.sqrt(((parts / shifted) ** 2).sum(axis=1))
        slope = -(parts**2 / shifted**3).sum(axis=1) / np.maximum(length, 1e-300)
        change = (1.0 - length / radius) * length / np.minimum(slope, -1e-300)
        damping = np.where(length > radius, np.maximum(damping + change, 0.0), damping)
    return damping


def steps_of(factor, size, radius, coordinates, bounds) -> np.ndarray:
    """Damped Gauss-Newton steps of lanes inside a trust region and the bounds (Levenberg 1944, Marquardt 1963).

    Columns are divided by `size`, so that neither units nor the size of the noise matter. Coordinates that would leave
    their bounds go to them, and the others take the best step beside that.
    """
    count = coordinates.shape[1]
    held = on_bound(factor, coordinates, bounds, 1e-12)
    scaled = factor[:, :, :count] / np.where(size > 0.0, size, 1.0)[:, None]
    residuals, step = factor[:, :, count], np.zeros_like(coordinates)
    damping: np.ndarray | None = None
    for _ in range(count):
        free = np.where(held[:, None], 0.0, scaled)
        rest = residuals + np.einsum("lri,li->lr", scaled, np.where(held, step * size, 0.0))
        left, singular, right = np.linalg.svd(free, full_matrices=False)
        inside = np.einsum("lri,lr->li", left, rest)
        damping = damping_of(singular, inside, radius) if damping is None else damping
        known = singular > 1e-12 * singular.max(axis=1, keepdims=True)
        shares = np.where(known, singular * inside / np.where(known, singular**2 + damping[:, None], 1.0), 0.0)
        moved = -np.einsum("lki,lk->li", right, shares) / np.where(size > 0.0, size, 1.0)
        step = np.where(held, step, moved)
        inner = np.clip(coordinates + step, bounds[:, 0], bounds[:, 1]) - coordinates
        left_over = ~held & (inner != step)
        step = np.where(left_over, inner, step)
        held = held | left_over
        if not left_over.any():
            break
    return np.clip(coordinates + step, bounds[:, 0], bounds[:, 1]) - coordinates


def offsets(factor, coordinates, bounds, samples) -> np.ndarray:
    """Remaining Gauss-Newton steps in standard errors (lanes,); see `search.relative_offset`, here of all lanes.

    samples (lanes,): how many rows the factors stand for.
    """
    count, widths = coordinates.shape[1], bounds[:, 1] - bounds[:, 0]
    stuck = on_bound(factor, coordinates, bounds, 1e-6)
    residuals = factor[:, :, count]
    left, singular, _ = np.linalg.svd(np.where(stuck[:, None], 0.0, factor[:, :, :count] * widths), full_matrices=False)
    inside = np.where(singular > 0.0, np.einsum("lri,lr->li", left, residuals), 0.0)
    outside = residuals - np.einsum("lri,li->lr", left, inside)
    freedom = np.maximum(samples - (singular > 0.0).sum(axis=1), 1)
    level = np.maximum(np.sqrt((outside**2).sum(axis=1) / freedom), 1e-300)[:, None]
    steps, known = np.abs(inside) / level, singular > level / UNINFORMED
    firm = np.sqrt((np.where(known, steps, 0.0) ** 2).sum(axis=1) / np.maximum(known.sum(axis=1), 1))
    reach = np.minimum(steps, singular / level)  # a walk ends at its best point or at the bounds
    gainful = ~known & (steps * reach - 0.5 * reach**2 > 0.5)
    return np.maximum(firm, np.where(gainful, steps, 0.0).max(axis=1, initial=0.0))


def advance(batch: Batch, state: Searches, active: np.ndarray, level: int, bounds: np.ndarray) -> np.ndarray:
    """One trial step of the active lanes; returns which of them are finished."""
    factor = state.factor[active]
    lengths = np.sqrt((factor[:, :, :-1] ** 2).sum(axis=1))
    state.size[active] = size = np.maximum(state.size[active], lengths)
    steps = steps_of(factor, size, state.radius[active], state.coordinates[active], bounds)
    trial = state.coordinates[active] + steps
    seen = evaluate(batch, trial, active, state.sigma[active], level)
    for i in np.flatnonzero(~np.isfinite(seen.cost)):
        state.failed[active[i]].append(trial[i])
    moved = np.einsum("lri,li->lr", factor[:, :, :-1], steps)
    predicted = -(factor[:, :, -1] * moved).sum(axis=1) - 0.5 * (moved**2).sum(axis=1)
    better = np.isfinite(seen.cost) & (seen.cost < state.cost[active])
    gained = np.where(better, state.cost[active] - np.where(better, seen.cost, 0.0), 0.0)
    accepted = active[better]
    state.coordinates[accepted], state.cost[accepted] = trial[better], seen.cost[better]
    state.simulated[accepted], state.factor[accepted] = seen.simulated[better], seen.factor[better]
    state.radius[active] = _radius(gained / np.maximum(predicted, 1e-300), steps * size, state.radius[active])
    state.iterations[active] += 1
    tiny = np.all(np.abs(steps) < 1e-9 * (bounds[:, 1] - bounds[:, 0]), axis=1)
    settled = np.zeros(active.size, bool)
    remaining = offsets(state.factor[accepted], state.coordinates[accepted], bounds, samples_of(batch, accepted))
    settled[better] = remaining < state.goal[accepted]
    return tiny | settled


def _radius(gain, steps, radius) -> np.ndarray:
    """Radii of the trust regions after steps (scaled) that gained so much of what was predicted."""
    length = np.sqrt((steps**2).sum(axis=1))
    grown = np.where((gain > GOOD) & (length > 0.95 * radius), 2.0 * radius, radius)
    return np.where(gain < POOR, 0.25 * length, grown)


def samples_of(batch: Batch, lanes) -> np.ndarray:
    """How many samples count in each lane."""
    return batch.used[lanes].sum(axis=(1, 2))


def look_again(batch: Batch, state: Searches, lanes: np.ndarray, level: int, bounds: np.ndarray) -> np.ndarray:
    """End points simulated again at another level of accuracy, with noise levels from the search so far.

    Returns which lanes are not at the optimum of what is now seen.
    """
    sigma = batch.levels(state.simulated[lanes], lanes)
    seen = evaluate(batch, state.coordinates[lanes], lanes, sigma, level)
    good = np.isfinite(seen.cost)
    kept, state.level[lanes] = lanes[good], level
    state.sigma[kept], state.simulated[kept] = sigma[good], seen.simulated[good]
    state.factor[kept], state.cost[kept] = seen.factor[good], seen.cost[good]
    state.checked[lanes] = good
    state.offset[kept] = offsets(seen.factor[good], state.coordinates[kept], bounds, samples_of(batch, kept))
    state.goal[kept] = np.clip(INEXACT * state.offset[kept], OFFSET_GOAL, FIRST_GOAL)
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
