"""What is drawn in Matplotlib Axes, as glyphs of an interactive plot: curves, bands, bars, steps, points."""

from typing import Any, NamedTuple

import numpy as np

from jaxlines.edge.plots import MEASURED, SIMULATED

INK = "#010203"
"""A colour that nothing else has: it stands for the text colour of the page, whatever that is."""

_VARIABLES = {INK: "--ink", SIMULATED: "--blue", MEASURED: "--grey"}
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}


class Screen(NamedTuple):
    """An interactive plot as it grows.

    Fields: plot: of Bokeh; paints: (model, property, CSS variable) of what takes its colour from the page; entries:
    label -> renderers, for the legend; hover: (renderer, direction in which the nearest value is looked for).
    """

    plot: Any
    paints: list[tuple[str, str, str]]
    entries: dict[str, list]
    hover: list[tuple[Any, str]]

    def colour(self, model, colour, *properties: str) -> None:
        """Give a model a colour: that of the page where it stands for one, else its own."""
        from matplotlib.colors import to_hex

        text = to_hex(colour)
        for name in properties:
            setattr(model, name, text)
            if text in _VARIABLES:
                self.paints.append((model.id, name, _VARIABLES[text]))

    def add(self, artist, renderer, hover: str = "") -> None:
        """Note a renderer for the legend and for hovering ("vline": by abscissa, "mouse": under the pointer)."""
        label = str(artist.get_label())
        if label and not label.startswith("_"):
            self.entries.setdefault(label, []).append(renderer)
        if hover:
            renderer.name = "" if label.startswith("_") else label
            self.hover.append((renderer, hover))


def take_over(axes, screen: Screen) -> None:
    """Add what the Axes hold to a plot, from the back to the front; kinds that it does not know are left out."""
    from matplotlib.container import BarContainer

    bars = [container for container in axes.containers if isinstance(container, BarContainer)]
    for container in bars:
        _bars(axes, container, screen)
    taken = {axes.patch, *(patch for container in bars for patch in container.patches)}
    for artist in sorted(axes.get_children(), key=lambda artist: artist.get_zorder()):
        if artist not in taken and artist.get_visible():
            _add(axes, artist, screen)


def _add(axes, artist, screen: Screen) -> None:
    """Add what an artist draws, if it is of a kind that is taken over."""
    from matplotlib.collections import LineCollection, PathCollection, PolyCollection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle, StepPatch

    if isinstance(artist, Line2D):
        _line(axes, artist, screen)
    elif isinstance(artist, PolyCollection):
        _areas(artist, screen)
    elif isinstance(artist, PathCollection):
        points = np.asarray(artist.get_offsets())
        _points(artist, points[:, 0], points[:, 1], 6.0, artist.get_facecolor()[0], screen)
    elif isinstance(artist, LineCollection):
        _segments(artist, screen)
    elif isinstance(artist, StepPatch):
        _steps(artist, screen)
    elif isinstance(artist, Rectangle):
        _stripe(axes, artist, screen)


def _line(axes, line, screen: Screen) -> None:
    """A curve, points, or a line across the whole plot."""
    from bokeh.models import Span

    x, y = (np.asarray(values, dtype=float) for values in line.get_data())
    along_x, along_y = line.get_transform().contains_branch_seperately(axes.transData)
    style = {
        "line_width": float(line.get_linewidth()),
        "line_alpha": _alpha(line),
        "line_dash": _DASHES.get(line.get_linestyle(), "solid"),
    }
    if not (along_x and along_y):
        place = float(x[0]) if along_x else float(y[0])
        span = Span(location=place, dimension="height" if along_x else "width", **style)
        screen.colour(span, line.get_color(), "line_color")
        screen.plot.add_layout(span)
    elif line.get_linestyle() in ("None", "", " "):
        _points(line, x, y, float(line.get_markersize()), line.get_markerfacecolor(), screen)
    else:
        drawn = screen.plot.line(x, y, **style)
        screen.colour(drawn.glyph, line.get_color(), "line_color")
        screen.add(line, drawn, "vline")
        if line.get_marker() not in ("None", "", " ", None):
            _points(line, x, y, float(line.get_markersize()), line.get_markerfacecolor(), screen, hover="")


