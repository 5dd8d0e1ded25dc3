"""Uncertain numbers together: single ones, correlated ones, those of a fit, those of a table."""

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from jaxlines.inference.distributions import AbstractDistribution, LogNormal, Normal


@dataclasses.dataclass(frozen=True)
class JointNormal:
    """Several numbers that are normal together.

    Args: names, paths of the numbers; mean, shape (numbers,); covariance, shape (numbers, numbers), in the products of
        their units.
    Raises: ValueError for shapes that do not fit and a covariance that is not symmetric and positive definite.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray

    def __post_init__(self):
        mean, covariance = (np.asarray(a, dtype=float) for a in (self.mean, self.covariance))
        size = len(self.names)
        if mean.shape != (size,) or covariance.shape != (size, size):
            raise ValueError(f"JointNormal: {size} names need a mean of {size} and a covariance of {size} x {size}")
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)
        if np.any(np.diag(covariance) <= 0):
            raise ValueError("JointNormal: the variances on the diagonal of the covariance must be positive")
        sds = np.sqrt(np.diag(covariance))
        correlation_root(covariance / np.outer(sds, sds), "JointNormal")

    @property
    def dims(self) -> int:
        """How many uniform numbers it takes."""
        return len(self.names)

    def values(self, u: np.ndarray) -> np.ndarray:
        """Numbers, shape (lanes, numbers), from uniform ones of the same shape."""
        from scipy.special import ndtri

        sds = np.sqrt(np.diag(self.covariance))
        root = correlation_root(self.covariance / np.outer(sds, sds), "JointNormal")
        return self.mean + sds * correlate(ndtri(u), root)


@dataclasses.dataclass(frozen=True)
class Draws:
    """Several numbers of which equally likely rows are known: posterior draws, a bootstrap, a table of cases.

    Args: names, paths of the numbers; rows, shape (rows, numbers), SI.
    """

    names: tuple[str, ...]
    rows: np.ndarray

    def __post_init__(self):
        rows = np.asarray(self.rows, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != len(self.names) or not rows.shape[0]:
            raise ValueError(f"Draws: rows must have shape (rows, {len(self.names)}), got {rows.shape}")
        if not np.all(np.isfinite(rows)):
            bad = np.argwhere(~np.isfinite(rows))[0]
            raise ValueError(f"Draws: every number must be finite, got {rows[tuple(bad)]} in row {bad[0]}")
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "rows", rows)

    @classmethod
    def from_table(cls, table) -> "Draws":
        """From a pandas DataFrame or a dictionary of columns: path -> values, one row a case."""
        names = [str(name) for name in table]
        return cls(tuple(names), np.column_stack([np.asarray(table[name], dtype=float) for name in table]))

    @property
    def dims(self) -> int:
        """How many uniform numbers it takes: one, which picks the row."""
        return 1

    def values(self, u: np.ndarray) -> np.ndarray:
        """Numbers, shape (lanes, numbers), from uniform ones, shape (lanes, 1)."""
        row = np.floor(u[:, 0] * len(self.rows)).astype(int)
        return self.rows[np.minimum(row, len(self.rows) - 1)]


def correlation_root(matrix: np.ndarray, what: str) -> np.ndarray:
    """Lower triangular L with L L^T = matrix. Raises ValueError unless it is symmetric and positive definite."""
    if not np.allclose(matrix, matrix.T, atol=1e-12):
        raise ValueError(f"{what}: the matrix of correlations must be symmetric")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 1e-12:
        raise ValueError(
            f"{what}: correlations contradict each other (smallest eigenvalue {smallest:.3g}, must be positive): "
            "when a is tied to b and b to c, a and c are not free"
        )
    return np.linalg.cholesky(matrix)


def correlate(z: np.ndarray, root: np.ndarray) -> np.ndarray:
    """z L^T as sums in one order, so that a row does not depend on how many there are (a matrix product's may)."""
    columns = [sum(root[i, j] * z[:, j] for j in range(i + 1)) for i in range(len(root))]
    return np.stack(columns, axis=1)


@dataclasses.dataclass(frozen=True)
class Uncertain:
    """All uncertain numbers of a sweep.

    Fields: single: name -> distribution; shared: name -> the paths it drives, where these are several; correlation:
    (name, name) -> correlation of normal scores (Gaussian copula) among `single`; joint: groups of numbers.
    Raises: ValueError when a number is given twice, for correlations outside (-1, 1) or that contradict each other.
    Reference: Nelsen, "An Introduction to Copulas", 2006 (Gaussian copula).
    """

    single: Mapping[str, AbstractDistribution]
    shared: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    correlation: Mapping[tuple[str, str], float] = dataclasses.field(default_factory=dict)
    joint: tuple[JointNormal | Draws, ...] = ()

    def __post_init__(self):
        for name, distribution in self.single.items():
            if not isinstance(distribution, AbstractDistribution):
                raise TypeError(f"{name}: expected a distribution such as Normal(mean, sd), got {distribution!r}")
        paths = [path for name in self.names for path in self.paths(name)]
        twice = sorted({path for path in paths if paths.count(path) > 1})
        if twice:
            raise ValueError(f"{twice[0]} is uncertain twice: give it one distribution")
        if not paths:
            raise ValueError('nothing is uncertain: give a path and a distribution, {"A.length": Normal(20.8, 0.05)}')
        for (a, b), r in self.correlation.items():
            for name in (a, b):
                if name not in self.single:
                    raise KeyError(f"correlation: {name!r} is none of the uncertain numbers {', '.join(self.single)}")
            if a == b or not -1 < r < 1:
                raise ValueError(f"correlation of {a!r} and {b!r} must be between -1 and 1, got {r:g}")
        if self.correlation:
            _ = self._root

    @property
    def names(self) -> tuple[str, ...]:
        """The columns of the table of samples."""
        return (*self.single, *(name for group in self.joint for name in group.names))

    def paths(self, name: str) -> tuple[str, ...]:
        """The paths of the numbers that a column drives."""
        return self.shared.get(name, (name,))

    @property
    def dims(self) -> int:
        """How many uniform numbers a lane takes."""
        return len(self.single) + sum(group.dims for group in self.joint)

    @property
    def independent(self) -> bool:
        """Whether every column has its own uniform number, which variance-based sensitivity indices require."""
        return not self.correlation and not self.joint

    @functools.cached_property
    def _root(self) -> np.ndarray:
        names, matrix = list(self.single), np.eye(len(self.single))
        for (a, b), r in self.correlation.items():
            matrix[names.index(a), names.index(b)] = matrix[names.index(b), names.index(a)] = r
        return correlation_root(matrix, "correlation")

    def values(self, u: np.ndarray) -> np.ndarray:
        """Numbers in SI, shape (lanes, names), from uniform ones, shape (lanes, dims); each row from its row alone."""
        count, columns = len(self.single), []
        scores = u[:, :count]
        if self.correlation:
            from scipy.special import ndtr, ndtri

            scores = ndtr(correlate(ndtri(scores), self._root))
        for j, distribution in enumerate(self.single.values()):
            columns.append(distribution.quantile(scores[:, j])[:, None])
        for group in self.joint:
            columns.append(group.values(u[:, count : count + group.dims]))
            count += group.dims
        return np.concatenate(columns, axis=1)


def from_fit(fit, names=None) -> Uncertain:
    """What a fit knows of its parameters: the Laplace approximation of its posterior.

    Args: fit: a `Fit`; names: which of its parameters (default: all that have an interval).
    Returns: each parameter normal or log-normal, whichever its 95 % interval is symmetric in, with the correlations of
        the fit between them.
    Raises: ValueError for a parameter that the fit left open, which must be given a distribution by hand.
    Reference: MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, chapter 27.
    """
    known = list(fit.parameters)
    chosen = [name for name in known if fit.parameters[name].kind == "interval"] if names is None else list(names)
    single: dict[str, AbstractDistribution] = {}
    for name in chosen:
        if name not in fit.parameters:
            raise KeyError(f"the fit has no parameter {name!r}; it has {', '.join(known)}")
        if fit.parameters[name].kind != "interval":
            raise ValueError(f"{name}: the fit left it open, so that it has no standard deviation: give a distribution")
        single[name] = _marginal(fit.parameters[name])
    places = [known.index(name) for name in chosen]
    pairs = {
        (chosen[i], chosen[j]): float(fit.correlations[places[i], places[j]])
        for i in range(len(chosen))
        for j in range(i)
    }
    return Uncertain(single, correlation={pair: r for pair, r in pairs.items() if r != 0.0})


def _marginal(estimate) -> AbstractDistribution:
    """Normal, or log-normal where the interval of an estimate is symmetric in the logarithm."""
    low, high = estimate.ci95
    skewed = low > 0 and abs(np.log(high * low / estimate.value**2)) < abs(high + low - 2 * estimate.value) / (
        high - low
    )
    if skewed and estimate.value > 0:
        return LogNormal(estimate.value, estimate.sd / estimate.value)
    return Normal(estimate.value, estimate.sd)
