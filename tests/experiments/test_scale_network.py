"""The scaling experiment at a small size: the program of a network does not grow with its lines."""

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def experiment(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("scale_network")


def test_a_hundred_lines_compile_like_ten(experiment):
    """Times within a factor of three on a busy machine; the experiment asks for two between 10 and 1000 lines."""
    experiment.measure(2, segments=4)
    few, many = experiment.measure(10, segments=4), experiment.measure(200, segments=4)
    assert many["operations"] == few["operations"]
    assert (many["nodes"], many["kinds"]) == (100, few["kinds"])
    assert many["status"] == few["status"] == 0
    assert many["total"] < 3.0 * few["total"]


def test_the_grid_is_connected(experiment):
    """Every junction is met by four ends of lines."""
    parts = experiment.network(100).parts()
    ends = [end for name, part in parts.items() if name.startswith("line") for end in (part.node, part.to)]
    assert sorted(map(ends.count, set(ends))) == [4] * 50
