"""What the commands print of a sweep: quantiles, exceedances and causes in units that read well."""

import numpy as np
from rich.markup import escape

from jaxlines.edge.display import readable, readable_unit
from jaxlines.edge.showing import plain_console, plain_table, show_sentences
from jaxlines.inference.sensitivity_indices import Sensitivity
from jaxlines.inference.statistics import Summary
from jaxlines.inference.sweep_result import SweepResult

MOST_CAUSES = 6
"""Causes of the spread that are named for each reduction."""


def show_sweep(result: SweepResult, title: str) -> None:
    """A collected sweep: quantiles of every reduction, probabilities to exceed, causes of the spread, notes."""
    console, found = plain_console(), result.found
    failed = sum(found.failed.values())
    console.print(f"[bold]{escape(title)}[/bold]")
    console.print(f"{result.count:,} lanes, {failed:,} failed\n")
    if found.summaries:
        probabilities = [q.probability for q in next(iter(found.summaries.values())).quantiles]
        table = plain_table("reduction", "mean", "sd", *(f"{100 * p:g} %" for p in probabilities), "unit")
        for summary in found.summaries.values():
            table.add_row(*_row(summary))
        console.print(table)
    show_sentences(console, "Probability to exceed", _exceedances(found.summaries.values()))
    for name in found.summaries:
        for sensitivity in found.sensitivities.get(name, ()):
            heading = f"What moves {escape(name)}: {sensitivity.method}"
            show_sentences(console, heading, _causes(sensitivity, result[name]))
    show_sentences(console, "Notes", found.notes)
    if any(summary.unit == "Pa" for summary in found.summaries.values()):
        console.print("\nPressures are absolute, but for those of gauge sensors.")


def _row(summary: Summary) -> list[str]:
    """A reduction as a row of the table."""
    label, factor = readable_unit(summary.unit, max(abs(summary.minimum), abs(summary.maximum)))
    numbers = [summary.mean, summary.sd, *(q.value for q in summary.quantiles)]
    return [escape(summary.name), *(f"{number * factor:.4g}" for number in numbers), label]


def _exceedances(summaries) -> list[str]:
    """Each threshold with the probability to exceed it and its 95 % interval, which failed lanes widen."""
    lines = []
    for summary in summaries:
        for e in summary.exceedances:
            low, high = e.wilson
            text = f"{summary.name} above {readable(summary.unit, e.threshold)}: {e.value:.3g}"
            text += f" (95 % {low:.3g} to {high:.3g}"
            text += f"; with the failed lanes {e.bounds[0]:.3g} to {e.bounds[1]:.3g})" if summary.failed else ")"
            lines.append(text)
    return lines


def _causes(sensitivity: Sensitivity, summary: Summary) -> list[str]:
    """The numbers that matter most, the first measure that ranks them in front; swings in the reduction's unit."""
    measures = {name: values for name, values in sensitivity.measures.items() if values.ndim == 1}
    key = next(name for name in ("total", "share", "mu_star", "total_bound", "swing") if name in measures)
    order = np.argsort(-np.abs(np.nan_to_num(measures[key])))[:MOST_CAUSES]
    lines = []
    for j in order:
        if key == "swing":
            parts = [f"{name} {readable(summary.unit, float(values[j]))}" for name, values in measures.items()]
        else:
            half = {name: f" +- {widths[j]:.1g}" for name, widths in sensitivity.confidence.items() if name in measures}
            parts = [f"{name} {values[j]:.3g}{half.get(name, '')}" for name, values in measures.items()]
        lines.append(f"{sensitivity.names[j]}: {', '.join(parts)}")
    return lines
