"""Curvature of a least-squares problem at its optimum: covariance by Gauss-Newton and by the full Hessian, Laplace."""

import dataclasses

import numpy as np

from jaxlines.inference.least_squares import FunctionProblem, LeastSquaresProblem


def noise_variance(residuals, num_parameters: int, noise: str = "estimated") -> float:
    """Variance of the weighted residuals: 1 when the noise is "known", else sum r^2/(rows - parameters)."""
    if noise not in ("known", "estimated"):
        raise ValueError(f'noise must be "known" or "estimated", got {noise!r}')
    return 1.0 if noise == "known" else float(residuals @ residuals) / max(residuals.size - num_parameters, 1)


def column_scale(jacobian, lower, upper) -> np.ndarray:
    """A size for every coordinate: the width of its bounds, or 1/|column| where they are infinite."""
    width, size = np.asarray(upper) - np.asarray(lower), np.linalg.norm(jacobian, axis=0)
    return np.where(np.isfinite(width), width, 1.0 / np.where(size > 0.0, size, 1.0))


def gauss_newton_covariance(jacobian, variance: float = 1.0) -> np.ndarray:
    """variance * (J'J)^-1 from weighted slopes J, shape (rows, parameters), in the coordinates of its columns.

    Columns are scaled first. A combination that the rows do not determine has infinite variance, and so has every
    parameter in it. Valid when the model is close to linear within a standard error or the residuals are small.
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, singular, right = np.linalg.svd(jacobian / size, full_matrices=False)
    known = singular > 1e-12 * singular[0]
    root = right[known].T / singular[known]
    covariance = variance * (root @ root.T) / np.outer(size, size)
    open_parts = np.any(np.abs(right[~known]) > 1e-6, axis=0)
    if singular.size < size.size:
        open_parts = open_parts | (np.sum(right**2, axis=0) < 1.0 - 1e-6)
    covariance[open_parts, :], covariance[:, open_parts] = np.nan, np.nan
    covariance[open_parts, open_parts] = np.inf
    return covariance


def hessian(problem: LeastSquaresProblem, x) -> np.ndarray:
    """Second derivatives of half the sum of squares, J'J + sum r_i d2 r_i, shape (parameters, parameters).

    Exact for a `FunctionProblem`; else central differences of the exact gradient J'r, to about 1e-6, on steps that
    change the rows by a thousandth of a standard error or so.
    """
    x = np.asarray(x, dtype=float)
    if isinstance(problem, FunctionProblem):
        return problem.hessian(x)
    size = np.linalg.norm(problem.jacobian(x), axis=0)
    steps = np.where(size > 0.0, 1e-2 / np.where(size > 0.0, size, 1.0), 1e-6 * np.maximum(np.abs(x), 1.0))
    steps = np.clip(steps, 1e-7 * np.maximum(np.abs(x), 1e-12), 1e-3 * np.maximum(np.abs(x), 1e-3))
    columns = []
    for i, step in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[i] += sign * step
            ends.append(problem.jacobian(moved).T @ problem.residuals(moved))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    found = np.stack(columns, axis=1)
    return 0.5 * (found + found.T)


def hessian_covariance(second, variance: float = 1.0) -> np.ndarray:
    """variance * H^-1 of the full Hessian.

    Raises: ValueError when it is not positive definite: the point is no strict minimum, or a combination is open.
    """
    size = np.sqrt(np.maximum(np.diag(second), 1e-300))
    values, vectors = np.linalg.eigh(second / np.outer(size, size))
    if not values[0] > 1e-12 * values[-1]:
        raise ValueError(
            f"the Hessian is not positive definite (smallest scaled eigenvalue {values[0]:.2g}): the point is no "
            "strict minimum, or the data leave a combination of parameters open"
        )
    return variance * (vectors / values) @ vectors.T / np.outer(size, size)


@dataclasses.dataclass(frozen=True)
class Laplace:
    """A normal approximation of the posterior, ln p(x) = ln p(mean) - (x - mean)' C^-1 (x - mean)/2.

    Fields: mean; covariance; log_evidence: ln of the integral of exp(-cost), relative to the constants of the
    likelihood, which is comparable between models of the same rows at known noise.
    Reference: MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, chapter 27.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_evidence: float

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draws, shape (count, parameters)."""
        return rng.multivariate_normal(self.mean, self.covariance, size=count, method="eigh")


def laplace(problem: LeastSquaresProblem, x, noise: str = "known") -> Laplace:
    """The Laplace approximation at an optimum inside the bounds. Raises as `hessian_covariance`."""
    rows = problem.residuals(x)
    variance = noise_variance(rows, len(problem.labels), noise)
    covariance = hessian_covariance(hessian(problem, x), variance)
    logdet = float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    return Laplace(np.asarray(x, dtype=float), covariance, -0.5 * float(rows @ rows) / variance + 0.5 * logdet)
