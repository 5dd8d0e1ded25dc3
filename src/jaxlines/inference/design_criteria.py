"""What a designed test is judged by: the covariance that a fit will state, and the D-, A-, E- and c-criterion of it."""

import dataclasses

import numpy as np

from jaxlines.inference.curvature import gauss_newton_covariance

CRITERIA = ("D", "A", "E", "c")
HOWS = ("nominal", "average", "worst")


def covariance_of(information, prior) -> np.ndarray:
    """Covariance of the free parameters, (A^-1 + A^-1 B B' A^-1) with A = M_ff + prior and B = M_fk.

    The second part is what numbers that are held fixed, each in units of its standard uncertainty, add to the result
    (GUM, Type B); it is what `fit` adds for its `known`.

    Args: information: M = R'R of weighted rows R by (free, known) parameters, shape (..., free + known, free + known);
        prior: information before the test, added to M_ff and M_fk, shape (free, free + held), its first part positive
        definite; the first of what is held are the known ones, the others are none of the test's.
    """
    return _parts(information, prior)[0]


def _parts(information, prior) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """C, H = A^-1, B and T = H B B' H; A is scaled to a unit diagonal before it is inverted."""
    size = prior.shape[0]
    both = information[..., :size, :size] + prior[:, :size]
    fixed = np.zeros((*both.shape[:-1], max(prior.shape[1], information.shape[-1]) - size))
    fixed[..., : information.shape[-1] - size] = information[..., :size, size:]
    fixed[..., : prior.shape[1] - size] += prior[:, size:]
    root = 1.0 / np.sqrt(np.diagonal(both, axis1=-2, axis2=-1))
    pair = root[..., :, None] * root[..., None, :]
    inverse = np.linalg.inv(both * pair) * pair
    inverse = 0.5 * (inverse + np.swapaxes(inverse, -1, -2))
    reached = inverse @ fixed
    added = reached @ np.swapaxes(reached, -1, -2)
    return inverse + added, inverse, fixed, added


@dataclasses.dataclass(frozen=True)
class Criterion:
    """ln of a standard deviation that a test leaves, to be made small; V = L' C L is the covariance of what is asked.

        D: ln det V / (2 q), the geometric mean; A: ln(tr V / q)/2, the root mean square; E: ln(largest eigenvalue)/2,
        the worst combination; c: ln V/2 of one combination (q = 1).

    exp of the difference of two values is how many times smaller the standard deviation is.

    Args: kind: "D", "A", "E" or "c"; directions: L, shape (free, q); prior: information before the test, shape
        (free, free + held), see `covariance_of`.
    Reference: Atkinson, Donev and Tobias, "Optimum Experimental Designs, with SAS", 2007, ch. 10; Chaloner and
    Verdinelli, "Bayesian experimental design: a review", Statistical Science 10, 1995.
    """

    kind: str
    directions: np.ndarray
    prior: np.ndarray

    @property
    def holds(self) -> bool:
        """Whether what is known before rests on numbers that are held."""
        return self.prior.shape[1] > self.prior.shape[0] and bool(np.any(self.prior[:, self.prior.shape[0] :]))

    def _asked(self, covariance) -> np.ndarray:
        return np.swapaxes(self.directions, -1, -2) @ covariance @ self.directions

    def value(self, information) -> np.ndarray:
        """The criterion, for information of shape (..., free + known, free + known)."""
        asked = self._asked(covariance_of(information, self.prior))
        if self.kind == "D":
            return 0.5 * np.linalg.slogdet(asked)[1] / asked.shape[-1]
        if self.kind == "E":
            return 0.5 * np.log(np.linalg.eigvalsh(asked)[..., -1])
        return 0.5 * np.log(np.trace(asked, axis1=-2, axis2=-1) / asked.shape[-1])

    def slope(self, information) -> np.ndarray:
        """D, symmetric, with d value = sum(D * dM), at one M of shape (free + known, free + known)."""
        covariance, inverse, fixed, added = _parts(information, self.prior)
        asked, count = self._asked(covariance), self.directions.shape[1]
        if self.kind == "D":
            weight = np.linalg.inv(asked) / (2.0 * count)
        elif self.kind == "E":
            values, vectors = np.linalg.eigh(asked)
            weight = np.outer(vectors[:, -1], vectors[:, -1]) / (2.0 * values[-1])
        else:
            weight = np.eye(count) / (2.0 * np.trace(asked))
        by_covariance = self.directions @ weight @ self.directions.T
        inner = inverse @ by_covariance @ inverse
        crossed = inverse @ by_covariance @ added
        found = np.zeros_like(information)
        size = self.prior.shape[0]
        found[:size, :size] = -inner - crossed - crossed.T
        found[:size, size:] = (inner @ fixed)[:, : information.shape[-1] - size]
        found[size:, :size] = found[:size, size:].T
        return found


@dataclasses.dataclass(frozen=True)
class Goal:
    """One criterion for each set of parameter values that are thought possible, and how they count together.

    how: "nominal" (there is one), "average" or "worst" of them. Information has shape (scenarios, ..., n, n).
    """

    criteria: tuple[Criterion, ...]
    how: str = "nominal"

    def values(self, information) -> np.ndarray:
        """The criterion of each scenario, shape (scenarios, ...)."""
        return np.stack([c.value(m) for c, m in zip(self.criteria, information, strict=True)])

    def value(self, information) -> np.ndarray:
        """What counts, shape (...)."""
        return self.combine(self.values(information))

    def combine(self, values) -> np.ndarray:
        """What counts of the criteria of all scenarios."""
        return np.max(values, axis=0) if self.how == "worst" else np.mean(values, axis=0)

    def slope(self, information) -> np.ndarray:
        """Derivatives of what counts by the information of each scenario, shape (scenarios, n, n)."""
        slopes = np.stack([c.slope(m) for c, m in zip(self.criteria, information, strict=True)])
        if self.how != "worst":
            return slopes / len(self.criteria)
        return slopes * (np.arange(len(slopes)) == np.argmax(self.values(information)))[:, None, None]


def stated_covariance(rows, num_free: int) -> np.ndarray:
    """The covariance that a fit to such data states, infinite for what they do not tell, shape (free, free).

    Args: rows: weighted slopes of samples and priors by (free, known) parameters, shape (rows, free + known), the known
        ones in units of their standard uncertainty.
    """
    free, known = rows[:, :num_free], rows[:, num_free:]
    covariance = gauss_newton_covariance(free)
    told = np.isfinite(np.diag(covariance))
    inner = np.where(np.isfinite(covariance), covariance, 0.0)
    moved = inner @ (free.T @ known)
    return covariance + np.where(np.outer(told, told), moved @ moved.T, 0.0)
