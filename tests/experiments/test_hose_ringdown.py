"""The ring-down study: on runs computed here with NumPy, and on the real recordings where they are."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared" / "data" / "rotary_actuator"
HOLD, SPEED, STEADY_DROP = 6000.0, 10000.0, 2300.0  # counts and seconds
LINE, PASSAGE = (0.12, 0.0015, 0.021), (0.093, 0.00047, 0.0105)  # resistance, inertance, capacitance of each lump


def mode_frequencies() -> np.ndarray:
    """Both modes of the undamped lumps [Hz], by hand: (1 - w^2 I_1 C_1)(1 - w^2 I_2 C_2) = w^2 I_1 C_2."""
    (_, i_1, c_1), (_, i_2, c_2) = LINE, PASSAGE
    roots = np.roots([i_1 * c_1 * i_2 * c_2, -(i_1 * c_1 + i_2 * c_2 + i_1 * c_2), 1.0])
    return np.sort(np.sqrt(roots)) / (2 * np.pi)


def computed_run(seed: int) -> pd.DataFrame:
    """A stroke that stops within 3 ms and the ring-down after it, by small explicit steps, with sensor noise."""
    rng, samples, substeps = np.random.default_rng(seed), 1200, 50
    hold = HOLD * (1 + 0.02 * rng.standard_normal())
    (r_1, i_1, c_1), (r_2, i_2, c_2) = LINE, PASSAGE
    quadratic = (STEADY_DROP - (r_1 + r_2) * SPEED) / SPEED**2
    stop, step = 0.43 + 0.0005 * rng.random(), 1e-3 / substeps
    hose, pressure, flow, passing, angle = hold - STEADY_DROP + r_2 * SPEED, hold - STEADY_DROP, SPEED, SPEED, 0.0
    rows = np.empty((samples, 3))
    for k in range(samples * substeps):
        if k % substeps == 0:
            rows[k // substeps] = angle, pressure, 0.0
        rate = SPEED * min(max((stop + 0.0015 - k * step) / 0.003, 0.0), 1.0)
        flow += step * (hold - hose - r_1 * flow - quadratic * flow * abs(flow)) / i_1
        passing += step * (hose - pressure - r_2 * passing) / i_2
        hose += step * (flow - passing) / c_1
        pressure += step * (passing - rate) / c_2
        angle += step * rate
    rows += rng.standard_normal(rows.shape) * [1.0, 3.0, 3.0]
    return pd.DataFrame({"Angle": rows[:, 0] + 3000, "PG_1": rows[:, 1], "PG_2": rows[:, 2]}).round()


def run_script(data: Path, out: Path, *options: str) -> tuple[int, dict, str]:
    command = [sys.executable, ROOT / "experiments" / "hose_ringdown.py", "--data", data, "--out", out, *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (out / "results.json").exists(), done.stderr[-2000:]
    return done.returncode, json.loads((out / "results.json").read_text()), done.stdout


@pytest.mark.slow
def test_two_lumps_are_found_in_computed_runs(tmp_path):
    """One lump misses the second mode; both find the first. The computed stop is a ramp, the fitted one is smooth."""
    runs = [computed_run(seed).assign(run_id=seed) for seed in range(3)]
    pd.concat(runs).to_parquet(tmp_path / "runs.parquet")
    pd.DataFrame({"run_id": range(3), "unit": "bench"}).to_csv(tmp_path / "runs_index.csv", index=False)
    code, results, shown = run_script(tmp_path, tmp_path / "out", "--skip-carry-over", "--only", "two lumps")
    assert code == 0, shown
    assert results["runs"] == results["converged"] == 3
    rows = pd.read_csv(tmp_path / "out" / "runs.csv")
    first, second = mode_frequencies()
    assert rows.frequency_hz.median() == pytest.approx(first, rel=0.06)  # damping lowers it
    assert rows.frequency_hz_second_mode.median() == pytest.approx(second, rel=0.06)
    truth = dict(zip(["resistance", "inertance", "hose_capacitance"], LINE, strict=True))
    truth |= dict(zip(["passage_resistance", "passage_inertance", "port_capacitance"], PASSAGE, strict=True))
    for name, value in truth.items():
        assert np.median(rows[name]) == pytest.approx(value, rel=0.05 if "inertance" in name else 0.12)
    one, two = (results["structures"][name] for name in ("one lump", "two lumps"))
    assert one["median_rmse_percent"] > 4.0 * two["median_rmse_percent"]
    assert results["uncertainty"]["numbers"]["inertance"]["standard_deviation_correlated"] > 0.0
    assert (tmp_path / "out" / results["figure"]).stat().st_size > 20_000


def test_standard_deviations_under_correlated_noise():
    """A straight line under noise whose neighbours correlate by 0.8: the white formula is three times too small."""
    sys.path.insert(0, str(ROOT / "experiments"))
    correlated = importlib.import_module("ringdown_statistics").correlated
    rng, count, rho = np.random.default_rng(5), 1200, 0.8
    slope = np.column_stack([np.ones(count), np.linspace(-1.0, 1.0, count)])
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    true = np.linalg.inv(slope.T @ slope)
    true = np.sqrt(np.diag(true @ slope.T @ rho**lags @ slope @ true))
    root, found, white = np.linalg.cholesky(rho**lags), [], []
    for _ in range(60):
        noise = root @ rng.standard_normal(count)
        rows = noise - slope @ np.linalg.lstsq(slope, noise, rcond=None)[0]
        found.append(np.diag(correlated(rows, slope)))
        white.append(np.diag(np.linalg.inv(slope.T @ slope)) * np.mean(rows**2))
    assert np.sqrt(np.mean(found, axis=0)) == pytest.approx(true, rel=0.2)
    assert np.all(np.sqrt(np.mean(white, axis=0)) < 0.4 * true)


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
    assert results["converged"] >= 0.97 * results["runs"]
    assert results["rmse_percent"]["median"] <= 0.5 and results["rmse_percent"]["p90"] <= 0.7
    older = results["structures"]["one lump"]
    assert older["median_rmse_percent"] <= 1.3 and older["p90_rmse_percent"] <= 1.6
    assert results["baseline_damped_cosine"]["median"] < 1.1
    left = results["structures"]["two lumps"]["left_out_rmse_percent"]
    assert set(left) == {"halves", "other units"}
    assert left["other units"]["p90"] <= 1.3
    assert "air" in results["not_wanted"]
