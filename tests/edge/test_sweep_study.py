"""Sweeps from study files and the command line."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxlines.edge import help_texts
from jaxlines.edge.building import StudyError
from jaxlines.edge.commands import run
from jaxlines.edge.exit_codes import TOO_MANY_FAILED
from jaxlines.edge.sweep_study import load_sweep
from jaxlines.inference.distributions import Discrete, LogNormal, Normal, Truncated, Uniform
from jaxlines.inference.samplers import Grid, Morris, Rows, SobolIndices
from jaxlines.inference.sweep_store import open_store
from jaxlines.simulation.reductions import Crossing, Peak
from tests.edge.pages import Page

STUDY = """
title = "Line pumped up"
[fluid]
bulk_modulus = "1.5 GPa"
density = "850 kg/m^3"
kinematic_viscosity = "27.7 mm^2/s"
air_fraction = "0.5 %"
[circuit.line]
type = "Line"
node = "A"
path_length = "20.83 m"
parts = [{ type = "Pipe", length = "20.83 m", inner_diameter = "42.85 mm", outer_diameter = "60.32 mm", youngs_modulus = "206.84 GPa", poissons_ratio = 0.25 }]
[circuit.valve]
type = "FlowSource"
node = "A"
flow = { input = "flow" }
[circuit.leak]
type = "LaminarLeak"
a = "A"
b = "tank"
conductance = "5e-12 m^3/(s*Pa)"
[circuit.reservoir]
type = "Tank"
node = "tank"
[initial]
"A.pressure" = "2 bar_a"
[simulate]
stop = "1 s"
samples = 21
[simulate.inputs]
flow = "6 L/min"
[sweep]
count = 200
sampler = "monte_carlo"
outputs = ["A.pressure"]
quantiles = [0.05, 0.5, 0.95]
[[sweep.uncertain]]
path = "fluid.air_fraction"
log_normal = { median = "0.5 %", spread = 0.4 }
[[sweep.uncertain]]
path = "fluid.bulk_modulus"
normal = { mean = "1.5 GPa", sd = "0.1 GPa" }
within = ["1 GPa", "2 GPa"]
[[sweep.uncertain]]
path = "initial.A.pressure"
uniform = { low = "1.2 bar_a", high = "0.4 MPa_a" }
[[sweep.correlation]]
between = ["fluid.air_fraction", "fluid.bulk_modulus"]
value = -0.3
[[sweep.reduction]]
name = "peak"
type = "Peak"
output = "A.pressure"
above = ["8 bar_g", "9 MPa_a"]
[[sweep.reduction]]
type = "Crossing"
output = "A.pressure"
options = { level = "5 bar_a" }
"""  # noqa: E501


def write(folder, *changes):
    text = STUDY
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_levels_of_a_gauge_sensor_count_from_the_atmosphere(tmp_path):
    sensor = '[circuit.sensor]\ntype = "PressureSensor"\nnode = "A"\nreference = "gauge"\n[circuit.reservoir]'
    asked = 'output = "sensor"\nabove = ["8 bar_g", "9 MPa_a"]'
    crossing = 'output = "sensor"\noptions = { level = "5 bar_a" }'
    loaded = load_sweep(
        write(
            tmp_path,
            ("[circuit.reservoir]", sensor),
            ('output = "A.pressure"\nabove = ["8 bar_g", "9 MPa_a"]', asked),
            ('output = "A.pressure"\noptions = { level = "5 bar_a" }', crossing),
        )
    )
    assert loaded.thresholds["peak"] == pytest.approx([8e5, 9e6 - 101325.0])
    assert loaded.plan.model.reductions["Crossing sensor"] == Crossing("sensor", 5e5 - 101325.0)


def test_a_study_says_all_of_a_sweep_in_units(tmp_path):
    loaded = load_sweep(write(tmp_path))
    uncertain = loaded.plan.uncertain
    assert uncertain.single["fluid.air_fraction"] == LogNormal(0.005, 0.4)
    assert uncertain.single["fluid.bulk_modulus"] == Truncated(Normal(1.5e9, 1e8), 1e9, 2e9)
    low = uncertain.single["initial.A.pressure"]
    assert isinstance(low, Uniform)
    assert (low.low, low.high) == pytest.approx((1.2e5, 4e5))
    assert uncertain.correlation == {("fluid.air_fraction", "fluid.bulk_modulus"): -0.3}
    assert loaded.thresholds["peak"] == pytest.approx([901325.0, 9e6])
    assert loaded.plan.model.reductions == {
        "peak": Peak("A.pressure"),
        "Crossing A.pressure": Crossing("A.pressure", 5e5),
    }
    assert loaded.count == 200
    assert load_sweep(write(tmp_path), 77).count == 77
    assert loaded.plan.hash() == load_sweep(write(tmp_path), 77).plan.hash()


def test_samplers_and_tables_of_cases(tmp_path):
    one = STUDY[STUDY.index("[[sweep.correlation]]") : STUDY.index("[[sweep.reduction]]")]
    plain = (one, "")
    indices = load_sweep(write(tmp_path, plain, ('"monte_carlo"', '"sobol_indices"\nsecond_order = true')), 16)
    assert indices.plan.sampler == SobolIndices(0, second_order=True)
    assert load_sweep(write(tmp_path, plain, ('"monte_carlo"', '"morris"\nseed = 3')), 16).plan.sampler == Morris(3)
    levels = ("within =", "levels = 4\nwithin ="), ("uniform = {", "levels = 2\nuniform = {")
    values = ('log_normal = { median = "0.5 %", spread = 0.4 }', 'discrete = { values = ["0.1 %", "1 %"] }')
    grid = load_sweep(write(tmp_path, plain, ('"monte_carlo"', '"grid"'), ("count = 200", ""), values, *levels))
    assert grid.plan.sampler == Grid((2, 4, 2))
    assert grid.plan.uncertain.single["fluid.air_fraction"] == Discrete((0.001, 0.01))
    (tmp_path / "cases.csv").write_text("air [%],p0 [bar_g]\n0.1,1\n1,2\n")
    start, stop = STUDY.index("[[sweep.uncertain]]"), STUDY.index("[[sweep.reduction]]")
    columns = '{ "fluid.air_fraction" = "air [%]", "initial.A.pressure" = "p0 [bar_g]" }'
    cases = f'[sweep.cases]\nfile = "cases.csv"\ncolumns = {columns}\n'
    table = load_sweep(write(tmp_path, (STUDY[start:stop], cases), ("count = 200", "")))
    assert table.plan.sampler == Rows(2)
    assert np.allclose(table.plan.samples(0, 2), [[0.001, 201325.0], [0.01, 301325.0]])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ([('air_fraction"\nlog', 'air_fractoin"\nlog')], "uncertain.0: no number is called 'fluid.air_fractoin'"),
        ([('sd = "0.1 GPa"', 'sd = "-0.1 GPa"')], "sweep.uncertain.1: Normal: mean must be finite and sd positive"),
        ([("count = 200", "count = 1000000000")], "a sweep has 100,000,000 lanes at most"),
        ([("spread = 0.4", "spraed = 0.4")], "uncertain.0.log_normal: unknown key 'spraed'"),
        ([('normal = { mean = "1.5 GPa", sd', 'normal = { sd')], "sweep.uncertain.1.normal: 'mean' is missing"),
        ([("outputs = [\"A.p", "otputs = [\"A.p")], "sweep: unknown key 'otputs', did you mean 'outputs'"),
        ([("type = \"Peak\"", "type = \"Peek\"")], "sweep.reduction.0: unknown type 'Peek', did you mean 'Peak'"),
        ([('"8 bar_g"', '"8 bar"')], "sweep.reduction.0.above: .*absolute"),
        ([("[[sweep.correlation]]", "[sweep.correlation]")], r"sweep.correlation: write \[\[sweep.correlation\]\]"),
        ([("value = -0.3", "value = -1.3")], "sweep.correlation.0.value"),
        ([('sampler = "monte_carlo"', 'sampler = "sobol_indices"')], "SobolIndices needs independent numbers"),
        ([("within = [", "uniform = { low = 1, high = 2 }\nwithin = [")], "got normal, uniform"),
        ([('within = ["1 GPa", "2 GPa"]', ""), ('sd = "0.1', 'sd = "0.5')], "its distribution reaches -1.499e"),
        ([("[sweep]\n", "[seep]\n")], "unknown key 'seep'|nothing to sweep"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line_with_their_place(tmp_path, changes, text):
    path = write(tmp_path, *changes)
    with pytest.raises(StudyError, match=text) as caught:
        load_sweep(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept")
    code = run(["sweep", str(write(folder)), "--out", str(folder / "out"), "--quiet"])
    return folder, code


def test_the_command_runs_and_writes(swept, capsys):
    folder, code = swept
    store = open_store(folder / "out")
    assert code == 0
    files = {f"HASH/{path.name}" for path in store.folder.iterdir()}
    assert set(help_texts.COLLECT.files) <= files
    summary = json.loads((store.folder / "summary.json").read_text())
    assert summary["count"] == 200
    assert [q["probability"] for q in summary["reductions"]["peak"]["quantiles"]] == [0.05, 0.5, 0.95]
    assert len(summary["reductions"]["peak"]["exceedances"]) == 2
    report = (store.folder / "report.html").read_text()
    assert report.count("<svg") >= 8
    for piece in ("Line pumped up", "Worst lanes", "LogNormal", "What causes the spread", store.content["hash"]):
        assert piece in report
    assert Page(report).outside == []
    before = (store.folder / "table.parquet").read_bytes()
    assert run(["sweep", "status", str(folder / "out")]) == 0
    shown = capsys.readouterr().out
    assert "Line pumped up" in shown
    assert "done: 200 lanes" in shown
    assert run(["sweep", "collect", str(folder / "out")]) == 0
    assert (store.folder / "table.parquet").read_bytes() == before
    assert "5 %" in capsys.readouterr().out


def test_the_command_wants_resume_and_refuses_another_plan(swept, capsys):
    folder, _ = swept
    command = ["sweep", str(folder / "study.toml"), "--out", str(folder / "out"), "--quiet"]
    assert run(command) == 2
    assert "resume it" in capsys.readouterr().err
    (folder / "other").mkdir(exist_ok=True)
    other = write(folder / "other", ("spread = 0.4", "spread = 0.5"))
    assert run(["sweep", str(other), "--out", str(folder / "out"), "--quiet", "--resume"]) == 2
    assert "spread: 0.4 -> 0.5" in capsys.readouterr().err
    assert run([*command, "--resume", "--count", "300", "--max-failed", "-1"]) == TOO_MANY_FAILED
    assert "300 lanes" in capsys.readouterr().out
    assert run([*command, "--shard", "3"]) == 2
    assert "--shard must be I/N" in capsys.readouterr().err
    assert run(["sweep", "status", str(folder / "nowhere")]) == 2


@pytest.mark.slow
def test_an_interrupted_command_leaves_a_store_to_resume(tmp_path):
    out = tmp_path / "out"
    line = [sys.executable, "-m", "jaxlines.edge.main", "sweep", str(write(tmp_path)), "--out", str(out)]
    options = ["--count", "200000", "--chunk", "512"]
    with subprocess.Popen([*line, *options], stderr=subprocess.PIPE, text=True, env=os.environ) as process:
        while not list(out.glob("*/chunks/0*.parquet")):
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in said
    done = sum(piece.stop - piece.start for piece in open_store(out).done())
    assert 0 < done < 200_000
    code = subprocess.run([*line, "--resume", "--count", str(done + 512), "--quiet"], check=False).returncode
    assert code == 0
