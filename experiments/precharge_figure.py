"""The pre-charge study in three pictures: readings over labels, twice, and volume against pre-charge."""

from pathlib import Path

import numpy as np
from precharge_data import ATMOSPHERE_BAR, Cycles
from precharge_model import CAP, Calibration, taken_in
from study_figure import BLUE, FAINT, INK, ORANGE, label, panels, save

from jaxlines.simulation.precision import computing_in


def _readings(axes, title: str, value: np.ndarray, known: np.ndarray, found: dict) -> None:
    """Readings of settled cycles over their labels [bar]: all, quartiles, median."""
    rng = np.random.default_rng(0)
    names = np.unique(known)
    axes.plot(known + rng.uniform(-2.2, 2.2, known.size), value, ls="", marker=".", ms=2.5, color=FAINT, alpha=0.6)
    low, middle, high = (np.array([np.percentile(value[known == one], q) for one in names]) for q in (25, 50, 75))
    axes.errorbar(
        names, middle, [middle - low, high - middle], fmt="o", color=BLUE, ms=6, capsize=5, label="median and quartiles"
    )
    ends = np.array([names.min() - 6, names.max() + 6])
    axes.plot(ends, ends, color=INK, lw=1.0, ls="--", label="reading = label")
    axes.set_ylim(*np.clip(np.percentile(value, [0.5, 99.5]) + np.array([-8.0, 8.0]), 40, 200))
    words = f"{title}\nrank correlation {found['rank_correlation']:.2f}, RMSE {found['rmse_bar']:.1f} bar"
    label(axes, words, "label of the rig [bar gauge]", "reading without the label [bar gauge]")
    axes.set_xticks(names)


def _trade_off(axes, cycles: Cycles, calibration: Calibration) -> None:
    """Misfit of the cycles of one label over volume and pre-charge, when neither is known."""
    one = np.unique(cycles.label)[1]
    few = cycles[np.flatnonzero(cycles.stable & (cycles.label == one) & cycles.usable.all(axis=1))[::10]]
    volumes, tried = np.linspace(0.4, 1.4, 60), np.linspace(70e5, 150e5, 80)
    misfit = np.empty((tried.size, volumes.size))
    with computing_in("float64"):
        for k, volume in enumerate(volumes):
            shared = [volume, *calibration.values[1:]]
            shown = taken_in(shared, tried[:, None, None], few.temperature[:, None], few.before, few.after)
            rows = (np.asarray(shown) - few.taken) / calibration.noise
            misfit[:, k] = np.sqrt(np.mean(np.minimum(rows**2, CAP), axis=(1, 2)))
    drawn = axes.contourf(volumes, tried / 1e5 - ATMOSPHERE_BAR, misfit, np.linspace(1.0, 3.0, 17), cmap="Blues_r")
    axes.grid(visible=False)
    axes.figure.colorbar(drawn, ax=axes, label="misfit of a step [noise levels]", ticks=[1, 1.5, 2, 2.5, 3])
    known = one / 1e5 - ATMOSPHERE_BAR
    axes.plot(calibration.values[0], known, marker="*", ms=14, color=ORANGE, ls="", label="calibrated volume, label")
    label(axes, f"Cycles labelled {known:.0f} bar, volume not known", "gas volume [l]", "pre-charge [bar gauge]")


def draw(folder: Path, cycles: Cycles, told: dict) -> str:
    """Write figure.png; told: way of leaving out -> what it tells. Returns its name."""
    figure, axes = panels(1, 3, (14.0, 4.6))
    for at, name in zip(axes[0], ("same conditions", "other temperature"), strict=False):
        _readings(at, name.capitalize(), told[name].value, told[name].label, told[name].found["settled"])
    _trade_off(axes[0, 2], cycles, told["same conditions"].calibration)
    return save(figure, folder)
