"""Which of many candidates to measure: sensors or instants, by exhaustion, or by relaxed weights that are rounded."""

import itertools
import math
from typing import NamedTuple

import numpy as np

from jaxlines.inference.design_criteria import Goal

EXHAUSTIVE = 20_000
"""As many subsets are all looked at."""

_ROUNDS = 2000
_GAP = 1e-4


class Selection(NamedTuple):
    """What was chosen.

    counts: how often each candidate is measured, shape (candidates,), integers; value: of the goal; weights: the
    relaxed optimum, shape (candidates,), of the same sum; bound: no choice can have a lower value than this (-inf where
    the goal is not convex); efficiency: exp(bound - value), how close the standard deviation is to the best that
    fractions of measurements could give; method: "exhaustive" or "relaxed, rounded and exchanged".
    """

    counts: np.ndarray
    value: float
    weights: np.ndarray
    bound: float
    efficiency: float
    method: str


def _total(blocks, weights) -> np.ndarray:
    """Information of weighted candidates, shape (scenarios, n, n)."""
    return np.einsum("scij,c->sij", blocks, weights)


def _gains(goal: Goal, blocks, weights) -> np.ndarray:
    """How fast the goal falls with each weight, shape (candidates,)."""
    return -np.einsum("scij,sij->c", blocks, goal.slope(_total(blocks, weights)))


def _capped(raw, count: float, cap: float) -> np.ndarray:
    """min(f raw, cap) with the factor f that makes the sum `count`."""
    weights, full = np.zeros_like(raw), np.zeros(raw.size, bool)
    for _ in range(raw.size + 1):
        left = count - cap * full.sum()
        share = raw * ~full
        weights = np.where(full, cap, share * left / max(share.sum(), 1e-300))
        over = (weights > cap) & ~full
        if not over.any():
            return np.minimum(weights, cap)
        full |= over
    return weights


def relaxed(blocks, goal: Goal, count: float, *, repeats: bool = False) -> tuple[np.ndarray, float]:
    """Weights of sum `count`, each at most 1 (no limit with `repeats`), that make the goal small, and a lower bound.

    Each weight is multiplied by how much it helps, to the power of one half, until the bound of Frank and Wolfe
    (value minus the most that a linear step could gain) is within 1e-4 of the value.

    Args: blocks: information of each candidate, shape (scenarios, candidates, n, n).
    Reference: Silvey, Titterington and Torsney, "An algorithm for optimal designs on a finite design space", Commun.
    Stat. A 7, 1978; Pukelsheim, "Optimal Design of Experiments", 2006, ch. 11.
    """
    candidates, cap = blocks.shape[1], float(count) if repeats else 1.0
    weights = np.full(candidates, count / candidates)
    best, best_value, bound = weights, np.inf, -np.inf
    for _ in range(_ROUNDS):
        value, gains = float(goal.value(_total(blocks, weights))), _gains(goal, blocks, weights)
        order = np.sort(gains)[::-1]
        most = order[0] * count if repeats else order[: math.floor(count)].sum()
        bound = max(bound, value - (most - float(gains @ weights)))
        if value < best_value:
            best, best_value = weights, value
        if best_value - bound < _GAP:
            break
        weights = _capped(weights * np.sqrt(np.maximum(gains, 1e-12 * max(order[0], 1e-300))), count, cap)
    return best, bound


def _subsets(blocks, goal: Goal, count: int) -> np.ndarray:
    """The best subset of all."""
    candidates, best, found = blocks.shape[1], np.inf, np.zeros(blocks.shape[1], int)
    every = itertools.combinations(range(candidates), count)
    while batch := list(itertools.islice(every, 2000)):
        members = np.zeros((len(batch), candidates))
        np.put_along_axis(members, np.array(batch), 1.0, axis=1)
        values = goal.value(np.einsum("scij,bc->sbij", blocks, members))
        if values.min() < best:
            best, found = float(values.min()), members[int(np.argmin(values))].astype(int)
    return found


