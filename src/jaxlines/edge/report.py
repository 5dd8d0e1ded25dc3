"""The report of a fit: one page of HTML that needs nothing else, in light and dark."""

import dataclasses

import numpy as np

from jaxlines.edge.display import estimate_row, readable, readable_text, readable_unit
from jaxlines.edge.drawing import circuit_svg
from jaxlines.edge.plots import (
    plot_bulk_modulus,
    plot_channel,
    plot_directions,
    plot_posterior,
    plot_residuals,
    plot_starts,
    plot_wave_speed,
)
from jaxlines.edge.report_page import PRINT_POINTS, SCREEN_POINTS, Picture, inline_svg, picture, render
from jaxlines.inference.analysis import ChannelFit
from jaxlines.inference.curves import Curve
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.identifiability import Identifiability
from jaxlines.inference.posterior import Posterior
from jaxlines.inference.uncertainty import p_value_text

_MOST_PRINTED, _MOST_SHOWN, _MOST_DIRECTIONS, _MOST_PAIRS = 4_000, 15_000, 10, 6
_MOST_CHANNELS = 24
_STATUS = {"converged": "good", "failed": "bad"}


def _channel_figure(name: str, channel: ChannelFit, points: tuple[int, int]) -> dict:
    """Data and fit over time above, residuals below."""
    unit, factor = readable_unit(channel.unit, channel.rmse)
    noise = f"rmse {channel.rmse * factor:.3g} {unit}, noise {channel.sigma * factor:.3g} {unit}"
    summary = f"{noise}, residuals {_randomness(channel)}"

    def draw(axes, limit):
        plot_channel(channel, name, axes[0], limit).set_xlabel("")
        plot_residuals(channel, name, axes[1], limit)

    alt = f"{name} over time, measured and simulated, and the residuals below; {summary}"
    size, samples = (8.2, 5.0), channel.times.size
    shown = picture(draw, alt, size=size, panels=(2.2, 1), points=points, samples=samples)
    return {"name": name, "summary": summary, "picture": shown}


def _shown(fit: Fit) -> dict[str, ChannelFit]:
    """The channels that are drawn: all, or of very many those that fit worst for their noise."""
    worst = sorted(fit.channels, key=lambda name: -fit.channels[name].rmse / max(fit.channels[name].sigma, 1e-300))
    return {name: fit.channels[name] for name in fit.channels if name in worst[:_MOST_CHANNELS]}


def _randomness(channel: ChannelFit) -> str:
    """Whether residuals are white, in words."""
    if np.isnan(channel.whiteness_p):
        return "are too few to tell whether they are random"
    look = "look random" if channel.white else "do not look random"
    return f"{look} (Ljung-Box {p_value_text(channel.whiteness_p)})"


def _curve_figure(name: str, curve: Curve) -> dict:
    """Effective bulk modulus and wave speed over pressure."""
    span = f"between {curve.pressure[0]:.3g} and {curve.pressure[-1]:.3g} Pa, with 95 % band"
    modulus = f"effective bulk modulus, {curve.bulk_modulus[0]:.3g} to {curve.bulk_modulus[-1]:.3g} Pa"
    speed = f"wave speed, {curve.wave_speed[0]:.4g} to {curve.wave_speed[-1]:.4g} m/s"
    pictures = [
        picture(lambda axes, _, plot=plot: plot(curve, axes), f"{name}: {what}, {span}", size=(4.4, 3.2))
        for plot, what in ((plot_bulk_modulus, modulus), (plot_wave_speed, speed))
    ]
    return {"name": name, "pictures": pictures}


def _searches(fit: Fit) -> list[Picture]:
    """Where the searches ended, if there was more than one."""
    if len(fit.starts) < 2:
        return []
    worked = sum(bool(np.isfinite(start.cost)) for start in fit.starts)
    alt = f"costs at which {len(fit.starts)} searches ended, best first; {worked} came to an end, the best at "
    return [picture(lambda axes, _: plot_starts(fit.starts, axes), alt + f"{fit.starts[0].cost:.5g}", size=(8.2, 2.8))]


