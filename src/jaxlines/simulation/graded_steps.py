"""Steps for many lanes in step through stiff circuits: long where all rest, short where any moves fast.

Some lanes are integrated together with an error test on the worst of them; the steps they needed then serve all
lanes, whatever chunks these run in, so that results do not depend on who runs beside whom.
"""

import functools
import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.rosenbrock import BLOCK, relative_error, step

ORDER = 4
"""A step's error estimate goes with this power of its length."""

SMALLEST = 1e-12
"""Shortest step, relative to the whole time."""


class Steps(NamedTuple):
    """Boundaries of steps [s], shape (steps + 1,), and the interval between samples that each is in, (steps,)."""

    times: np.ndarray
    interval: np.ndarray

    @property
    def count(self) -> int:
        """How many steps there are."""
        return len(self.interval)


@functools.partial(jax.jit, static_argnums=0)
def _trial(plan: Plan, values: Values, t, h, state):
    """A step and the relative error of each lane; infinite where it is not finite."""
    new, error = step(plan, values, t, h, state)
    size = relative_error(plan, new, error)
    return new, jnp.where(jnp.isfinite(size), size, jnp.inf)


def trial_of(plan: Plan, values: Values) -> Callable:
    """What tries a step of a pilot, for `graded_steps`. Args: values: of the pilot's lanes, lanes last."""
    return functools.partial(_trial, plan, values)


def graded_steps(
    trial: Callable, times, start, tolerance: float, *, knots=(), max_steps: int = 100_000, seen: Callable | None = None
) -> Steps:
    """The steps that some lanes need together; runs on the host, outside of traced code.

    Args: trial(t, h, state): gives the state after a step and the error estimate of each lane, infinite where it fails,
        see `trial_of`; times: of the samples [s], increasing; start: state of the pilot's lanes;
        tolerance: largest error estimate of a step, relative to each state plus its typical size; knots: further times
        at which steps end, as the jumps and kinks of inputs [s]; max_steps: of the pilot, rejected ones included;
        seen(t, state, error): called with what every step that is taken leaves.
    Returns: steps that end on all samples and knots.
    Raises: RuntimeError when a lane fails however short the step, or when max_steps are not enough.
    Validity: of the lanes it was made for. Others are as accurate where they move no faster; each lane's own error
        estimate tells. The estimate is that of the third-order solution, so that errors are mostly far smaller.
    """
    times = np.asarray(times, dtype=float)
    stops = np.unique(np.concatenate([times, np.asarray(knots, dtype=float).ravel()]))
    stops = stops[(stops > times[0]) & (stops <= times[-1])]
    shortest, state, taken, tried = SMALLEST * (times[-1] - times[0]), start, [times[0]], 0
    h = 1e-3 * (stops[0] - times[0])
    for stop in stops:
        while taken[-1] < stop:
            left = stop - taken[-1]
            part = left if h >= left else min(h, 0.5 * left)  # two equal steps rather than a long and a tiny one
            new, error = trial(taken[-1], part, state)
            tried, worse = tried + 1, float(np.max(error)) / tolerance
            if worse <= 1.0:
                state = new
                taken.append(stop if part == left else taken[-1] + part)
                if seen is not None:
                    seen(taken[-1], new, error)
            h = part * min(max(0.9 * max(worse, 1e-8) ** (-1.0 / ORDER), 0.2), 5.0)
            if h < shortest or tried >= max_steps:
                raise RuntimeError(
                    f"the pilot of the linearly implicit scheme stopped at {taken[-1]:g} s: "
                    + (f"a step of {h:g} s is still too long" if h < shortest else f"{max_steps} steps are not enough")
                )
    return _steps(np.asarray(taken), times)


def _steps(boundaries: np.ndarray, times: np.ndarray) -> Steps:
    middle = 0.5 * (boundaries[1:] + boundaries[:-1])
    return Steps(boundaries, (np.searchsorted(times, middle) - 1).astype(np.int32))


class StepTimes(tuple):
    """Boundaries of all steps [s], for a record, from which the grid is made again; shown in a few words."""

    def __str__(self) -> str:
        return f"{len(self) - 1} graded"


def graded_grid(times, boundaries) -> np.ndarray:
    """Boundaries of steps row by row, shape (samples, most + 1): row 0 the start, then one for each interval.

    Rows with fewer steps are filled up with their end, which stands for no step (see `rosenbrock.integrate`). Their
    common length is one of few (32, 128, 512, ...), so that programs serve other steps too.

    Args: times: of the samples [s], increasing; boundaries: of all steps [s], the samples among them.
    Raises: ValueError when they do not belong together.
    """
    times, boundaries = np.asarray(times, dtype=float), np.unique(np.asarray(boundaries, dtype=float))
    if not np.isin(times, boundaries).all() or boundaries[0] < times[0] or boundaries[-1] > times[-1]:
        raise ValueError(
            f"steps must end on all {len(times)} saved times and lie within {times[0]:g} s to {times[-1]:g} s; got "
            f"{len(boundaries)} times from {boundaries[0]:g} s to {boundaries[-1]:g} s: are they of another run?"
        )
    places = np.searchsorted(boundaries, times)
    most = 4 * BLOCK
    while most < np.diff(places).max():
        most *= 4
    grid = np.repeat(times[:, None], most + 1, axis=1)
    for row, (first, last) in enumerate(itertools.pairwise(places), start=1):
        grid[row, : last - first + 1] = boundaries[first : last + 1]
    return grid


def step_times(grid: np.ndarray) -> StepTimes:
    """The boundaries of all steps of a grid [s]."""
    return StepTimes(np.unique(grid).tolist())


def cut_times(boundaries, parts: int) -> np.ndarray:
    """Boundaries when every step is cut into equal parts [s]."""
    boundaries = np.asarray(boundaries, dtype=float)
    inner = boundaries[:-1, None] + np.diff(boundaries)[:, None] * np.arange(parts) / parts
    return np.append(inner.ravel(), boundaries[-1])
