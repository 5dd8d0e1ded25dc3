"""The report and its pictures: complete, self-contained, small, and faithful to the numbers."""

import dataclasses
import re
import xml.etree.ElementTree as ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxlines as jl
from jaxlines.edge import report
from jaxlines.edge.display import estimate_row, readable_text, readable_unit, rounded
from jaxlines.edge.drawing import circuit_svg
from jaxlines.edge.plots import decimate, plot_bulk_modulus, plot_channel, plot_residuals, plot_wave_speed
from jaxlines.edge.report import fit_report
from jaxlines.edge.report_glyphs import INK
from jaxlines.edge.report_page import inline_svg
from jaxlines.inference import fit_tools
from jaxlines.inference.analysis import ChannelFit
from jaxlines.inference.curves import Curve
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.identifiability import Identifiability
from jaxlines.inference.posterior import Posterior
from jaxlines.inference.scatter import Between
from jaxlines.inference.starts import Start
from jaxlines.inference.uncertainty import Estimate
from tests.edge.pages import Page

INTERVAL = Estimate(1.379e9, 3.6e6, (1.372e9, 1.386e9), "Pa", "interval", "isentropic & tangent")
LIMIT = Estimate(1e-13, 2e-13, (0.0, 4.3e-13), "m^3/(s*Pa)", "upper_limit", "not detected: 95 % upper limit")
COSTS = (10.0, 10.0, 14.0, np.inf)
OPEN = Estimate(0.012, None, None, "1", "unidentified", "left open")


def circuit():
    oil = jl.Oil(bulk_modulus=1.5e9, density=850.0)
    parts = {
        "line": jl.Line("A", [jl.Vessel(volume=1e-3)], 5.0),
        "leak <1>": jl.LaminarLeak("A", "T", conductance=1e-12),
        "tank": jl.Tank("T"),
        "gauge": jl.PressureSensor("A"),
        "meter": jl.FlowSensor("leak <1>.a"),
    }
    return jl.Circuit(oil, parts)


