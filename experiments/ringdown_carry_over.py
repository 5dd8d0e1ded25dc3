"""Do parameters carry over? Runs that were not fitted are predicted from the parameters of others."""

import numpy as np
from rich.console import Console
from ringdown_data import COSINE_SIZES, Ringdown, cosine_start, damped_cosine
from ringdown_model import MODELS, PASCAL
from scipy.optimize import least_squares

from jaxlines.inference.batch import Batch


def pooled(batch: Batch, lanes: np.ndarray, start: np.ndarray) -> np.ndarray:
    """One set of parameters for several runs, coordinates: least squares over all of them together."""
    bounds = np.array([f.coordinate_bounds() for f in batch.free])
    weight = 1.0 / (batch.sigma[lanes] * 100.0)

    def residuals(point):
        numbers = batch.to_values(np.tile(point, (lanes.size, 1)))
        return ((batch.predict(numbers, lanes) - batch.measured[lanes]) * weight).ravel()

    def jacobian(point):
        numbers = batch.to_values(np.tile(point, (lanes.size, 1)))
        steps = np.array([f.slope(v) for f, v in zip(batch.free, numbers[0], strict=True)])
        slopes = batch.sensitivities(numbers, lanes)[1] * steps * weight[..., None]
        return slopes.reshape(-1, point.size)

    found = least_squares(residuals, start, jac=jacobian, bounds=bounds.T, x_scale="jac", xtol=1e-5, ftol=1e-6)  # pyright: ignore
    return found.x


def folds(runs: list[Ringdown], kind: str):
    """Training and test runs: alternate halves of each unit and port, or every fourth run of the other units."""
    units, ports = np.array([r.unit for r in runs]), np.array([r.port for r in runs])
    for unit in np.unique(units):
        for name in np.unique(ports):
            own = np.flatnonzero((units == unit) & (ports == name))
            if kind == "halves" and own.size >= 6:
                yield (unit, name), own[::2], own[1::2]
                yield (unit, name), own[1::2], own[::2]
            others = np.flatnonzero((units != unit) & (ports == name))[::4]
            if kind == "other units" and own.size and others.size >= 3:
                yield (unit, name), others, own


def carry_over(
    runs: list[Ringdown], batches: dict[str, Batch], fitted: dict[str, np.ndarray], kind: str, console: Console
) -> dict:
    """Prediction of runs that were not fitted, per cent of hold, by each model and by the damped cosine.

    `fitted`: model -> values of every run's own fit, shape (runs, free), whose median starts the shared search.
    """
    errors = {name: {} for name in [*batches, "damped cosine"]}
    hold = np.array([run.hold for run in runs]) * PASCAL
    groups = {}
    for group, train, test in folds(runs, kind):
        console.log(f"{kind}: {group[0]} {group[1]}, {train.size} runs to {test.size}")
        for name, batch in batches.items():
            medians = np.median(fitted[name][train], axis=0)
            start = np.array([f.to_coordinate(v) for f, v in zip(batch.free, medians, strict=True)])
            bounds = np.array([f.coordinate_bounds() for f in batch.free])
            point = pooled(batch, train, np.clip(start, bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6))
            shown = batch.predict(batch.to_values(np.tile(point, (test.size, 1))), test)
            rmse = np.sqrt(np.mean((shown - batch.measured[test])[..., 0] ** 2, axis=1))
            errors[name] |= dict(zip(test, 100.0 * rmse / hold[test], strict=True))
        shared = least_squares(
            lambda v, train=train: np.concatenate(
                [damped_cosine(runs[i], v) - runs[i].pressure / runs[i].hold for i in train]
            ),
            np.median([cosine_start(runs[i]) for i in train], axis=0),
            x_scale=COSINE_SIZES,
        ).x
        for i in test:
            miss = damped_cosine(runs[i], shared) - runs[i].pressure / runs[i].hold
            errors["damped cosine"][i] = 100.0 * float(np.sqrt(np.mean(miss**2)))
        groups.setdefault(group, []).extend(test)
    return summarise_carry_over(errors, groups)


def summarise_carry_over(errors: dict, groups: dict) -> dict:
    """Median and 90th percentile of each model, and the paired difference of air minus constant by group."""
    if not groups:
        return {}
    found = {
        name: {"median": float(np.median(list(e.values()))), "p90": float(np.percentile(list(e.values()), 90))}
        for name, e in errors.items()
    }
    constant, air = (errors[name] for name in MODELS)
    differences = np.array([np.mean([air[i] - constant[i] for i in members]) for members in groups.values()])
    spread = float(differences.std(ddof=1) / np.sqrt(differences.size)) if differences.size > 1 else float("nan")
    comparison = {
        "mean": float(differences.mean()),
        "standard_error": None if np.isnan(spread) else spread,
        "groups": int(differences.size),
        "groups_where_air_is_better": int((differences < 0).sum()),
    }
    return {**found, "air minus constant": comparison}


def verdict(carried: dict) -> str:
    """What the data prefer in predicting left-out runs, in words; 0.05 % of hold counts as a difference."""
    if not carried:
        return "carry-over was not studied"
    differences = [c["air minus constant"] for c in carried.values() if c]
    if not differences:
        return "too few runs to compare a constant with a pressure-dependent capacitance"
    gains = [d["mean"] for d in differences]
    if max(gains) < -0.05:
        return "left-out runs are predicted better with a pressure-dependent capacitance"
    if min(gains) > 0.05:
        return "left-out runs are predicted better with a constant capacitance"
    if max(map(abs, gains)) > 0.05:
        return "left-out runs of the same unit and of other units disagree on a pressure-dependent capacitance"
    return "left-out runs do not call for a pressure-dependent capacitance (differences below 0.05 % of hold)"
