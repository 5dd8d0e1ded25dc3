"""The ring-down study: on runs computed here with NumPy, and on the real recordings where they are."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared" / "data" / "rotary_actuator"
HOLD, SPEED = 6000.0, 10000.0
RESISTANCE, INERTANCE, CAPACITANCE = 0.15, 0.0021, 0.0239  # counts and seconds
STEADY_DROP = 2300.0
FREQUENCY = 1.0 / np.sqrt(INERTANCE * CAPACITANCE) / (2 * np.pi)


def computed_run(seed: int) -> pd.DataFrame:
    """A stroke that stops within 3 ms and the ring-down after it, by small explicit steps, with sensor noise."""
    rng, samples, substeps = np.random.default_rng(seed), 1500, 50
    hold = HOLD * (1 + 0.02 * rng.standard_normal())
    quadratic = (STEADY_DROP - RESISTANCE * SPEED) / SPEED**2
    stop, step = 0.43 + 0.0005 * rng.random(), 1e-3 / substeps
    pressure, flow, angle = hold - STEADY_DROP, SPEED, 0.0
    rows = np.empty((samples, 3))
    for k in range(samples * substeps):
        if k % substeps == 0:
            rows[k // substeps] = angle, pressure, 0.0
        rate = SPEED * np.clip((stop + 0.0015 - k * step) / 0.003, 0.0, 1.0)
        flow += step * (hold - pressure - RESISTANCE * flow - quadratic * flow * abs(flow)) / INERTANCE
        pressure += step * (flow - rate) / CAPACITANCE
        angle += step * rate
    rows += rng.standard_normal(rows.shape) * [0.3, 10.0, 10.0]
    return pd.DataFrame({"Angle": rows[:, 0] + 3000, "PG_1": rows[:, 1], "PG_2": rows[:, 2]}).round()


def run_script(data: Path, out: Path, *options: str) -> tuple[int, dict, str]:
    command = [sys.executable, ROOT / "experiments" / "hose_ringdown.py", "--data", data, "--out", out, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (out / "results.json").exists(), done.stderr[-2000:]
    return done.returncode, json.loads((out / "results.json").read_text()), done.stdout


def test_known_frequency_and_damping_are_found_in_computed_runs(tmp_path):
    runs = [computed_run(seed).assign(run_id=seed) for seed in range(4)]
    pd.concat(runs).to_parquet(tmp_path / "runs.parquet")
    pd.DataFrame({"run_id": range(4), "unit": "bench"}).to_csv(tmp_path / "runs_index.csv", index=False)
    code, results, shown = run_script(tmp_path, tmp_path / "out", "--skip-carry-over")
    assert code == 0, shown
    assert results["runs"] == results["converged"] == 4
    rows = pd.read_csv(tmp_path / "out" / "runs.csv")
    assert rows.frequency_hz.median() == pytest.approx(FREQUENCY, rel=0.02)
    # The angle rate is a slope over 9 ms, which blurs the 3 ms arrest and shows up as stiffness: 3.6 % here.
    assert rows.stiffness.median() == pytest.approx(1.0 / CAPACITANCE, rel=0.06)
    assert rows.resistance.median() == pytest.approx(RESISTANCE, rel=0.15)
    assert set(rows.status) == {"converged"}
    assert np.all(rows.stiffness_sd > 0)


def test_missing_data_says_where_to_get_it(tmp_path):
    command = [sys.executable, ROOT / "experiments" / "hose_ringdown.py", "--data", tmp_path, "--out", tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "github.com/vtnsi/actuator_dataset" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(not (REAL / "runs.parquet").exists(), reason="the rotary actuator recordings are not here")
def test_real_runs_meet_the_targets(tmp_path):
    code, results, shown = run_script(REAL, tmp_path / "out")
    assert code == 0, shown
    assert results["converged_share"] >= 0.97
    assert results["median_rmse_percent"] <= 1.3 and results["p90_rmse_percent"] <= 1.6
    assert results["baseline_damped_cosine"]["median_rmse_percent"] < 1.1
    assert set(results["carry_over_rmse_percent"]) == {"halves", "other units"}
