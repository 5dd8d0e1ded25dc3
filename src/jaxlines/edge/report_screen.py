"""From Matplotlib Axes to an interactive plot: what was drawn once is zoomed, hovered and toggled in the browser.

Curves, bands, bars, steps, points and error bars with their labels, limits and logarithmic scales are taken over; what
else is in the Axes (texts, pictures of arrays) is not, and an Axes with nothing to take over gives no plot.
"""

from typing import Any

from jaxlines.edge.report_glyphs import INK, Screen, take_over

_PIXELS, _TOOL_PIXELS = 88, 40
"""An inch of a figure on the screen, and the height of tools and legend."""

_TOOLS = "xpan,box_zoom,wheel_zoom,reset,save"


def interactive(figure) -> dict[str, Any] | None:
    """A Matplotlib figure whose Axes stand one above the other as an interactive plot.

    Returns: item: what `Bokeh.embed.embed_item` takes; paints: as of `Screen`; toolbars: their ids. None when there is
    nothing to plot.
    """
    from bokeh.embed import json_item
    from bokeh.layouts import column

    screens: list[Screen] = []
    for axes in figure.axes:
        joined = bool(screens) and axes.get_shared_x_axes().joined(figure.axes[0], axes)
        screen = _screen(axes, figure, screens[0].plot.x_range if joined else None)
        if screen.plot.renderers:
            screens.append(screen)
    if not screens:
        return None
    plots = [screen.plot for screen in screens]
    return {
        "item": json_item(plots[0] if len(plots) == 1 else column(*plots, sizing_mode="stretch_width", spacing=4)),
        "paints": [paint for screen in screens for paint in screen.paints],
        "toolbars": [plot.toolbar.id for plot in plots],
    }


def _screen(axes, figure, shared) -> Screen:
    """One Axes as a plot. shared: the abscissa of the plot above, if it is common."""
    from bokeh.models import Range1d
    from bokeh.plotting import figure as new_plot

    left, right = axes.get_xlim()
    bottom, top = axes.get_ylim()
    height = figure.get_size_inches()[1] * _PIXELS * axes.get_position().height / _filled(figure) + _TOOL_PIXELS
    plot = new_plot(
        x_range=shared or Range1d(left, right),
        y_range=Range1d(bottom, top),
        x_axis_type=axes.get_xscale(),
        y_axis_type=axes.get_yscale(),
        x_axis_label=axes.get_xlabel() or None,
        y_axis_label=axes.get_ylabel() or None,
        title=axes.get_title() or None,
        height=int(height),
        sizing_mode="stretch_width",
        tools="xbox_zoom" if shared else _TOOLS,  # with a common abscissa the tools of the first plot serve all
        active_drag="xbox_zoom" if shared else "box_zoom",
        toolbar_location=None if shared else "above",
        min_border_right=12,
        min_border_left=0 if len(figure.axes) == 1 else 64,  # panels stand flush
    )
    plot.toolbar.logo = None
    screen = Screen(plot, [], {}, [])
    take_over(axes, screen)
    _dress(axes, screen)
    _hover(axes, screen)
    return screen


def _filled(figure) -> float:
    """The part of the height of a figure that its Axes fill."""
    return sum(axes.get_position().height for axes in figure.axes)


def _dress(axes, screen: Screen) -> None:
    """Colours of the page for axes, grid and title; names at ticks; the legend, whose entries toggle what they name."""
    from bokeh.models import FixedTicker, Legend, LegendItem

    plot = screen.plot
    plot.background_fill_color = plot.border_fill_color = plot.outline_line_color = None
    for bokeh_axis, axis in ((plot.xaxis[0], axes.xaxis), (plot.yaxis[0], axes.yaxis)):
        screen.colour(bokeh_axis, INK, "axis_label_text_color", "major_label_text_color")
        screen.colour(bokeh_axis, INK, "axis_line_color", "major_tick_line_color", "minor_tick_line_color")
        bokeh_axis.axis_label_text_font_style, bokeh_axis.major_label_text_font_size = "normal", "12px"
        words = [text.get_text() for text in axis.get_ticklabels()]
        if not all(_is_number(word) for word in words):
            bokeh_axis.ticker = FixedTicker(ticks=[float(tick) for tick in axis.get_ticklocs()])
            bokeh_axis.major_label_overrides = dict(zip(bokeh_axis.ticker.ticks, words, strict=True))
    for grid in plot.grid:
        screen.colour(grid, INK, "grid_line_color")
        grid.grid_line_alpha = 0.12
    if plot.title is not None:
        screen.colour(plot.title, INK, "text_color")
    if axes.get_legend() is not None and screen.entries:
        items = [LegendItem(label=label, renderers=drawn) for label, drawn in screen.entries.items()]
        legend = Legend(items=items, click_policy="hide", orientation="horizontal", border_line_color=None)
        legend.background_fill_color = legend.inactive_fill_color = None
        screen.colour(legend, INK, "label_text_color")
        plot.add_layout(legend, "above")


def _is_number(word: str) -> bool:
    """Whether the word at a tick is a number as Matplotlib writes it ("\N{MINUS SIGN}1.5", "$10^{3}$", nothing)."""
    return all(sign in "0123456789.+-\N{MINUS SIGN}e$\\mathdefault{}^" for sign in word)


def _hover(axes, screen: Screen) -> None:
    """What is said of a value under the pointer."""
    from bokeh.models import HoverTool

    panels = axes.get_shared_x_axes().get_siblings(axes)  # the lowest one names the common abscissa
    names = next((panel.get_xlabel() for panel in panels if panel.get_xlabel()), "x"), axes.get_ylabel() or "y"
    for mode in ("vline", "mouse"):
        for renderer in [renderer for renderer, of in screen.hover if of == mode]:
            columns = renderer.data_source.data
            if "span" in columns:
                tips = [("", "@name"), (names[0], "@span")]
            else:
                tips = [(names[0], "@x{%.6g}"), (names[1], "@y{%.5g}")]
            if renderer.name:
                tips.insert(0, ("", "$name"))
            formats: dict[str, Any] = {f"@{name}": "printf" for name in ("x", "y") if name in columns}
            screen.plot.add_tools(
                HoverTool(renderers=[renderer], mode=mode, tooltips=tips, formatters=formats, visible=False)
            )
