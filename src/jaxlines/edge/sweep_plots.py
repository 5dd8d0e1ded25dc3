"""Pictures of sweeps: each function draws into Axes (new ones by default) and returns them."""

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.edge.plots import (
    BAND,
    MAX_POINTS,
    MEASURED,
    SIMULATED,
    _axes,
    _label,
    _largest,
    decimate,
    decimate_band,
)
from jaxlines.inference.sensitivity_indices import Sensitivity
from jaxlines.inference.statistics import Band, Summary
from jaxlines.simulation.ensemble_result import Ensemble

MOST_POINTS = 1500


def plot_histogram(summary: Summary, axes=None):
    """How the lanes of a reduction are distributed, with median, 5 and 95 % (where asked for) and thresholds."""
    axes = _axes(axes)
    edges, counts = summary.histogram
    unit, factor = readable_unit(summary.unit, _largest(edges))
    axes.stairs(counts / max(counts.sum(), 1) * 100, edges * factor, fill=True, color=BAND, alpha=0.35, lw=0)
    for quantile in summary.quantiles:
        if quantile.probability in (0.05, 0.5, 0.95):
            style = "-" if quantile.probability == 0.5 else "--"
            axes.axvline(quantile.value * factor, color=SIMULATED, lw=1.2, ls=style)
    for exceedance in summary.exceedances:
        axes.axvline(exceedance.threshold * factor, color=MEASURED, lw=1.6, ls=":")
    axes.set(xlabel=_label(summary.name, unit), ylabel="lanes [%]")
    axes.margins(x=0)
    return axes


def plot_band(band: Band, kept=None, axes=None, limit: int = MAX_POINTS):
    """A sensor over time: nested bands of quantiles around the median, and a few lanes.

    Args: band: of `SweepResult.found.bands`; kept: lanes drawn on their own, SI, shape (lanes, times); axes; limit:
    points of a curve, of which the bands keep the widest place of every stretch.
    """
    axes = _axes(axes)
    unit, factor = readable_unit(band.unit, _largest(band.high))
    return _draw_bands(axes, band.times, band.quantiles, kept, _label(band.name, unit), factor, limit)


def plot_ensemble(ensemble: Ensemble, name: str, axes=None, *, probabilities=(0.05, 0.25, 0.5, 0.75, 0.95), lanes=3):
    """An output of an ensemble over time: bands of quantiles over the lanes that can be trusted, and a few lanes.

    Args: ensemble: of `ensemble`; name: of an output; axes (new ones by default); probabilities: of the quantiles, a
    band for each pair around the median; lanes: how many are drawn on their own.
    Raises: ValueError when no lane can be trusted.
    """
    values = ensemble[name][ensemble.usable]
    if not len(values):
        raise ValueError(f"no lane can be trusted, so that there is nothing to draw: {ensemble.statuses}")
    unit, factor = readable_unit(ensemble.units.get(name, ""), _largest(values))
    quantiles = dict(zip(probabilities, np.quantile(values, probabilities, axis=0), strict=True))
    kept = values[np.linspace(0, len(values) - 1, min(lanes, len(values))).astype(int)]
    return _draw_bands(_axes(axes), ensemble.times, quantiles, kept, _label(name, unit), factor, MAX_POINTS)


def _draw_bands(axes, times, quantiles: dict, kept, label: str, factor: float, limit: int):
    """Nested bands, lanes, median."""
    ordered = sorted(quantiles)
    for low in [q for q in ordered if q < 0.5]:
        high = next((q for q in ordered if np.isclose(q, 1 - low)), None)
        if high is not None:
            outline = decimate_band(times, quantiles[low] * factor, quantiles[high] * factor, limit)
            axes.fill_between(*outline, color=BAND, alpha=0.18, lw=0, label=f"{100 * (high - low):.3g} %")
    for k, series in enumerate(() if kept is None else kept[:5]):
        few = "some lanes" if k == 0 else "_lane"
        axes.plot(*decimate(times, series * factor, limit), color=MEASURED, lw=0.7, alpha=0.7, label=few)
    if 0.5 in quantiles:
        median = decimate(times, quantiles[0.5] * factor, limit)
        axes.plot(*median, color=SIMULATED, lw=1.6, label="median")
    axes.set(xlabel="time [s]", ylabel=label)
    axes.legend(frameon=False, loc="best", fontsize=8)
    axes.margins(x=0)
    return axes


def plot_sensitivity(sensitivity: Sensitivity, unit: str = "1", axes=None, most: int = 12):
    """Bars of the indices of each number, the most important at the top; of a tornado, the means at either end."""
    axes = _axes(axes)
    key = main_measure(sensitivity)
    order = np.argsort(np.abs(np.nan_to_num(sensitivity.measures[key])))[-most:]
    place = np.arange(len(order))
    if sensitivity.method == "tornado":
        low, high = sensitivity.measures["low"][order], sensitivity.measures["high"][order]
        label, factor = readable_unit(unit, _largest([*low, *high]))
        middles = 0.5 * (low + high)
        if np.isfinite(middles).any():
            axes.axvline(float(np.nanmean(middles)) * factor, color=MEASURED, lw=1.0)
        axes.barh(place, (high - low) * factor, left=low * factor, color=SIMULATED, height=0.6)
        axes.set(xlabel=f"mean where the number is in its lowest to its highest tenth [{label or '-'}]")
    else:
        shown = [n for n in ("first", key) if n in sensitivity.measures]
        height = 0.7 / len(shown)
        for k, name in enumerate(dict.fromkeys(shown)):
            half = sensitivity.confidence.get(name)
            error = None if half is None else np.nan_to_num(half[order])
            colour = SIMULATED if name == key else MEASURED
            values = sensitivity.measures[name][order]
            axes.barh(place + k * height, values, height, xerr=error, color=colour, label=name, error_kw={"lw": 1})
        axes.legend(frameon=False, loc="lower right", fontsize=8)
        axes.set(xlabel=f"{sensitivity.method}: {key.replace('_', ' ')}")
    axes.set_yticks(place + 0.1, [sensitivity.names[j] for j in order])
    return axes


def main_measure(sensitivity: Sensitivity) -> str:
    """The measure by which numbers are ranked."""
    ranked = ("total", "share", "mu_star", "total_bound", "swing")
    return next(name for name in ranked if name in sensitivity.measures)


def plot_scatter(summary: Summary, name: str, rows: dict, worst: dict, axes=None):
    """A reduction over one uncertain number: some lanes, and the worst ones."""
    axes = _axes(axes)
    good = np.flatnonzero((rows["status"] == 0) & np.isfinite(rows[summary.name]))[:MOST_POINTS]
    unit, factor = readable_unit(summary.unit, _largest(rows[summary.name][good]))
    style = {"marker": ".", "ls": "", "rasterized": True}
    axes.plot(rows[name][good], rows[summary.name][good] * factor, color=MEASURED, ms=2, alpha=0.6, **style)
    axes.plot(worst[name], worst[summary.name] * factor, color=SIMULATED, ms=9, **style)
    axes.set(xlabel=name, ylabel=_label(summary.name, unit))
    return axes
