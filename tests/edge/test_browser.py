"""The pages in a browser: drawn without an error or a request, zoomed, hovered, toggled, dark, narrow, on paper."""

import base64
import json
import re
import shutil
import time

import numpy as np
import pytest

from jaxlines.edge.design_report import design_report
from jaxlines.edge.report import fit_report
from jaxlines.edge.sweep_report import sweep_report
from tests.edge.pages import small_sweep
from tests.edge.test_design_report import made_design
from tests.edge.test_report import made_fit

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="no Chromium with chromedriver is installed")

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
)
CANVASES = """
const found = [];
const walk = (node) => {
  for (const child of node.querySelectorAll("*")) {
    if (child.tagName === "CANVAS") found.push(child);
    if (child.shadowRoot) walk(child.shadowRoot);
  }
};
walk(arguments[0]);
"""
COLOURED = (
    CANVASES
    + """
return found.some((canvas) => {
  if (!canvas.width || !canvas.height) return false;
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const seen = new Set();
  for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 0) seen.add(data.slice(i, i + 3).join());
  return seen.size > 5;
});
"""
)
FIRST = "const plot = [...Bokeh.index.roots][0].child_views[0]; "
TOOLTIP = """
const words = [];
const walk = (node) => {
  for (const child of node.querySelectorAll("*")) {
    if (child.classList.contains("bk-Tooltip"))
      for (const part of child.shadowRoot.children) if (part.tagName !== "STYLE") words.push(part.textContent);
    if (child.shadowRoot) walk(child.shadowRoot);
  }
};
walk(document);
return words;
"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The pages as files, and the fit behind the first."""
    folder, fit = tmp_path_factory.mktemp("pages"), made_fit(2000)
    texts = {"fit": fit_report(fit, "A fit"), "sweep": sweep_report(small_sweep(), "A sweep")}
    texts["design"] = design_report(made_design(), "A design")
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return folder, fit


@pytest.fixture(scope="module")
def browser():
    """A browser without a window."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*FLAGS, "--window-size=1100,1600"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(str(DRIVER)))
    yield driver
    driver.quit()


@pytest.fixture
def screen(browser):
    """The browser as a light desktop again after the test."""
    yield browser
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def emulate(browser, scheme: str = "light", media: str = "") -> None:
    """The colour scheme that the reader prefers, and paper instead of a screen."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})


def wait_for(browser, script: str, *arguments):
    """The first true value of a script. Fails after ten seconds."""
    end = time.monotonic() + 10.0
    while not (value := browser.execute_script(script, *arguments)):
        if time.monotonic() > end:
            pytest.fail(f"never true: {script[-300:]}")
        time.sleep(0.05)
    return value


def show(browser, folder, name: str) -> None:
    """Open a page and wait until its plots are drawn."""
    for log in ("browser", "performance"):
        browser.get_log(log)  # forgets what earlier pages said
    browser.get((folder / f"{name}.html").as_uri())
    wait_for(browser, "return document.documentElement.dataset.plots")


