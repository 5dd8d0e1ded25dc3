"""Which model of the noise the residuals of a fit call for, and what that makes of the uncertainty."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlines.inference.bootstrap import block_length, draw_blocks
from jaxlines.inference.generalised import channel_noise
from jaxlines.inference.least_squares import LeastSquaresProblem
from jaxlines.inference.noise_models import Autoregression, carry, series_of, whiten, whiteness
from jaxlines.inference.restricted_likelihood import NoiseFit
from jaxlines.inference.uncertainty import WHITE_LIMIT, p_value_text

MANY_RECORDINGS = 20
"""Recordings from which a covariance clustered by recording is trusted (fewer make it too small: Cameron and Miller,
"A practitioner's guide to cluster-robust inference", Journal of Human Resources 50, 2015)."""

METHODS = ("white", "clusters", "autoregressive", "blocks")


@dataclasses.dataclass(frozen=True)
class StatedNoise:
    """The noise of a fit as its residuals show it.

    Fields: method: one of `METHODS`; sentence: what is assumed and why; whiteness_p: p-value that the residuals are
    white, NaN where they are too few to tell; fitted: the autoregressive models, else None; problem, rows: residuals at
    the optimum; variance of the rows where they are white; lost: number of parameters; known: whether noise levels were
    given; draws, seed: of the bootstrap.
    """

    method: str
    sentence: str
    whiteness_p: float
    fitted: NoiseFit | None
    problem: LeastSquaresProblem = dataclasses.field(repr=False)
    rows: np.ndarray = dataclasses.field(repr=False)
    variance: float = 1.0
    lost: int = 0
    known: bool = False
    draws: int = 400
    seed: int = 0

    @property
    def models(self) -> tuple[Autoregression, ...]:
        """The autoregressive noise of each channel; none with another method."""
        return self.fitted.models if self.fitted is not None else ()

    def spread(self, gain) -> np.ndarray:
        """Covariance of gain @ noise for linear combinations of rows, gain (m, rows), shape (m, m)."""
        if self.method == "white":
            return self.variance * gain @ gain.T
        if self.method == "autoregressive":
            return self._carried(gain, self.models)
        if self.method == "clusters":
            return self._clustered(gain)
        return self._drawn(gain)

    def freedom(self, gain) -> np.ndarray:
        """Degrees of freedom of the variances on the diagonal of `spread`, shape (m,): for Student's t."""
        count = gain.shape[0]
        if self.fitted is not None:
            found = self.fitted.freedom(lambda models: np.diag(self._carried(gain, models)))
            return np.minimum(found, max(self.rows.size - self.lost, 1))
        if self.method == "clusters":
            return np.full(count, np.unique(self.problem.recording[self.problem.recording >= 0]).size - 1.0)
        if self.known or self.method == "blocks":
            return np.full(count, np.inf)
        return np.full(count, float(max(self.rows.size - self.lost, 1)))

    def log_likelihood(self) -> float | None:
        """ln of the density of the rows under the autoregressive models; None with another method."""
        if self.fitted is None:
            return None
        total = 0.0
        for piece in series_of(self.problem):
            model = self.models[int(self.problem.channel[piece[0]])]
            white, roots = whiten(self.rows[piece], model), whiten(np.eye(piece.size, model.order), model)
            first = np.diag(roots)  # whitening is triangular: ln of its determinant
            scale = float(np.sum(np.log(first))) - (piece.size - first.size) * np.log(model.sd)
            total += scale - 0.5 * float(white @ white) - 0.5 * piece.size * np.log(2.0 * np.pi)
        return total

    def _priors(self, gain) -> np.ndarray:
        """The part of the priors, whose rows have variance 1."""
        own = gain[:, self.problem.recording < 0]
        return own @ own.T

    def _carried(self, gain, models: Sequence[Autoregression]) -> np.ndarray:
        """G V G' with V of autoregressive noise."""
        found = self._priors(gain)
        for piece in series_of(self.problem):
            carried = carry(gain[:, piece].T, models[int(self.problem.channel[piece[0]])])
            found = found + carried.T @ carried
        return found

    def _clustered(self, gain) -> np.ndarray:
        """sum_c (G_c r_c)(G_c r_c)', recordings c being independent, with the factor of `sandwich_covariance`."""
        recording = self.problem.recording
        names = np.unique(recording[recording >= 0])
        told = np.stack([gain[:, recording == c] @ self.rows[recording == c] for c in names], axis=1)
        count = int(np.sum(recording >= 0))
        factor = names.size / (names.size - 1) * (count - 1) / max(count - self.lost, 1)
        return factor * told @ told.T + self._priors(gain)

    def _drawn(self, gain) -> np.ndarray:
        """Covariance over draws of moving blocks of residuals."""
        rng, pieces = np.random.default_rng(self.seed), series_of(self.problem)
        total = sum(piece.size for piece in pieces)
        enlarge = np.sqrt(total / max(total - self.lost, 1))
        lengths = [block_length(self.rows[piece]) for piece in pieces]
        found = np.zeros((self.draws, gain.shape[0]))
        for draw in range(self.draws):
            for piece, length in zip(pieces, lengths, strict=True):
                found[draw] += gain[:, piece] @ (enlarge * draw_blocks(self.rows[piece], length, rng))
        return np.atleast_2d(np.cov(found.T)) + self._priors(gain)