def _directions(fit: Fit) -> list[Picture]:
    """What the data tell and what not, if there is more than one free number."""
    if fit.problem is None or fit.coordinates is None or not 1 < len(fit.problem.labels) <= _MOST_DIRECTIONS:
        return []
    problem, coordinates = fit.problem, fit.coordinates
    alt = "directions in the space of the free numbers, the best known first, and which numbers take part in each"
    size = (8.2, 1.2 + 0.35 * len(problem.labels))
    return [picture(lambda axes, _: plot_directions(problem, coordinates, axes), alt, size=size)]


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


def _posterior(fit: Fit, drawn: Posterior | None) -> dict | None:
    """Medians and intervals of a posterior, and its draws in pairs."""
    if drawn is None:
        return None
    from matplotlib.figure import Figure

    from jaxlines.edge.fit_files import posterior_summary
    from jaxlines.inference.fit_tools import values_of

    summary, rows = posterior_summary(fit, drawn), []
    for name, own in summary["parameters"].items():
        unit = fit.parameters[name].unit
        rows.append([name, readable(unit, own["median"]), readable(unit, *own["ci95"]), f"{own['rhat']:.3f}"])
    pictures, count = [], len(drawn.labels)
    if 1 < count <= _MOST_PAIRS:
        figure = Figure(figsize=(2.4 * count, 2.2 * count), layout="constrained")
        plot_posterior(dataclasses.replace(drawn, draws=values_of(fit, drawn)), axes=figure.subplots(count, count))
        alt = f"draws of the posterior in pairs: {', '.join(drawn.labels)}"
        pictures.append(Picture(alt, inline_svg(figure, alt)))
    words = f"{summary['draws']:,} draws by the no-U-turn sampler, {summary['divergences']} of them divergent."
    return {"rows": rows, "pictures": pictures, "words": words, "warnings": "; ".join(summary["warnings"])}


def fit_report(
    fit: Fit,
    title: str,
    classes: dict[str, Identifiability] | None = None,
    posterior: Posterior | None = None,
) -> str:
    """The report of a fit as one page of HTML without any link to the outside.

    Args: fit; title of the page; classes, posterior: of `Fit.assess` and `Fit.posterior`, where they were asked for.
    """
    channels = _shown(fit)
    curves = 3 * max(1, len(channels))
    points = min(_MOST_PRINTED, PRINT_POINTS // curves), min(_MOST_SHOWN, SCREEN_POINTS // curves)
    return render(
        "report.html.jinja",
        title=title,
        status=fit.status,
        mood=_STATUS.get(fit.status, "fair"),
        message=readable_text(fit.message),
        effort=f"{fit.num_evaluations} evaluations, {fit.seconds:.1f} s",
        circuit=circuit_svg(fit.circuit),
        parameters=[(name, estimate_row(estimate)) for name, estimate in fit.parameters.items()],
        derived=[(name, estimate_row(estimate)) for name, estimate in fit.derived.items()],
        correlations=_correlations(fit),
        channels=[_channel_figure(name, channel, points) for name, channel in channels.items()],
        left_out=len(fit.channels) - len(channels),
        curves=[_curve_figure(name, curve) for name, curve in fit.curves.items()],
        searches=_searches(fit),
        intervals=readable_text(fit.intervals),
        scatter=[readable_text(between.sentence(name)) for name, between in fit.scatter.items()],
        classes=[(name, found.kind, readable_text(found.sentence)) for name, found in (classes or {}).items()],
        posterior=_posterior(fit, posterior),
        directions=_directions(fit),
        identifiability=[readable_text(sentence) for sentence in fit.identifiability],
        scale=[readable_text(sentence) for sentence in fit.scale],
        warnings=[readable_text(sentence) for sentence in fit.warnings],
        validity=fit.validity.sentences() if fit.validity else [],
        valid=fit.validity is None or fit.validity.ok,
    )
