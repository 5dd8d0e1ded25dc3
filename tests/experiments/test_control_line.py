"""The truth behind the bundled recording is found again, and the bundled files belong together."""

import importlib
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxlines

FOLDER = Path(__file__).parents[2] / "experiments"
EXAMPLES = Path(jaxlines.__file__).parent / "examples"


@pytest.mark.slow
def test_recovery_of_the_truth(tmp_path):
    """Every claim of the experiment holds; it also makes the recording anew and compares it byte for byte."""
    command = [sys.executable, str(FOLDER / "control_line_recovery.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    assert done.stdout.strip().splitlines()[-1] == results["finding"]
    assert len(results["claims"]) == 9 and all(results["claims"].values())
    truth, clean = results["truth"], results["fits"]["noise_free"]["parameters"]
    for name in ("fluid.bulk_modulus", "fluid.air_fraction", "leak.conductance"):
        assert clean[name]["value"] == pytest.approx(truth[name], rel=2e-3)
    assert results["fits"]["airless"]["parameters"]["fluid.bulk_modulus"]["value"] < 0.9 * truth["fluid.bulk_modulus"]


def test_bundled_recording_and_truth_belong_together(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    generator = importlib.import_module("make_control_line_recording")
    facts = json.loads((EXAMPLES / "control-line-truth.json").read_text(encoding="utf-8"))
    assert facts["truth"] == asdict(generator.Truth())
    assert facts["sensors"] == generator.SENSORS
    assert (facts["seed"], facts["sample_rate_Hz"], facts["noise_free"]) == (generator.SEED, generator.RATE, False)
    table = pd.read_csv(EXAMPLES / "control-line.csv")
    assert list(table) == ["t [s]", "p_line [bar_g]", "q_valve [L/min]"]
    np.testing.assert_allclose(table["t [s]"], np.arange(len(table)) / facts["sample_rate_Hz"], atol=1e-9)
    assert table["t [s]"].iloc[-1] == generator.DURATION
    sensors, resting = facts["sensors"], table[:50]  # the valve opens after one second
    pressure, start = (
        np.asarray(resting["p_line [bar_g]"]),
        (facts["truth"]["initial_pressure_Pa_abs"] - generator.P_ATM) / 1e5,
    )
    assert np.mean(pressure) == pytest.approx(start, abs=4 * sensors["pressure_noise_sd_bar"] / np.sqrt(50))
    assert np.std(pressure) == pytest.approx(sensors["pressure_noise_sd_bar"], rel=0.4)
    steps = table["p_line [bar_g]"] / sensors["pressure_step_bar"]
    np.testing.assert_allclose(steps, steps.round(), atol=0.01)
    flow = generator.valve_flow(table["t [s]"]) / generator.L_PER_MIN
    assert np.std(np.asarray(table["q_valve [L/min]"]) - np.asarray(flow)) == pytest.approx(
        sensors["flow_noise_sd_L_per_min"], rel=0.1
    )