def _rounded(weights, count: int, repeats: bool) -> np.ndarray:
    """Whole numbers near the weights: with repeats by efficient apportionment (Pukelsheim and Rieder, 1992)."""
    counts = np.zeros(weights.size, int)
    if not repeats:
        counts[np.argsort(-weights, kind="stable")[:count]] = 1
        return counts
    support = np.flatnonzero(weights > 1e-3 * weights.max())
    support = support[np.argsort(-weights[support], kind="stable")][:count]
    share = weights[support] / weights[support].sum()
    given = np.maximum(np.ceil((count - 0.5 * support.size) * share).astype(int), 1)
    while given.sum() < count:
        given[np.argmin(given / share)] += 1
    while given.sum() > count:
        given[np.argmax((given - 1) / share)] -= 1
    counts[support] = given
    return counts


def _exchanged(blocks, goal: Goal, counts, repeats: bool, rounds: int = 60) -> np.ndarray:
    """Exchange one measurement at a time for a better one, as long as that helps (Fedorov, 1972)."""
    counts = counts.copy()
    for _ in range(rounds):
        total = _total(blocks, counts.astype(float))
        value, best = float(goal.value(total)), (0.0, -1, -1)
        gains = _gains(goal, blocks, counts.astype(float))
        free = np.flatnonzero(counts >= 0 if repeats else counts == 0)
        free = free[np.argsort(-gains[free], kind="stable")][:40]
        used = np.flatnonzero(counts)
        for out in used[np.argsort(gains[used], kind="stable")][:40]:
            values = goal.value(total[:, None] - blocks[:, out : out + 1] + blocks[:, free])
            at = int(np.argmin(values))
            if value - values[at] > best[0] + 1e-12:
                best = (value - float(values[at]), out, int(free[at]))
        if best[1] < 0:
            break
        counts[best[1]] -= 1
        counts[best[2]] += 1
    return counts


def select(blocks, goal: Goal, count: int, *, repeats: bool = False, convex: bool = True) -> Selection:
    """Choose `count` candidates (each once, or as often as it helps with `repeats`).

    Args: blocks: information of each candidate, shape (scenarios, candidates, n, n), n = free + known parameters;
        convex: whether the goal is a convex function of the information (it is not with known numbers).
    Raises: ValueError for more than there are, or less than one.
    """
    candidates = blocks.shape[1]
    if count < 1 or (count > candidates and not repeats):
        raise ValueError(f"{count} of {candidates} candidates cannot be chosen: give a number from 1 to {candidates}")
    if not repeats and math.comb(candidates, count) <= EXHAUSTIVE:
        counts, method = _subsets(blocks, goal, count), "exhaustive"
        weights, bound = relaxed(blocks, goal, count)
    else:
        weights, bound = relaxed(blocks, goal, count, repeats=repeats)
        counts = _exchanged(blocks, goal, _rounded(weights, count, repeats), repeats)
        method = "relaxed, rounded and exchanged"
    value = float(goal.value(_total(blocks, counts.astype(float))))
    bound = bound if convex else -np.inf
    against = bound if convex else float(goal.value(_total(blocks, weights)))
    return Selection(counts, value, weights, bound, float(min(np.exp(against - value), 1.0)), method)


def evenly(blocks, goal: Goal, count: int) -> tuple[np.ndarray, float]:
    """The best start and interval of `count` evenly spaced candidates: counts, shape (candidates,), and the value.

    Raises: ValueError for less than two or more than there are.
    """
    candidates = blocks.shape[1]
    if not 2 <= count <= candidates:
        raise ValueError(f"{count} evenly spaced of {candidates} candidates cannot be chosen: 2 to {candidates}")
    best, found = np.inf, np.zeros(candidates, int)
    for step in range(1, (candidates - 1) // (count - 1) + 1):
        firsts = np.arange(candidates - step * (count - 1))
        summed = sum(blocks[:, firsts + step * k] for k in range(count))
        values = goal.value(summed)
        if values.min() < best:
            best = float(values.min())
            found = np.zeros(candidates, int)
            found[int(np.argmin(values)) + step * np.arange(count)] = 1
    return found, best
