"""What a least-squares problem is, one made of a function written in JAX, and one made of another one's rows."""

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from jaxlines.simulation.precision import computing_in


@runtime_checkable
class LeastSquaresProblem(Protocol):
    """Half the sum of squares of weighted rows r(x), to be minimised over lower <= x <= upper.

    labels: names of the parameters; lower, upper: bounds of the coordinates x, infinite where there are none;
    recording, channel, time: integers of shape (rows,) that say where a row comes from, recording -1 for the row of a
    prior. residuals: (simulated - measured)/sigma, shape (rows,), NaN where the model fails; jacobian: their slopes by
    the coordinates, shape (rows, parameters).
    """

    @property
    def labels(self) -> tuple[str, ...]: ...
    @property
    def lower(self) -> np.ndarray: ...
    @property
    def upper(self) -> np.ndarray: ...
    @property
    def recording(self) -> np.ndarray: ...
    @property
    def channel(self) -> np.ndarray: ...
    @property
    def time(self) -> np.ndarray: ...
    def residuals(self, x) -> np.ndarray:
        """Weighted rows at x."""
        ...

    def jacobian(self, x) -> np.ndarray:
        """Their slopes by x."""
        ...


def checked_bounds(count: int, lower, upper) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of so many parameters, infinite where none are given. Raises: ValueError unless each pair increases."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    lower, upper = (b if b.size else np.full(count, free) for b, free in ((lower, -np.inf), (upper, np.inf)))
    if lower.shape != (count,) or upper.shape != (count,) or not np.all(lower < upper):
        raise ValueError(f"bounds need one increasing pair for each of {count} parameters, got {lower} and {upper}")
    return lower, upper


@dataclasses.dataclass(frozen=True)
class FunctionProblem:
    """A least-squares problem of a function written in JAX, so that a model of any kind can be fitted.

    Args:
        function: x -> weighted residuals, shape (parameters,) -> (rows,), traceable and differentiable forward.
        labels: names of the parameters; lower, upper: their bounds, unbounded by default.
        recording, channel, time: where rows come from; one recording, one channel, rows in order by default.
    """

    function: Callable
    labels: tuple[str, ...]
    lower: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    upper: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    recording: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))
    channel: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))
    time: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=int))

    def __post_init__(self):
        count = len(self.labels)
        object.__setattr__(self, "labels", tuple(self.labels))
        for name, bound in zip(("lower", "upper"), checked_bounds(count, self.lower, self.upper), strict=True):
            object.__setattr__(self, name, bound)
        rows = self._num_rows()
        for name, default in (("recording", np.zeros), ("channel", np.zeros), ("time", np.arange)):
            given = np.asarray(getattr(self, name), dtype=int)
            object.__setattr__(self, name, given if given.size else default(rows).astype(int))
            if getattr(self, name).shape != (rows,):
                raise ValueError(f"{name} needs one integer for each of {rows} rows, got {given.shape}")

    def _num_rows(self) -> int:
        import jax

        with computing_in("float64"):
            shape = jax.eval_shape(self.function, jax.ShapeDtypeStruct((len(self.labels),), np.float64)).shape
        if len(shape) != 1:
            raise ValueError(f"the function must return one axis of residuals, got shape {shape}: ravel them")
        return shape[0]

    @functools.cached_property
    def _programs(self) -> tuple[Callable, Callable, Callable]:
        import jax

        slopes = jax.jacfwd(self.function)
        gradient = lambda x: slopes(x).T @ self.function(x)  # noqa: E731
        return jax.jit(self.function), jax.jit(slopes), jax.jit(jax.jacfwd(gradient))

    def _run(self, which: int, x) -> np.ndarray:
        with computing_in("float64"):
            return np.asarray(self._programs[which](np.asarray(x, dtype=float)))

    def residuals(self, x) -> np.ndarray:
        """Weighted residuals at x, shape (rows,)."""
        return self._run(0, x)

    def jacobian(self, x) -> np.ndarray:
        """Their exact slopes by x, shape (rows, parameters)."""
        return self._run(1, x)

    def hessian(self, x) -> np.ndarray:
        """Exact second derivatives of half the sum of squares, shape (parameters, parameters)."""
        return self._run(2, x)


@dataclasses.dataclass(frozen=True)
class AbstractRewritten(abc.ABC):
    """A problem with the parameters, bounds and origins of rows of another one, `plain`, but rows of its own."""

    plain: LeastSquaresProblem

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.plain.labels

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates."""
        return self.plain.lower

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates."""
        return self.plain.upper

    @property
    def recording(self) -> np.ndarray:
        """Recording of a row, -1 for priors."""
        return self.plain.recording

    @property
    def channel(self) -> np.ndarray:
        """Channel of a row."""
        return self.plain.channel

    @property
    def time(self) -> np.ndarray:
        """Sample of a row."""
        return self.plain.time

    @abc.abstractmethod
    def residuals(self, x) -> np.ndarray:
        """Weighted rows, shape (rows,)."""

    @abc.abstractmethod
    def jacobian(self, x) -> np.ndarray:
        """Their slopes by the coordinates, shape (rows, parameters)."""
