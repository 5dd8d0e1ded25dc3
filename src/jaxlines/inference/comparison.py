"""Which model: prediction of recordings that were left out of the fit, with AIC and BIC beside it."""

import dataclasses
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxlines.inference.least_squares import AbstractRewritten, LeastSquaresProblem, Solution, solve
from jaxlines.inference.noise_models import whiteness
from jaxlines.inference.uncertainty import WHITE_LIMIT, p_value_text

if TYPE_CHECKING:
    import pandas as pd


class Criteria(NamedTuple):
    """ln likelihood at its maximum, and AIC = 2 k - 2 ln L, AICc (small samples), BIC = k ln n - 2 ln L."""

    log_likelihood: float
    aic: float
    aicc: float
    bic: float


def criteria(log_likelihood: float, num_parameters: int, num_rows: int) -> Criteria:
    """Information criteria; smaller is better, differences below 2 say nothing.

    Args: num_parameters: estimated ones, noise levels included; num_rows: data.
    Reference: Akaike, 1974; Hurvich and Tsai, Biometrika 76, 1989; Schwarz, Annals of Statistics 6, 1978.
    """
    aic = 2.0 * num_parameters - 2.0 * log_likelihood
    spare = num_rows - num_parameters - 1
    aicc = aic + 2.0 * num_parameters * (num_parameters + 1) / spare if spare > 0 else np.inf
    return Criteria(log_likelihood, aic, aicc, num_parameters * np.log(num_rows) - 2.0 * log_likelihood)


def gaussian_log_likelihood(residuals, num_levels: int = 0, channel=None) -> float:
    """ln likelihood of weighted residuals at known noise of 1, or, with levels, at the most likely one a channel."""
    if not num_levels:
        return -0.5 * float(residuals @ residuals) - 0.5 * residuals.size * np.log(2.0 * np.pi)
    channel = np.zeros(residuals.size, dtype=int) if channel is None else channel
    total = 0.0
    for own in (residuals[channel == c] for c in range(num_levels)):
        total -= 0.5 * own.size * (np.log(2.0 * np.pi * float(own @ own) / own.size) + 1.0)
    return total


@dataclasses.dataclass(frozen=True)
class Part(AbstractRewritten):
    """The rows of some recordings, and the priors; every other row is 0."""

    kept: tuple[int, ...]

    def _keep(self) -> np.ndarray:
        return np.isin(self.recording, [*self.kept, -1])

    def residuals(self, x) -> np.ndarray:
        """Rows of the kept recordings."""
        return np.where(self._keep(), self.plain.residuals(x), 0.0)

    def jacobian(self, x) -> np.ndarray:
        """Their slopes."""
        return np.where(self._keep()[:, None], self.plain.jacobian(x), 0.0)


class LeftOut(NamedTuple):
    """What a model says of a recording that it has not seen.

    recording: its index; rms: root mean square of weighted residuals (1: within the noise); log_density: of the data
    under the prediction at noise 1; status of the fit to the others; x: what they gave.
    """

    recording: int
    rms: float
    log_density: float
    status: str
    x: np.ndarray


def predict_left_out(problem: LeastSquaresProblem, solution: Solution) -> tuple[LeftOut, ...]:
    """Leave each recording out in turn, fit to the others from the solution, and predict it.

    A parameter local to the recording that is left out keeps the value of `solution`, which is too kind to the model.
    Raises: ValueError for a single recording.
    """
    names = np.unique(problem.recording[problem.recording >= 0])
    if names.size < 2:
        raise ValueError("prediction of left-out recordings needs at least two recordings: cut this one in parts")
    found = []
    for name in names:
        end = solve(Part(problem, tuple(int(n) for n in names if n != name)), solution.x)
        rows = problem.residuals(end.x)[problem.recording == name]
        rms = float(np.sqrt(np.mean(rows**2)))
        found.append(LeftOut(int(name), rms, gaussian_log_likelihood(rows), end.status, end.x))
    return tuple(found)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Models side by side. rows: model -> criteria and left-out predictions; warnings, in words."""

    criteria: dict[str, Criteria]
    left_out: dict[str, tuple[LeftOut, ...]]
    warnings: tuple[str, ...]

    def to_frame(self) -> "pd.DataFrame":
        """One row a model, best prediction first (best BIC where there is a single recording)."""
        import pandas as pd

        rows = []
        for name, numbers in self.criteria.items():
            predicted = self.left_out.get(name, ())
            pooled = float(np.sqrt(np.mean([p.rms**2 for p in predicted]))) if predicted else np.nan
            density = float(np.sum([p.log_density for p in predicted])) if predicted else np.nan
            rows.append({"model": name, "left-out rms": pooled, "left-out log density": density, **numbers._asdict()})
        frame = pd.DataFrame(rows).set_index("model")
        return frame.sort_values("bic" if not self.left_out else "left-out rms")

    @property
    def best(self) -> str:
        """The model that predicts best what it has not seen."""
        return str(self.to_frame().index[0])


def compare(models: Mapping[str, tuple[LeastSquaresProblem, Solution]], *, num_levels: int = 0) -> Comparison:
    """Compare fitted models of the same data: name -> (problem, solution).

    Args: num_levels: noise levels that were estimated, one a channel (0: noise is known).
    Warns: when residuals are correlated, since AIC and BIC then take the data for more than they are.
    Raises: ValueError when the models have different numbers of data.
    """
    sizes = {name: int(np.sum(problem.recording >= 0)) for name, (problem, _) in models.items()}
    if len(set(sizes.values())) != 1:
        raise ValueError(f"models must be fitted to the same data, got {sizes} rows")
    numbers, left_out, remarks = {}, {}, []
    for name, (problem, solution) in models.items():
        data = problem.recording >= 0
        log = gaussian_log_likelihood(solution.residuals[data], num_levels, problem.channel[data])
        numbers[name] = criteria(log, len(problem.labels) + num_levels, sizes[name])
        p = whiteness(problem, solution.residuals)
        if p <= WHITE_LIMIT:
            remarks.append(f"{name}: residuals are correlated ({p_value_text(p)}), so that AIC and BIC are no guide")
        if np.unique(problem.recording[data]).size > 1:
            left_out[name] = predict_left_out(problem, solution)
    if remarks:
        warnings.warn("; ".join(remarks), stacklevel=2)
    return Comparison(numbers, left_out, tuple(remarks))
