"""How much a residual costs: the normal distribution, or heavier tails that let outliers weigh less."""

import dataclasses

import numpy as np

KINDS = ("gauss", "huber", "student")
_USUAL_SCALE = {"gauss": 1.0, "huber": 1.345, "student": 4.0}


@dataclasses.dataclass(frozen=True)
class Loss:
    """The cost rho(z) of a residual z over its noise level; sum rho is what a fit minimises.

    kind: "gauss", rho = z^2/2;
        "huber", rho = z^2/2 up to |z| = k and k|z| - k^2/2 beyond, k = `scale` (1.345: 95 % efficient on normal noise);
        "student", rho = (nu + 1)/2 ln(1 + z^2/nu), nu = `scale` degrees of freedom (4 by default), the likelihood of
        Student's t.
    Each cost is written as half a square of a row r = sign(z) sqrt(2 rho(z)), so that a least-squares search
    minimises it exactly.

    Args: kind; scale [-]: None for the usual one.
    Raises: ValueError for an unknown kind or a scale that is not positive.
    Reference: Huber and Ronchetti, "Robust Statistics", 2009, ch. 7; Lange, Little and Taylor, JASA 84, 1989.
    """

    kind: str = "gauss"
    scale: float | None = None

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"loss must be one of {', '.join(KINDS)}, got {self.kind!r}")
        scale = _USUAL_SCALE[self.kind] if self.scale is None else float(self.scale)
        if not (np.isfinite(scale) and scale > 0.0):
            raise ValueError(f"scale of the loss must be positive (in standard deviations), got {self.scale}")
        object.__setattr__(self, "scale", scale)

    @property
    def _scale(self) -> float:
        assert self.scale is not None
        return self.scale

    def cost(self, z) -> np.ndarray:
        """rho(z)."""
        z, k = np.asarray(z), self._scale
        if self.kind == "huber":
            size = np.abs(z)
            return np.where(size <= k, 0.5 * z**2, k * size - 0.5 * k**2)
        if self.kind == "student":
            return 0.5 * (k + 1.0) * np.log1p(z**2 / k)
        return 0.5 * z**2

    def influence(self, z) -> np.ndarray:
        """psi(z) = d rho / dz."""
        z, k = np.asarray(z), self._scale
        if self.kind == "huber":
            return np.clip(z, -k, k)
        return (k + 1.0) * z / (k + z**2) if self.kind == "student" else z

    def rows(self, z) -> np.ndarray:
        """The rows whose half squares are the costs."""
        return z if self.kind == "gauss" else np.sign(z) * np.sqrt(2.0 * self.cost(z))

    def row_slopes(self, z) -> np.ndarray:
        """d row / dz."""
        z = np.asarray(z)
        if self.kind == "gauss":
            return np.ones_like(z)
        rows = self.rows(z)
        small = np.abs(z) < 1e-6
        at_zero = np.sqrt((self._scale + 1.0) / self._scale) if self.kind == "student" else 1.0
        return np.where(small, at_zero, self.influence(z) / np.where(small, 1.0, rows))

    def information(self, z) -> float:
        """What a residual tells of the model, relative to one of unit normal noise: (mean psi')^2 / mean psi^2.

        The covariance of an M-estimate is that of least squares divided by it (Huber, 1973).
        """
        if self.kind == "gauss":
            return 1.0
        z, k = np.asarray(z), self._scale
        bend = (np.abs(z) <= k) if self.kind == "huber" else (k + 1.0) * (k - z**2) / (k + z**2) ** 2
        return float(max(np.mean(bend), 1e-3) ** 2 / max(np.mean(self.influence(z) ** 2), 1e-300))

    def scale_cost(self, z) -> np.ndarray:
        """chi(z), whose sum with ln sigma gives the noise level: rho where that is a likelihood.

        For "huber" z chi'(z) = psi(z)^2, so that far outliers count no more than near ones (Huber's proposal 2):
        chi = z^2/2 up to k, k^2/2 + k^2 ln(|z|/k) beyond.
        """
        if self.kind != "huber":
            return self.cost(z)
        size, k = np.abs(z), self._scale
        return np.where(size <= k, 0.5 * size**2, 0.5 * k**2 + k**2 * np.log(np.maximum(size, k) / k))

    @property
    def consistency(self) -> float:
        """E[z chi'(z)] on noise of the level 1, normal for "huber"."""
        if self.kind != "huber":
            return 1.0
        from scipy.special import ndtr

        k = self._scale
        tail, density = 1.0 - ndtr(k), np.exp(-0.5 * k**2) / np.sqrt(2.0 * np.pi)
        return float(1.0 - 2.0 * tail - 2.0 * k * density + 2.0 * k**2 * tail)

    def log_normaliser(self) -> float:
        """ln of the integral of exp(-rho(z)) dz, so that exp(-rho - this)/sigma is a density."""
        from scipy.special import gammaln, ndtr

        k = self._scale
        if self.kind == "student":
            return float(gammaln(0.5 * k) - gammaln(0.5 * (k + 1.0)) + 0.5 * np.log(np.pi * k))
        root = 0.5 * np.log(2.0 * np.pi)
        if self.kind == "gauss":
            return float(root)
        return float(np.log(np.exp(root) * (2.0 * ndtr(k) - 1.0) + 2.0 / k * np.exp(-0.5 * k**2)))
