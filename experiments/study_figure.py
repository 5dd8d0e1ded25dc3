"""One look for the figures of the studies: drawn without a display, written next to results.json."""

from pathlib import Path
from typing import Any

import numpy as np

INK, FAINT, BLUE, ORANGE, GREEN = "#222222", "#9a9a9a", "#1f5fa8", "#d1661c", "#2d8a57"


def panels(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, np.ndarray]:
    """Figure and axes, shape (rows, columns); size [inch]."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    style: Any = {
        "font.size": 9.5,
        "axes.titlesize": 10,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e6e6e6",
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
        "lines.linewidth": 1.3,
    }
    with plt.rc_context(style):
        figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    return figure, axes


def label(axes, title: str, x: str, y: str, legend: bool = True) -> None:
    """Title, axes with units, legend."""
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_axisbelow(True)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if legend:
        axes.legend(frameon=False, fontsize=8.5)


def save(figure, folder: Path, name: str = "figure.png") -> str:
    """Write the figure; returns its name, for results.json."""
    import matplotlib.pyplot as plt

    figure.savefig(folder / name, dpi=140, facecolor="white")
    plt.close(figure)
    return name


def shares(values) -> tuple[np.ndarray, np.ndarray]:
    """Sorted values and the share of them that is not above each [per cent]."""
    ordered = np.sort(np.asarray(values, dtype=float))
    return ordered, 100.0 * np.arange(1, ordered.size + 1) / ordered.size
