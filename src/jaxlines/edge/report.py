"""The report of a fit: one page of HTML that needs nothing else, in light and dark."""

import functools
import importlib.metadata
import io
import platform
import re
from typing import Any

import numpy as np

from jaxlines.edge.display import estimate_row, readable_text, readable_unit
from jaxlines.edge.drawing import circuit_svg
from jaxlines.edge.plots import MAX_POINTS, SIMULATED, plot_bulk_modulus, plot_channel, plot_residuals, plot_wave_speed
from jaxlines.inference.analysis import ChannelFit
from jaxlines.inference.curves import Curve
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.uncertainty import p_value_text

_INK = "#010203"
# A colour that nothing else has: it stands for the text colour of the page, whatever that is.
_POINTS_OF_A_PAGE = 24_000
_DECIMALS = re.compile(r"\d+\.\d{3,}")
_STATUS = {"converged": "good", "at_bound": "fair", "stalled": "fair", "failed": "bad"}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "jaxlines",
    "font.size": 10,
    "text.color": _INK,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": _INK,
    "grid.alpha": 0.12,
    "axes.formatter.useoffset": False,
}


def inline_svg(figure, description: str) -> str:
    """A figure as SVG for a page: no prolog, no metadata, colours of the page, two decimals, a description."""
    buffer = io.StringIO()
    blank = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(buffer, format="svg", transparent=True, metadata=blank)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(_INK, "currentColor").replace(SIMULATED, "var(--blue)")
    svg = re.sub(r'<g id="[^"]*">', "<g>", svg)
    svg = re.sub(r"<[^>]*>", lambda tag: _DECIMALS.sub(lambda number: f"{float(number[0]):.2f}", tag[0]), svg)
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font: \1 var(--font)", svg)
    svg = re.sub(
        r'(<svg[^>]*?) width="[^"]*"', r"\1", re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1), count=1
    )
    return svg.replace("<svg", f'<svg role="img" aria-label="{_attribute(description)}"', 1)


def _attribute(text: str) -> str:
    """A text that may stand in a quoted attribute."""
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")


def _channel_figure(name: str, channel: ChannelFit, limit: int) -> dict:
    """Data and fit over time above, residuals below."""
    import matplotlib
    from matplotlib.figure import Figure

    unit, factor = readable_unit(channel.unit, channel.rmse)
    white = "look random" if channel.white else "do not look random"
    summary = f"rmse {channel.rmse * factor:.3g} {unit}, noise {channel.sigma * factor:.3g} {unit}, residuals {white}"
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8.2, 5.0), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1))
        plot_channel(channel, name, upper, limit).set_xlabel("")
        plot_residuals(channel, name, lower, limit)
        alt = f"{name} over time, measured and simulated, and the residuals below; {summary}"
        return {
            "name": name,
            "summary": summary,
            "p": p_value_text(channel.whiteness_p),
            "svg": inline_svg(figure, alt),
        }


def _curve_figure(name: str, curve: Curve) -> dict:
    """Effective bulk modulus and wave speed over pressure."""
    import matplotlib
    from matplotlib.figure import Figure

    pictures = []
    span = f"between {curve.pressure[0]:.3g} and {curve.pressure[-1]:.3g} Pa, with 95 % band"
    modulus = f"effective bulk modulus, {curve.bulk_modulus[0]:.3g} to {curve.bulk_modulus[-1]:.3g} Pa"
    speed = f"wave speed, {curve.wave_speed[0]:.4g} to {curve.wave_speed[-1]:.4g} m/s"
    with matplotlib.rc_context(_STYLE):
        for plot, what in ((plot_bulk_modulus, modulus), (plot_wave_speed, speed)):
            figure = Figure(figsize=(4.4, 3.2), layout="constrained")
            plot(curve, figure.add_subplot())
            pictures.append(inline_svg(figure, f"{name}: {what}, {span}"))
    return {"name": name, "pictures": pictures}


def _correlations(fit: Fit) -> list[dict]:
    """Rows of the table of correlations: the number, and how strongly to colour it."""
    matrix = np.asarray(fit.correlations)
    return [
        {
            "name": name,
            "cells": [
                {"text": f"{r:+.2f}" if np.isfinite(r) else "-", "share": round(100 * abs(r)) if np.isfinite(r) else 0,
                 "sign": "plus" if r >= 0 else "minus"}
                for r in matrix[i]
            ],
        }
        for i, name in enumerate(fit.parameters)
    ]  # fmt: skip


def _versions() -> str:
    """What computed this."""
    packages = ("jaxlines", "jax", "diffrax", "equinox", "numpy")
    return ", ".join(
        [f"Python {platform.python_version()}", *(f"{p} {importlib.metadata.version(p)}" for p in packages)]
    )


@functools.cache
def _template():
    """The page."""
    import jinja2

    loader = jinja2.PackageLoader("jaxlines.edge", ".")
    return jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True).get_template(
        "report.html.jinja"
    )


def fit_report(fit: Fit, title: str) -> str:
    """The report of a fit as one page of HTML without any link to the outside."""
    limit = int(min(MAX_POINTS, _POINTS_OF_A_PAGE / (3 * max(1, len(fit.channels)))))
    return _template().render(
        title=title,
        status=fit.status,
        mood=_STATUS[fit.status],
        message=readable_text(fit.message),
        effort=f"{fit.num_evaluations} evaluations, {fit.seconds:.1f} s",
        circuit=circuit_svg(fit.circuit),
        parameters=[(name, estimate_row(estimate)) for name, estimate in fit.parameters.items()],
        derived=[(name, estimate_row(estimate)) for name, estimate in fit.derived.items()],
        correlations=_correlations(fit),
        channels=[_channel_figure(name, channel, limit) for name, channel in fit.channels.items()],
        curves=[_curve_figure(name, curve) for name, curve in fit.curves.items()],
        identifiability=[readable_text(sentence) for sentence in fit.identifiability],
        scale=[readable_text(sentence) for sentence in fit.scale],
        warnings=[readable_text(sentence) for sentence in fit.warnings],
        validity=fit.validity.sentences() if fit.validity else [],
        valid=fit.validity is None or fit.validity.ok,
        versions=_versions(),
    )
