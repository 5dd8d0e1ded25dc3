"""The study of the antennas' axes: one manoeuvre with few segments here, all of it on demand."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from jaxlines.catalogue import dsn70m_axis

SCRIPT = Path(__file__).parents[2] / "experiments" / "dsn_axis.py"


@pytest.mark.slow
def test_tracking_with_few_segments(monkeypatch):
    """The article's claims about tracking, and what its lumped lines make of 1 to 20 Hz: sin(kL)/kL, tan(kL)/kL."""
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    study = importlib.import_module("dsn_axis")
    monkeypatch.setattr(study, "SEGMENTS", 4)
    numbers, runs = study.compare("azimuth", "tracking")
    assert runs["segmented"].status == "ok" and numbers["speed_error"] < 0.02
    assert numbers["viscous"] < 2e3 and numbers["inertial"] < 0.01 * numbers["lowest"]
    assert numbers["lumped_pressure_off"] < 5e3
    rows = study.over_frequency("azimuth_1")
    assert [row["lumped_motors"] for row in rows] == pytest.approx([0.998, 0.992, 0.952, 0.822, 0.67, 0.40], abs=0.02)
    assert rows[2]["lumped_valve"] == pytest.approx(1.104, abs=0.02)


def test_the_equivalent_conduit_has_length_volume_and_modulus_of_the_line():
    for name, modulus in (("azimuth_1", 1.2888e9), ("elevation_2", 1.2816e9)):
        conduit = dsn70m_axis.equivalent_conduit(name)
        assert float(conduit.length) == pytest.approx(20.83, rel=1e-3)
        assert float(conduit.reference_volume()) == pytest.approx(dsn70m_axis.VOLUMES[name].value, rel=1e-12)
        whole = 1.0 / (1.0 / float(conduit.container_modulus()) + 1.0 / float(dsn70m_axis.OIL.bulk_modulus))
        assert whole == pytest.approx(modulus, rel=1e-4)


def test_another_axis_is_refused():
    with pytest.raises(ValueError, match='axis must be "azimuth" or "elevation", got'):
        dsn70m_axis.antenna_axis("polar")


@pytest.mark.slow
def test_the_whole_study(tmp_path):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--out", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert all(json.loads((tmp_path / "results.json").read_text())["claims"].values())