def _seen_by_many(problem: LeastSquaresProblem, jacobian) -> bool:
    """Whether every parameter is told by so many recordings that their scatter says how sure it is."""
    names = np.unique(problem.recording[problem.recording >= 0])
    if names.size < MANY_RECORDINGS:
        return False
    seen = np.stack([np.any(jacobian[problem.recording == name] != 0.0, axis=0) for name in names])
    return bool(np.all(seen.sum(axis=0) >= MANY_RECORDINGS))


def state_noise(
    problem: LeastSquaresProblem,
    residuals: np.ndarray,
    jacobian: np.ndarray,
    *,
    variance: float = 1.0,
    known: bool = False,
    autoregression: bool = True,
    draws: int = 400,
    seed: int = 0,
) -> StatedNoise:
    """Choose the noise model: white if the residuals are white, else the first that applies of

    clusters by recording (where `MANY_RECORDINGS` or more tell of every parameter), autoregressive noise (if it leaves
    white residuals), moving blocks. Nothing is simulated.

    Args: residuals, jacobian: rows at the optimum and their slopes; variance: of white rows; known: whether noise
    levels were given; autoregression: whether rows are such that it makes sense (not those of a robust loss).
    """
    p, count = whiteness(problem, residuals), jacobian.shape[1]

    def stated(method: str, sentence: str, fitted=None) -> StatedNoise:
        return StatedNoise(method, sentence, p, fitted, problem, residuals, variance, count, known, draws, seed)

    if np.isnan(p):
        return stated("white", "residuals are too few to tell whether they are white: the intervals take them to be")
    if p > WHITE_LIMIT:
        return stated("white", f"residuals are white ({p_value_text(p)})")
    why = f"residuals are not white ({p_value_text(p)})"
    if _seen_by_many(problem, jacobian):
        recordings = np.unique(problem.recording[problem.recording >= 0]).size
        return stated(
            "clusters", f"{why}: the covariance is that of {recordings} independent recordings, whatever their noise"
        )
    tried = ""
    if autoregression:
        fitted = channel_noise(problem, residuals, jacobian)
        orders = ", ".join(str(model.order) for model in fitted.models)
        left = whiteness(problem, _whitened(problem, residuals, fitted.models))
        if left > WHITE_LIMIT:
            word = f"{why}: the noise is taken as autoregressive of order {orders}, which leaves white ones "
            return stated("autoregressive", word + f"({p_value_text(left)})", fitted)
        tried = f", nor after autoregression of order {orders}"
    word = f"{why}{tried}: the covariance is from moving blocks. "
    return stated(
        "blocks", word + "A term that the model lacks may be the cause, and then no interval covers the truth"
    )


def _whitened(problem: LeastSquaresProblem, residuals, models) -> np.ndarray:
    """Residuals with the correlation of the models taken out."""
    white = np.array(residuals, dtype=float)
    for piece in series_of(problem):
        white[piece] = whiten(residuals[piece], models[int(problem.channel[piece[0]])])
    return white
