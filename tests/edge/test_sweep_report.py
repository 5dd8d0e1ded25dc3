"""The report of a sweep says what there is, also when there is little."""

import json
import warnings

import pytest

from jaxlines.edge.sweep_report import sweep_report, write_sweep
from jaxlines.edge.sweep_status import status_of
from jaxlines.inference.samplers import Morris, ShapleyEffects, Sobol, SobolIndices
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_plan import SweepPlan
from jaxlines.inference.sweep_store import SweepStore
from tests.edge.pages import FAILING as MODEL, Page
from tests.inference.sweep_cases import ANGLES

SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("sampler", "count", "pieces"),
    [
        (Sobol(), 5, ["Worst lanes", "y [Pa]"]),
        (Sobol(), 256, ["whatever the failed lanes give", "lowest to its highest tenth", "non_finite"]),
        pytest.param(SobolIndices(), 5 * 64, ["Sobol: total", "lanes of one block share numbers"], marks=SLOW),
        pytest.param(Morris(), 4 * 20, ["Morris: mu star", "no sample of the distributions"], marks=SLOW),
        pytest.param(ShapleyEffects(), 4 * 40, ["Shapley: share"], marks=SLOW),
    ],
    ids=["few", "sobol", "indices", "morris", "shapley"],
)
def test_a_report_shows_causes_bands_and_failures(sampler, count, pieces):
    result = run_sweep(SweepPlan(MODEL, ANGLES, sampler), count)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        page = sweep_report(result, "Angles & more")
    read = Page(page)
    for piece in ["Angles & more", "wave over time", "What is uncertain", "Uniform", *pieces]:
        assert piece in read.text, piece
    assert read.outside == []
    assert read.open == []
    assert len(read.plots) >= 4


def test_the_summary_is_strict_json_and_the_status_knows_the_failures(tmp_path):
    result = run_sweep(SweepPlan(MODEL, ANGLES, Sobol()), 128, store=tmp_path, thresholds={"y": [5.0]}, chunk=64)
    files = write_sweep(result, "Angles")
    assert all(file.is_file() for file in files)
    summary = json.loads(files[0].read_text(), parse_constant=lambda text: pytest.fail(text))
    failed = sum(summary["failed"].values())
    assert failed == sum(result.found.failed.values()) > 0
    assert summary["reductions"]["y"]["exceedances"][0]["threshold"] == 5.0
    status = status_of(SweepStore(result.folder))
    assert (status["done"], status["count"], status["working"]) == (128, 128, 0)
    assert sum(status["failed"].values()) == failed
    assert status["rate"] > 0
