"""The comparison of wave lines with the exact line, on coarser ladders."""

import importlib
import json
import sys
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def experiment(monkeypatch):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    module = importlib.import_module("wave_line")
    monkeypatch.setattr(module, "SEGMENTS", (10, 20, 40))
    yield module
    sys.modules.pop("wave_line")


def run(module, folder, monkeypatch) -> tuple[int, dict]:
    monkeypatch.setattr(sys, "argv", ["wave_line.py", "--out", str(folder)])
    return module.main(), json.loads((folder / "results.json").read_text())


@pytest.mark.slow
def test_order_and_errors(experiment, tmp_path, monkeypatch, capsys):
    code, result = run(experiment, tmp_path, monkeypatch)
    assert code == 0 and all(result["claims"].values())
    assert result["matrix_error"][-1] < 0.02 and result["raised_cosine"]["errors"][-1] < 0.01
    assert result["finding"] == capsys.readouterr().out.splitlines()[-1]
    assert (tmp_path / "wave_line.svg").stat().st_size > 10_000


@pytest.mark.slow
def test_a_wrong_line_is_noticed(experiment, tmp_path, monkeypatch):
    """A bore 5 % too large in the simulated line breaks the claims."""
    monkeypatch.setattr(experiment, "PIPE", experiment.jl.Pipe(experiment.LENGTH, 1.05 * experiment.BORE, 0.5))
    code, result = run(experiment, tmp_path, monkeypatch)
    assert code == 1 and not all(result["claims"].values()) and "MISSED" in result["finding"]
