"""How sure ring-down fits are: intervals that bear correlated residuals, scatter of runs, criteria, what is open."""

import numpy as np
import pandas as pd
from ringdown_data import Ringdown
from ringdown_fits import Fits, batch_of, in_counts, neighbours, residuals
from ringdown_model import Structure

from jaxlines.inference.comparison import criteria, gaussian_log_likelihood
from jaxlines.inference.robust_covariance import student_factor

LAGS = 45  # samples over which residuals of one run may be correlated: a period of the first mode
CROWDED = 0.95  # correlation of two estimates above which they are named as hard to tell apart


def slopes(runs: list[Ringdown], structure: Structure, fits: Fits) -> np.ndarray:
    """Sensitivity of the pressure to relative changes of the free numbers (delays: to 1 ms), (runs, samples, free)."""
    batch = batch_of(runs, structure, fits.result.values)
    partials = batch.sensitivities(fits.result.values, np.arange(len(runs)))[1][:, :, 0]
    sizes = np.where([f.transform == "identity" for f in structure.free], 1e-3, fits.result.values)
    return partials * sizes[:, None, :]


def correlated(rows: np.ndarray, slope: np.ndarray, lags: int = LAGS) -> np.ndarray:
    """Covariance of least squares under residuals correlated over some lags: (J'J)^-1 S (J'J)^-1 n/(n - p).

    S = sum_k w_k sum_t r_t r_(t+k) (J_t J_(t+k)' + its transpose), w_k = 1 - k/(lags + 1).
    Args: residuals, shape (samples,); slopes, shape (samples, parameters).
    Reference: Newey and West, Econometrica 55, 1987.
    """
    scores, (count, free) = rows[:, None] * slope, slope.shape
    middle = scores.T @ scores
    for k in range(1, lags + 1):
        lagged = scores[k:].T @ scores[:-k]
        middle += (1.0 - k / (lags + 1.0)) * (lagged + lagged.T)
    bread = np.linalg.pinv(slope.T @ slope)
    return bread @ middle @ bread * count / (count - free)


def uncertainty(runs: list[Ringdown], structure: Structure, fits: Fits) -> dict:
    """Of every free number: its spread over units, relative standard deviations within a run, and scatter of runs.

    Relative numbers are fractions of the value; those of delays are in ms.
    """
    shown, left = slopes(runs, structure, fits), residuals(runs, fits)
    hold = np.array([run.hold for run in runs]) * 10.0  # residuals are per cent of hold, slopes in Pa: 1000/100
    rows = left * hold[:, None]
    inside = [
        f.bounds[0] * 1.001 < v for f, v in zip(structure.free, np.median(fits.result.values, axis=0), strict=True)
    ]
    white, robust, nearest = [], [], []
    for r, j in zip(rows, shown, strict=True):
        inverse = np.linalg.pinv(j.T @ j)
        white.append(np.sqrt(np.diag(inverse) * (r @ r) / (r.size - j.shape[1])))
        robust.append(np.sqrt(np.diag(correlated(r, j))))
        nearest.append(inverse / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse))))
    counts = in_counts(structure, fits.result.values)
    together = np.median(nearest, axis=0)
    names = [_label(f.paths[0]) for f in structure.free]
    table = pd.DataFrame({"unit": [run.unit for run in runs], "port": [run.port for run in runs]})
    found = {}
    for i, (name, one) in enumerate(zip(names, structure.free, strict=True)):
        values = fits.result.values[:, i]
        sizes = 1e3 * values if one.transform == "identity" else np.log(values)
        groups = table.assign(x=sizes).groupby(["unit", "port"])["x"]
        variances = np.asarray([np.var(part, ddof=1) if len(part) > 1 else np.nan for _, part in groups])
        within = float(np.sqrt(np.nanmean(variances))) if np.isfinite(variances).any() else None
        ends = (values <= one.bounds[0] * (1 + 1e-4)) | (values >= one.bounds[1] * (1 - 1e-4))
        found[name] = {
            "standard_deviation_if_white": float(np.median(white, axis=0)[i]),
            "standard_deviation_correlated": float(np.median(robust, axis=0)[i]),
            "scatter_of_runs_of_a_unit_and_port": within,
            "share_of_runs_on_a_bound": float(np.mean(ends & (one.transform == "log"))),
            "told_by_the_data": bool(inside[i] and np.median(robust, axis=0)[i] < 0.5),
        }
    pairs = [
        {"pair": [names[i], names[j]], "correlation": float(together[i, j])}
        for i in range(len(names))
        for j in range(i)
        if abs(together[i, j]) > CROWDED
    ]
    return {"numbers": found, "hard_to_tell_apart": pairs, "values": over_units(table, counts)}


def _label(path: str) -> str:
    """A path in the words of the table."""
    words = {"fluid.bulk_modulus": "stiffness of the gauge's volume", "line.hose_volume": "hose volume over gauge's"}
    return words.get(path, path.split(".", 1)[1].replace("_", " "))


def over_units(table: pd.DataFrame, counts: dict[str, np.ndarray]) -> dict:
    """Mean of the medians of units and ports, with a 95 % interval from their scatter (Student's t) [counts, s, ms]."""
    found = {}
    for name, values in counts.items():
        medians = table.assign(x=values).groupby(["unit", "port"])["x"].median().to_numpy()
        count = medians.size
        reach = float(student_factor(count - 1)) * medians.std(ddof=1) / np.sqrt(count) if count > 1 else np.nan
        ends = None if count < 2 else [float(medians.mean() - reach), float(medians.mean() + reach)]
        found[name] = {"mean": float(medians.mean()), "ci95": ends, "groups": int(count)}
    return found


def information(runs: list[Ringdown], fits: Fits) -> dict:
    """AIC and BIC summed over runs, taken as white and with the effective number of samples n (1 - rho)/(1 + rho)."""
    left = residuals(runs, fits)
    free = fits.result.values.shape[1] + 1
    effective = left.shape[1] * np.clip((1.0 - neighbours(left)) / (1.0 + neighbours(left)), 0.0, 1.0)
    white = [criteria(gaussian_log_likelihood(r, 1), free, r.size) for r in left]
    bic = effective * np.log(np.mean(left**2, axis=1)) + free * np.log(np.maximum(effective, 2.0))
    return {
        "aic_white": float(sum(c.aic for c in white)),
        "bic_white": float(sum(c.bic for c in white)),
        "bic_effective": float(bic.sum()),
        "effective_samples_of_a_run": float(np.median(effective)),
        "parameters_of_a_run": free - 1,
    }


def common_shape(left: np.ndarray) -> float:
    """Share of the mean square of residuals that all runs have in common: what the structure lacks, not noise."""
    return float(np.mean(left.mean(axis=0) ** 2) / np.mean(left**2))
