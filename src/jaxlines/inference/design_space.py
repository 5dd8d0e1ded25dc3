"""The numbers of all excitations in units of their bounds, with the limits of the inputs themselves."""

import numpy as np

from jaxlines.inference.design_excitation import Inequalities
from jaxlines.inference.design_model import DesignModel

TOLERANCE = 1e-6
"""How far a limit may be missed, as a part of its range."""


class Space:
    """The coefficients scaled to their bounds, z = (c - low)/(high - low), with the limits of the inputs themselves."""

    def __init__(self, model: DesignModel):
        self.excitations = model.excitations
        bounds = np.concatenate([e.coefficient_bounds for e in model.excitations])
        self.low, self.width = bounds[:, 0], np.maximum(bounds[:, 1] - bounds[:, 0], 0.0)
        self.split = model.split
        self.start = self.scaled(np.concatenate([e.start_coefficients for e in model.excitations]))
        matrix, low, high, names, at = [], [], [], [], 0
        for excitation in model.excitations:
            own: Inequalities = excitation.inequalities()
            size = excitation.start_coefficients.size
            block = np.zeros((own.low.size, self.low.size))
            block[:, at : at + size] = own.matrix
            matrix.append(block)
            low.append(own.low)
            high.append(own.high)
            names += own.names
            at += size
        matrix, low, high = np.concatenate(matrix), np.concatenate(low), np.concatenate(high)
        offset, size = matrix @ self.low, np.maximum(high - low, 1e-300)
        self.matrix = matrix * self.width / size[:, None]
        self.lower, self.upper, self.names = (low - offset) / size, (high - offset) / size, tuple(names)

    def coefficients(self, z) -> np.ndarray:
        """Coefficients of scaled ones."""
        return self.low + np.asarray(z) * self.width

    def scaled(self, coefficients) -> np.ndarray:
        """Scaled coefficients; what is fixed is 0."""
        return (coefficients - self.low) / np.where(self.width > 0.0, self.width, 1.0)

    @property
    def ends(self) -> np.ndarray:
        """Bounds of z, shape (coefficients, 2)."""
        return np.stack([np.zeros(self.low.size), (self.width > 0.0).astype(float)], axis=1)

    def constraints(self) -> list[dict]:
        """The limits of the inputs, for SciPy."""
        found = []
        if self.lower.size:
            both = np.concatenate([self.matrix, -self.matrix])
            ends = np.concatenate([self.lower, -self.upper])
            found.append({"type": "ineq", "fun": lambda z: both @ z - ends, "jac": lambda z: both})
        for number, excitation in enumerate(self.excitations):
            if excitation.energy is not None:
                found.append(_energy_constraint(self, number, excitation))
        return found

    def kept(self, z) -> bool:
        """Whether all limits of the inputs are kept."""
        inside = np.all(z >= self.ends[:, 0] - TOLERANCE) and np.all(z <= self.ends[:, 1] + TOLERANCE)
        return bool(inside) and all(np.all(c["fun"](z) >= -TOLERANCE) for c in self.constraints())

    def nearest(self, z) -> np.ndarray:
        """The nearest z that keeps all limits of the inputs. Raises ValueError when there is none."""
        from scipy.optimize import minimize

        z = np.clip(z, *self.ends.T)
        if self.kept(z):
            return z
        found = minimize(
            lambda y: 0.5 * float((y - z) @ (y - z)),
            z,
            jac=lambda y: y - z,
            bounds=self.ends,
            constraints=self.constraints(),
            method="SLSQP",
            options={"maxiter": 200, "ftol": 1e-12},
        )
        if not self.kept(found.x):
            names = ", ".join(e.input for e in self.excitations)
            raise ValueError(
                f"the limits of {names} leave no room: no profile keeps level, rate, energy and fixed ends at once; "
                "widen one of them (is the rate in another unit, per ms instead of per s?)"
            )
        return found.x


def _energy_constraint(space: Space, number: int, excitation) -> dict:
    """integral u^2 dt <= energy, as 1 - integral/energy >= 0."""
    sizes = [e.start_coefficients.size for e in space.excitations]
    first = sum(sizes[:number])
    own = slice(first, first + sizes[number])

    def room(z):
        return 1.0 - excitation.energy_of(space.coefficients(z)[own]) / excitation.energy

    def slope(z):
        found = np.zeros(space.low.size)
        found[own] = -excitation.energy_slope(space.coefficients(z)[own]) * space.width[own] / excitation.energy
        return found

    return {"type": "ineq", "fun": room, "jac": slope}
