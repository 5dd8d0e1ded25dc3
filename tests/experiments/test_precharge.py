"""The accumulator study: on cycles computed here with NumPy, and on the real rig's where they are."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "experiments"))

import accumulator_precharge as study  # noqa: E402  # pyright: ignore[reportMissingImports]
import precharge_model as model  # noqa: E402  # pyright: ignore[reportMissingImports]
from precharge_data import ATMOSPHERE_BAR, STEPS, MissingData, cycles_of, exchange, read_cycles  # noqa: E402  # pyright: ignore[reportMissingImports]

VOLUME, INDEX, WARMING = 0.7, 1.5, 1.2  # l, -, -
LABELS = (90, 100, 115, 130)
LEVELS = (145.0, 155.0, 165.0, 155.0, 150.0)


def oil_volume(pressure, precharge):
    """Oil in the accumulator [l] at bar absolute: V_0 (1 - (p_pre/p)^(1/n)), nothing below the pre-charge."""
    return VOLUME * (1.0 - np.minimum(precharge / pressure, 1.0) ** (1.0 / INDEX))


def rig(count: int, noise: float = 0.004, seed: int = 0) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Cycles of a rig, 20 a label: pressure steps within 1 s, flow of a leaky pump less what is stored."""
    rng, rows, seconds = np.random.default_rng(seed), [], np.arange(60)
    label = np.array(LABELS)[(np.arange(count) // 20) % 4]
    warm = 40.0 + 10.0 * rng.random(count)
    for cycle in range(count):
        ends = np.full(61, LEVELS[0])
        for second, level in zip(STEPS, LEVELS[1:], strict=True):
            ends[second + 1 :] = level
        gas = (label[cycle] + ATMOSPHERE_BAR) * (1 + WARMING * (warm[cycle] - 20.0) / 293.15)
        stored = np.diff(oil_volume(ends + ATMOSPHERE_BAR, gas))
        mean = 0.5 * (ends[1:] + ends[:-1])
        flow = 8.0 - 0.01 * (mean - 145.0) - 60.0 * stored + noise * rng.standard_normal(60)
        rows.append(pd.DataFrame({"cycle": cycle, "t_s": seconds, "PS1": mean, "FS1": flow, "TS1": warm[cycle]}))
    profile = {"cycle": np.arange(count), "cooler_pct": np.where(np.arange(count) % 40 < 20, 20, 100)}
    profile |= {"accumulator_bar": label, "stable_flag": 0}
    return pd.concat(rows), pd.DataFrame(profile)


@pytest.fixture(scope="module")
def cycles():
    """320 cycles of the computed rig."""
    return cycles_of(*rig(320))


@pytest.fixture(scope="module")
def calibration(cycles):
    """Shared numbers from every second pair of blocks."""
    return model.calibrate(cycles[(cycles.number // 80) % 2 == 0])


def test_exchange_is_the_volume_beyond_the_steady_flow():
    """A pump that loses 0.01 l/min a bar, 10 ml left behind in the second of the step."""
    pressure = np.where(np.arange(60) < 19, 150.0, 160.0)[None]
    flow = 8.0 - 0.01 * (pressure - 150.0)
    flow[0, 19] -= 60.0 * 0.010
    left, before, after = exchange(pressure, flow, 19)
    assert left[0] == pytest.approx(-0.010)
    assert (before[0], after[0]) == (150.0, 160.0)


def test_taken_in_is_the_polytropic_law():
    """Against NumPy, far above the pre-charge where the switch is shut."""
    before, after, warm = 145e5, 165e5, 100e5 * (1 + WARMING * 30.0 / 293.15)
    law = VOLUME * 1e-3 * ((warm / before) ** (1 / INDEX) - (warm / after) ** (1 / INDEX))
    with model.computing_in("float64"):
        shown = model.taken_in([VOLUME, INDEX, 0.0, WARMING, 0.003, 0.0], 100e5, 323.15, before, after)
    assert float(shown) == pytest.approx(law, rel=1e-6)


def test_a_calibration_finds_what_cycles_share(calibration):
    """Volume and index trade off, so that their intervals are wide; what they make together is sharp."""
    shared = dict(zip(model.LABELS, calibration.values, strict=True))
    assert calibration.status in ("converged", "at_bound")
    assert shared["volume_l"] == pytest.approx(VOLUME, rel=0.15)
    assert shared["polytropic_index"] == pytest.approx(INDEX, rel=0.15)
    assert shared["warming"] == pytest.approx(WARMING, abs=0.15)


def test_left_out_cycles_show_their_precharge(cycles, calibration, tmp_path):
    """Without their labels; and a calibration that is wrong by 20 % in volume is seen to be wrong."""
    left = cycles[(cycles.number // 80) % 2 == 1]
    label = np.rint(study.gauge(left.label))
    reading = model.read_precharge(left, calibration)
    found = study.agreement(study.gauge(reading.value), label, reading)
    assert found["rank_correlation"] > 0.9
    assert found["rmse_bar"] < 4.0
    assert found["slope"] == pytest.approx(1.0, abs=0.1)
    assert 0.85 <= found["coverage_of_95_percent_intervals"] <= 1.0
    told = study.Told({"settled": found}, study.gauge(reading.value), label, calibration)
    name = study.draw(tmp_path, left, {"same conditions": told, "other temperature": told})
    assert (tmp_path / name).stat().st_size > 20_000
    wrong = model.read_precharge(
        left, model.dataclasses.replace(calibration, values=calibration.values * [0.8, 1, 1, 1, 1, 1])
    )
    assert study.agreement(study.gauge(wrong.value), label)["rmse_bar"] > 8.0


def test_intervals_take_up_what_the_steps_of_a_cycle_share(cycles, calibration):
    """An error of 3 ml in all steps of every fifth cycle: white intervals miss, those from the excess hold."""
    odd = cycles.number % 5 == 0
    spoilt = model.dataclasses.replace(cycles, taken=cycles.taken + np.where(odd, 3e-6, 0.0)[:, None])
    wide = model.dataclasses.replace(calibration, excess=model.excess(spoilt, calibration))
    label = np.rint(study.gauge(spoilt.label))
    covered = []
    for one in (model.dataclasses.replace(calibration, excess=model.CHI_SQUARE), wide):
        reading = model.read_precharge(spoilt, one)
        found = study.agreement(study.gauge(reading.value), label, reading)
        covered.append(found["coverage_of_95_percent_intervals"])
    assert wide.excess > 2.0 * model.CHI_SQUARE
    assert covered[0] < 0.9 and covered[1] >= 0.95


def test_agreement_of_numbers_known_by_hand():
    """Readings 10 bar high throughout."""
    label = np.array([90.0, 90.0, 100.0, 130.0])
    found = study.agreement(label + 10.0, label)
    assert (found["slope"], found["bias_bar"], found["rmse_bar"]) == pytest.approx((1.0, 10.0, 10.0))
    assert found["rank_correlation"] == pytest.approx(1.0)
    assert found["nearest_label_right"] == 0.5  # 110 is still nearest to 100, 140 to 130


def test_what_is_left_out_is_not_calibrated_on(cycles):
    for splits in study.folds(cycles).values():
        for fit, rest in splits:
            assert fit.any() and rest.any() and not (fit & rest).any()


def test_missing_data_says_where_to_get_them(tmp_path):
    with pytest.raises(MissingData, match="UCI"):
        read_cycles(tmp_path)


@pytest.mark.slow
def test_the_real_rig(tmp_path):
    """The whole study; it names its targets itself."""
    data = os.environ.get("JAXLINES_CONDITION_MONITORING_DATA")
    if not data:
        pytest.skip("JAXLINES_CONDITION_MONITORING_DATA does not name a folder with the rig's cycles")
    command = [sys.executable, ROOT / "experiments" / "accumulator_precharge.py", "--data", data, "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((tmp_path / "results.json").read_text())["passed"]
