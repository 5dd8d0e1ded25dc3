"""The ring-down study in four pictures: a run, what the structures leave over, how well all runs fit, stiffness."""

from pathlib import Path

import numpy as np
import pandas as pd
from ringdown_data import BEFORE, RATE, Ringdown
from ringdown_fits import Fits, residuals
from ringdown_model import BASELINE, MAIN, PASCAL
from study_figure import BLUE, FAINT, GREEN, INK, ORANGE, label, panels, save, shares

MARKS = ("o", "s", "^", "D", "v", "P", "X")


def _run(axes, runs: list[Ringdown], fits: dict[str, Fits]) -> None:
    """The run of median error, measured and simulated."""
    percent = fits[MAIN].percent
    one = int(np.argsort(percent)[percent.size // 2])
    run, times = runs[one], 1e3 * runs[one].times - 1e3 * BEFORE / RATE
    axes.plot(times, 100.0 * run.pressure / run.hold, color=INK, lw=2.4, label="measured")
    for name, color in ((BASELINE, ORANGE), (MAIN, BLUE)):
        shown = fits[name].result.simulated[one, :, 0] / PASCAL
        axes.plot(times, 100.0 * shown / run.hold, color=color, lw=1.3, label=name)
    axes.set_xlim(-30, 150)
    label(axes, f"Unit {run.unit}, run {run.run_id}", "time after the stop [ms]", "pressure [% of hold]")


def _left_over(axes, runs: list[Ringdown], fits: dict[str, Fits]) -> None:
    """Mean over runs of what is left, and where 80 % of the runs lie."""
    times = 1e3 * runs[0].times - 1e3 * BEFORE / RATE
    for name, color in ((BASELINE, ORANGE), (MAIN, BLUE)):
        left = residuals(runs, fits[name])
        low, high = np.percentile(left, [10, 90], axis=0)
        axes.fill_between(times, low, high, color=color, alpha=0.25, lw=0)
        axes.plot(times, left.mean(axis=0), color=color, label=f"{name}: mean, 10 to 90 % of runs")
    axes.set_xlim(-30, 150)
    label(axes, "What the structures leave over", "time after the stop [ms]", "measured - simulated [% of hold]")


def _errors(axes, fits: dict[str, Fits], carried: dict, targets: dict) -> None:
    """Share of runs within an error: fitted, and predicted from other units."""
    for name, color in ((BASELINE, ORANGE), (MAIN, BLUE)):
        axes.plot(*shares(fits[name].percent), color=color, label=f"{name}, fitted")
        errors, groups = carried.get("other units", ({}, {}))
        if groups:
            axes.plot(*shares(list(errors[name].values())), color=color, ls="--", label=f"{name}, other units' numbers")
    axes.plot(
        [targets["median"], targets["p90"]], [50, 90], ls="", marker="x", ms=8, color=INK, label="targets, fitted"
    )
    axes.set_xlim(0, 2.5)
    label(axes, "Runs within an error", "RMSE [% of hold]", "share of runs [%]")


def _stiffness(axes, rows: pd.DataFrame) -> None:
    """Stiffness of hose and chamber over hold pressure, relative to its median."""
    colors = (BLUE, ORANGE, GREEN, INK, FAINT)
    middle = rows["stiffness"].median()
    for i, (unit, part) in enumerate(rows.groupby("unit")):
        look = {"color": colors[i % 5], "marker": MARKS[i % 7], "ms": 3.2, "ls": "", "alpha": 0.8}
        axes.plot(part["hold_counts"], part["stiffness"] / middle, label=f"unit {unit}", **look)
    label(axes, "Stiffness of hose and chamber", "hold pressure [counts]", "stiffness over its median [-]")


def draw(
    folder: Path, runs: list[Ringdown], fits: dict[str, Fits], rows: pd.DataFrame, carried: dict, targets: dict
) -> str:
    """Write figure.png; returns its name."""
    figure, axes = panels(2, 2, (11.0, 7.6))
    _run(axes[0, 0], runs, fits)
    _left_over(axes[0, 1], runs, fits)
    _errors(axes[1, 0], fits, carried, targets)
    _stiffness(axes[1, 1], rows)
    return save(figure, folder)
