"""Uncertainty budgets as the GUM has them: who contributes how much to the uncertainty of a result.

Reference: JCGM 100:2008, "Guide to the expression of uncertainty in measurement".
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxlines.simulation.precision import computing_in

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    "quantity",
    "type",
    "value",
    "standard uncertainty",
    "unit",
    "sensitivity",
    "contribution",
    "share",
    "degrees of freedom",
)


class Source(NamedTuple):
    """A source of uncertainty.

    quantity: its name; value and standard uncertainty sd, in its unit; kind: "A" (from statistics of the data) or "B"
    (known otherwise: certificate, tolerance); freedom: degrees of freedom of sd, infinite by default; sensitivity: d
    result / d quantity.
    """

    quantity: str
    value: float
    sd: float
    unit: str = "1"
    kind: str = "B"
    freedom: float = np.inf
    sensitivity: float = 1.0

    @property
    def contribution(self) -> float:
        """Standard uncertainty of the result from this source alone, with the sign of the sensitivity."""
        return self.sensitivity * self.sd


@dataclasses.dataclass(frozen=True)
class Budget:
    """The uncertainty of one result. correlations: between the sources, identity when None."""

    result: str
    value: float
    unit: str
    sources: tuple[Source, ...]
    correlations: np.ndarray | None = None

    @property
    def _parts(self) -> np.ndarray:
        return np.array([source.contribution for source in self.sources])

    @property
    def sd(self) -> float:
        """Combined standard uncertainty, u^2 = sum_ij c_i u_i r_ij c_j u_j (GUM eqs. 10 and 16)."""
        matrix = np.eye(len(self.sources)) if self.correlations is None else np.asarray(self.correlations)
        return float(np.sqrt(self._parts @ matrix @ self._parts))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom, u^4 / sum (c_i u_i)^4/nu_i (Welch and Satterthwaite, GUM eq. G.2b).

        For independent sources; with correlated ones it is a guide only.
        """
        below = float(np.sum(self._parts**4 / np.array([source.freedom for source in self.sources])))
        return self.sd**4 / below if below > 0.0 else np.inf

    def coverage_factor(self, level: float = 0.95) -> float:
        """k of the expanded uncertainty: Student's t at the effective degrees of freedom, cut to an integer."""
        from scipy.special import ndtri, stdtrit

        upper = 0.5 * (1.0 + level)
        return float(ndtri(upper) if np.isinf(self.freedom) else stdtrit(max(np.floor(self.freedom), 1.0), upper))

    def expanded(self, level: float = 0.95) -> float:
        """Expanded uncertainty k u."""
        return self.coverage_factor(level) * self.sd

    def rows(self) -> list[dict]:
        """One row a source, then the result; share: part of the variance (without the cross terms of correlation)."""
        total = float(np.sum(self._parts**2)) or 1.0
        rows = []
        for s in self.sources:
            numbers = (s.value, s.sd, s.unit, s.sensitivity, s.contribution, s.contribution**2 / total, s.freedom)
            rows.append(dict(zip(COLUMNS, (s.quantity, s.kind, *numbers), strict=True)))
        last = (self.result, "result", self.value, self.sd, self.unit, 1.0, self.sd, 1.0, self.freedom)
        return [*rows, dict(zip(COLUMNS, last, strict=True))]

    def to_frame(self) -> "pd.DataFrame":
        """The table as a pandas DataFrame."""
        import pandas as pd

        return pd.DataFrame(self.rows(), columns=pd.Index(COLUMNS))

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV."""
        self.to_frame().to_csv(path, index=False)

    def to_markdown(self) -> str:
        """The table in Markdown."""
        lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
        for row in self.rows():
            cells = [f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()]
            lines.append("| " + " | ".join(cells) + " |")
        return "\n".join(lines)

    def __str__(self) -> str:
        return (
            f"{self.result} = {self.value:.6g} {self.unit}, u = {self.sd:.2g} (k = {self.coverage_factor():.3g} for "
            f"95 %, {self.freedom:.3g} degrees of freedom)\n\n{self.to_markdown()}"
        )


def measurement_budget(
    function: Callable,
    sources: Sequence[Source],
    *,
    result: str = "result",
    unit: str = "1",
    correlations: np.ndarray | None = None,
) -> Budget:
    """The budget of a result that is a function of quantities, y = f(x_1, x_2, ...), by exact first derivatives.

    Args: function: written in JAX, of as many numbers as there are sources, whose sensitivities are filled in.
    Raises: ValueError for a standard uncertainty that is negative, or correlations of the wrong shape.
    Validity: f close to linear within the uncertainties; else sample (`jaxlines.sweep`).
    """
    import jax

    if bad := [s for s in sources if not s.sd >= 0.0]:
        raise ValueError(f"{bad[0].quantity}: a standard uncertainty must not be negative, got {bad[0].sd:g}")
    if correlations is not None and np.shape(correlations) != (len(sources), len(sources)):
        raise ValueError(f"correlations must have shape ({len(sources)}, {len(sources)}), got {np.shape(correlations)}")
    values = tuple(float(source.value) for source in sources)
    with computing_in("float64"):
        value, slopes = jax.value_and_grad(lambda x: function(*x))(values)
    filled = tuple(s._replace(sensitivity=float(c)) for s, c in zip(sources, slopes, strict=True))
    return Budget(result, float(value), unit, filled, correlations)


def parameter_budget(
    name: str,
    value: float,
    unit: str,
    statistical_sd: float,
    freedom: float,
    known: Sequence[Source],
    *,
    scatter_sd: float | None = None,
    num_recordings: int = 1,
) -> Budget:
    """The budget of a fitted parameter: noise of the data (Type A) and numbers that were held fixed (Type B).

    Args: statistical_sd: from the residuals alone, with `freedom` rows less parameters; known: one source a number held
    fixed, sensitivity d estimate / d number = -(J'J)^-1 J' J_known (see `known_sensitivities`); scatter_sd: standard
    deviation between recordings beyond their noise, which adds a Type A source scatter_sd/sqrt(recordings).
    """
    sources = [Source("noise of the recording", value, statistical_sd, unit, "A", freedom)]
    if scatter_sd is not None:
        spread = scatter_sd / np.sqrt(num_recordings)
        sources.append(Source("scatter between recordings", value, spread, unit, "A", max(num_recordings - 1, 1)))
    return Budget(name, value, unit, (*sources, *known))


def known_sensitivities(jacobian, known_jacobian) -> np.ndarray:
    """d estimates / d known numbers = -J^+ J_known, shape (parameters, known), in the units of the columns."""
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return -np.linalg.lstsq(jacobian / size, known_jacobian, rcond=1e-12)[0] / size[:, None]
