"""The picture of the README: measured and simulated pressure of the example fit, and what is left between them.

    python experiments/example_picture.py --out docs

Writes example.svg. Its background is transparent and its ink is a grey that reads on light and dark pages.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

import jaxlines as jl
from jaxlines.edge.plots import plot_channel, plot_residuals
from jaxlines.inference.fit_result import Fit

INK = "#7d8590"
LARGEST = 100_000
POINTS = 700
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "jaxlines",
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "path.simplify_threshold": 0.5,
}


def draw(fit: Fit) -> Figure:
    """Pressure above, residuals below."""
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1.0))
    (name, channel) = next(iter(fit.channels.items()))
    plot_channel(channel, name, upper, limit=POINTS)
    plot_residuals(channel, name, lower, limit=POINTS)
    modulus, air = (fit.parameters[path] for path in ("fluid.bulk_modulus", "fluid.air_fraction"))
    index = float(fit.circuit["fluid.polytropic_index"])
    upper.set(
        xlabel="",
        title=f"bulk modulus {modulus.value / 1e9:.3f} ± {(modulus.sd or 0.0) / 1e9:.3f} GPa, "
        f"entrained air {100 * air.value:.3f} ± {100 * (air.sd or 0.0):.3f} % (at polytropic index {index:g})",
    )
    return figure


def main() -> int:
    """Fit the example and draw it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for example.svg and results.json")
    folder = parser.parse_args().out
    fit = jl.load_study("example:control-line").fit()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "example.svg"
    with matplotlib.rc_context(STYLE):
        draw(fit).savefig(path, transparent=True, metadata={"Date": None})
    size = path.stat().st_size
    values = {name: estimate.value for name, estimate in fit.parameters.items()}
    results = {"status": fit.status, "bytes": size, "parameters": values}
    (folder / "results.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    print(f"wrote {path}: {size} bytes, the fit {fit.status}")
    return 0 if fit.status == "converged" and size < LARGEST else 1


if __name__ == "__main__":
    sys.exit(main())
