"""Figures of studies are written with what they are given; shares of runs are what they are called."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


def test_shares_of_values(load):
    """Two of four values are at most 2."""
    values, share = load("study_figure").shares([3.0, 1.0, 2.0, 9.0])
    assert values.tolist() == [1.0, 2.0, 3.0, 9.0]
    assert share.tolist() == [25.0, 50.0, 75.0, 100.0]


def test_labels_carry_title_and_units(load):
    drawing = load("study_figure")
    figure, axes = drawing.panels(1, 2, (6.0, 3.0))
    axes[0, 0].plot([0, 1], [0, 1], label="measured")
    drawing.label(axes[0, 0], "A run", "time [s]", "pressure [bar]")
    assert (axes[0, 0].get_title(loc="left"), axes[0, 0].get_xlabel()) == ("A run", "time [s]")
    assert [text.get_text() for text in axes[0, 0].get_legend().get_texts()] == ["measured"]
    assert len(figure.axes) == 2


def fit_of(parameters: dict, times: np.ndarray):
    """What the figure of the control line reads of a fit."""
    measured = 1e6 * (1.0 + np.sin(times))
    channel = SimpleNamespace(times=times, measured=measured, simulated=measured + 1e3, whiteness_p=0.3)
    estimates = {n: SimpleNamespace(value=v, ci95=(0.9 * v, 1.1 * v)) for n, v in parameters.items()}
    estimates["leak.conductance"].ci95 = None
    return SimpleNamespace(channels={"A.pressure": channel}, parameters=estimates)


def test_figure_of_the_control_line(load, tmp_path):
    """With a parameter that one fit lacks, and one without an interval."""
    drawing = load("control_line_figure")
    truth = {"fluid.bulk_modulus": 1.4e9, "fluid.air_fraction": 0.02, "leak.conductance": 5e-12}
    fits = {name: fit_of(truth, np.linspace(0.0, 30.0, 200)) for name in drawing.SHOWN}
    del fits["airless"].parameters["fluid.air_fraction"]
    numbers = {"bias_over_statistical_sd": dict.fromkeys(truth, 0.1), "bias_limit": 0.3}
    name = drawing.draw(tmp_path, fits, truth, numbers, dict.fromkeys(drawing.SHOWN, "noise"))
    assert (tmp_path / name).stat().st_size > 20_000
