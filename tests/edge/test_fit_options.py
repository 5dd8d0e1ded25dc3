"""What `jaxlines fit` does beside the fit: a checkpoint to go on from, classes of identifiability, a posterior."""

import json

import numpy as np
import pandas as pd
import pytest
from studies import write_study
from typer.testing import CliRunner

from jaxlines.edge import help_texts
from jaxlines.edge.commands import app
from jaxlines.inference import posterior

run = CliRunner().invoke


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A model without air for a recording of a line with it, so that its residuals are correlated."""
    return str(write_study(tmp_path_factory.mktemp("study"), ('air_fraction = "0.5 %"', "air_fraction = 0.0")))


@pytest.fixture(scope="module")
def assessed(study, tmp_path_factory):
    folder = tmp_path_factory.mktemp("assessed")
    result = run(app, ["fit", study, "--out", str(folder), "--assess", "--checkpoint", str(folder / "fit.ckpt")])
    assert result.exit_code == 0, result.output
    return result, folder


def test_classes_are_shown_and_written(assessed):
    result, folder = assessed
    table = pd.read_csv(folder / "identifiability.csv")
    assert list(table["parameter"]) == ["fluid.bulk_modulus", "initial.A.pressure"]
    assert "identifiable" in table["class"].tolist()
    assert "fluid.bulk_modulus: identifiable: 95 % within" in result.stdout
    content = json.loads((folder / "result.json").read_text())
    assert content["classes"]["fluid.bulk_modulus"]["class"] == "identifiable"
    assert "Which numbers the data can tell" in (folder / "report.html").read_text()
    assert {path.name for path in folder.iterdir()} == set(help_texts.FIT.files) - {"posterior.csv"} | {"fit.ckpt"}


def test_budgets_are_written_and_add_up(assessed):
    table = pd.read_csv(assessed[1] / "budget.csv")
    content = json.loads((assessed[1] / "result.json").read_text())
    own = table[table["parameter"] == "fluid.bulk_modulus"]
    total = float(own.loc[own["type"] == "result", "contribution"].iloc[0])
    assert total == pytest.approx(content["parameters"]["fluid.bulk_modulus"]["sd"], rel=1e-6)
    parts = own.loc[own["type"] != "result", "contribution"].to_numpy(dtype=float)
    assert np.linalg.norm(parts) == pytest.approx(total, rel=1e-6)


def test_the_result_says_which_noise_the_intervals_assume(assessed):
    content = json.loads((assessed[1] / "result.json").read_text())
    assert content["intervals"]["method"] == "autoregressive"
    assert "the noise is taken as autoregressive" in content["intervals"]["sentence"]
    assert "the noise is taken as autoregressive" in " ".join(assessed[0].stdout.split())
    assert content["starts"][0]["status"] == "converged"
    assert set(content["starts"][0]["end"]) == {"fluid.bulk_modulus", "initial.A.pressure"}
    assert isinstance(content["log_likelihood"], float)


def test_a_fit_goes_on_from_its_checkpoint_to_the_same_numbers(study, assessed, tmp_path):
    _, folder = assessed
    again = run(app, ["fit", study, "--out", str(tmp_path), "--checkpoint", str(folder / "fit.ckpt"), "--quiet"])
    assert again.exit_code == 0, again.output
    first, second = (json.loads((f / "result.json").read_text()) for f in (folder, tmp_path))
    assert first["parameters"] == second["parameters"]


def test_a_posterior_without_its_libraries_says_what_to_install(study, monkeypatch):
    def missing():
        raise ImportError("sampling needs BlackJAX: pip install 'jaxlines[posterior]'")

    monkeypatch.setattr(posterior, "_blackjax", missing)
    result = run(app, ["fit", study, "--posterior", "100"])
    assert result.exit_code == 2
    assert "pip install 'jaxlines[posterior]'" in result.stderr and "Traceback" not in result.stderr


@pytest.mark.slow
def test_draws_of_the_posterior_are_written(study, tmp_path):
    result = run(app, ["fit", study, "--out", str(tmp_path), "--posterior", "50", "--quiet"])
    assert result.exit_code == 0, result.output
    table = pd.read_csv(tmp_path / "posterior.csv")
    assert len(table) == 4 * 50 and {"chain", "draw", "fluid.bulk_modulus", "diverged"} <= set(table.columns)
    content = json.loads((tmp_path / "result.json").read_text())["posterior"]["parameters"]["fluid.bulk_modulus"]
    assert content["ci95"][0] < content["median"] < content["ci95"][1]
    assert ">Posterior</h2>" in (tmp_path / "report.html").read_text()
    assert {path.name for path in tmp_path.iterdir()} == set(help_texts.FIT.files) - {"identifiability.csv"}
