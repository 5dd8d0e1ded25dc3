"""The report of a designed test: one page of HTML that needs nothing else, in light and dark."""

from typing import Any

import numpy as np

from jaxlines.edge.design_plots import plot_design_gain, plot_design_input, plot_design_output
from jaxlines.edge.display import readable, readable_text
from jaxlines.edge.report_page import PRINT_POINTS, SCREEN_POINTS, Picture, picture, render
from jaxlines.inference.design_result import Design, Profile

_MOST_PRINTED, _MOST_SHOWN = 4_000, 15_000


def design_report(design: Design, title: str) -> str:
    """The report of a designed test as one page of HTML without any link to the outside.

    Args: design: of `design`; title of the page.
    """
    gain = design.improvement
    return render(
        "design_report.html.jinja",
        title=title,
        status=f"{gain:.3g} times as sharp" if gain >= 1.0 else f"{1.0 / gain:.3g} times less sharp",
        mood="good" if gain > 1.05 else "fair",
        message=f"designed for {readable_text(design.finding())}",
        effort=f"{design.num_simulations} simulations, {design.seconds:.1f} s",
        parameters=[_parameter(row) for row in design.table()],
        gains=_gain(design),
        inputs=[_input(design, name) for name in design.profiles],
        outputs=[_output(design, name) for name in design.outputs],
        readings=_readings(design),
        active=[readable_text(text) for text in design.active],
        unidentified=[readable_text(text) for text in design.unidentified],
        warnings=[readable_text(text) for text in design.warnings],
        considered=_considered(design),
    )


def _parameter(row: dict[str, Any]) -> list[str]:
    """A row of the table: name, value, and standard deviations before, after the starting and the designed test."""
    deviations = [readable(row["unit"], sd) if np.isfinite(sd) else "not known" for sd in _deviations(row)]
    ratio = "" if row["ratio"] is None else f"{row['ratio']:.3g}"
    return [row["name"], readable(row["unit"], row["value"]), *deviations, ratio]


def _deviations(row: dict[str, Any]) -> tuple[float, float, float]:
    """Standard deviations before, after the starting test and after the designed one."""
    return row["sd_before"], row["sd_base"], row["sd"]


def _gain(design: Design) -> list[Picture]:
    """How much sharper each number is told, where both tests tell it."""
    told = [row for row in design.table() if row["ratio"] is not None]
    if not told:
        return []
    shares = ", ".join(f"{row['name']} {100 / row['ratio']:.3g} %" for row in told)
    alt = f"standard deviations after the designed test in parts of those after the starting test: {shares}"
    return [picture(lambda axes, _: plot_design_gain(design, axes), alt, size=(8.2, 1.2 + 0.35 * len(told)))]


def _input(design: Design, name: str) -> dict[str, Any]:
    """A designed input for the page."""
    profile = design.profiles[name]
    alt = f"{name} over time, designed and starting test, with the limits of its level; {_span(profile)}"
    return {
        "name": name,
        "words": f"{_span(profile)}; {_energy(profile)}",
        "picture": picture(lambda axes, _: plot_design_input(design, name, axes), alt),
        "waves": _waves(profile),
    }


def _span(profile: Profile) -> str:
    """ "0 to 12 L/min within 0 to 15 L/min, at most 3 L/min in a second"."""
    unit, words = profile.unit, readable(profile.unit, float(profile.values.min()), float(profile.values.max()))
    if np.isfinite([profile.low, profile.high]).all():
        words += f" within {readable(unit, profile.low, profile.high)}"
    return words if profile.rate is None else f"{words}, changing at most {readable(unit, profile.rate)} in a second"


def _energy(profile: Profile) -> str:
    """The integral of the square against that of the starting test."""
    if profile.base_energy <= 0.0:
        return "the starting test is at rest"
    return f"integral of its square {profile.energy / profile.base_energy:.3g} times that of the starting test"


def _waves(profile: Profile) -> list[list[str]]:
    """Frequencies and amplitudes of a multisine."""
    if profile.frequencies is None or profile.amplitudes is None:
        return []
    pairs = zip(np.ravel(profile.frequencies), np.ravel(profile.amplitudes), strict=False)
    return [[f"{frequency:.4g} Hz", readable(profile.unit, amplitude)] for frequency, amplitude in pairs]


def _output(design: Design, name: str) -> dict[str, Any]:
    """What a sensor is predicted to show."""
    values, unit = design.outputs[name], design.output_units[name]
    span = readable(unit, float(np.nanmin(values)), float(np.nanmax(values)))
    points = min(_MOST_PRINTED, PRINT_POINTS // 6), min(_MOST_SHOWN, SCREEN_POINTS // 6)
    shown = picture(
        lambda axes, limit: plot_design_output(design, name, axes, limit),
        f"{name} over time as predicted, designed and starting test; {span} in the designed test",
        points=points,
        samples=values.size,
    )
    return {"name": name, "span": span, "picture": shown}


def _readings(design: Design) -> list[str]:
    """What is measured and when, in words."""
    times = design.times
    words = [f"{', '.join(design.sensors)} at {times.size} of {design.candidate_times.size} instants."]
    if 0 < times.size <= 20:
        words.append(f"Instants: {', '.join(f'{time:.4g}' for time in times)} s.")
    elif times.size:
        words.append(f"Instants: {times[0]:.4g} to {times[-1]:.4g} s.")
    for what, found in design.selections.items():
        words.append(f"Choice of {what}: {found.method}; efficiency {100 * found.efficiency:.3g} %.")
    return words


def _considered(design: Design) -> list[str]:
    """For what values of the parameters the test is designed, and how sure the search is."""
    words = [f"Values of the parameters considered: {len(design.scenarios)} ({design.robust})."]
    if design.starts:
        kept = [start.after for start in design.starts if start.kept]
        words.append(f"{len(design.starts)} searches, {len(kept)} of them ended within all limits.")
    return words
