"""The interactive plot of Axes: the same numbers, limits, labels and names; colours of the page; nothing invented."""

import base64
import gzip
import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxlines.edge.plots import MEASURED, SIMULATED
from jaxlines.edge.report_glyphs import INK
from jaxlines.edge.report_page import picture
from jaxlines.edge.report_screen import interactive


def models(figure) -> list[dict]:
    """All models of the interactive plot of a figure, as they stand in the page."""
    content = interactive(figure)
    assert content is not None
    found = []

    def walk(part):
        if isinstance(part, dict):
            if part.get("type") == "object" and "id" in part:
                found.append(part)
            part = list(part.values())
        if isinstance(part, list):
            for piece in part:
                walk(piece)

    walk(json.loads(json.dumps(content["item"])))
    return found


def of(kind: str, found: list[dict]) -> list[dict]:
    """The attributes of the models of a kind."""
    return [model.get("attributes", {}) for model in found if model["name"] == kind]


def columns(found: list[dict]) -> list[dict[str, np.ndarray]]:
    """The columns of every data source."""

    def numbers(value):
        if isinstance(value, dict) and value["type"] == "ndarray":
            raw = gzip.decompress(base64.b64decode(value["array"]["data"]))
            return np.frombuffer(raw, dtype=value["dtype"])
        return np.array(value)

    return [{k: numbers(v) for k, v in source["data"]["entries"]} for source in of("ColumnDataSource", found)]


@pytest.fixture
def axes():
    return Figure(figsize=(6, 3)).add_subplot()


def test_curves_keep_numbers_limits_and_names(axes):
    x, y = np.linspace(0.0, 2.0, 50), np.geomspace(1.0, 1e4, 50)
    axes.plot(x, y, color=SIMULATED, label="simulated")
    axes.plot(x, 2 * y, color="#aa0000", ls="--")
    axes.axvline(0.7, color=MEASURED)
    axes.set(xlabel="time [s]", ylabel="p [Pa]", yscale="log", xlim=(0.5, 1.5), ylim=(10.0, 1e5))
    axes.legend()
    found = models(axes.figure)
    drawn = columns(found)
    np.testing.assert_array_equal(drawn[0]["x"], x)
    np.testing.assert_array_equal(drawn[0]["y"], y)
    np.testing.assert_array_equal(drawn[1]["y"], 2 * y)
    ranges = {(r["start"], r["end"]) for r in of("Range1d", found)}
    assert ranges == {(0.5, 1.5), (10.0, 1e5)}
    assert len(of("LogAxis", found)) == 1
    assert [item["label"]["value"] for item in of("LegendItem", found)] == ["simulated"]
    assert of("Legend", found)[0]["click_policy"] == "hide"
    assert of("Span", found)[0]["location"] == 0.7
    assert len(of("HoverTool", found)) == 2


def test_bands_bars_steps_points_and_stripes(axes):
    axes.fill_between([0.0, 1.0], [1.0, 2.0], [3.0, 4.0], label="95 %")
    axes.barh([0.0, 1.0], [2.0, -1.0], left=[1.0, 1.0], xerr=[0.1, 0.2])
    axes.set_yticks([0.0, 1.0], ["air", "leak"])
    axes.stairs([5.0, 6.0], [0.0, 1.0, 3.0], fill=True)
    axes.plot([0.3], [0.4], ls="", marker=".")
    axes.axhspan(-1.0, 1.0, alpha=0.2)
    found = models(axes.figure)
    drawn = columns(found)
    bars = next(source for source in drawn if "span" in source)
    assert bars["name"].tolist() == ["air", "leak"]
    assert bars["span"].tolist() == ["1 to 3", "1 to 0"]
    steps = next(source for source in drawn if "y" in source and "left" in source)
    assert steps["y"].tolist() == [5.0, 6.0]
    assert steps["right"].tolist() == [1.0, 3.0]
    outline = next(source for source in drawn if set(source) == {"x", "y"} and len(source["x"]) > 3)
    assert {(0.0, 1.0), (1.0, 2.0), (0.0, 3.0), (1.0, 4.0)} <= set(zip(outline["x"], outline["y"], strict=True))
    assert len(of("Segment", found)) >= 1
    assert len(of("Scatter", found)) >= 1
    (stripe,) = [box for box in of("BoxAnnotation", found) if box.get("level") == "underlay"]
    assert (stripe["bottom"], stripe["top"]) == (-1.0, 1.0)


def test_colours_of_the_page_are_named_and_others_kept(axes):
    axes.plot([0.0, 1.0], [0.0, 1.0], color=SIMULATED)
    axes.plot([0.0, 1.0], [1.0, 0.0], color="#aa0000")
    content = interactive(axes.figure)
    assert content is not None
    named = {(prop, variable) for _, prop, variable in content["paints"]}
    assert ("line_color", "--blue") in named
    assert ("axis_label_text_color", "--ink") in named
    assert len([1 for _, prop, _ in content["paints"] if prop == "line_color"]) == 1
    assert INK in json.dumps(content["item"])


def test_panels_share_their_abscissa():
    upper, lower = Figure().subplots(2, 1, sharex=True)
    upper.plot([0.0, 1.0], [0.0, 1.0])
    lower.plot([0.0, 1.0], [0.0, 1.0])
    lower.set_xlabel("time [s]")
    found = models(upper.figure)
    assert len(of("Range1d", found)) == 3
    assert all(tool["tooltips"][0][0] == "time [s]" for tool in of("HoverTool", found))


def test_nothing_to_plot_gives_no_plot():
    assert interactive(Figure()) is None
    shown = picture(lambda axes, _: axes.text(0.5, 0.5, "nothing </script> here"), "words")
    assert shown.screen == ""
    assert 'aria-label="words"' in shown.svg


def test_a_plot_cannot_end_the_script_it_stands_in():
    shown = picture(lambda axes, _: axes.plot([0, 1], [0, 1]) and axes.set_xlabel("</script><b>"), "curve")
    assert "<" not in shown.screen
    assert "</script><b>" in json.dumps(json.loads(shown.screen))
