"""Do parameters carry over? Runs that were not fitted are predicted from the parameters of others."""

import numpy as np
from rich.console import Console
from ringdown_data import COSINE_SIZES, Ringdown, cosine_start, damped_cosine
from ringdown_fits import Fits, batch_of
from ringdown_model import PASCAL, Structure
from scipy.optimize import least_squares

from jaxlines.inference.batch import Batch

WORTH = 0.02  # per cent of hold: by how much a further term must better the prediction of left-out runs
EVERY = 4  # of the runs of other units, one in so many is learnt from


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

    start = np.clip(start, bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6)
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
            others = np.flatnonzero((units != unit) & (ports == name))[::EVERY]
            if kind == "other units" and own.size and others.size >= 3:
                yield (unit, name), others, own


def cosine_errors(runs: list[Ringdown], train: np.ndarray, test: np.ndarray) -> dict[int, float]:
    """The damped cosine shared by the training runs: RMSE of the others, per cent of hold."""
    shared = least_squares(
        lambda v: np.concatenate([damped_cosine(runs[i], v) - runs[i].pressure / runs[i].hold for i in train]),
        np.median([cosine_start(runs[i]) for i in train], axis=0),
        x_scale=COSINE_SIZES,
    ).x
    misses = {i: damped_cosine(runs[i], shared) - runs[i].pressure / runs[i].hold for i in test}
    return {int(i): 100.0 * float(np.sqrt(np.mean(miss**2))) for i, miss in misses.items()}


def carry_over(
    runs: list[Ringdown], structures: dict[str, Structure], fits: dict[str, Fits], kind: str, console: Console
) -> tuple[dict[str, dict[int, float]], dict[tuple, list[int]]]:
    """Prediction of runs that were not fitted: structure -> run's position -> RMSE [per cent of hold]; and the groups.

    Every free number, timing included, is shared by the runs learnt from and used as it is for the others; what a run
    brings of its own is its stroke, its hold pressure and the pressure before the stop.
    """
    batches = {name: batch_of(runs, s, fits[name].result.values) for name, s in structures.items()}
    errors: dict[str, dict[int, float]] = {name: {} for name in [*structures, "damped cosine"]}
    hold = np.array([run.hold for run in runs]) * PASCAL
    groups: dict[tuple, list[int]] = {}
    for group, train, test in folds(runs, kind):
        console.log(f"{kind}: {group[0]} {group[1]}, {train.size} runs to {test.size}")
        for name, batch in batches.items():
            medians = np.median(fits[name].result.values[train], axis=0)
            start = np.array([f.to_coordinate(v) for f, v in zip(batch.free, medians, strict=True)])
            point = pooled(batch, train, start)
            shown = batch.predict(batch.to_values(np.tile(point, (test.size, 1))), test)
            rmse = np.sqrt(np.mean((shown - batch.measured[test])[..., 0] ** 2, axis=1))
            errors[name] |= dict(zip(test.tolist(), (100.0 * rmse / hold[test]).tolist(), strict=True))
        errors["damped cosine"] |= cosine_errors(runs, train, test)
        groups.setdefault(group, []).extend(test.tolist())
    return errors, groups


def spread(percent) -> dict[str, float]:
    """Median and 90th percentile of RMSEs."""
    found = np.asarray(percent, dtype=float)
    return {"median": float(np.median(found)), "p90": float(np.percentile(found, 90))}


def paired(errors: dict, groups: dict, term: str, without: str) -> dict:
    """By how much a structure with a term predicts worse than one without it, by group of runs [per cent of hold]."""
    differences = np.array([np.mean([errors[term][i] - errors[without][i] for i in g]) for g in groups.values()])
    error = float(differences.std(ddof=1) / np.sqrt(differences.size)) if differences.size > 1 else None
    return {
        "mean": float(differences.mean()),
        "standard_error": error,
        "groups": int(differences.size),
        "groups_where_it_is_better": int((differences < 0).sum()),
    }


def wanted(difference: dict) -> bool:
    """Whether left-out runs want a term: predicted better by `WORTH`, and by two standard errors."""
    return -difference["mean"] > max(WORTH, 2.0 * (difference["standard_error"] or 0.0))
