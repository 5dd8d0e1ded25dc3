"""Steps of many least-squares searches at once, from the triangular factors of their rows.

A factor is R of [J r] = Q R, shape (lanes, free + 1, free + 1), of weighted rows by coordinates: it holds J'J, J'r and
r'r without squaring anything.
"""

import numpy as np

from jaxlines.inference.uncertainty import UNINFORMED

POOR, GOOD = 0.25, 0.75
"""Ratios of actual to predicted decrease below which the trust region shrinks, and above which it grows."""

SHRINK = 0.5
"""Radius of a trust region after a poor step, as a share of its length."""

FIRST_REACH = 0.25
"""Share of the width between its bounds that no coordinate leaves in the first step."""


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
        if not (length > radius).any():
            break
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
    for _ in range(count):
        free = np.where(held[:, None], 0.0, scaled)
        gone = np.where(held, step * size, 0.0)
        rest = residuals + np.einsum("lri,li->lr", scaled, gone)
        left, singular, right = np.linalg.svd(free, full_matrices=False)
        inside = np.einsum("lri,lr->li", left, rest)
        left_over = np.sqrt(np.maximum(1.0 - (gone**2).sum(axis=1) / radius**2, 1e-4)) * radius
        damping = damping_of(singular, inside, left_over)
        known = singular > 1e-12 * singular.max(axis=1, keepdims=True)
        shares = np.where(known, singular * inside / np.where(known, singular**2 + damping[:, None], 1.0), 0.0)
        moved = -np.einsum("lki,lk->li", right, shares) / np.where(size > 0.0, size, 1.0)
        step = np.where(held, step, moved)
        trial = coordinates + step
        leaving = ~held & ((trial < bounds[:, 0]) | (trial > bounds[:, 1]))
        if not leaving.any():
            break
        step = np.where(leaving, np.clip(trial, bounds[:, 0], bounds[:, 1]) - coordinates, step)
        held = held | leaving
    return np.clip(coordinates + step, bounds[:, 0], bounds[:, 1]) - coordinates


def first_radius(factor, size, coordinates, bounds) -> np.ndarray:
    """Radii with which no coordinate moves by more than a share of its width, (lanes,)."""
    steps = steps_of(factor, size, np.full(len(factor), np.inf), coordinates, bounds)
    share = np.max(np.abs(steps) / (bounds[:, 1] - bounds[:, 0]), axis=1)
    length = np.sqrt(((steps * size) ** 2).sum(axis=1))
    return np.where(share > FIRST_REACH, length * FIRST_REACH / np.maximum(share, 1e-300), np.inf)


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


def next_radius(gain, steps, radius) -> np.ndarray:
    """Radii of the trust regions after steps (scaled) that gained so much of what was predicted."""
    length = np.sqrt((steps**2).sum(axis=1))
    grown = np.where((gain > GOOD) & (length > 0.95 * radius), 2.0 * radius, radius)
    return np.where(gain < POOR, SHRINK * np.minimum(length, radius), grown)