def _points(artist, x, y, size: float, colour, screen: Screen, hover: str = "mouse") -> None:
    """Points; `size` of a marker [point]."""
    point = getattr(artist, "get_marker", lambda: "o")() == "."  # half as large as others of its size
    drawn = screen.plot.scatter(
        x, y, size=max(3.0, size * (0.65 if point else 1.3)), fill_alpha=_alpha(artist), line_color=None
    )
    screen.colour(drawn.glyph, colour, "fill_color")
    screen.add(artist, drawn, hover)


def _areas(areas, screen: Screen) -> None:
    """Filled areas, such as bands between curves."""
    outlines = [np.asarray(path.vertices) for path in areas.get_paths() if len(path.vertices)]
    for outline in outlines:
        drawn = screen.plot.patch(outline[:, 0], outline[:, 1], fill_alpha=_alpha(areas), line_color=None)
        screen.colour(drawn.glyph, areas.get_facecolor()[0], "fill_color")
        screen.add(areas, drawn)


def _segments(lines, screen: Screen) -> None:
    """Error bars."""
    ends = np.array([[*piece[0], *piece[-1]] for piece in lines.get_segments() if len(piece) > 1])
    if ends.size:
        drawn = screen.plot.segment(*ends.T, line_width=float(lines.get_linewidth()[0]))
        screen.colour(drawn.glyph, lines.get_color()[0], "line_color")
        screen.add(lines, drawn)


def _steps(patch, screen: Screen) -> None:
    """A histogram."""
    values, edges, base = patch.get_data()
    source = {"x": 0.5 * (edges[1:] + edges[:-1]), "y": values, "left": edges[:-1], "right": edges[1:]}
    drawn = screen.plot.quad("left", "right", "y", float(base or 0.0), source=source, line_color=None)
    drawn.glyph.fill_alpha = _alpha(patch)
    screen.colour(drawn.glyph, patch.get_facecolor(), "fill_color")
    screen.add(patch, drawn, "mouse")


def _bars(axes, container, screen: Screen) -> None:
    """The bars of one series; each has the name of the tick that it stands at."""
    boxes = list(container.patches)
    sides = [(box.get_x(), box.get_y(), box.get_width(), box.get_height()) for box in boxes]
    x, y, width, height = np.array(sides, dtype=float).T
    lying = container.orientation == "horizontal"
    ticks = axes.get_yticks() if lying else axes.get_xticks()
    words = [text.get_text() for text in (axes.get_yticklabels() if lying else axes.get_xticklabels())]
    middles = y + height / 2 if lying else x + width / 2
    names = [words[int(np.argmin(np.abs(ticks - middle)))] if len(words) else "" for middle in middles]
    low, size = (x, width) if lying else (y, height)
    ends = zip(low, low + size, strict=True)
    span = [f"{end:.4g}" if start == 0.0 else f"{start:.4g} to {end:.4g}" for start, end in ends]
    source = {"left": x, "right": x + width, "bottom": y, "top": y + height, "name": names, "span": span}
    source["opaque"] = [_alpha(box) for box in boxes]
    drawn = screen.plot.quad("left", "right", "top", "bottom", source=source, line_color=None)
    drawn.glyph.fill_alpha = "opaque"
    screen.colour(drawn.glyph, boxes[0].get_facecolor(), "fill_color")
    screen.add(container, drawn, "mouse")


def _stripe(axes, box, screen: Screen) -> None:
    """A stripe across the whole plot."""
    from bokeh.models import BoxAnnotation

    (x, y), width, height = box.get_xy(), box.get_width(), box.get_height()
    along_x, along_y = box.get_transform().contains_branch_seperately(axes.transData)
    if along_x and along_y:
        return
    sides = {"left": x, "right": x + width} if along_x else {"bottom": y, "top": y + height}
    stripe = BoxAnnotation(**sides, level="underlay", fill_alpha=_alpha(box), line_color=None)
    screen.colour(stripe, box.get_facecolor(), "fill_color")
    screen.plot.add_layout(stripe)


def _alpha(artist) -> float:
    """How opaque an artist is."""
    return 1.0 if artist.get_alpha() is None else float(artist.get_alpha())
