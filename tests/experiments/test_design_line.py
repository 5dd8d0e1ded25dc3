"""The experiment on designed tests of the control line."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def experiment(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("design_line")


def test_scatter_is_compared_with_the_band_of_chi_square(experiment):
    """Chi-square of 200 degrees of freedom: 152.241 at 0.5 %, 255.264 at 99.5 % (printed tables)."""
    rng = np.random.default_rng(5)
    values = np.stack([3.0 + 2.0 * rng.standard_normal(201), 1.0 + 1.5 * rng.standard_normal(201)], axis=1)
    rows = experiment.compare(("right", "wrong"), values, np.array([2.0, 1.0]), np.array([3.0, 1.0]))
    assert rows["right"]["band"] == pytest.approx(np.sqrt([152.241 / 200, 255.264 / 200]), rel=1e-5)
    assert rows["right"]["agrees"] and not rows["wrong"]["agrees"]
    assert abs(rows["right"]["bias_over_standard_error"]) < 3.0


@pytest.mark.slow
def test_every_claim_holds(tmp_path):
    command = [sys.executable, str(FOLDER / "design_line.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    assert done.stdout.strip().splitlines()[-1] == results["finding"]
    assert len(results["claims"]) == 21 and all(results["claims"].values())
