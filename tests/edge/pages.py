"""Pages for the tests of reports: what is in one, and some to look at."""

import dataclasses
from html.parser import HTMLParser

from jaxlines.inference.samplers import Sobol
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_plan import SweepPlan
from tests.inference.sweep_cases import ANGLES, Analytic

FAILING = dataclasses.replace(Analytic("ishigami", ("a", "b", "c"), outputs=("wave",)), fails_below=-2.9)
VOID = ("meta", "br", "img", "image", "link", "input", "hr")


class Page(HTMLParser):
    """Collects the words, the addresses, the scripts of plots, and the tags that are left open."""

    def __init__(self, text: str):
        HTMLParser.__init__(self)
        self.words, self.addresses, self.open, self.plots = [], [], [], []
        self.policy = ""
        self.in_script, self.in_plot = False, False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.addresses += [value for key, value in attrs if key in ("src", "href", "xlink:href", "action", "data")]
        if values.get("http-equiv") == "Content-Security-Policy":
            self.policy = values["content"] or ""
        self.in_script, self.in_plot = tag in ("script", "style"), values.get("class") == "plot"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.in_script = self.in_plot = False

    def handle_data(self, data):
        if self.in_plot:
            self.plots.append(data)
        elif not self.in_script:
            self.words.append(data)

    @property
    def text(self) -> str:
        """All words, one space between them."""
        return " ".join(" ".join(self.words).split())

    @property
    def outside(self) -> list[str]:
        """Addresses that are not in the page itself."""
        return [address for address in self.addresses if not address.startswith(("#", "data:"))]


def small_sweep(count: int = 128):
    """A sweep of a formula in which some lanes fail."""
    return run_sweep(SweepPlan(FAILING, ANGLES, Sobol()), count, thresholds={"y": [5.0]})
