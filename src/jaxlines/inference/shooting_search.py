"""Least squares of records cut into windows: the states at their beginnings are unknowns, tied by continuity.

Over parameters x and states s_k at the beginnings of windows,

    minimise  1/2 sum_k |r_k(s_k, x)|^2   subject to   f_k(s_k, x) = s_(k+1),   s_0 = start(x) where it is known.

The search minimises 1/2 |r|^2 + w^2/2 |c|^2 with c the gaps at the ends of windows in units of the states, by damped
Gauss-Newton steps, for a weight w that grows until the gaps are closed. The equations of a step are sparse: one block a
window, and the weight enters as -1/w^2 only, so that they are as well conditioned for closed gaps as for open ones.

References: Bock, "Recent advances in parameter identification techniques for O.D.E.", 1983 (multiple shooting,
generalised Gauss-Newton); Nocedal and Wright, "Numerical Optimization", 2006, ch. 17 (quadratic penalty).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxlines.inference.shooting_equations import Equations, Pieces, Windows, gaps

WEIGHTS = tuple(10.0**k for k in range(8))
"""Weights w of the gaps, one after another."""

SETTLED, LAST_SETTLED = 1e-2, 1e-9
"""Expected relative decrease at which the search goes on to the next weight, and with which it ends."""

FIRST_DAMPING, MOST_DAMPING, NO_DAMPING = 1e-3, 1e12, 1e-14

CONTINUOUS = 1e-5
"""Largest gap, in typical sizes of the states, that counts as closed."""


class Unstartable(ValueError):
    """A window cannot be simulated at the start of a search."""


class At(NamedTuple):
    """Where a search in windows is: x; states: one array (windows, d) a record; level: position of the weight;
    damping; count of evaluations."""

    x: np.ndarray
    states: tuple[np.ndarray, ...]
    level: int = 0
    damping: float = FIRST_DAMPING
    count: int = 0


class Joined(NamedTuple):
    """Where a search in windows ended.

    x; states: one array (windows, d) a record; cost: half the sum of squares without the gaps; gap: the largest, in
    units of the states; offset: remaining step of parameters and states in standard errors (see
    `search.relative_offset`); covariance: of x for rows of unit noise; num_evaluations; pieces: what was seen there.
    """

    x: np.ndarray
    states: tuple[np.ndarray, ...]
    cost: float
    gap: float
    offset: float
    covariance: np.ndarray
    num_evaluations: int
    pieces: tuple[Pieces, ...]


def _rows(windows: Windows, x, pieces: tuple[Pieces, ...]) -> float:
    """Half the sum of squares of residuals and priors."""
    prior = windows.prior(x)[0]
    return 0.5 * float(sum((piece.rows**2).sum() for piece in pieces) + prior @ prior)


def _bounded(
    equations: Equations, misfit, weight: float, damping: float, x, windows: Windows
) -> tuple[np.ndarray, np.ndarray]:
    """A step that keeps the parameters within their bounds, and which entries are held: those that would leave go to
    the bounds."""
    held, fixed = np.zeros(equations.gradient.size, bool), np.zeros(equations.gradient.size)
    step = fixed
    for _ in range(x.size + 1):
        step = equations.solve(misfit, weight, damping, held, fixed)
        trial = x + step[: x.size] * equations.widths
        leaving = ~held[: x.size] & ((trial < windows.lower) | (trial > windows.upper))
        if not leaving.any():
            break
        clipped = (np.clip(trial, windows.lower, windows.upper) - x) / equations.widths
        fixed[: x.size] = np.where(leaving, clipped, fixed[: x.size])
        held[: x.size] |= leaving
    return step, held


def _moved(at: At, step, windows: Windows, widths) -> At:
    """Parameters and states after a step."""
    x, place, states = np.clip(at.x + step[: at.x.size] * widths, windows.lower, windows.upper), at.x.size, []
    for own in at.states:
        states.append(own + step[place : place + own.size].reshape(own.shape) * windows.units)
        place += own.size
    return at._replace(x=x, states=tuple(states), count=at.count + 1)


def _finite(pieces: tuple[Pieces, ...]) -> bool:
    return all(np.isfinite(part).all() for piece in pieces for part in piece if part is not None)


def join(
    windows: Windows,
    start: At,
    *,
    max_evaluations: int = 200,
    report: Callable[[int, float], None] | None = None,
    save: Callable[[At], None] | None = None,
) -> Joined:
    """Search parameters and states from a start, closing the gaps.

    Args: report: called with the number of evaluations and the cost; save: called with every accepted iterate, from
    which a later search goes on to the same end. Raises: Unstartable when a window fails at the start.
    """
    widths = np.where(np.isfinite(windows.upper - windows.lower), windows.upper - windows.lower, 1.0)
    at = start._replace(x=np.clip(start.x, windows.lower, windows.upper), count=max(start.count, 1))
    pieces = windows.evaluate(at.x, at.states)
    if not _finite(pieces):
        raise Unstartable("a window cannot be simulated at the start of the search: other start values are needed")
    equations = Equations(windows, at.x, pieces, widths)
    for level, weight in list(enumerate(WEIGHTS))[start.level :]:
        if level > at.level:
            at = at._replace(level=level, damping=FIRST_DAMPING)
        settled = LAST_SETTLED if weight == WEIGHTS[-1] else SETTLED
        misfit = gaps(pieces, at.states, windows.units).ravel()
        total = _rows(windows, at.x, pieces) + 0.5 * weight**2 * float(misfit @ misfit)
        while at.count < max_evaluations:
            step = _bounded(equations, misfit, weight, at.damping, at.x, windows)[0]
            gain = equations.gain(step, misfit, weight)
            if gain <= settled * total or at.damping > MOST_DAMPING:
                break
            new = _moved(at, step, windows, widths)
            found = windows.evaluate(new.x, new.states)
            new_cost, new_misfit = _rows(windows, new.x, found), gaps(found, new.states, windows.units).ravel()
            new_total = new_cost + 0.5 * weight**2 * float(new_misfit @ new_misfit)
            if report:
                report(new.count, new_cost)
            ratio = (total - new_total) / gain if _finite(found) else -1.0
            if ratio <= 1e-4:
                at = at._replace(damping=at.damping * 8.0, count=new.count)
                continue
            damping = max(at.damping * max(1.0 / 9.0, 1.0 - (2.0 * ratio - 1.0) ** 3), NO_DAMPING)
            at, pieces, total, misfit = new._replace(damping=damping), found, new_total, new_misfit
            equations = Equations(windows, at.x, pieces, widths)
            if save:
                save(at)
    return _ended(windows, at, pieces, equations)


def _ended(windows: Windows, at: At, pieces: tuple[Pieces, ...], equations: Equations) -> Joined:
    """The end point: what an undamped step would still gain, as a step in standard errors, and the covariance."""
    weight, misfit = WEIGHTS[-1], gaps(pieces, at.states, windows.units)
    step, held = _bounded(equations, misfit.ravel(), weight, NO_DAMPING, at.x, windows)
    cost = _rows(windows, at.x, pieces)
    rows = sum(int(np.count_nonzero(piece.rows)) for piece in pieces)
    level = max(2.0 * cost / max(rows - at.x.size, 1), 1e-300)
    left = max(2.0 * equations.gain(step, misfit.ravel(), weight), 0.0)
    return Joined(
        x=at.x,
        states=at.states,
        cost=cost,
        gap=float(np.abs(misfit).max(initial=0.0)),
        offset=float(np.sqrt(left / at.x.size / level)),
        covariance=equations.covariance(weight, held[: at.x.size]),
        num_evaluations=at.count,
        pieces=pieces,
    )