def requests(browser) -> list[str]:
    """What the browser asked for that is not in the page."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [url for url in asked if not url.startswith(("data:", "blob:"))]


@pytest.mark.parametrize(("name", "least"), [("fit", 4), ("sweep", 5), ("design", 3)])
def test_a_page_is_drawn_without_an_error_or_a_request(screen, pages, name, least):
    show(screen, pages[0], name)
    figures = screen.find_elements("css selector", "figure.live")
    assert len(figures) == len(screen.find_elements("css selector", "script.plot")) >= least
    for figure in figures:
        screen.execute_script("arguments[0].scrollIntoView()", figure)
        assert wait_for(screen, COLOURED, figure)
        assert figure.find_element("css selector", ".paper").size["width"] == 1
    assert [entry for entry in screen.get_log("browser") if entry["level"] in ("WARNING", "SEVERE")] == []
    assert requests(screen) == [(pages[0] / f"{name}.html").as_uri()]
    assert screen.execute_script("return document.documentElement.scrollWidth <= innerWidth")


def drag(browser, *steps: tuple[float, float]) -> None:
    """Press at the first point of the frame of the first plot (shares of its width and height), and move on."""
    frame = browser.execute_script(
        FIRST + "plot.el.scrollIntoView({block: 'center'}); const page = plot.canvas_view.el.getBoundingClientRect(); "
        "const box = plot.frame.bbox; return [page.left + box.left, page.top + box.top, box.width, box.height]"
    )
    actions = webdriver.ActionChains(browser, duration=50).w3c_actions
    for k, (x, y) in enumerate(steps):
        place = int(frame[0] + x * frame[2]), int(frame[1] + y * frame[3])
        actions.pointer_action.move_to_location(*place)
        if k == 0 and len(steps) > 1:
            actions.pointer_action.pointer_down()
    if len(steps) > 1:
        actions.pointer_action.pointer_up()
    actions.perform()


def test_a_trace_is_zoomed_with_its_residuals_and_reset(screen, pages):
    show(screen, pages[0], "fit")
    ranges = (
        FIRST + "return [...Bokeh.index.roots][0].child_views.map((v) => [v.model.x_range.start, v.model.x_range.end])"
    )
    assert screen.execute_script(ranges) == [[0.0, 30.0], [0.0, 30.0]]
    drag(screen, (0.25, 0.2), (0.4, 0.5), (0.5, 0.8))
    wait_for(screen, FIRST + "return plot.model.x_range.start > 0")
    upper, lower = screen.execute_script(ranges)
    assert upper == lower == pytest.approx([7.5, 15.0], abs=0.1)
    screen.execute_script(FIRST + "plot.reset()")
    assert screen.execute_script(ranges) == [[0.0, 30.0], [0.0, 30.0]]


def test_a_value_is_told_under_the_pointer(screen, pages):
    folder, fit = pages
    show(screen, folder, "fit")
    drag(screen, (0.3, 0.5))
    words = " ".join(wait_for(screen, TOOLTIP))
    channel = fit.channels["A.pressure"]
    for series, values in {"measured": channel.measured, "simulated": channel.simulated}.items():
        told = re.search(series + r"\W*time \[s\]\W*([\d.]+)\W*A.pressure \[MPa\]\W*([\d.]+)", words)
        assert told, words
        when, value = float(told[1]), float(told[2])
        assert when == pytest.approx(9.0, abs=0.1)
        assert value == pytest.approx(np.interp(when, channel.times, values) / 1e6, rel=1e-3)


def test_a_series_is_toggled_in_the_legend(screen, pages):
    show(screen, pages[0], "fit")
    screen.execute_script(FIRST + "plot.el.scrollIntoView({block: 'center'})")
    seen = FIRST + "return plot.model.renderers.filter((r) => r.visible).length"
    before = screen.execute_script(seen)
    left, top, width, height = screen.execute_script(
        FIRST + "const legend = [...plot.renderer_views.values()].find((v) => v.model.type === 'Legend'); "
        "const box = legend.el.getBoundingClientRect(); return [box.left, box.top, box.width, box.height]"
    )
    actions = webdriver.ActionChains(screen).w3c_actions
    actions.pointer_action.move_to_location(int(left + 0.25 * width), int(top + 0.5 * height)).click()
    actions.perform()
    wait_for(screen, seen.replace("return ", f"return {before} - 1 == "))


def test_colours_follow_the_scheme_of_the_reader(screen, pages):
    emulate(screen, "dark")
    show(screen, pages[0], "fit")
    colour = (
        FIRST
        + "return plot.model.xaxis ? plot.model.xaxis.axis_label_text_color : plot.model.below[0].axis_label_text_color"
    )
    assert screen.execute_script(colour) == "#e4e9f0"
    assert screen.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 28)"
    emulate(screen, "light")
    wait_for(screen, colour.replace("return ", "return '#1b2430' === (") + ")")


def test_a_phone_shows_all_and_scrolls(screen, pages):
    size = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    screen.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    screen.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    for name in ("fit", "sweep", "design"):
        show(screen, pages[0], name)
        assert screen.execute_script("return document.documentElement.scrollWidth") == 390
        wide = "return [...document.querySelectorAll('.screen')].map((e) => e.getBoundingClientRect().right)"
        assert all(right <= 390 for right in screen.execute_script(wide))
        assert screen.execute_script("return [...Bokeh.index.roots][0].model.toolbar?.active_drag ?? null") is None


def test_paper_and_readers_without_scripts_get_the_drawings(screen, pages):
    show(screen, pages[0], "fit")
    emulate(screen, "dark", "print")
    drawing, plot = (screen.find_element("css selector", f"figure {name}") for name in (".paper svg", ".screen"))
    assert drawing.size["width"] > 300
    assert not plot.is_displayed()
    assert screen.execute_script("return getComputedStyle(document.body).color") == "rgb(27, 36, 48)"
    printed = screen.execute_cdp_cmd("Page.printToPDF", {"printBackground": False})
    content = base64.b64decode(printed["data"])
    assert content.startswith(b"%PDF")
    assert content.count(b"/Type /Page\n") <= 6
    emulate(screen)
    screen.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    screen.get((pages[0] / "fit.html").as_uri())
    assert screen.find_element("css selector", "figure .paper svg").size["width"] > 300


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["fit", "sweep", "design"])
def test_pages_are_accessible(screen, pages, name, scheme):
    axe = pytest.importorskip("axe_core_python.selenium", reason="axe-core-python is not installed")
    emulate(screen, scheme)
    show(screen, pages[0], name)
    options = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]}
    found = axe.Axe().run(screen, options=options)
    wrong = [(rule["id"], [node["html"][:200] for node in rule["nodes"]]) for rule in found["violations"]]
    assert wrong == []
    assert len(found["passes"]) > 10
