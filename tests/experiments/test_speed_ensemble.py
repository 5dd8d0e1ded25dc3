"""The comparison of ensembles with their peers: which settings are compared, and what becomes of a missed claim."""

import importlib
import sys
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
pytest.importorskip("diffrax")


@pytest.fixture(scope="module")
def speed():
    sys.path.insert(0, str(EXPERIMENTS))
    try:
        yield importlib.import_module("speed_ensemble")
    finally:
        sys.path.remove(str(EXPERIMENTS))


def row(speed, engine, rate, rms):
    return speed.Row(engine, "float64", "some", 4096, rate, rms, 2 * rms, 0.0, 0, False)


def test_a_peer_is_taken_at_nearly_our_error(speed):
    rows = [row(speed, "peer", 30.0, 4000.0), row(speed, "peer", 20.0, 300.0), row(speed, "peer", 10.0, 110.0)]
    assert speed.nearest(rows, "peer", "float64", 100.0).sims_per_second == 20.0
    assert speed.nearest(rows, "peer", "float64", 3000.0).sims_per_second == 30.0
    assert (
        speed.nearest(rows, "peer", "float64", 5000.0) is None and speed.nearest(rows, "other", "float64", 1.0) is None
    )


def test_the_vector_fields_agree_and_claims_can_be_missed(speed):
    results, claims = speed.run(["difference"], 8)
    assert results["claims"][0]["met"] and claims.rows[0]["value"] < 1e-12
    claims.add("too slow", 1.0, 2.0, 3.0)
    assert not claims.rows[-1]["met"] and not claims.rows[-1]["reached"]
