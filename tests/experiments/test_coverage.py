"""The coverage studies on a few data sets, and that a wrong interval would be noticed."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def load(monkeypatch):
    """Experiments as modules, forgotten afterwards."""
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    loaded = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - loaded:
        if name.startswith(("coverage_", "make_control_line")):
            sys.modules.pop(name)


def run(module, monkeypatch, folder, *options) -> tuple[int, dict]:
    monkeypatch.setattr(sys, "argv", [module.__name__, "--out", str(folder), *options])
    return module.main(), json.loads((folder / "results.json").read_text())


def test_intervals_of_a_few_data_sets(load, tmp_path, monkeypatch, capsys):
    module = load("coverage_intervals")
    options = ("--count", "6", "--bootstrap", "2", "--draws", "40", "--samples", "121", "--no-short")
    code, result = run(module, monkeypatch, tmp_path, *options)
    kinds = result["found"]
    assert code == 0 and not result["missed"]
    assert kinds["AR(1), 121 samples"]["methods"] == {"autoregressive": 6}
    assert set(kinds["white, 121 samples"]["hits"]) == {"wald", "profile", "bootstrap"}
    assert all(own["failed"] == 0 for own in kinds.values())
    assert result["finding"] == capsys.readouterr().out.splitlines()[-1]


def test_bands_are_the_demanded_ones_and_a_count_outside_is_a_miss(load):
    module = load("coverage_intervals")
    bands, missed = module.judge(
        {"white": {"hits": {"wald": {"a": 926, "b": 925}, "bootstrap": {"a": 199}}}}, 1000, 200
    )
    assert bands["wald"] == (926, 971) and bands["bootstrap"] == (179, 198)
    assert missed == ["white wald b: 925", "white bootstrap a: 199"]


def test_condensed_rows_keep_cost_gradient_and_curvature(load):
    rng = np.random.default_rng(0)
    rows, slopes = rng.standard_normal((2, 30)), rng.standard_normal((2, 30, 4))
    short, few = load("coverage_batch").condensed(rows, slopes)
    assert short.shape == (2, 5) and few.shape == (2, 5, 4)
    np.testing.assert_allclose(np.sum(short**2, axis=1), np.sum(rows**2, axis=1))
    np.testing.assert_allclose(np.einsum("lsi,ls->li", few, short), np.einsum("lsi,ls->li", slopes, rows))
    np.testing.assert_allclose(np.einsum("lsi,lsj->lij", few, few), np.einsum("lsi,lsj->lij", slopes, slopes))


def test_made_noise_has_the_correlation_and_level_it_says(load):
    line = load("coverage_line")
    made = line.noise(np.random.default_rng(1), 4000, 20, 0.6) / line.NOISE_SD
    np.testing.assert_allclose(made.var(axis=0), 1.0, atol=0.1)
    assert np.mean(made[:, 1:] * made[:, :-1]) == pytest.approx(0.6, abs=0.03)
    assert stats.kstest(made[:, 0], "norm").pvalue > 1e-3


@pytest.mark.slow
def test_posteriors_of_a_few_data_sets(load, tmp_path, monkeypatch):
    code, result = run(load("coverage_posterior"), monkeypatch, tmp_path, "--count", "4")
    assert code == 0 and len(result["ranks"]["log-likelihood"]) == 4
    assert all(0 <= rank <= 49 for ranks in result["ranks"].values() for rank in ranks)
