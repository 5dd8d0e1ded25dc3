"""A fit's problem as one function written in JAX: for samplers, second derivatives and objectives of one's own."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jaxlines.inference.distributions import LogNormal, Normal, Truncated
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.least_squares_problem import FunctionProblem
from jaxlines.inference.priors import Prior
from jaxlines.inference.programs import prediction
from jaxlines.simulation.precision import cast
from jaxlines.simulation.result import STATUS


def traced_values(problem: JointProblem) -> Callable:
    """x -> values in SI, traceable, as `JointProblem.to_values`."""
    kinds = np.array([f.transform for f in problem.free])
    low, high = (np.array([f.bounds[end] for f in problem.free], dtype=float) for end in (0, 1))

    def values(x):
        logs = jnp.exp(jnp.where(kinds == "log", x, 0.0))
        inside = low + (high - low) / (1.0 + jnp.exp(-jnp.where(kinds == "logit", x, 0.0)))
        return jnp.where(kinds == "log", logs, jnp.where(kinds == "logit", inside, x))

    return values


def _trial_rows(trial, own, sigma) -> Callable:
    """Values in SI of all parameters -> weighted rows of one recording."""
    used, measured = trial.used, trial.measured
    members = np.concatenate([np.full(len(group), i) for i, group in enumerate(trial.groups)])
    arguments = trial.arguments(np.ones(len(own)))  # in the precision of the trial; only the numbers depend on x
    _, packed, times, tolerance = cast(arguments, trial.precision)
    good = np.array([STATUS["ok"], STATUS["tension"]])

    def rows(values):
        every = jnp.concatenate([values[np.asarray(own, dtype=int)], jnp.asarray(trial.known_values)])
        outputs, status = prediction(
            trial.plan,
            trial.wanted,
            trial.method,
            trial.locations,
            every[members],
            packed,
            times,
            tolerance,
            trial.steady,
        )
        misfit = (outputs[: measured.shape[0]] - np.where(used, measured, 0.0)) / sigma
        return jnp.where(jnp.isin(status, good), misfit[np.nonzero(used)], jnp.nan)

    return rows


def as_function(problem: JointProblem) -> FunctionProblem:
    """The same rows as `JointProblem.residuals`, at its present noise levels, as a traced function of coordinates.

    Raises: ValueError for a robust loss, which has no normal likelihood to sample.
    """
    if problem.loss.kind != "gauss":
        raise ValueError(f'a traced problem needs loss="gauss", got {problem.loss.kind!r}')
    to_values = traced_values(problem)
    parts = [_trial_rows(t, own, s) for t, own, s in zip(problem.trials, problem.columns, problem.sigma, strict=True)]
    kept = [(i, f.prior) for i, f in enumerate(problem.free) if isinstance(f.prior, Prior) and not f.prior.flat]
    priors = [(i, prior.distribution) for i, prior in kept]

    def rows(x):
        values = to_values(x)
        found = [part(values) for part in parts]
        for i, given in priors:
            base = given.base if isinstance(given, Truncated) else given
            if isinstance(base, LogNormal):
                found.append(jnp.log(values[i : i + 1] / base.median) / base.spread)
            elif isinstance(base, Normal):
                found.append((values[i : i + 1] - base.mean) / base.sd)
        return jnp.concatenate(found)

    groups = problem.residual_groups
    return FunctionProblem(
        rows, problem.labels, problem.lower, problem.upper, groups.recording, groups.channel, groups.time
    )
