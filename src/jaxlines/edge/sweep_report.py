"""The report of a sweep: one page of HTML that needs nothing else, in light and dark; and its summary as JSON."""

import importlib.metadata
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.display import readable, readable_unit
from jaxlines.edge.report_page import PRINT_POINTS, SCREEN_POINTS, picture, render
from jaxlines.edge.sweep_plots import main_measure, plot_band, plot_histogram, plot_scatter, plot_sensitivity
from jaxlines.edge.writing import _json, write_whole
from jaxlines.inference.propagation import Linear
from jaxlines.inference.sensitivity_indices import Sensitivity
from jaxlines.inference.statistics import Summary
from jaxlines.inference.sweep_result import SweepResult
from jaxlines.simulation.ensemble_result import LANE_MESSAGES

_SCATTERS = 2
_HEAD = ["quantile", "value", "95 % interval", "whatever the failed lanes give"]
_MOST_PRINTED, _MOST_SHOWN = 1_500, 4_000
_LISTED = ("name", "quantiles", "exceedances")


def status_name(code: int) -> str:
    """The name of a status code."""
    names = list(LANE_MESSAGES)
    return names[code] if code < len(names) else str(code)


def _pair(unit: str, ends: tuple[float, float]) -> str:
    """An interval in a unit that reads well; open ends are infinite."""
    finite = [end for end in ends if np.isfinite(end)]
    label, factor = readable_unit(unit, max(finite, key=abs, default=0.0))
    texts = [f"{end * factor:.5g}" if np.isfinite(end) else "open" for end in ends]
    return f"{texts[0]} to {texts[1]} {label}".strip()


def _quantile_rows(summary: Summary) -> list[list[str]]:
    """Quantiles and exceedances as texts: name, value, 95 % interval, and with failed lanes what they may change."""
    rows = [
        [
            f"{100 * q.probability:g} %",
            readable(summary.unit, q.value),
            _pair(summary.unit, q.ci95),
            _pair(summary.unit, q.bounds),
        ]
        for q in summary.quantiles
    ]
    rows += [
        [f"P(above {readable(summary.unit, e.threshold)})", f"{e.value:.4g}", _share(e.wilson), _share(e.bounds)]
        for e in summary.exceedances
    ]
    return rows if summary.failed else [row[:3] for row in rows]


def _share(ends: tuple[float, float]) -> str:
    """An interval of a probability."""
    return f"{ends[0]:.4g} to {ends[1]:.4g}"


def _linear_text(summary: Summary, linear: Linear | None) -> str:
    """Linear propagation in a sentence."""
    if linear is None or not np.isfinite(linear.remainder):
        return ""
    value, sd = readable(summary.unit, linear.value), readable(summary.unit, linear.sd)
    sampled = readable(summary.unit, linear.sampled_sd)
    return (
        f"Linear propagation ({linear.method}): {value} with a standard deviation of {sd}, sampled {sampled}; "
        f"{100 * linear.remainder:.2g} % of the spread is not linear."
    )


def _reduction(result: SweepResult, summary: Summary) -> dict[str, Any]:
    """A reduction for the page: numbers, histogram, causes, worst lanes."""
    found = result.found
    causes = found.sensitivities.get(summary.name, [])
    spread = f"mean {readable(summary.unit, summary.mean)}, standard deviation {readable(summary.unit, summary.sd)}"
    pictures = [picture(lambda axes, _: plot_histogram(summary, axes), f"histogram of {summary.name}; {spread}")]
    bars = [
        picture(
            lambda axes, _, c=cause: plot_sensitivity(c, summary.unit, axes),
            f"{cause.method} of {summary.name}; {_ranking(cause)}",
            size=(8.2, 2.6),
        )
        for cause in causes
    ]
    scatters = [
        picture(
            lambda axes, _, n=name: plot_scatter(summary, n, found.rows, found.worst[summary.name], axes),
            f"{summary.name} over {name}, worst lanes marked",
            size=(4.1, 3.0),
        )
        for name in _most_important(result, causes)
    ]
    return {
        "name": summary.name,
        "spread": spread,
        "range": _pair(summary.unit, (summary.minimum, summary.maximum)),
        "head": _HEAD if summary.failed else _HEAD[:3],
        "rows": _quantile_rows(summary),
        "linear": _linear_text(summary, found.linear.get(summary.name)),
        "pictures": pictures,
        "bars": bars,
        "scatters": scatters,
        "worst": _worst(result, summary),
    }


def _ranking(cause: Sensitivity) -> str:
    """The three most important numbers in words."""
    values = np.nan_to_num(cause.measures[main_measure(cause)])
    order = np.argsort(-np.abs(values))[:3]
    return "most important: " + ", ".join(f"{cause.names[j]} ({values[j]:.3g})" for j in order)


