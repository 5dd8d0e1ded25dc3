"""Many sparse linear systems of one pattern side by side: (diagonal - J) x = r, solved without pivoting, lanes last.

Small systems are eliminated number by number in an order that fills in little; chains by blocks along the chain, a
scan each way; what is neither by LU with pivoting of the dense matrices. Lanes never meet: where a pivot is zero or
not finite, that lane's solution is not finite, and no other is disturbed. Without pivoting the diagonal must not be
small against what is eliminated with it; in an implicit step it is 1/(gamma h) plus the damping of a state's own.

Reference: Markowitz, "The elimination form of the inverse", Management Science 3, 1957; Cuthill and McKee, "Reducing
the bandwidth of sparse symmetric matrices", Proc. 24th Nat. Conf. ACM, 1969; Golub and Van Loan, "Matrix
Computations", 4th ed. 2013, section 4.5 (block tridiagonal systems).
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

SMALL = 20
"""Up to so many unknowns are eliminated one by one whatever their pattern."""

WIDEST = 8
"""Largest bandwidth of a chain."""

MOST_OPERATIONS = 1500
"""Up to so many multiplications of an elimination one by one; more of them compile slowly."""


class Pivot(NamedTuple):
    """One step of an elimination: the pivot, the rows below it that have an entry in its column, and its row."""

    index: int
    below: tuple[int, ...]
    right: tuple[int, ...]


def elimination_order(pattern: np.ndarray) -> list[Pivot]:
    """Pivots on the diagonal, each the one that fills in least of those left (Markowitz)."""
    full = np.asarray(pattern, dtype=bool) | np.eye(len(pattern), dtype=bool)
    left, order = list(range(len(full))), []
    while left:
        inside = full[np.ix_(left, left)]
        costs = (inside.sum(axis=0) - 1) * (inside.sum(axis=1) - 1)
        k = left.pop(int(np.argmin(costs)))
        below, right = [i for i in left if full[i, k]], [j for j in left if full[k, j]]
        full[np.ix_(below, right)] = True
        order.append(Pivot(k, tuple(below), tuple(right)))
    return order


class Chain(NamedTuple):
    """Unknowns in an order along a chain, cut into blocks of a size that couple to their neighbours only.

    order: the unknown at each place, -1 for places that fill the last block, shape (blocks, size).
    """

    order: np.ndarray

    def places(self) -> np.ndarray:
        """The place of each unknown in the flattened order."""
        flat = self.order.ravel()
        places = np.zeros(np.count_nonzero(flat >= 0), dtype=int)
        places[flat[flat >= 0]] = np.nonzero(flat >= 0)[0]
        return places


def chain_order(pattern: np.ndarray) -> Chain:
    """The unknowns along a chain of least bandwidth (reverse Cuthill-McKee), in blocks as large as that bandwidth."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    both = np.asarray(pattern, dtype=bool) | np.asarray(pattern, dtype=bool).T
    order = np.asarray(reverse_cuthill_mckee(csr_array(both), symmetric_mode=True), dtype=int)
    rows, columns = np.nonzero(both[np.ix_(order, order)])
    size = max(int(np.max(np.abs(rows - columns), initial=0)), 1)
    filled = np.full(-(-len(order) // size) * size, -1)
    filled[: len(order)] = order
    return Chain(filled.reshape(-1, size))


class Elimination(NamedTuple):
    """How systems of a pattern are solved.

    factor(entries, diagonal) prepares what solve(factors, right) needs. by_rows: whether right-hand sides and solutions
    are lists of rows (lanes,), else one array (unknowns, lanes).
    """

    method: str
    by_rows: bool
    factor: Callable[["Entries", Any], Any]
    solve: Callable[[Any, Any], Any]


class Entries(NamedTuple):
    """The entries of a sparse matrix in every lane: entry k of all stands at (rows[k], columns[k]).

    get(k): that entry, shape (lanes,); take(indices): several at once, shape (*indices', lanes), 0 for index -1.
    """

    rows: np.ndarray
    columns: np.ndarray
    get: Callable[[int], Any]
    take: Callable[[np.ndarray], Any]

    def numbered(self, size: int) -> np.ndarray:
        """The number of the entry at each place of the matrix, -1 where there is none."""
        numbers = np.full((size, size), -1)
        numbers[self.rows, self.columns] = np.arange(len(self.rows))
        return numbers


def plan_elimination(pattern: np.ndarray) -> Elimination:
    """The elimination for a pattern: one by one ("rows"), along a chain ("chain"), or "dense"."""
    order, size = elimination_order(pattern), len(pattern)
    operations = sum(len(p.below) * (len(p.right) + 1) for p in order)
    if size <= SMALL and operations <= MOST_OPERATIONS:
        return rows_elimination(size, order)
    chain = chain_order(pattern)
    if chain.order.shape[1] <= WIDEST:
        return chain_elimination(chain)
    return rows_elimination(size, order) if operations <= MOST_OPERATIONS else dense_elimination(size)


def rows_elimination(size: int, order: list[Pivot]) -> Elimination:
    """One pivot after the other, every entry an array of lanes."""
    factor = functools.partial(_factor_rows, size, order)
    return Elimination("rows", True, factor, functools.partial(_solve_rows, order))


def _factor_rows(size: int, order: list[Pivot], entries: Entries, diagonal) -> dict:
    """Upper rows, shares of them to be taken off below, and reciprocals of the pivots, by (row, column)."""
    places = zip(entries.rows.tolist(), entries.columns.tolist(), strict=True)
    matrix = {place: -entries.get(k) for k, place in enumerate(places)}
    for i in range(size):
        matrix[i, i] = diagonal + matrix.get((i, i), 0.0)
    for k, below, right in order:
        matrix[k, k] = 1.0 / matrix[k, k]
        for i in below:
            matrix[i, k] = matrix[i, k] * matrix[k, k]
            for j in right:
                matrix[i, j] = matrix.get((i, j), 0.0) - matrix[i, k] * matrix[k, j]
    return matrix


def _solve_rows(order: list[Pivot], matrix: dict, given: list) -> list:
    """Forward and backward substitution."""
    x = list(given)
    for k, below, _ in order:
        for i in below:
            x[i] = x[i] - matrix[i, k] * x[k]
    for k, _, right in reversed(order):
        for j in right:
            x[k] = x[k] - matrix[k, j] * x[j]
        x[k] = matrix[k, k] * x[k]
    return x


class ChainFactors(NamedTuple):
    """Blocks (blocks, size, size, lanes): inverses of the pivots, the blocks before, and after, these reduced."""

    inverse: Any
    before: Any
    after: Any


def chain_elimination(chain: Chain) -> Elimination:
    """Blocks along a chain: D_k' = D_k - L_k D_{k-1}'^-1 U_{k-1}, then a recurrence each way."""
    blocks, size = chain.order.shape
    places = chain.places()

    def block_entries(entries: Entries, shift: int):
        """Entries of each block row in the block column `shift` further on."""
        numbers = np.pad(entries.numbered(len(places)), ((0, 1), (0, 1)), constant_values=-1)
        columns = np.full_like(chain.order, -1)
        inside = slice(max(-shift, 0), blocks - max(shift, 0))
        columns[inside] = chain.order[max(shift, 0) : blocks + min(shift, 0)]
        return -entries.take(numbers[chain.order[:, :, None], columns[:, None, :]])

    def factor(entries: Entries, diagonal) -> ChainFactors:
        before, middle, after = (block_entries(entries, shift) for shift in (-1, 0, 1))
        middle = middle + jnp.eye(size, dtype=middle.dtype)[:, :, None] * diagonal

        def forward(reduced, row):
            before, middle, after = row
            inverse = _inverted(middle - _product(before, reduced))
            reduced = _product(inverse, after)
            return reduced, (inverse, reduced)

        _, (inverse, after) = jax.lax.scan(forward, jnp.zeros_like(middle[0]), (before, middle, after))
        return ChainFactors(inverse, before, after)

    def solve(factors: ChainFactors, rows):
        fill = jnp.zeros((1, *rows.shape[1:]), rows.dtype)
        placed = jnp.concatenate([rows, fill])[chain.order]

        # The products stay inside of the loops: outside, the compiler would work out the right-hand side in each anew.
        def forward(x, row):
            inverse, before, right = row
            x = _applied(inverse, right - _applied(before, x))
            return x, x

        def backward(x, row):
            after, reduced = row
            x = reduced - _applied(after, x)
            return x, x

        nothing = jnp.zeros_like(placed[0])
        _, reduced = jax.lax.scan(forward, nothing, (factors.inverse, factors.before, placed))
        _, found = jax.lax.scan(backward, nothing, (factors.after, reduced), reverse=True)
        return found.reshape(-1, *rows.shape[1:])[places]

    return Elimination("chain", False, factor, solve)


def _applied(matrix, vector):
    """Matrices (..., rows, columns, lanes) times vectors (..., columns, lanes)."""
    columns = range(matrix.shape[-2])
    return sum(matrix[..., j, :] * vector[..., j, None, :] for j in columns)


def _product(a, b):
    """Matrices (..., rows, inner, lanes) times matrices (..., inner, columns, lanes)."""
    return sum(a[..., :, k, None, :] * b[..., k, None, :, :] for k in range(a.shape[-2]))


def _inverted(matrix):
    """Inverses of matrices (size, size, lanes) by Gauss and Jordan's elimination in place, without pivoting."""
    size = len(matrix)
    for k in range(size):
        here = np.arange(size) == k
        pivot = 1.0 / matrix[k, k]
        row, column = matrix[k] * pivot, matrix[:, k]
        inner = matrix - column[:, None] * row[None]
        inner = jnp.where(here[None, :, None], (-column * pivot)[:, None], inner)
        row = jnp.where(here[:, None], pivot, row)
        matrix = jnp.where(here[:, None, None], row[None], inner)
    return matrix


def dense_elimination(size: int) -> Elimination:
    """LU with pivoting of the dense matrices, one lane at a time: right for every pattern, slow."""
    from jax.scipy.linalg import lu_factor, lu_solve

    def factor(entries: Entries, diagonal):
        matrix = -entries.take(entries.numbered(size)) + jnp.eye(size)[:, :, None] * diagonal
        return jax.vmap(lu_factor)(jnp.moveaxis(matrix, -1, 0))

    def solve(factors, rows):
        return jax.vmap(lu_solve)(factors, rows.T).T

    return Elimination("dense", False, factor, solve)
