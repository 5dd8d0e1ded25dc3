"""The command line, run in this process; one line and an exit code for everything that goes wrong."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from studies import write_study
from typer.testing import CliRunner

import jaxlines.edge.study
from jaxlines.edge import help_texts, main as main_module, writing
from jaxlines.edge.commands import app
from jaxlines.edge.study import load_study
from jaxlines.edge.writing import plain, write_fit
from jaxlines.inference.analysis import ChannelFit
from jaxlines.inference.fit_result import Fit

run = CliRunner().invoke


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return str(write_study(tmp_path_factory.mktemp("study"), ('air_fraction = "0.5 %"', "air_fraction = 0.0")))


@pytest.fixture(scope="module")
def fitted(study, tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "deep" / "down"
    return run(app, ["fit", study, "--out", str(folder)]), folder


def test_fit_writes_its_results(fitted):
    result, folder = fitted
    assert result.exit_code == 0, result.output
    assert sorted(os.listdir(folder)) == ["budget.csv", "report.html", "result.json", "traces.csv"]
    assert set(os.listdir(folder)) <= set(help_texts.FIT.files)
    assert f"wrote {folder}/result.json" in result.stdout
    assert "fluid.bulk_modulus" in result.stdout
    assert "GPa" in result.stdout
    assert "start 1 of 1" in result.stderr


def test_correlations_are_printed_as_they_are_written(fitted):
    matrix = json.loads((fitted[1] / "result.json").read_text())["correlations"]["matrix"]
    lines = fitted[0].stdout.splitlines()
    (row,) = (line for line in lines if line.startswith("  2 initial.A.pressure"))
    assert "correlations" in lines
    assert row.split()[-1] == f"{matrix[1][0]:+.2f}"


def test_result_is_strict_json_with_all_keys(fitted):
    def refuse(word):
        raise AssertionError(word)

    content = json.loads((fitted[1] / "result.json").read_text(), parse_constant=refuse)
    keys = "status message parameters derived rmse noise whiteness intervals starts log_likelihood correlations "
    keys += "identifiability scale validity warnings scatter_between_recordings"
    assert {*keys.split(), "seconds", "version"} <= set(content)
    modulus = content["parameters"]["fluid.bulk_modulus"]
    assert set(modulus) == {"value", "sd", "ci95", "unit", "kind", "note"}
    assert 0.6e9 < modulus["ci95"][0] < modulus["value"] < modulus["ci95"][1] < 2.5e9
    assert modulus["unit"] == "Pa"
    assert content["correlations"]["names"] == ["fluid.bulk_modulus", "initial.A.pressure"]
    assert np.shape(content["correlations"]["matrix"]) == (2, 2)
    assert content["noise"] == {"A.pressure": pytest.approx(1e4)}
    assert "line.effective_bulk_modulus" in content["derived"]


def test_traces_hold_measured_and_simulated(fitted, study):
    traces = pd.read_csv(fitted[1] / "traces.csv")
    assert list(traces) == ["time [s]", "A.pressure measured [Pa]", "A.pressure simulated [Pa]"]
    recorded = pd.read_csv(os.path.join(os.path.dirname(study), "line.csv"))
    expected = recorded["p_line [bar_g]"] * 1e5 + 101325.0
    np.testing.assert_allclose(traces["A.pressure measured [Pa]"], expected, rtol=1e-8)
    rmse = np.sqrt(np.mean((traces.iloc[:, 1] - traces.iloc[:, 2]) ** 2))
    stored = json.loads((fitted[1] / "result.json").read_text())["rmse"]["A.pressure"]
    assert stored == pytest.approx(rmse, rel=1e-6)


def test_simulate_writes_the_outputs_asked_for(study, tmp_path):
    result = run(app, ["simulate", study, "--out", str(tmp_path), "--quiet"])
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    traces = pd.read_csv(tmp_path / "traces.csv")
    assert list(traces) == ["time [s]", "A.pressure [Pa]", "gauge [Pa]"]
    assert traces["time [s]"].iloc[-1] == 2.0
    np.testing.assert_allclose(traces["A.pressure [Pa]"] - traces["gauge [Pa]"], 101325.0, rtol=1e-6)
    content = json.loads((tmp_path / "result.json").read_text())
    assert set(os.listdir(tmp_path)) == set(help_texts.SIMULATE.files)
    assert content["status"] == "ok"
    assert content["outputs"]["A.pressure"]["last"] == pytest.approx(traces["A.pressure [Pa]"].iloc[-1])


def test_check_shows_what_is_there(study):
    result = run(app, ["check", study])
    assert result.exit_code == 0, result.output
    for words in (
        "valve (FlowSource)", "inputs: flow", "200 samples", "L/min",
        "fluid.bulk_modulus: 0.6 to 2.5 GPa, log, search from 2.2 GPa",
        "line.parts.0.length: standard uncertainty 50 mm", "validity of the lumped model", "2L/c0",
        "distance from the recording before any fit",
    ):  # fmt: skip
        assert words in result.stdout


def test_check_without_a_recording_takes_the_inputs_of_the_file(study, tmp_path):
    text = Path(study).read_text()
    path = tmp_path / "plain.toml"
    path.write_text(text[: text.index("[recording]")] + text[text.index("[simulate]") :])
    result = run(app, ["check", str(path), "--quiet"])
    assert result.exit_code == 0, result.output
    assert "ok: 0 s to 2 s, 50 samples" in result.stdout


def one_line(result, code, *words):
    lines = result.stderr.strip().splitlines()
    assert result.exit_code == code, result.output
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("jaxlines: ")
    for word in words:
        assert word in lines[0]


def test_mistakes_in_a_study_are_one_line(tmp_path):
    path = str(write_study(tmp_path, ("42.85 mm", "42.85")))
    for command in ("fit", "simulate", "check"):
        one_line(
            run(app, [command, path, "--quiet"]), 2, f"{path}: circuit.line.parts.0.inner_diameter: '42.85' has no"
        )


def test_missing_study_is_one_line():
    one_line(run(app, ["fit", "nope.toml", "--quiet"]), 2, "jaxlines: nope.toml: no such file")


def test_folder_that_cannot_be_written_is_one_line_before_any_work(study, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(jaxlines.edge.study, "load_study", lambda source: pytest.fail("work was done"))
    for out in (tmp_path / "file", tmp_path / "file" / "deeper"):
        one_line(run(app, ["fit", study, "--quiet", "--out", str(out)]), 2, str(out))


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (RuntimeError("simulation failed (max_steps):\n stiff"), 2, "simulation failed (max_steps): stiff"),
        (KeyError("no number is called 'x'"), 2, "no number is called 'x'"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_other_ends_are_one_line(study, monkeypatch, error, code, words):
    def fail(source):
        raise error

    monkeypatch.setattr(jaxlines.edge.study, "load_study", fail)
    one_line(run(app, ["fit", study, "--quiet"]), code, words)


def test_failed_fit_exits_with_one(study, monkeypatch, tmp_path):
    loaded = load_study(study)
    monkeypatch.setattr(
        jaxlines.edge.study, "fit", lambda *_, **__: Fit.failure(loaded.circuit, "no start worked", 0.1)
    )
    result = run(app, ["fit", study, "--quiet", "--out", str(tmp_path)])
    one_line(result, 1, "the fit failed: no start worked")
    assert json.loads((tmp_path / "result.json").read_text())["status"] == "failed"
    assert "no start worked" in (tmp_path / "report.html").read_text()


def test_rest_of_a_failed_write_is_removed(fitted, tmp_path, monkeypatch):
    path = tmp_path / "result.json"
    path.write_text("old")
    monkeypatch.setattr(writing.os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        writing.write_whole(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["result.json"]


def test_not_finite_becomes_null():
    values = {
        "a": float("nan"),
        "b": np.array([1.0, np.inf]),
        "c": (np.int64(3), np.bool_(True), None),
        "d": np.array(2),
    }
    assert plain(values) == {"a": None, "b": [1.0, None], "c": [3, True, None], "d": 2}


def test_jax_is_set_up_by_environment_and_what_is_set_stays(monkeypatch, tmp_path):
    for name in ("EQX_ON_ERROR", "JAX_COMPILATION_CACHE_DIR"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "7")
    main_module.set_up_jax()
    assert os.environ["EQX_ON_ERROR"] == "nan"
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path / "jaxlines" / "jax")
    assert os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] == "7"


def test_unwritable_home_means_no_cache(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    main_module.set_up_jax()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ


ENTRY = """
import sys
from pathlib import Path
sys.argv = ["jaxlines", "--version"]
from jaxlines.edge.main import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print(sorted(name for name in ("jax", "pint", "pandas", "matplotlib", "equinox") if name in sys.modules))
"""


def test_version_loads_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", ENTRY], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    version, loaded = done.stdout.strip().splitlines()
    assert version == f"jaxlines {jaxlines.__version__}"
    assert loaded == "[]"


def test_traces_of_unused_samples_are_empty(study, tmp_path):
    times, used = np.arange(3.0), np.array([True, False, True])
    channel = ChannelFit(times, times, times, used, 1.0, 0.0, "Pa", 0.5, True)
    failure = Fit.failure(load_study(study).circuit, "", 0.0)
    write_fit(dataclasses.replace(failure, channels={"p": channel}), "a title", tmp_path)
    measured = pd.read_csv(tmp_path / "traces.csv")["p measured [Pa]"]
    np.testing.assert_array_equal(measured, [0.0, np.nan, 2.0])
    assert json.loads((tmp_path / "result.json").read_text())["title"] == "a title"
