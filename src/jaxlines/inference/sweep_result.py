"""What a sweep returns, and how it reads."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.inference.sensitivity_indices import Sensitivity
from jaxlines.inference.statistics import Summary
from jaxlines.inference.sweep_collect import Collected


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """A collected sweep: `print(result)` shows it, `result["peak"]` is the `Summary` of a reduction.

    Fields: folder of the store; content of its plan.json; found: a `Collected` with summaries, bands, sensitivities,
    linear propagation, notes. A sweep without a store has a folder that goes with the result.
    """

    folder: Path
    content: dict[str, Any]
    found: Collected

    def __getitem__(self, name: str) -> Summary:
        """The statistics of a reduction. Raises KeyError with the names there are."""
        if name not in self.found.summaries:
            raise KeyError(f"the sweep has no reduction {name!r}; it has {', '.join(self.found.summaries) or 'none'}")
        return self.found.summaries[name]

    @property
    def count(self) -> int:
        """How many lanes there are."""
        return self.found.count

    @property
    def failed_fraction(self) -> float:
        """The share of lanes that failed."""
        return sum(self.found.failed.values()) / max(self.found.count, 1)

    def table(self):
        """All lanes as a pandas DataFrame: index, numbers, reductions, status, error (SI)."""
        import pandas

        return pandas.read_parquet(self.folder / "table.parquet")

    def to_xarray(self):
        """Bands over time (dimensions output, quantile, time) and kept series as an xarray.Dataset."""
        try:
            import xarray
        except ImportError as error:
            raise ImportError("to_xarray needs xarray: pip install 'jaxlines[xarray]'") from error
        data: dict[str, Any] = {}
        for name, band in self.found.bands.items():
            stacked = np.stack([band.quantiles[q] for q in band.quantiles])
            data[name] = (("quantile", "time"), stacked, {"units": band.unit})
            data[f"{name} mean"] = ("time", band.mean, {"units": band.unit})
            data[f"{name} lanes"] = (("lane", "time"), self.found.kept[name], {"units": band.unit})
        quantiles = list(next(iter(self.found.bands.values())).quantiles) if self.found.bands else []
        coords = {"time": np.asarray(self.content["times"]), "quantile": quantiles}
        return xarray.Dataset(data, coords=coords, attrs={"count": self.count, "failed": self.failed_fraction})

    def __str__(self) -> str:
        failed = sum(self.found.failed.values())
        lines = [f"{self.count:,} lanes, {failed:,} failed; {self.folder}", ""]
        for summary in self.found.summaries.values():
            lines += [*_summary_lines(summary), *self._linear_lines(summary.name)]
            for sensitivity in self.found.sensitivities.get(summary.name, ()):
                lines += _sensitivity_lines(sensitivity)
            lines.append("")
        lines += [f"  - {note}" for note in self.found.notes]
        return "\n".join(lines).rstrip()

    def _linear_lines(self, name: str) -> list[str]:
        linear = self.found.linear.get(name)
        if linear is None:
            return []
        rest = f"; {100 * linear.remainder:.2g} % of the spread is not linear" if np.isfinite(linear.remainder) else ""
        return [f"  linear: {linear.value:.5g}  sd {linear.sd:.3g}{rest}"]


def _summary_lines(summary: Summary) -> list[str]:
    """A reduction in a few lines."""
    unit = "" if summary.unit == "1" else f" {summary.unit}"
    lines = [f"{summary.name}: mean {summary.mean:.5g}{unit}, sd {summary.sd:.3g}, "
             f"from {summary.minimum:.5g} to {summary.maximum:.5g}"]  # fmt: skip
    for q in summary.quantiles:
        low, high = q.ci95
        failures = f"; with the failed lanes {q.bounds[0]:.5g} .. {q.bounds[1]:.5g}" if summary.failed else ""
        lines.append(f"  {100 * q.probability:g} %: {q.value:.5g}{unit}  (95 % {low:.5g} .. {high:.5g}{failures})")
    for e in summary.exceedances:
        failures = f"; with the failed lanes {e.bounds[0]:.3g} .. {e.bounds[1]:.3g}" if summary.failed else ""
        interval = f"95 % {e.wilson[0]:.3g} .. {e.wilson[1]:.3g}"
        lines.append(f"  above {e.threshold:.5g}{unit}: probability {e.value:.3g}  ({interval}{failures})")
    return lines


def _sensitivity_lines(sensitivity: Sensitivity) -> list[str]:
    """Indices, the largest first."""
    measures = {name: values for name, values in sensitivity.measures.items() if values.ndim == 1}
    key = next(name for name in ("total", "share", "mu_star", "total_bound", "swing") if name in measures)
    order = np.argsort(-np.abs(np.nan_to_num(measures[key])))
    lines = [f"  {sensitivity.method} ({sensitivity.blocks} blocks, {sensitivity.failed_blocks} with failures):"]
    for j in order:
        parts = []
        for name, values in measures.items():
            half = sensitivity.confidence.get(name)
            parts.append(f"{name} {values[j]:.3g}" + ("" if half is None else f" +- {half[j]:.1g}"))
        lines.append(f"    {sensitivity.names[j]:<32} {', '.join(parts)}")
    return lines
