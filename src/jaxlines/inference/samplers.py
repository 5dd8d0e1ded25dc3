"""Where the lanes of a sweep lie: uniform numbers as a pure function of seed and index, so that any machine can make
any of them, in any order, twice, with the same result."""

import abc
import dataclasses
import functools
import warnings
from typing import ClassVar

import numpy as np

BLOCK = 1024
"""Rows that one state of the counter-based generator makes."""

SOBOL_BITS = 30
_TAGS = {"monte_carlo": 1, "morris": 2, "shapley": 3, "latin_hypercube": 4}


class AbstractSampler(abc.ABC):
    """Uniform numbers by index.

    Class attributes: extendable: whether more lanes can be added without changing those that are there; independent:
    whether every column must have its own uniform number.
    """

    extendable: ClassVar[bool] = True
    independent: ClassVar[bool] = False

    @abc.abstractmethod
    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers in (0, 1) of the lanes start..stop, shape (stop - start, dims)."""

    def block(self, dims: int) -> int:
        """How many lanes belong together; counts are multiples of it."""
        return 1

    def total(self, dims: int) -> int | None:
        """How many lanes there are, where the sampler fixes it."""
        return None


def _generator(seed: int, kind: str, block: int) -> np.random.Generator:
    """The generator of a block (Philox: a function of key and counter)."""
    return np.random.Generator(np.random.Philox(key=[seed, _TAGS[kind]], counter=[0, block, 0, 0]))


def _open(u: np.ndarray, bits: int) -> np.ndarray:
    """Multiples of 2^-bits in [0, 1) moved by half a step, so that no quantile is infinite."""
    return np.minimum(u + 0.5 ** (bits + 1), 1.0 - 2.0**-53)


@dataclasses.dataclass(frozen=True)
class MonteCarlo(AbstractSampler):
    """Independent random lanes, by a counter-based generator.

    Reference: Salmon and others, "Parallel random numbers: as easy as 1, 2, 3", 2011 (Philox).
    """

    seed: int = 0

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers, shape (stop - start, dims)."""
        first, last = start // BLOCK, (stop - 1) // BLOCK
        rows = [_generator(self.seed, "monte_carlo", b).random((BLOCK, dims)) for b in range(first, last + 1)]
        return _open(np.concatenate(rows)[start - first * BLOCK : stop - first * BLOCK], 53)


def _sobol(start: int, stop: int, dims: int, seed: int) -> np.ndarray:
    """Points of a scrambled Sobol sequence."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(dims, scramble=True, bits=SOBOL_BITS, rng=np.random.default_rng(seed))
    if start:
        sequence.fast_forward(start)
    with warnings.catch_warnings():  # of counts that are no power of two: a chunk is a piece of one sequence
        warnings.simplefilter("ignore", UserWarning)
        return _open(sequence.random(stop - start), SOBOL_BITS)


@dataclasses.dataclass(frozen=True)
class Sobol(AbstractSampler):
    """Lanes that fill space evenly (scrambled Sobol sequence); best with a power of two of them.

    Reference: Owen, "Randomly permuted (t,m,s)-nets and (t,s)-sequences", 1995; Joe and Kuo, 2008 (directions).
    """

    seed: int = 0

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers, shape (stop - start, dims)."""
        return _sobol(start, stop, dims, self.seed)


@functools.lru_cache(maxsize=2)
def _hypercube(seed: int, count: int, dims: int) -> np.ndarray:
    from scipy.stats import qmc

    return qmc.LatinHypercube(dims, rng=np.random.default_rng([seed, _TAGS["latin_hypercube"]])).random(count)


@dataclasses.dataclass(frozen=True)
class LatinHypercube(AbstractSampler):
    """One lane in each of `count` equal slices of every column (count: of the sweep). It cannot be extended.

    Reference: McKay, Beckman and Conover, "A comparison of three methods ...", Technometrics 21, 1979.
    """

    seed: int = 0
    count: int | None = None
    extendable: ClassVar[bool] = False

    def total(self, dims: int) -> int | None:
        """Its count."""
        return self.count

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers, shape (stop - start, dims)."""
        if self.count is None:
            raise ValueError("LatinHypercube needs to know the count of lanes")
        return np.clip(_hypercube(self.seed, self.count, dims)[start:stop], 2.0**-54, 1.0 - 2.0**-53)


@dataclasses.dataclass(frozen=True)
class Grid(AbstractSampler):
    """All combinations of some levels of every column: level k of m lies at the probability (k + 1/2)/m.

    With `Discrete` distributions and as many levels as values, these are all combinations of the values.
    Args: levels: of every column, in the order of the columns. The last column varies fastest.
    """

    levels: tuple[int, ...]
    extendable: ClassVar[bool] = False
    independent: ClassVar[bool] = True

    def __post_init__(self):
        object.__setattr__(self, "levels", tuple(self.levels))
        if not self.levels or any(not isinstance(m, int) or m < 1 for m in self.levels):
            raise ValueError(f"Grid: every column needs a whole number of levels, 1 or more, got {self.levels}")

    def total(self, dims: int) -> int | None:
        """The number of combinations."""
        if dims != len(self.levels):
            raise ValueError(f"Grid: {dims} columns need {dims} numbers of levels, got {len(self.levels)}")
        return int(np.prod([int(m) for m in self.levels], dtype=object))

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers, shape (stop - start, dims)."""
        levels = np.unravel_index(np.arange(start, stop), self.levels)
        return (np.stack(levels, axis=1) + 0.5) / np.asarray(self.levels)


