"""The speed of fits: the script at a small size; its claims are for the full one, on a machine at rest."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_all_engines_find_the_same_optimum(tmp_path):
    pytest.importorskip("numba")
    command = [sys.executable, ROOT / "experiments" / "speed_fit.py", "--out", tmp_path]
    options = ["--count", "8", "--few", "1", "--some", "2", "--repeats", "1"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    assert (tmp_path / "results.json").exists(), done.stderr[-2000:]
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["converged"] == 8
    assert "same optimum" not in results["missed"]
    assert {"SciPy LSODA", "Numba DOPRI5, one thread"} <= set(results["peers"])
    assert done.returncode == (1 if results["missed"] else 0)
    assert done.stdout.strip().splitlines()[-1].startswith("MISSED" if results["missed"] else "8 recordings")
