"""The waterway study in four pictures: pressure, what is left, left-out parts by structure, period of the surge."""

from pathlib import Path

import numpy as np
from study_figure import BLUE, FAINT, GREEN, INK, ORANGE, label, panels, save
from surge_data import Series

BAR = 1e5


def _pressure(axes, whole: Series, shown: np.ndarray, until: float) -> None:
    """Measured and simulated pressure; what lies after `until` was not fitted."""
    axes.plot(whole.times, whole.pressure / BAR, color=INK, lw=2.2, label="measured")
    axes.plot(whole.times, shown / BAR, color=BLUE, lw=1.1, label="simulated with the measured flow")
    if whole.times[-1] > until:
        axes.axvspan(until, whole.times[-1], color=FAINT, alpha=0.18, lw=0, label="not fitted")
    label(axes, "Pressure before the turbine", "time [s]", "pressure [bar]")


def _left(axes, whole: Series, shown: np.ndarray, until: float) -> None:
    """Measured less simulated pressure, and the flow it is conditional on."""
    axes.plot(whole.times, (whole.pressure - shown) / BAR, color=BLUE, lw=0.8, label="measured - simulated")
    if whole.times[-1] > until:
        axes.axvspan(until, whole.times[-1], color=FAINT, alpha=0.18, lw=0)
    label(axes, "What is left, and the flow", "time [s]", "pressure [bar]", legend=False)
    other = axes.twinx()
    other.grid(False)
    other.spines["top"].set_visible(False)
    other.plot(whole.times, whole.flow, color=ORANGE, lw=0.9, alpha=0.7, label="flow (right)")
    other.set_ylabel("flow [m³/s]")
    lines = [*axes.get_lines(), *other.get_lines()]
    axes.legend(lines, [line.get_label() for line in lines], frameon=False, fontsize=8.5, loc="upper left")


def _structures(axes, results: dict) -> None:
    """RMSE of left-out parts by structure."""
    scores = results["left_out_rmse_bar"]
    places, names = np.arange(len(scores)), list(scores)
    parts = [part for part in scores[names[0]] if part != "all"]
    for k, (part, color) in enumerate(zip([*parts, "all"], (GREEN, ORANGE, BLUE), strict=False)):
        values = [scores[name][part] for name in names]
        axes.barh(places + 0.26 * (k - 1), values, 0.24, color=color, label=part)
    axes.axvline(results["targets"]["rmse_bar"], color=INK, ls="--", lw=1.0, label="target")
    axes.set_yticks(places, [_mark(name, results["structure"]) for name in names])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    label(axes, "Left-out parts", "RMSE [bar]", "", legend=False)
    axes.legend(frameon=False, fontsize=8.5, title="left out", title_fontsize=8.5, loc="upper right")


def _mark(name: str, chosen: str) -> str:
    """A structure's name over several lines, the chosen one marked."""
    return name.replace(", ", ",\n").replace("lag and delay", "lag, delay") + ("\n(chosen)" if name == chosen else "")


def _periods(axes, results: dict) -> None:
    """Periods of the surge, seen, fitted and by formula."""
    found = results["period"]
    rows = {
        "seen at rest": (found["seen_at_rest_s"], INK),
        "fitted, at rest": (found["fitted_s"], BLUE),
        "rigid column,\ngeometry alone": (found["rigid_column_s"], ORANGE),
        "the same with\nthe shaft's inertia": (found["rigid_column_with_shaft_inertia_s"], ORANGE),
    }
    if "surge_period_measured_s" in results:
        rows |= {
            "measured\nafter the stop": (results["surge_period_measured_s"], INK),
            "predicted\nafter the stop": (results["surge_period_predicted_s"], BLUE),
        }
    for k, (value, color) in enumerate(rows.values()):
        axes.plot([value], [k], marker="o", ms=8, color=color)
        axes.annotate(f"{value:.1f} s", (value, k), xytext=(0, 9), textcoords="offset points", ha="center", fontsize=9)
    axes.set_yticks(range(len(rows)), list(rows))
    axes.set_ylim(len(rows) - 0.4, -0.8)
    axes.margins(x=0.2)
    label(axes, "Period of the surge", "period [s]", "", legend=False)


def draw(folder: Path, results: dict, whole: Series, shown: np.ndarray, until: float) -> str:
    """Write figure.png; shown: simulated pressure over the whole file [Pa]. Returns its name."""
    figure, axes = panels(2, 2, (11.5, 7.6))
    _pressure(axes[0, 0], whole, shown, until)
    _left(axes[0, 1], whole, shown, until)
    _structures(axes[1, 0], results)
    _periods(axes[1, 1], results)
    return save(figure, folder)
