"""Pictures of sweeps: each function draws into Axes (new ones by default) and returns them."""

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.edge.plots import BAND, MEASURED, SIMULATED, _axes, _label, _largest
from jaxlines.inference.sensitivity_indices import Sensitivity
from jaxlines.inference.statistics import Band, Summary

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


def plot_band(band: Band, kept=None, axes=None):
    """A sensor over time: nested bands around the median, and a few lanes; `kept`, shape (lanes, times)."""
    axes = _axes(axes)
    unit, factor = readable_unit(band.unit, _largest(band.high))
    ordered = sorted(band.quantiles)
    for low in [q for q in ordered if q < 0.5]:
        high = next((q for q in ordered if np.isclose(q, 1 - low)), None)
        if high is not None:
            ends = band.quantiles[low] * factor, band.quantiles[high] * factor
            label = f"{100 * (high - low):.3g} %"
            axes.fill_between(band.times, *ends, color=BAND, alpha=0.18, lw=0, label=label)
    for series in () if kept is None else kept[:5]:
        axes.plot(band.times, series * factor, color=MEASURED, lw=0.7, alpha=0.7)
    if 0.5 in band.quantiles:
        axes.plot(band.times, band.quantiles[0.5] * factor, color=SIMULATED, lw=1.6, label="median")
    axes.set(xlabel="time [s]", ylabel=_label(band.name, unit))
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
