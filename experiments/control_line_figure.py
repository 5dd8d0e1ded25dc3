"""The recovery study in four pictures: recording and fit, residuals with and without air, estimates, half-widths."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from study_figure import BLUE, FAINT, GREEN, INK, ORANGE, label, panels, save

SHOWN = {"example": BLUE, "statistical": GREEN, "noise_free": FAINT, "airless": ORANGE}
BAR, SMOOTH = 1e5, 21  # [Pa]; samples over which residuals are averaged for the eye


def _words(path: str) -> str:
    """A path over two lines: "leak.conductance" is the leak's conductance."""
    return path.replace(".", "\n", 1).replace(".", " ").replace("_", " ")


def _recording(axes, fit) -> None:
    """Measured and simulated pressure."""
    channel = fit.channels["A.pressure"]
    axes.plot(channel.times, channel.measured / BAR, color=FAINT, marker=".", ms=2, ls="", label="recording")
    axes.plot(channel.times, channel.simulated / BAR, color=BLUE, label="one-lump fit with air")
    label(axes, "Recording and fit", "time [s]", "pressure [bar absolute]")


def _residuals(axes, found: Mapping) -> None:
    """Residuals averaged over neighbours, with air and without."""
    for name, color, text in (("airless", ORANGE, "air left out"), ("statistical", BLUE, "with air")):
        channel = found[name].channels["A.pressure"]
        left = (channel.measured - channel.simulated) / BAR
        kernel = np.ones(SMOOTH) / SMOOTH
        middle = np.convolve(left, kernel, mode="valid")
        times = channel.times[SMOOTH // 2 : SMOOTH // 2 + middle.size]
        axes.plot(times, middle, color=color, lw=1.0, label=f"{text} (whiteness p = {channel.whiteness_p:.2g})")
    label(axes, f"Residuals, means of {SMOOTH} samples", "time [s]", "measured - simulated [bar]")


def _estimates(axes, found: Mapping, truth: Mapping, words: Mapping) -> None:
    """Estimates over the truth with 95 % intervals, one row a parameter and fit."""
    names = list(truth)
    for k, (fit, color) in enumerate(SHOWN.items()):
        for row, name in enumerate(names):
            estimate = found[fit].parameters.get(name)
            if estimate is None:
                continue
            place = row + 0.2 * (k - 1.5)
            share = 100.0 * (estimate.value / truth[name] - 1.0)
            if estimate.ci95 is not None:
                ends = [100.0 * (end / truth[name] - 1.0) for end in estimate.ci95]
                axes.plot(ends, [place, place], color=color, lw=2.2)
            axes.plot([share], [place], color=color, marker="o", ms=5)
    for fit, color in SHOWN.items():
        axes.plot([], [], color=color, marker="o", lw=2.2, label=words[fit])
    axes.axvline(0.0, color=INK, lw=0.9)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_yticks(range(len(names)), [_words(name) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    label(axes, "Estimates about the truth, 95 % intervals", "deviation from the truth [%]", "", legend=False)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(0.0, -0.18), ncols=2)


def _bias(axes, numbers: Mapping) -> None:
    """Bias of the one-lump model in standard deviations of the noise."""
    bias = numbers["bias_over_statistical_sd"]
    axes.barh(range(len(bias)), list(bias.values()), 0.5, color=BLUE)
    axes.set_yticks(range(len(bias)), [_words(name) for name in bias])
    axes.axvline(numbers["bias_limit"], color=ORANGE, ls="--", label="largest bias allowed")
    axes.grid(axis="y", visible=False)
    label(axes, "Bias of the one-lump model", "bias over the standard deviation from noise [-]", "")


def draw(folder: Path, found: Mapping, truth: Mapping, numbers: Mapping, words: Mapping) -> str:
    """Write figure.png; found: fits by name; words: what each is called. Returns its name."""
    figure, axes = panels(2, 2, (11.5, 7.8))
    _recording(axes[0, 0], found["example"])
    _residuals(axes[0, 1], found)
    _estimates(axes[1, 0], found, truth, words)
    _bias(axes[1, 1], numbers)
    return save(figure, folder)