@dataclasses.dataclass(frozen=True)
class Rows(AbstractSampler):
    """Every row of a table of cases once, in its order (see `Draws`)."""

    count: int
    extendable: ClassVar[bool] = False

    def total(self, dims: int) -> int | None:
        """The number of rows."""
        return self.count

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """The middles of the shares of the rows, shape (stop - start, 1)."""
        return ((np.arange(start, stop) + 0.5) / self.count)[:, None]


@dataclasses.dataclass(frozen=True)
class SobolIndices(AbstractSampler):
    """Lanes from which first, total and, with `second_order`, second order Sobol indices follow.

    Blocks of dims + 2 (2 dims + 2) lanes: A, A with column j of B, (B with column j of A,) B.
    Reference: Saltelli and others, "Variance based sensitivity analysis of model output", 2010.
    """

    seed: int = 0
    second_order: bool = False
    independent: ClassVar[bool] = True

    def block(self, dims: int) -> int:
        """Lanes of one pair of base points."""
        return 2 * dims + 2 if self.second_order else dims + 2

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers, shape (stop - start, dims)."""
        size = self.block(dims)
        first, last = start // size, (stop - 1) // size
        base = _sobol(first, last + 1, 2 * dims, self.seed)
        index = np.arange(start, stop)
        row, place = index // size - first, index % size
        from_b = np.zeros((stop - start, dims), dtype=bool)
        column = np.arange(dims)
        from_b |= (place[:, None] - 1) == column
        if self.second_order:
            swapped = (place > dims) & (place < size - 1)
            from_b |= swapped[:, None] & ((place[:, None] - 1 - dims) != column)
        from_b |= (place == size - 1)[:, None]
        return np.where(from_b, base[row, dims:], base[row, :dims])


class _Trajectories(AbstractSampler):
    """Lanes in trajectories of dims + 1, in which one column after the other changes."""

    independent: ClassVar[bool] = True

    def block(self, dims: int) -> int:
        """Lanes of one trajectory."""
        return dims + 1

    @abc.abstractmethod
    def trajectory(self, number: int, dims: int) -> np.ndarray:
        """The uniform numbers of one trajectory, shape (dims + 1, dims)."""

    def uniforms(self, start: int, stop: int, dims: int) -> np.ndarray:
        """Uniform numbers, shape (stop - start, dims)."""
        size = self.block(dims)
        first, last = start // size, (stop - 1) // size
        rows = np.concatenate([self.trajectory(t, dims) for t in range(first, last + 1)])
        return rows[start - first * size : stop - first * size]


@dataclasses.dataclass(frozen=True)
class Morris(_Trajectories):
    """Trajectories on a coarse grid, for screening many columns with few lanes.

    Level k of m lies at the probability (k + 1/2)/m, so that distributions without ends have finite levels.
    Reference: Morris, "Factorial sampling plans for preliminary computational experiments", Technometrics 33, 1991.
    """

    seed: int = 0
    levels: int = 4

    def __post_init__(self):
        if self.levels < 2 or self.levels % 2:
            raise ValueError(f"Morris: the number of levels must be even, got {self.levels}")

    def trajectory(self, number: int, dims: int) -> np.ndarray:
        """One trajectory: every column moves once by half of the levels, in random order, up or down."""
        random, half = _generator(self.seed, "morris", number), self.levels // 2
        low, up = random.integers(half, size=dims), random.random(dims) < 0.5
        moved = np.zeros((dims + 1, dims), dtype=bool)
        moved[1:][np.arange(dims)[:, None] >= np.argsort(random.permutation(dims))[None, :]] = True
        return (low + half * (moved == up) + 0.5) / self.levels


@dataclasses.dataclass(frozen=True)
class ShapleyEffects(_Trajectories):
    """Trajectories from one random point to another, one column after the other in random order.

    Reference: Goda, "A simple algorithm for global sensitivity analysis with Shapley effects", 2021.
    """

    seed: int = 0

    def trajectory(self, number: int, dims: int) -> np.ndarray:
        """One trajectory."""
        random = _generator(self.seed, "shapley", number)
        first, second = _open(random.random((2, dims)), 53)
        moved = np.arange(dims + 1)[:, None] > random.permutation(dims)[None, :]
        return np.where(moved, second, first)
