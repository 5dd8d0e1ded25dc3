"""What can be chosen of an input: values at knots, amplitudes of sines, the size of a profile; and its limits."""

import abc
import functools
from typing import NamedTuple

import numpy as np

from jaxlines.simulation.signals import Sampled


class Inequalities(NamedTuple):
    """low <= matrix @ coefficients <= high, a name for each row; shape (rows, coefficients) and (rows,)."""

    matrix: np.ndarray
    low: np.ndarray
    high: np.ndarray
    names: tuple[str, ...]


class AbstractExcitation(abc.ABC):
    """An input that is linear in the numbers to be chosen: u = base + basis c on a grid of times, joined linearly.

    Attributes: input: its name; low, high: its limits [unit of the input]; rate: the steepest slope [unit/s] or None;
    energy: the largest integral of u^2 dt [unit^2 s] or None.
    """

    input: str
    low: float
    high: float
    rate: float | None
    energy: float | None

    @property
    @abc.abstractmethod
    def grid(self) -> np.ndarray:
        """Times of the samples [s], shape (samples,)."""

    @property
    @abc.abstractmethod
    def base(self) -> np.ndarray:
        """What does not depend on the coefficients, shape (samples,)."""

    @property
    @abc.abstractmethod
    def basis(self) -> np.ndarray:
        """Shape (samples, coefficients)."""

    @property
    @abc.abstractmethod
    def coefficient_bounds(self) -> np.ndarray:
        """Lowest and highest value of each coefficient, shape (coefficients, 2)."""

    @property
    @abc.abstractmethod
    def start_coefficients(self) -> np.ndarray:
        """Where the search starts, shape (coefficients,)."""

    def values(self, coefficients) -> np.ndarray:
        """Samples on the grid."""
        return self.base + self.basis @ coefficients

    def signal(self, coefficients) -> Sampled:
        """The input, to be used in `simulate`."""
        return Sampled(self.grid, self.values(coefficients))

    def energy_of(self, coefficients) -> float:
        """Integral of u^2 dt of the polygon [unit^2 s]."""
        values = self.values(coefficients)
        return float(values @ self._mass @ values)

    def energy_slope(self, coefficients) -> np.ndarray:
        """Derivative of the energy by the coefficients."""
        return 2.0 * self.basis.T @ (self._mass @ self.values(coefficients))

    @functools.cached_property
    def _mass(self) -> np.ndarray:
        """Matrix of the integral of a product of two polygons."""
        steps, size = np.diff(self.grid), self.grid.size
        mass, at = np.zeros((size, size)), np.arange(size - 1)
        for i, j, part in ((0, 0, 3.0), (1, 1, 3.0), (0, 1, 6.0), (1, 0, 6.0)):
            np.add.at(mass, (at + i, at + j), steps / part)
        return mass

    def inequalities(self) -> Inequalities:
        """Limits of level and rate that are no bounds of single coefficients."""
        matrix, low, high, names = [], [], [], []
        if not self._levels_are_bounds:
            matrix.append(self.basis)
            low.append(self.low - self.base)
            high.append(self.high - self.base)
            names += [f"level of {self.input} at {t:.4g} s" for t in self.grid]
        if self.rate is not None:
            steps = np.diff(self.grid)
            matrix.append(np.diff(self.basis, axis=0) / steps[:, None])
            slope = np.diff(self.base) / steps
            low.append(-self.rate - slope)
            high.append(self.rate - slope)
            names += [f"rate of {self.input} after {t:.4g} s" for t in self.grid[:-1]]
        if not matrix:
            return Inequalities(np.zeros((0, self.basis.shape[1])), np.zeros(0), np.zeros(0), ())
        return Inequalities(np.concatenate(matrix), np.concatenate(low), np.concatenate(high), tuple(names))

    @property
    def _levels_are_bounds(self) -> bool:
        """Whether the bounds of the coefficients say all about the level."""
        return False


def require(rule: bool, text: str) -> None:
    """Raise ValueError with a text unless a rule holds."""
    if not rule:
        raise ValueError(text)


def check_limits(of: AbstractExcitation) -> None:
    """Raise ValueError for limits that cannot be kept."""
    name = of.input
    require(
        bool(np.isfinite([of.low, of.high]).all()) and of.low < of.high,
        f"{name}: low and high must be finite and increasing, got {of.low:g} .. {of.high:g}: there is no room",
    )
    require(of.rate is None or of.rate > 0.0, f"{name}: rate must be positive (unit of the input/s), got {of.rate}")
    require(of.energy is None or of.energy > 0.0, f"{name}: energy must be positive, got {of.energy}")
