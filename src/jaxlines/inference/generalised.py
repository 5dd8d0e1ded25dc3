"""Generalised least squares: fits whose noise is autoregressive."""

import dataclasses
import functools

import numpy as np

from jaxlines.inference.least_squares import AbstractRewritten, LeastSquaresProblem, Solution, solve
from jaxlines.inference.noise_models import Autoregression, fit_autoregression, series_of, whiten
from jaxlines.inference.restricted_likelihood import NoiseFit, restricted_fit


@dataclasses.dataclass(frozen=True)
class Whitened(AbstractRewritten):
    """A problem whose rows are made uncorrelated by a noise model a channel: generalised least squares.

    Fields: plain: the problem; noise: the models, one `Autoregression` a channel, and how sure they are.
    """

    noise: NoiseFit

    @functools.cached_property
    def _pieces(self) -> list[np.ndarray]:
        return series_of(self.plain)

    def whitened(self, rows) -> np.ndarray:
        """Rows, or their slopes, with the correlation taken out."""
        white = np.array(rows, dtype=float)
        for piece in self._pieces:
            white[piece] = whiten(rows[piece], self.noise.models[self.plain.channel[piece[0]]])
        return white

    def residuals(self, x) -> np.ndarray:
        """Whitened rows of variance 1."""
        return self.whitened(self.plain.residuals(x))

    def jacobian(self, x) -> np.ndarray:
        """Their slopes."""
        return self.whitened(self.plain.jacobian(x))


def channel_noise(problem: LeastSquaresProblem, residuals, jacobian, max_order: int = 12) -> NoiseFit:
    """One autoregressive model a channel: its order from the residuals by BIC, its numbers by restricted likelihood."""
    pieces, models, by_channel = series_of(problem), [], []
    for channel in range(int(problem.channel.max(initial=0)) + 1):
        own = [rows for rows in pieces if problem.channel[rows[0]] == channel]
        share = sum(rows.size for rows in own) / max(sum(rows.size for rows in pieces), 1)
        rows = [residuals[piece] for piece in own]
        model = fit_autoregression(rows, max_order, round(share * len(problem.labels))) if own else None
        models.append(model or Autoregression(np.zeros(0), 1.0))
        by_channel.append(own)
    return restricted_fit(residuals, jacobian, by_channel, models, np.flatnonzero(problem.recording < 0))


def solve_with_autoregression(
    problem: LeastSquaresProblem, solution: Solution, *, max_order: int = 12, rounds: int = 3, tolerance: float = 1e-9
) -> tuple[Whitened, Solution]:
    """Fit again with autoregressive noise: noise models by restricted likelihood, whitened fit, a few rounds.

    Returns: the whitened problem, its noise of variance 1, and its solution, whose (J'J)^-1 is the covariance.
    Reference: feasible generalised least squares; Seber and Wild, "Nonlinear Regression", 1989, chapter 6.
    """
    whitened, end = (
        Whitened(problem, channel_noise(problem, solution.residuals, solution.jacobian, max_order)),
        solution,
    )
    for turn in range(rounds):
        if turn:
            noise = channel_noise(problem, problem.residuals(end.x), problem.jacobian(end.x), max_order)
            whitened = Whitened(problem, noise)
        before, end = end.x, solve(whitened, end.x, tolerance=tolerance)
        if np.allclose(end.x, before, rtol=1e-7, atol=0.0):
            break
    return whitened, end