def _most_important(result: SweepResult, causes: list[Sensitivity]) -> list[str]:
    """The uncertain numbers that matter most for a reduction."""
    names = result.content["names"]
    if not causes:
        return names[:_SCATTERS]
    order = np.argsort(-np.abs(np.nan_to_num(causes[0].measures[main_measure(causes[0])])))
    return [causes[0].names[j] for j in order[:_SCATTERS]]


def _worst(result: SweepResult, summary: Summary) -> dict[str, Any]:
    """The worst lanes as a table of texts."""
    worst, names = result.found.worst[summary.name], result.content["names"]
    rows = [
        [str(int(worst["index"][i])), readable(summary.unit, worst[summary.name][i]),
         *(f"{worst[name][i]:.5g}" for name in names)]
        for i in range(len(worst["index"]))
    ]  # fmt: skip
    return {"head": ["lane", summary.name, *names], "rows": rows[:5]}


def sweep_report(result: SweepResult, title: str) -> str:
    """The report of a sweep as one page of HTML without any link to the outside."""
    found, content = result.found, result.content
    failed = {status_name(code): lanes for code, lanes in found.failed.items()}
    share = result.failed_fraction
    return render(
        "sweep_report.html.jinja",
        title=title,
        status="complete" if not failed else f"{100 * share:.3g} % failed",
        mood="good" if not failed else ("fair" if share < 0.1 else "bad"),
        message=f"{found.count:,} lanes of {len(content['names'])} uncertain numbers",
        failed=[f"{lanes:,} lanes: {name} ({LANE_MESSAGES.get(name, 'failed')})" for name, lanes in failed.items()],
        notes=list(found.notes),
        reductions=[_reduction(result, summary) for summary in found.summaries.values()],
        bands=[_band(result, name) for name in found.bands],
        numbers=_numbers(content["plan"]),
        sampler=_described(content["plan"]["sampler"]),
        hash=content["hash"],
    )


def _band(result: SweepResult, name: str) -> dict[str, Any]:
    """A sensor over time for the page."""
    band, kept = result.found.bands[name], result.found.kept.get(name)
    ends = readable(band.unit, float(np.nanmin(band.low)), float(np.nanmax(band.high)))
    alt = f"{name} over time, bands of quantiles; all lanes lie within {ends}"
    points = min(_MOST_PRINTED, PRINT_POINTS // 12), min(_MOST_SHOWN, SCREEN_POINTS // 12)
    draw = lambda axes, limit: plot_band(band, kept, axes, limit)  # noqa: E731
    return {"name": name, "picture": picture(draw, alt, points=points, samples=band.times.size)}


def _numbers(plan: dict) -> list[tuple[str, str]]:
    """The uncertain numbers and their distributions, in words."""
    uncertain = plan["uncertain"]
    rows = [(name, _described(law)) for name, law in uncertain["single"].items()]
    rows += [(", ".join(group["names"]), group["type"]) for group in uncertain["joint"]]
    return rows + [(pair, f"correlation {r:g}") for pair, r in uncertain["correlation"].items()]


def _described(content: dict) -> str:
    """ "Normal, mean 3, sd 0.1", from the plan."""
    parts = [f"{key} {_word(value)}" for key, value in content.items() if key != "type" and value is not None]
    return ", ".join([content["type"], *parts])


def _word(value) -> str:
    """An entry of a plan, in words."""
    if isinstance(value, dict):
        return _described(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def sweep_summary(result: SweepResult, title: str) -> dict:
    """What summary.json says of a sweep; SI units."""
    found = result.found
    return {
        "title": title,
        "hash": result.content["hash"],
        "count": found.count,
        "failed": {status_name(code): lanes for code, lanes in found.failed.items()},
        "reductions": {
            name: {
                **{key: value for key, value in vars(summary).items() if key not in _LISTED},
                "quantiles": [q._asdict() for q in summary.quantiles],
                "exceedances": [e._asdict() for e in summary.exceedances],
            }
            for name, summary in found.summaries.items()
        },
        "sensitivities": {name: [vars(s) for s in of] for name, of in found.sensitivities.items()},
        "linear": {name: vars(linear) for name, linear in found.linear.items()},
        "worst": found.worst,
        "notes": found.notes,
        "version": importlib.metadata.version("jaxlines"),
    }


def write_sweep(result: SweepResult, title: str) -> list[Path]:
    """Write summary.json and report.html beside the table of a sweep. Raises OSError when they cannot be written."""
    folder = result.folder
    return [
        write_whole(folder / "summary.json", _json(sweep_summary(result, title))),
        write_whole(folder / "report.html", sweep_report(result, title)),
        folder / "table.parquet",
    ]
