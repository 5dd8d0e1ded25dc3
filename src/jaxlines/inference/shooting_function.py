"""Multiple shooting of a model written in JAX, so that a model of any kind can be fitted in windows."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxlines.inference.least_squares_problem import checked_bounds
from jaxlines.inference.search import OFFSET_LIMIT
from jaxlines.inference.shooting_equations import Pieces
from jaxlines.inference.shooting_search import CONTINUOUS, At, Joined, Unstartable, join
from jaxlines.simulation.precision import computing_in


@dataclasses.dataclass(frozen=True)
class FunctionWindows:
    """One record in windows of a function written in JAX, for `solve_windows`.

    Args:
        function: (state (d,), x (parameters,), data of a window) -> (weighted residuals (m,), state at the end (d,)),
            traceable and differentiable forward; all windows are computed as lanes of one program.
        data: of all windows, arrays with a leading axis (windows, ...).
        labels: names of the parameters; lower, upper: their bounds, unbounded by default.
        units: typical sizes of the states, shape (d,).
        start: x -> state at the beginning of the record (d,), or None where that is free.
    Raises: ValueError for bounds or sizes that do not fit, or data of unequal numbers of windows.
    """

    function: Callable
    data: Any
    labels: tuple[str, ...]
    units: np.ndarray
    lower: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    upper: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    start: Callable | None = None

    def __post_init__(self):
        import jax

        count = len(self.labels)
        object.__setattr__(self, "units", np.asarray(self.units, dtype=float))
        for name, bound in zip(("lower", "upper"), checked_bounds(count, self.lower, self.upper), strict=True):
            object.__setattr__(self, name, bound)
        if not (self.units.ndim == 1 and np.all(self.units > 0.0)):
            raise ValueError(f"units must be one positive size for each state, got {self.units}")
        shapes = [np.shape(part) for part in jax.tree.leaves(self.data)]
        if not shapes or len({shape[:1] for shape in shapes}) > 1 or () in shapes:
            raise ValueError(f"data need a leading axis of windows, the same in each array, got shapes {shapes}")

    @property
    def num_windows(self) -> int:
        """How many windows there are."""
        import jax

        return int(np.shape(jax.tree.leaves(self.data)[0])[0])

    @functools.cached_property
    def _program(self) -> Callable:
        import jax

        def one(state, x, data):
            def both(state, x):
                found = self.function(state, x, data)
                return found, found

            slopes, found = jax.jacfwd(both, (0, 1), has_aux=True)(state, x)
            return found, slopes

        def all_windows(states, x, data):
            (rows, ends), (by_rows, by_ends) = jax.vmap(one, in_axes=(0, None, 0))(states, x, data)
            return rows, by_rows[0], by_rows[1], ends, by_ends[0], by_ends[1]

        return jax.jit(all_windows)

    @functools.cached_property
    def _start_program(self) -> Callable:
        import jax

        start = self.start
        assert start is not None
        return jax.jit(lambda x: (start(x), jax.jacfwd(start)(x)))

    def evaluate(self, x, states: tuple[np.ndarray, ...]) -> tuple[Pieces, ...]:
        """The record at parameters and states."""
        with computing_in("float64"):
            start, start_x = (None, None) if self.start is None else map(np.asarray, self._start_program(x))
            found = [np.asarray(part) for part in self._program(states[0], x, self.data)]
        return (Pieces(start, start_x, *found),)

    def prior(self, x) -> tuple[np.ndarray, np.ndarray]:
        """No rows."""
        return np.zeros(0), np.zeros((0, np.size(x)))


@dataclasses.dataclass(frozen=True)
class WindowsSolution:
    """Where a search in windows ended, the counterpart of `Solution`.

    Fields: x; cost: half the sum of squares; status: "converged", "at_bound", "stalled" or "failed", judged from the
    gaps and from what is left to gain; message: the same in words; covariance: of x for rows of unit noise, zero for
    coordinates on a bound, NaN of a search that failed (that no row is left open by x is not tested, see `assess`);
    residuals: rows window by window, (windows, m); states: at the beginnings of windows, (windows, d); gap: the largest
    jump between windows, in typical sizes of the states; start; num_evaluations: of all windows.
    """

    x: np.ndarray
    cost: float
    status: str
    message: str
    covariance: np.ndarray
    residuals: np.ndarray
    states: np.ndarray
    gap: float
    start: np.ndarray
    num_evaluations: int

    @property
    def ok(self) -> bool:
        """Whether it is an optimum, inside the bounds or on one."""
        return self.status in ("converged", "at_bound")


def _judge(windows: FunctionWindows, joined: Joined) -> tuple[str, str]:
    """Status of an end point from its gaps and from what is left to gain."""
    said = f"largest gap {joined.gap:.1e} of a typical size, remaining step {joined.offset:.1e} of a standard error"
    if not joined.gap <= CONTINUOUS or not joined.offset <= OFFSET_LIMIT:
        return "stalled", f"the search stopped before the windows were one trajectory at its optimum: {said}"
    width = windows.upper - windows.lower
    margin = 1e-9 * np.where(np.isfinite(width), width, 0.0)
    stuck = (joined.x <= windows.lower + margin) | (joined.x >= windows.upper - margin)
    if stuck.any():
        at = [f"{windows.labels[i]} at {joined.x[i]:.6g}" for i in np.flatnonzero(stuck)]
        return "at_bound", f"the optimum lies on a bound: {', '.join(at)} ({said})"
    return "converged", said


def solve_windows(
    windows: FunctionWindows,
    x,
    states,
    *,
    max_evaluations: int = 200,
    report: Callable[[int, float], None] | None = None,
) -> WindowsSolution:
    """Fit a model of one's own by multiple shooting: least squares over parameters and the states where windows begin,
    tied by continuity. It finds what `solve` finds, also from starts whose trajectory soon has nothing in common with
    the record; `fit(..., windows=...)` does the same with a circuit.

    Args: x: coordinates where the search starts, shape (parameters,); states: first guess of the states at the
    beginnings of windows, (windows, d), such as measured ones; max_evaluations: of all windows; report: called with
    their number and the cost. Returns: a `WindowsSolution`; with status "failed" when a window fails at the start.
    Raises: ValueError for shapes that do not fit. Reference: Bock, "Recent advances in parameter identification
    techniques for O.D.E.", 1983.
    """
    x, states = np.asarray(x, dtype=float), np.asarray(states, dtype=float)
    shapes = (len(windows.labels),), (windows.num_windows, windows.units.size)
    if (x.shape, states.shape) != shapes:
        raise ValueError(f"x and states need the shapes {shapes[0]} and {shapes[1]}, got {x.shape} and {states.shape}")
    try:
        end = join(windows, At(x, (states,)), max_evaluations=max_evaluations, report=report)
    except Unstartable as failure:
        none = np.full((x.size, x.size), np.nan)
        return WindowsSolution(x, np.inf, "failed", str(failure), none, np.zeros((0, 0)), states, np.inf, x, 1)
    status, message = _judge(windows, end)
    rows, found = end.pieces[0].rows, end.states[0]
    return WindowsSolution(
        end.x, end.cost, status, message, end.covariance, rows, found, end.gap, x, end.num_evaluations
    )
