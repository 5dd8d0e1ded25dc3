"""What can be asked of a finished fit: uncertainty budgets, classes of identifiability, a posterior."""

from typing import Protocol

import numpy as np

from jaxlines.inference.analysis import Analysis, unit_of
from jaxlines.inference.budget import Budget, Source, parameter_budget
from jaxlines.inference.identifiability import Identifiability, assess
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.least_squares import Solution
from jaxlines.inference.posterior import Posterior, sample_posterior
from jaxlines.inference.problem import number_metadata
from jaxlines.inference.scatter import Between
from jaxlines.inference.traced import as_function
from jaxlines.inference.uncertainty import Estimate


class Finished(Protocol):
    """What is needed of a `Fit`."""

    @property
    def status(self) -> str: ...
    @property
    def message(self) -> str: ...
    @property
    def parameters(self) -> dict[str, Estimate]: ...
    @property
    def scatter(self) -> dict[str, Between]: ...
    @property
    def problem(self) -> JointProblem | None: ...
    @property
    def coordinates(self) -> np.ndarray | None: ...
    @property
    def analysis(self) -> Analysis | None: ...


def _parts(fit: Finished) -> tuple[JointProblem, np.ndarray, Analysis]:
    """Problem, optimum and analysis. Raises: ValueError for a failed fit."""
    if fit.problem is None or fit.coordinates is None or fit.analysis is None:
        raise ValueError(f"the fit failed, there is nothing to look at: {fit.message}")
    return fit.problem, fit.coordinates, fit.analysis


def solution_of(fit: Finished) -> Solution:
    """The end of a fit as a `Solution` of its problem, simulated again with slopes. Raises: ValueError if it failed."""
    problem, x, _ = _parts(fit)
    residuals, jacobian = problem.residuals(x), problem.jacobian(x)
    cost = 0.5 * float(residuals @ residuals)
    return Solution(x, cost, fit.status, fit.message, residuals, jacobian, x, 1)


def budgets(fit: Finished) -> dict[str, Budget]:
    """The budget of each parameter that has an interval: parameter -> `Budget`, SI.

    Type A: the noise of the recording under its model, and where the recordings differ significantly their scatter.
    Type B: the numbers of `known`, and noise of recorded inputs as what is left of the standard deviation.
    """
    problem, _, analysis = _parts(fit)
    found, count = {}, len(problem.free)
    gain, steps = analysis.covariance.gain, analysis.steps
    own = np.diag(analysis.noise.spread(gain)) if analysis.noise.method != "white" else np.diag(gain @ gain.T)
    freedom = analysis.noise.freedom(gain)
    by_known = analysis.covariance.joint[:count, count:]  # gain times variance of the known numbers
    values = _known_values(problem)
    for i, (name, estimate) in enumerate(fit.parameters.items()):
        if estimate.kind != "interval" or estimate.sd is None:
            continue
        sources = []
        for k, known in enumerate(problem.known):
            slope = steps[i] * by_known[i, k] / known.sd**2 if known.sd > 0.0 else 0.0
            circuit = problem.trials[0].circuit
            unit = number_metadata(circuit, known.path).get("unit", "1")
            sources.append(Source(known.path, values[k], known.sd, unit, "B", np.inf, float(slope)))
        sd = float(steps[i] * np.sqrt(own[i]))
        rest = estimate.sd**2 - sd**2 - sum(source.contribution**2 for source in sources)
        if rest > 1e-6 * estimate.sd**2:
            sources.append(Source("noise of inputs and bounds", estimate.value, float(np.sqrt(rest)), estimate.unit))
        between = fit.scatter.get(name)
        differ = between is not None and between.p <= 0.05
        found[name] = parameter_budget(
            name,
            estimate.value,
            unit_of(problem, i),
            sd,
            float(freedom[i]),
            sources,
            scatter_sd=between.sd if between is not None and differ else None,
            num_recordings=between.recordings if between is not None else 1,
        )
    return found


def _known_values(problem: JointProblem) -> np.ndarray:
    """Values of the known numbers, of the first recording that has each."""
    values = np.full(len(problem.known), np.nan)
    for trial, columns in reversed(list(zip(problem.trials, problem.known_columns, strict=True))):
        values[list(columns)] = trial.known_values
    return values


def assessment(fit: Finished, seed: int = 0) -> dict[str, Identifiability]:
    """Classes of all parameters by likelihood profiles under the noise that the residuals show, words in SI."""
    problem, _, analysis = _parts(fit)
    gain = analysis.covariance.gain
    white = np.maximum(np.diag(gain @ gain.T), 1e-300)
    inflation = (
        np.ones(white.size) if analysis.noise.method == "white" else np.diag(analysis.noise.spread(gain)) / white
    )
    units = [unit_of(problem, i) for i in range(len(problem.free))]
    shown = {f.label: (f, "" if u == "1" else f" {u}") for f, u in zip(problem.free, units, strict=True)}

    def words(label: str, x: float) -> str:
        parameter, unit = shown[label]
        return f"{float(parameter.to_value(x)):.5g}{unit}"

    end = solution_of(fit)
    return assess(problem, end, freedom=analysis.noise.freedom(gain), inflation=inflation, seed=seed, words=words)


def posterior(fit: Finished, *, warmup: int, draws: int, chains: int, seed: int) -> Posterior:
    """Draws from the posterior of a fit, its noise inferred, or known where it was given; see `sample_posterior`."""
    problem, _, analysis = _parts(fit)
    noise = "known" if analysis.noise.known else "inferred"
    options = {"noise": noise, "warmup": warmup, "draws": draws, "chains": chains, "seed": seed}
    return sample_posterior(as_function(problem), solution_of(fit), **options)


def values_of(fit: Finished, drawn: Posterior) -> np.ndarray:
    """Draws in SI, shape (chains, draws, parameters)."""
    problem, _, _ = _parts(fit)
    flat = drawn.draws.reshape(-1, len(problem.labels))
    columns = [f.to_value(flat[:, i]) for i, f in enumerate(problem.free)]
    return np.stack(columns, axis=1).reshape(drawn.draws.shape)
