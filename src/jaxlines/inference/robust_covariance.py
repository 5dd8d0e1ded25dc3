"""Intervals where residuals are not white: clusters of recordings, moving blocks, autoregression; a rule to choose."""

import dataclasses

import numpy as np

from jaxlines.inference.bootstrap import (
    Shifted as Shifted,
    block_bootstrap as block_bootstrap,
    block_length as block_length,
)
from jaxlines.inference.curvature import gauss_newton_covariance, noise_variance
from jaxlines.inference.generalised import Whitened, solve_with_autoregression
from jaxlines.inference.least_squares import LeastSquaresProblem, Solution
from jaxlines.inference.scatter import Scatter as Scatter, between_recordings as between_recordings
from jaxlines.inference.stated_noise import MANY_RECORDINGS as MANY_RECORDINGS, state_noise
from jaxlines.inference.uncertainty import student_factor as student_factor


def sandwich_covariance(residuals, jacobian, clusters) -> np.ndarray:
    """(J'J)^-1 (sum_c s_c s_c') (J'J)^-1 with s_c = J_c' r_c, times G/(G - 1) (n - 1)/(n - p).

    Right for any correlation within a cluster when clusters are independent and many (`MANY_RECORDINGS`).

    Args: residuals, shape (rows,); jacobian, shape (rows, parameters); clusters: integers, -1 for priors, whose
    information is taken as it is.
    Reference: Liang and Zeger, Biometrika 73, 1986; Cameron and Miller, 2015.
    Raises: ValueError for fewer than two clusters.
    """
    names = np.unique(clusters[clusters >= 0])
    if names.size < 2:
        raise ValueError(f"a covariance clustered by recording needs at least two recordings, got {names.size}")
    bread = gauss_newton_covariance(jacobian)
    scores = np.stack([jacobian[clusters == c].T @ residuals[clusters == c] for c in names])
    rows, count = int(np.sum(clusters >= 0)), jacobian.shape[1]
    factor = names.size / (names.size - 1) * (rows - 1) / max(rows - count, 1)
    prior = jacobian[clusters < 0]
    return bread @ (factor * scores.T @ scores + prior.T @ prior) @ bread


@dataclasses.dataclass(frozen=True)
class NoiseStatement:
    """How uncertain estimates are, by which model of the noise, and why.

    Fields: method: "white", "clusters", "autoregressive" or "blocks"; x: estimates in coordinates (those of generalised
    least squares with "autoregressive"); covariance of the coordinates; freedom: degrees of freedom of each variance;
    sentence: what was done and why; whiteness_p; scatter between recordings, None for a single one; whitened: the
    problem with its noise whitened, where that was done, for likelihood intervals.
    """

    method: str
    x: np.ndarray
    covariance: np.ndarray
    freedom: np.ndarray
    sentence: str
    whiteness_p: float
    scatter: Scatter | None
    whitened: tuple[Whitened, Solution] | None = None

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the coordinates."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def factor(self) -> np.ndarray:
        """95 % intervals are x +- factor * sd: Student's t, shape (parameters,)."""
        return student_factor(self.freedom)


def generalised_freedom(whitened: Whitened, jacobian) -> np.ndarray:
    """Degrees of freedom of the variances (J'V^-1 J)^-1 of generalised least squares; jacobian: of the plain rows."""

    def variances(models) -> np.ndarray:
        other = dataclasses.replace(whitened, noise=whitened.noise._replace(models=models))
        return np.diag(gauss_newton_covariance(other.whitened(jacobian)))

    return whitened.noise.freedom(variances)


def uncertainty_under_noise(
    problem: LeastSquaresProblem, solution: Solution, *, noise: str = "estimated", draws: int = 200, seed: int = 0
) -> NoiseStatement:
    """The covariance that the residuals allow, by the rule of `state_noise`.

    With autoregressive noise the estimates are those of generalised least squares, found by another search.

    Args: noise: as in `profiles.interval`; draws, seed of the bootstrap.
    """
    recordings = np.unique(problem.recording[problem.recording >= 0]).size
    count, rows = solution.x.size, solution.residuals
    variance = noise_variance(rows, count, noise)
    scatter = between_recordings(problem, solution) if recordings > 1 else None
    stated = state_noise(problem, rows, solution.jacobian, variance=variance, known=noise == "known")
    x, whitened = solution.x, None
    freedom = stated.freedom(np.zeros((count, rows.size))) if stated.fitted is None else np.zeros(count)
    if stated.method == "white":
        covariance = gauss_newton_covariance(solution.jacobian, variance)
    elif stated.method == "clusters":
        covariance = sandwich_covariance(rows, solution.jacobian, problem.recording)
    elif stated.method == "autoregressive":
        whitened = solve_with_autoregression(problem, solution)
        x, covariance = whitened[1].x, gauss_newton_covariance(whitened[1].jacobian)
        freedom = generalised_freedom(whitened[0], problem.jacobian(x))
    else:
        drawn = block_bootstrap(problem, solution, count=draws, refit=False, seed=seed)
        covariance = np.atleast_2d(np.cov(drawn.T))
    return NoiseStatement(stated.method, x, covariance, freedom, stated.sentence, stated.whiteness_p, scatter, whitened)