def channel(samples):
    times = np.linspace(0.0, 30.0, samples)
    measured = 5e6 + 4e6 * np.sin(times) + 4e4 * np.cos(1e3 * times)
    measured[samples // 2] = 2e7
    used = times < 29.0
    return ChannelFit(times, measured, 5e6 + 4e6 * np.sin(times), used, 4e4, 3.9e4, "Pa", 0.02, False)


def made_fit(samples=500, channels=("A.pressure",)):
    pressure = np.linspace(1e5, 1e7, 60)
    band = (1.3e9 - 1e14 / pressure, 1.2e9 - 1e14 / pressure, 1.4e9 - 1e14 / pressure)
    curve = Curve(pressure, *band, *(np.sqrt(np.abs(b) / 850.0) for b in band))
    return Fit(
        status="at_bound",
        message="the optimum lies on a bound",
        parameters={"fluid.bulk_modulus": INTERVAL, "leak.conductance": LIMIT, "fluid.air_fraction": OPEN},
        derived={"line.wave_speed": Estimate(1186.4, 1.4, (1183.5, 1189.2), "m/s", "interval", "at 3.75 MPa")},
        correlations=np.array([[1.0, -0.5, np.nan], [-0.5, 1.0, 0.2], [np.nan, 0.2, 1.0]]),
        channels={name: channel(samples) for name in channels},
        curves={"line": curve},
        identifiability=("air and index only together",),
        scale=("the measured flow fixes the scale",),
        singular_values=np.ones(3),
        warnings=("flow: constant <dead>",),
        validity=None,
        circuit=circuit(),
        initial={},
        num_evaluations=13,
        seconds=2.5,
        starts=tuple(Start(i, np.zeros(1), np.zeros(1), cost, "", "", 5) for i, cost in enumerate(COSTS)),
    )


@pytest.fixture(scope="module")
def html():
    return fit_report(made_fit(), "Line <1> & test")


def test_page_is_well_formed_and_complete(html):
    page = Page(html)
    assert html.startswith("<!DOCTYPE html>")
    assert page.open == []
    text = page.text
    for words in (
        "Line <1> & test", "at_bound", "the optimum lies on a bound", "13 evaluations, 2.5 s", "fluid.bulk_modulus",
        "1.3790", "0.0036", "1.3720 to 1.3860", "GPa", "isentropic & tangent", "< 2.58", "not identified",
        "line.wave_speed", "1186.4", "air and index only together", "the measured flow fixes the scale",
        "flow: constant <dead>", "-0.50", "do not look random", "wave speed [m/s]", "effective bulk modulus [GPa]",
        "A.pressure [MPa]", "residual [MPa]", "leak <1>", "LaminarLeak", "jax ",
    ):  # fmt: skip
        assert words in text, words


def test_numbers_on_an_axis_keep_their_digits():
    figure = Figure(figsize=(4, 3))
    figure.add_subplot().set(ylim=(1.0401, 1.0601), yticks=(1.045, 1.055))
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        svg = inline_svg(figure, "two ticks")
    assert ">1.045<" in svg and ">1.055<" in svg
    assert not re.search(r'="[^"]*\d\.\d{3}', svg)


def test_page_needs_no_network(html):
    page = Page(html)
    assert page.outside == []
    assert "default-src 'none'" in page.policy
    assert "http" not in page.policy
    assert not re.search(r"url\((?!['\"]?#)|@import", html[: html.index("</style>")])


def test_page_is_light_dark_narrow_and_described(html):
    assert "prefers-color-scheme: dark" in html
    assert 'name="viewport"' in html
    assert "max-width: 40rem" in html
    assert "currentColor" in html
    labels = re.findall(r'<svg role="img" aria-label="([^"]+)"', html)
    assert len(labels) == len(Page(html).plots) == 4
    assert "A.pressure over time, measured and simulated" in labels[0]
    assert "4 searches ended, best first; 3 came to an end" in labels[3]
    assert f'"{INK}"' not in re.sub(r"<script.*?</script>", "", html, flags=re.S)


def luminance(colour: str) -> float:
    """Relative luminance of "#rrggbb" (WCAG 2.1)."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours (WCAG 2.1)."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_colours_have_contrast(html, scheme):
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    colours = dict(re.findall(r"--(\w+): (#\w{6})", re.findall(r":root \{(.*?)\}", html, flags=re.S)[scheme]))
    for name in ("ink", "soft", "good", "fair", "bad"):
        assert contrast(colours[name], colours["card"]) > 4.5, name
        assert contrast(colours[name], colours["page"]) > 4.5, name
    for name in ("blue", "grey"):
        assert contrast(colours[name], colours["card"]) > 3.0, name


def test_classes_posterior_and_scatter_are_shown_where_there_are_some(monkeypatch):
    pytest.importorskip("arviz")
    draws = np.random.default_rng(0).normal([1.4e9, 1e-13, 0.01], [1e6, 1e-14, 1e-3], (2, 200, 3))
    flat = np.zeros((2, 200))
    names = ("fluid.bulk_modulus", "leak.conductance", "fluid.air_fraction")
    posterior = Posterior(names, draws, draws[..., :0], flat, flat > 0, np.full(3, 1.002), np.full(3, 300.0))
    monkeypatch.setattr(fit_tools, "values_of", lambda fit, drawn: drawn.draws)
    classes = {"fluid.air_fraction": Identifiability("fluid.air_fraction", "identifiable", None, "both ends <found>")}
    fit = dataclasses.replace(made_fit(), scatter={"leak.conductance": Between(1e-13, 0.01, "m^3/(s*Pa)", 3)})
    html = fit_report(fit, "more", classes=classes, posterior=posterior)
    page = Page(html)
    for words in (
        "Which numbers the data can tell", "both ends <found>", "400 draws by the no-U-turn sampler, 0 of them",
        "few effective draws (300, 400 wanted)", "1.4 GPa", "1.002", "between 3 recordings (p = 0.01)",
    ):  # fmt: skip
        assert words in page.text, words
    assert "draws of the posterior in pairs" in html
    assert page.open == []
    assert len(html.encode()) < 2_500_000


def test_long_recordings_stay_small_and_say_what_is_drawn():
    names = tuple(f"N{i}.pressure" for i in range(6))
    page = fit_report(made_fit(100_000, names), "long")
    assert len(page.encode()) < 5_000_000
    assert "Drawn with at most 5,000 of 100,000 samples: the lowest and the highest of every 40" in page


def test_of_very_many_channels_those_that_fit_worst_are_drawn(monkeypatch):
    monkeypatch.setattr(report, "_MOST_CHANNELS", 1)
    fit = made_fit(50, ("first", "second", "third"))
    fit.channels["second"] = fit.channels["second"]._replace(rmse=5e5)
    page = Page(fit_report(fit, "many"))
    assert "second [MPa]" in page.text
    assert "first [MPa]" not in page.text
    assert "2 more channels are not drawn" in page.text


def test_failed_fit_has_a_page():
    page = fit_report(Fit.failure(circuit(), "every start failed", 0.5), "failed")
    assert "every start failed" in page
    assert "Parameters" not in page


def test_decimation_keeps_extremes_order_and_holes():
    times = np.arange(100_000.0)
    values = np.sin(times / 500.0)
    values[12_345], values[67_890] = 7.0, -7.0
    values[30_000:40_000] = np.nan
    kept_times, kept = decimate(times, values, 4000)
    assert kept.size <= 4000
    assert np.nanmax(kept) == 7.0
    assert np.nanmin(kept) == -7.0
    assert np.all(np.diff(kept_times) > 0)
    assert np.isnan(kept[(kept_times > 31_000) & (kept_times < 39_000)]).all()
    assert decimate(times[:10], values[:10])[0].size == 10


def test_plots_draw_the_numbers():
    shown = channel(300)
    lines = {line.get_label(): np.asarray(line.get_data()) for line in plot_channel(shown, "A.pressure").get_lines()}
    np.testing.assert_allclose(lines["simulated"][1], shown.simulated / 1e6)
    np.testing.assert_allclose(lines["measured"][1], np.where(shown.used, shown.measured / 1e6, np.nan))
    residuals = np.asarray(plot_residuals(shown, "A.pressure").get_lines()[0].get_ydata())
    np.testing.assert_allclose(residuals[shown.used], (shown.measured - shown.simulated)[shown.used] / 1e6)
    curve = made_fit().curves["line"]
    axes = plot_bulk_modulus(curve)
    np.testing.assert_allclose(np.asarray(axes.get_lines()[0].get_ydata()), curve.bulk_modulus / 1e9)
    assert axes.get_xlabel() == "absolute pressure [MPa]"
    speed = plot_wave_speed(curve)
    np.testing.assert_allclose(np.asarray(speed.get_lines()[0].get_ydata()), curve.wave_speed)
    band = speed.collections[0].get_paths()[0].vertices[:, 1]
    assert band.min() == pytest.approx(curve.wave_speed_low.min())


def drawn(circuit_object):
    root = ElementTree.fromstring(circuit_svg(circuit_object))
    texts = [element.text for element in root.iter() if element.tag == "text"]
    return root, texts


def test_drawing_names_every_node_component_and_port():
    root, texts = drawn(circuit())
    for name in ("A", "T", "line", "leak <1>", "tank", "gauge", "meter", "LaminarLeak", "a", "b"):
        assert name in texts
    assert "leak <1> (LaminarLeak) at A, T" in (root.findtext("title") or "")


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (1.379e9, 3.6e6, "1.3790e+09"),
        (1186.43, 1.4, "1186.4"),
        (0.0069897, 4.8e-5, "0.006990"),
        (12.0, None, "12.000"),
        (0.0, 1.0, "0"),
        (1.0, 50.0, "1.0"),
        (float("nan"), None, "nan"),
    ],
)
def test_rounding_leaves_two_digits_of_the_uncertainty(value, sd, text):
    assert rounded(value, sd) == text


@pytest.mark.parametrize(
    ("unit", "size", "label", "factor"),
    [
        ("Pa", 1.3e9, "GPa", 1e-9),
        ("Pa", -2e6, "MPa", 1e-6),
        ("Pa", 300.0, "kPa", 1e-3),
        ("Pa", 3.0, "Pa", 1.0),
        ("m^3/s", 1e-4, "L/min", 6e4),
        ("m^3", 1e-3, "L", 1e3),
        ("s", 0.02, "ms", 1e3),
        ("1", 0.5, "", 1.0),
        ("N*m", 0.5, "N·m", 1.0),
        ("Pa", float("nan"), "Pa", 1.0),
    ],
)
def test_readable_units(unit, size, label, factor):
    assert readable_unit(unit, size) == (label, factor)


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("1.365e+09 to 1.392e+09 Pa over 1 to 1.4", "1.365 to 1.392 GPa over 1 to 1.4"),
        ("known with standard uncertainty 5e-05 m: 1 %", "known with standard uncertainty 0.05 mm: 1 %"),
        ("leak 3e-12 m^3/(s*Pa)", "leak 18 cm³/(min·bar)"),
        ("at 3.753 MPa, 1186 m/s, 0.5 s, 2 to 3 of 5", "at 3.753 MPa, 1186 m/s, 0.5 s, 2 to 3 of 5"),
    ],
)
def test_numbers_in_sentences_read_well(sentence, expected):
    assert readable_text(sentence) == expected


def test_rows_of_estimates():
    assert estimate_row(INTERVAL)[:4] == ("1.3790", "0.0036", "1.3720 to 1.3860", "GPa")
    assert estimate_row(LIMIT)[:4] == ("< 2.58", "", "0 to 2.58", "cm³/(min·bar)")
    assert estimate_row(OPEN)[:4] == ("0.012000", "", "not identified", "")
