"""What the pages of a fit, a sweep and a design share: the skeleton, and pictures that are drawn once for both uses.

A picture is drawn by Matplotlib into Axes. From these come an SVG (for print, for readers without scripts and, with its
description, for those who do not see it) and, by Bokeh, the plot that a reader zooms, hovers and toggles. Everything
is in the one file: a policy in its head forbids the browser to load anything else.
"""

import functools
import importlib.metadata
import io
import json
import platform
import re
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxlines.edge.plots import SIMULATED
from jaxlines.edge.report_glyphs import INK
from jaxlines.edge.report_screen import interactive

PRINT_POINTS, SCREEN_POINTS = 24_000, 90_000
"""Points of all curves of a page on paper and on screen: about 0.5 MB and 2 MB beside 1.3 MB of Bokeh."""

_DECIMALS = re.compile(r"\d+\.\d{3,}")
_STYLE: Any = {
    "svg.fonttype": "none",
    "font.size": 10,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": INK,
    "grid.alpha": 0.12,
    "axes.formatter.useoffset": False,
}


class Picture(NamedTuple):
    """A picture of a page. Fields: description, for those who do not see it; svg; screen: the interactive plot as JSON,
    empty where there is none; note: a sentence below it."""

    description: str
    svg: str
    screen: str = ""
    note: str = ""


def picture(
    draw: Callable[[Any, int], Any],
    description: str,
    *,
    size: tuple[float, float] = (8.2, 3.2),
    panels: tuple[float, ...] = (1.0,),
    points: tuple[int, int] = (PRINT_POINTS, SCREEN_POINTS),
    samples: int = 0,
) -> Picture:
    """A picture for a page.

    Args: draw: called with Axes (a tuple of them, one above the other with a common abscissa, for several panels) and
    the number of points that a curve may have; description: what it shows, in words; size [inch]; panels: their
    relative heights; points of a curve on paper and on screen; samples of the longest curve, for the note.
    """
    svg = inline_svg(_drawn(draw, size, panels, points[0], "constrained"), description)
    screen = interactive(_drawn(draw, size, panels, points[1], None))  # Bokeh makes room for words by itself
    return Picture(description, svg, _in_script(screen) if screen else "", decimation_note(samples, points[1]))


def _drawn(draw: Callable[[Any, int], Any], size: tuple[float, float], panels: tuple[float, ...], limit: int, layout):
    """The Matplotlib figure of a picture in the style of the page."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=size, layout=layout)
        axes = figure.subplots(len(panels), 1, sharex=True, height_ratios=panels)
        draw(tuple(axes) if len(panels) > 1 else axes, limit)
    return figure


def decimation_note(samples: int, limit: int) -> str:
    """What is said where a curve has more samples than the points it is drawn with."""
    if samples <= limit:
        return ""
    return (
        f"Drawn with at most {limit:,} of {samples:,} samples: the lowest and the highest of every "
        f"{-(-samples // (limit // 2))}, so that no peak is lost."
    )


def inline_svg(figure, description: str) -> str:
    """A figure as SVG for a page: no prolog, no metadata, colours of the page, two decimals, a description."""
    import matplotlib

    buffer = io.StringIO()
    blank = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": description}):  # no two drawings of a page share an id
        figure.savefig(buffer, format="svg", transparent=True, metadata=blank)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor").replace(SIMULATED, "var(--blue)")
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


def _in_script(content: dict) -> str:
    """JSON that may stand in a script element, which ends at the first "</"."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


@functools.cache
def _environment():
    """Where the pages lie."""
    import jinja2

    loader = jinja2.PackageLoader("jaxlines.edge", ".")
    return jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)


@functools.cache
def _bokeh_script() -> str:
    """The part of Bokeh that runs in the browser."""
    from bokeh.resources import Resources

    return "\n".join(Resources(mode="inline", components=["bokeh"], log_level="warn").js_raw)


def versions() -> str:
    """What computed this."""
    packages = ("jaxlines", "jax", "diffrax", "equinox", "numpy")
    return ", ".join(
        [f"Python {platform.python_version()}", *(f"{p} {importlib.metadata.version(p)}" for p in packages)]
    )


def render(template: str, *, title: str, **content) -> str:
    """A page of HTML without any link to the outside.

    Args: template: its file, which extends report_base.html.jinja; title; content: what else it names.
    """
    page = _environment().get_template(template).render(title=title, versions=versions(), bokeh="@bokeh@", **content)
    # Bokeh's megabyte is put in last and only where there is a plot: the template would look through it for escapes.
    return page.replace("@bokeh@", _bokeh_script() if 'class="plot"' in page else "", 1)
