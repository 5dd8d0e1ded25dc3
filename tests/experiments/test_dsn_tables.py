"""The recomputation of the DSN article runs, agrees, and flags the one misprint."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "experiments" / "dsn_tables.py"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dsn")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--out", str(folder)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, json.loads((folder / "results.json").read_text())


def test_every_number_but_the_viscosity_agrees(run):
    numbers = run[1]["numbers"]
    assert len(numbers) == 8 + 15 + 4 + 5
    wrong = [number for number in numbers if not number["agrees"]]
    assert [number["name"] for number in wrong] == ["fluid_kinematic_viscosity"]
    assert "39.37" in wrong[0]["note"] and wrong[0]["ours_si"] == 27.7e-6
    assert wrong[0]["ours_inch_pound"] == pytest.approx(0.042935, rel=1e-5)


def test_recomputed_moduli_and_speeds(run):
    containers, lines = run[1]["containers"], run[1]["lines"]
    psi = {name: container["effective_modulus_psi"] for name, container in containers.items()}
    expected = {"1-in pipe": 193555, "1.5-in pipe": 191773, "2-in pipe": 191603, "hose": 151574}
    assert psi == pytest.approx(expected, abs=0.6)
    speeds = [line["wave_speed_m_per_s"] for line in lines.values()]
    assert speeds == pytest.approx([1231.4, 1231.7, 1227.9, 1227.9], abs=0.06)
    assert all(line["eq_11_holds"] and line["impedance_error_at_20_Hz"] > 2 for line in lines.values())


def test_reconstructions_reproduce_table_1_and_say_what_they_are(run):
    for line in run[1]["reconstructions"].values():
        assert abs(line["difference_from_table_1"]) < 1 / 18587
        assert line["label"] == "reconstruction, not from the article"


def test_last_line_is_the_finding(run):
    output, results = run
    assert output.strip().splitlines()[-1] == results["finding"]
    assert results["finding"].startswith("31 of 32 printed numbers agree within rounding; in disagreement: fluid_kin")
