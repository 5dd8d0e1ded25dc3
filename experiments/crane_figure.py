"""The crane study in four pictures: pressure, position, intervals, and structures or residuals."""

from pathlib import Path

import numpy as np
import pandas as pd
from crane_model import METRE, PASCAL
from study_figure import BLUE, FAINT, INK, ORANGE, label, panels, save

LAGS = 60  # of the residuals' autocorrelation that is drawn


def _series(axes, times, measured, shown, fitted: int, words: tuple[str, str], legend: bool) -> None:
    """Measured and freely simulated samples; those from `fitted` on were not seen by the fit."""
    axes.plot(times[: len(measured)], measured, color=INK, lw=1.8, label="measured")
    axes.plot(times[: len(shown)], shown, color=BLUE, lw=1.1, label="simulated freely from the valve signal")
    axes.axvspan(fitted, times[-1], color=FAINT, alpha=0.18, lw=0, label="not fitted")
    label(axes, words[0], "sample", words[1], legend=legend)


def _intervals(axes, parameters: dict) -> None:
    """95 % intervals over the estimates (relative), for white noise and as the fit states them."""
    names = list(parameters)
    for k, name in enumerate(names):
        one = parameters[name]
        for key, shift, color in (("ci95_white_noise", -0.15, FAINT), ("ci95", 0.15, BLUE)):
            if one[key] is not None:
                low, high = ((end - one["value"]) / abs(one["value"]) for end in one[key])
                axes.plot([100 * low, 100 * high], [k + shift] * 2, color=color, lw=3, solid_capstyle="butt")
    axes.axvline(0.0, color=INK, lw=0.8)
    for text, color in (("white noise", FAINT), ("correlated noise", BLUE)):
        axes.plot([], [], color=color, lw=3, label=text)
    axes.set_yticks(range(len(names)), names, fontsize=7.5)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(-110, 110)
    label(axes, "95 % intervals about the estimates", "deviation from the estimate [%]", "", legend=False)
    axes.legend(frameon=False, fontsize=8.5, loc="lower center", bbox_to_anchor=(0.5, -0.32), ncols=2)


def _structures(axes, results: dict) -> None:
    """Free-run RMSE of the validation part by structure."""
    table = {name: row for name, row in results["structures"].items() if "validation_rmse" in row}
    for k, (name, row) in enumerate(table.items()):
        color = BLUE if name == results["structure"] else FAINT
        axes.barh([k], [row["validation_rmse"]], 0.6, color=color)
        axes.annotate(f" {row['validation_rmse']:.2f}", (row["validation_rmse"], k), va="center", fontsize=9)
    axes.axvline(results["target_rmse"], color=ORANGE, ls="--", label="target on what follows")
    axes.set_yticks(range(len(table)), [name.replace(" and ", "\nand ") for name in table])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlim(0.0, 1.6 * results["target_rmse"])
    title, x = "Structures on the part not fitted", "free-run RMSE of p_oil [units of the record]"
    label(axes, title, x, "", legend=False)
    axes.legend(frameon=False, fontsize=8.5, loc="center right")


def _correlation(axes, missed: np.ndarray) -> None:
    """Autocorrelation of the pressure residuals of the final fit."""
    left = missed - missed.mean()
    values = np.array([left[k:] @ left[: left.size - k] for k in range(LAGS)]) / (left @ left)
    axes.vlines(range(LAGS), 0.0, values, color=BLUE, lw=2)
    limit = 1.96 / np.sqrt(left.size)
    axes.axhspan(-limit, limit, color=FAINT, alpha=0.3, lw=0, label="95 % of white residuals")
    label(axes, "Residuals of p_oil are not white" if abs(values[1]) > limit else "Residuals", "lag [samples]",
          "autocorrelation [-]")  # fmt: skip


def draw(folder: Path, results: dict, train: pd.DataFrame, trial, final, later: tuple | None, fitted: int) -> str:
    """Write figure.png; returns its name.

    Args: trial, final: the fits to the first `fitted` samples and to all of train.csv; later: measured and predicted
    oil pressure of test.csv, where there is one.
    """
    figure, axes = panels(2, 2, (12.0, 8.2))
    measured, shown = train["p_oil"].to_numpy(), trial.channels["gauge"].simulated / PASCAL
    if later is not None:
        measured, shown = np.concatenate([measured, later[0]]), np.concatenate([shown, later[1]])
    times = np.arange(len(measured))
    _series(axes[0, 0], times, measured, shown, fitted, ("Oil pressure", "p_oil [units of the record]"), True)
    place = trial.channels["position"].simulated / METRE
    times = np.arange(len(train))
    words = ("Position", "x_crane [units of the record]")
    _series(axes[0, 1], times, train["x_crane"], place, fitted, words, False)
    _intervals(axes[1, 0], results["parameters"])
    if len(results["structures"]) > 1:
        _structures(axes[1, 1], results)
    else:
        channel = final.channels["gauge"]
        _correlation(axes[1, 1], (channel.measured - channel.simulated) / PASCAL)
    return save(figure, folder)
