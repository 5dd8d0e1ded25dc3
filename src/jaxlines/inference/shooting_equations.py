"""Records in windows at some states and parameters, and the sparse equations of a step that ties them together."""

from typing import NamedTuple, Protocol

import numpy as np


class Pieces(NamedTuple):
    """One record in windows at some states and parameters.

    start (d,): the state that the parameters put at the beginning, None where it is free; start_x (d, parameters);
    rows (windows, m): weighted residuals, zero where there are none; row_states (windows, m, d); row_x (windows, m,
    parameters); ends (windows, d): states at the ends of windows; end_states (windows, d, d); end_x (windows, d,
    parameters). NaN for a window that fails.
    """

    start: np.ndarray | None
    start_x: np.ndarray | None
    rows: np.ndarray
    row_states: np.ndarray
    row_x: np.ndarray
    ends: np.ndarray
    end_states: np.ndarray
    end_x: np.ndarray


class Windows(Protocol):
    """Records in windows, as functions of parameters and states.

    labels; lower, upper (parameters,): bounds of their coordinates; units (d,): typical sizes of the states.
    """

    @property
    def labels(self) -> tuple[str, ...]: ...
    @property
    def lower(self) -> np.ndarray: ...
    @property
    def upper(self) -> np.ndarray: ...
    @property
    def units(self) -> np.ndarray: ...
    def evaluate(self, x, states: tuple[np.ndarray, ...]) -> tuple[Pieces, ...]:
        """Every record at parameters and at states, one array (windows, d) a record."""
        ...

    def prior(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Rows of priors and their slopes by the parameters."""
        ...


def gaps(pieces: tuple[Pieces, ...], states: tuple[np.ndarray, ...], units) -> np.ndarray:
    """All gaps in units of the states, shape (gaps, d): at the start where it is known, then between windows."""
    found = []
    for piece, own in zip(pieces, states, strict=True):
        if piece.start is not None:
            found.append((piece.start - own[0])[None])
        found.append(piece.ends[:-1] - own[1:])
    return np.concatenate(found) / units


def _blocks(blocks: np.ndarray, columns: list[int], per_row: list[int], width: int):
    """A sparse matrix of dense blocks (count, d, d): the columns of blocks, and how many blocks each row has."""
    from scipy import sparse

    depth = blocks.shape[-1]
    pointer = np.concatenate([[0], np.cumsum(per_row)]).astype(int)
    shape = (len(per_row) * depth, width * depth)
    return sparse.bsr_matrix((blocks, np.asarray(columns, dtype=int), pointer), shape=shape, blocksize=(depth, depth))


class Equations:
    """The normal equations of the rows and the slopes of the gaps, over parameters first, then states window by window,
    all in units of the states and of the widths between bounds."""

    def __init__(self, windows: Windows, x, pieces: tuple[Pieces, ...], widths):
        from scipy import sparse

        self.count, self.widths = x.size, widths
        prior, prior_x = windows.prior(x)
        prior_x = prior_x * widths
        inner, slope = prior_x.T @ prior_x, prior_x.T @ prior
        own, cross, by_own = [], [], []
        for piece in pieces:
            by_x, by_state = piece.row_x * widths, piece.row_states * windows.units
            turned = by_state.transpose(0, 2, 1)
            inner = inner + np.einsum("kmi,kmj->ij", by_x, by_x)
            slope = slope + np.einsum("kmi,km->i", by_x, piece.rows)
            own.append(turned @ by_state)
            cross.append((turned @ by_x).reshape(-1, x.size))
            by_own.append((turned @ piece.rows[..., None]).ravel())
        own, cross, total = np.concatenate(own), np.concatenate(cross), sum(len(piece.rows) for piece in pieces)
        self.gradient = np.concatenate([slope, *by_own])
        diagonal = _blocks(own, list(range(total)), [1] * total, total)
        self.normal = sparse.bmat([[inner, cross.T], [cross, diagonal]], format="csc")
        self.ties = self._ties(windows, pieces, total)
        self.num_gaps = (total - sum(piece.start is None for piece in pieces)) * windows.units.size

    def _ties(self, windows: Windows, pieces: tuple[Pieces, ...], total: int):
        """Slopes of the gaps, in the order of `gaps`."""
        from scipy import sparse

        units, minus = windows.units, -np.eye(windows.units.size)
        by_x, blocks, columns, per_row, first = [np.zeros((0, self.count))], [], [], [], 0
        for piece in pieces:
            if piece.start_x is not None:
                by_x.append(piece.start_x * self.widths / units[:, None])
                blocks, columns, per_row = [*blocks, minus], [*columns, first], [*per_row, 1]
            for k in range(len(piece.rows) - 1):
                by_x.append(piece.end_x[k] * self.widths / units[:, None])
                blocks += [piece.end_states[k] * units / units[:, None], minus]
                columns, per_row = [*columns, first + k, first + k + 1], [*per_row, 2]
            first += len(piece.rows)
        blocks = np.array(blocks).reshape(-1, units.size, units.size)
        by_states = _blocks(blocks, columns, per_row, total)
        return sparse.csc_matrix(sparse.hstack([sparse.csr_matrix(np.concatenate(by_x)), by_states]))

    def _factored(self, weight: float, damping: float, free: np.ndarray):
        """The damped matrix, and the factors of the equations in the entries that are free."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        diagonal = self.normal.diagonal()
        size = np.maximum(diagonal, 1e-12 * diagonal.max(initial=1e-300)) + 1e-300
        matrix = sparse.csc_matrix(self.normal + sparse.diags(damping * size))
        rest, tie = matrix[free][:, free], self.ties[:, free]
        corner = sparse.identity(self.num_gaps) * (-1.0 / weight**2)
        return matrix, splu(sparse.bmat([[rest, tie.T], [tie, corner]], format="csc"))

    def solve(self, misfit, weight: float, damping: float, held: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        """The step with gaps of that misfit, with some entries held at fixed values."""
        free = np.flatnonzero(~held)
        matrix, factors = self._factored(weight, damping, free)
        right = -(self.gradient + matrix @ fixed)[free]
        below = -(misfit + self.ties @ fixed)
        step = fixed.copy()
        step[free] = factors.solve(np.concatenate([right, below]))[: free.size]
        return step

    def gain(self, step, misfit, weight: float) -> float:
        """What the penalised sum of squares should lose by a step."""
        along = self.ties @ step
        linear = self.gradient @ step + weight**2 * (misfit @ along)
        return -float(linear + 0.5 * (step @ (self.normal @ step) + weight**2 * (along @ along)))

    def covariance(self, weight: float, held: np.ndarray) -> np.ndarray:
        """Covariance of the coordinates for rows of unit noise, (parameters, parameters); zero for those held.

        The inverse of the information that is left when the states follow from the gaps: a block of the inverse of all
        equations, which stays well conditioned where a trajectory over all windows would not.
        """
        moving = np.flatnonzero(~held)
        free = np.concatenate([moving, np.arange(self.count, self.gradient.size)])
        _, factors = self._factored(weight, 1e-14, free)
        right = np.zeros((free.size + self.num_gaps, moving.size))
        right[: moving.size] = np.eye(moving.size)
        found = np.zeros((self.count, self.count))
        found[np.ix_(moving, moving)] = factors.solve(right)[: moving.size]
        return 0.5 * (found + found.T) * np.outer(self.widths, self.widths)
