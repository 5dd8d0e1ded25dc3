"""Bootstrap of fits whose residuals are correlated: blocks of residuals, moved about."""

import dataclasses

import numpy as np

from jaxlines.inference.least_squares import AbstractRewritten, LeastSquaresProblem, Solution, solve
from jaxlines.inference.noise_models import series_of


@dataclasses.dataclass(frozen=True)
class Shifted(AbstractRewritten):
    """A problem whose data are the model's at some point plus other noise: rows r(x) + shift."""

    shift: np.ndarray

    def residuals(self, x) -> np.ndarray:
        """Rows of the plain problem, shifted."""
        return self.plain.residuals(x) + self.shift

    def jacobian(self, x) -> np.ndarray:
        """Slopes of the plain problem."""
        return self.plain.jacobian(x)


def block_length(piece: np.ndarray) -> int:
    """Length of moving blocks, n^(1/3) (6 a^2/(1 - a^2)^2)^(1/3) with a the correlation of neighbours, at least 1.

    Reference: Carlstein, Annals of Statistics 14, 1986; Kuensch, Annals of Statistics 17, 1989.
    """
    centred = piece - piece.mean()
    power = float(centred @ centred)
    a = float(centred[1:] @ centred[:-1]) / power if power > 0 and piece.size > 2 else 0.0
    a = min(abs(a), 0.97)
    ideal = piece.size ** (1.0 / 3.0) * (6.0 * a**2 / (1.0 - a**2) ** 2) ** (1.0 / 3.0)
    return int(np.clip(np.ceil(ideal), 1, max(piece.size // 4, 1)))


def block_bootstrap(
    problem: LeastSquaresProblem,
    solution: Solution,
    *,
    count: int = 200,
    block: int | None = None,
    refit: bool = True,
    seed: int = 0,
) -> np.ndarray:
    """Estimates from data made anew of the fitted model and blocks of its residuals, shape (draws, parameters).

    Blocks are drawn within each recording and channel. Residuals are centred and enlarged by sqrt(n/(n - p)).

    Args: block: samples a block, `block_length` by default; refit: search anew for every draw, or take one
    Gauss-Newton step from the optimum (cheap, and the same to first order). Failed searches are left out.
    """
    rng = np.random.default_rng(seed)
    pieces, rows = series_of(problem), problem.residuals(solution.x)
    total = sum(piece.size for piece in pieces)
    enlarge = np.sqrt(total / max(total - solution.x.size, 1))
    size = np.linalg.norm(solution.jacobian, axis=0)
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(solution.jacobian / size, rcond=1e-12) / size[:, None]
    draws = []
    for _ in range(count):
        drawn = rng.standard_normal(rows.size)  # priors: what was known might as well have been this
        drawn = np.where(problem.recording < 0, rows - drawn, 0.0)
        for piece in pieces:
            drawn[piece] = enlarge * draw_blocks(rows[piece], block or block_length(rows[piece]), rng)
        if not refit:
            draws.append(np.clip(solution.x - inverse @ drawn, problem.lower, problem.upper))
            continue
        end = solve(Shifted(problem, drawn - rows), solution.x, max_evaluations=50)
        if end.ok:
            draws.append(end.x)
    return np.array(draws).reshape(-1, solution.x.size)


def draw_blocks(piece, block: int, rng) -> np.ndarray:
    """A series of the same length from moving blocks of a centred one."""
    block = min(block, piece.size)
    starts = rng.integers(0, piece.size - block + 1, size=-(-piece.size // block))
    series = (piece - piece.mean())[(starts[:, None] + np.arange(block)).ravel()]
    return series[: piece.size]
