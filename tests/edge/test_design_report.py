"""The page of a designed test says what to run, what to measure, and what it will tell."""

import dataclasses

import numpy as np
import pytest

from jaxlines.edge.design_report import design_report
from jaxlines.inference.design_result import Design, Profile
from jaxlines.inference.design_search import OutputLimit, Start
from jaxlines.inference.design_selection import Selection
from tests.edge.pages import Page


def made_design(samples: int = 200) -> Design:
    """A design for a line: bulk modulus and leakage from a flow."""
    times = np.linspace(0.0, 10.0, samples)
    knots = np.linspace(0.0, 10.0, 11)
    flow = Profile(
        times=knots,
        values=1e-4 * (1 + np.sin(knots)),
        base_values=np.full(11, 1e-4),
        low=0.0,
        high=2.5e-4,
        rate=1e-4,
        energy=1.5e-7,
        base_energy=1e-7,
        unit="m^3/s",
        frequencies=np.array([0.1, 0.3]),
        amplitudes=np.array([5e-5, 2e-5]),
    )
    measured = np.zeros((samples, 1))
    measured[::10] = 1.0
    return Design(
        names=("fluid.bulk_modulus", "leak <1>"),
        units=("Pa", "m^3/(s*Pa)"),
        values=np.array([1.4e9, 1e-12]),
        sd_before=np.array([np.inf, 1e-12]),
        sd_base=np.array([2e7, 4e-13]),
        sd=np.array([5e6, 2e-13]),
        target="fluid.bulk_modulus",
        criterion="c",
        target_sd_base=2e7,
        target_sd=5e6,
        target_unit="Pa",
        improvement=4.0,
        profiles={"flow": flow},
        inputs={},
        base_inputs={},
        sensors=("A.pressure",),
        times=times[::10],
        candidate_sensors=("A.pressure",),
        candidate_times=times,
        measured=measured,
        outputs={"A.pressure": 5e6 + 4e6 * np.sin(times)},
        base_outputs={"A.pressure": np.full(samples, 5e6)},
        output_units={"A.pressure": "Pa"},
        limits=(OutputLimit("A.pressure", 1e5, 9.5e6),),
        base_keeps_limits=False,
        selections={"samples": Selection(np.ones(3), 0.0, np.ones(3), -0.1, 0.95, "relaxed, rounded and exchanged")},
        active=("flow: upper limit 0.00025 m^3/s at 2 of 11 knots",),
        unidentified=("leak <1> is told no better than before",),
        warnings=(),
        scenarios=np.ones((3, 2)),
        robust="average",
        starts=(Start(1.0, 0.5, True, 12, "ended"), Start(1.0, 0.9, False, 3, "stopped")),
        num_simulations=321,
        seconds=4.5,
    )


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(design_report(made_design(), "Next test & why"))


def test_the_page_is_complete_and_needs_nothing_else(page):
    for words in (
        "Next test & why", "4 times as sharp", "321 simulations, 4.5 s", "fluid.bulk_modulus", "1.4 GPa", "not known",
        "designed for fluid.bulk_modulus (criterion c): ", "standard deviation 5 MPa instead of 20 MPa by the starting",
        "leak <1>", "does not keep the limits",
        "0.2465 to 11.94 L/min within 0 to 15 L/min", "6 L/min",
        "1.5 times that of the starting test", "0.1 Hz", "3 L/min", "A.pressure at 20 of 200 instants",
        "efficiency 95 %", "1 to 9 MPa in the designed test", "upper limit 15 L/min", "no better than before",
        "3 (average)", "2 searches, 1 of them ended within all limits",
    ):  # fmt: skip
        assert words in page.text, words
    assert page.outside == []
    assert page.open == []
    assert len(page.plots) == 3


def test_a_test_that_is_no_better_is_said_to_be_so():
    worse = dataclasses.replace(
        made_design(),
        improvement=0.5,
        base_keeps_limits=True,
        profiles={},
        starts=(),
        selections={},
        sd=np.full(2, np.inf),
    )
    text = Page(design_report(worse, "worse")).text
    assert "2 times less sharp" in text
    assert "does not keep" not in text
    assert "Run:" not in text
