"""Designs from study files and the command line."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Rectangle
from studies import write_study
from typer.testing import CliRunner

from jaxlines.edge import design_study
from jaxlines.edge.building import StudyError
from jaxlines.edge.commands import app
from jaxlines.edge.design_plots import plot_design_gain, plot_design_input, plot_design_output
from jaxlines.edge.design_study import DesignStudy, load_design
from jaxlines.edge.design_writing import profile_csv, simulate_toml
from jaxlines.edge.study import Study, load_study
from jaxlines.inference.design_inputs import Knots, Multisine, Scaled
from jaxlines.inference.design_result import Profile
from jaxlines.inference.noise import Noise
from jaxlines.inference.parameters import Known

SENSORS = """
[design]
target = "fluid.bulk_modulus"
stop = "4 s"
samples = 21
sensors = ["A.pressure", "gauge"]
noise = { gauge = "0.02 bar" }
num_sensors = 1
num_samples = 3
"""
EXCITE = """
[design]
limits = { "A.pressure" = ["1.1 bar_a", "none"] }
samples = 41
starts = 2
[[design.excite]]
input = "flow"
low = "-6 L/min"
high = "6 L/min"
knots = 6
rate = "60 L/min/s"
first = "0 L/min"
energy = "start"
"""


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    """A function: more text of the study, and pieces replaced -> the path of the study."""

    def written(more: str, *changes: tuple[str, str]):
        path = write_study(tmp_path_factory.mktemp("study"), *changes)
        path.write_text(path.read_text() + more)
        return path

    return written


def run(*arguments: str):
    """The command."""
    return CliRunner().invoke(app, ["design", *arguments])


@pytest.fixture(scope="module")
def sensors_chosen(write):
    """One of two sensors and three of 21 instants, by the command."""
    study = write(SENSORS)
    result = run(str(study), "--out", str(study.parent / "out"), "--quiet")
    assert result.exit_code == 0, result.output
    return result.output, study.parent / "out"


def test_command_shows_and_writes(sensors_chosen):
    output, folder = sensors_chosen
    assert "fluid.bulk_modulus (criterion c): standard deviation" in output and " MPa instead of " in output
    assert "measure gauge at 3 of 21 instants" in output  # a fifth of the noise of the other
    assert "sensors: exhaustive, efficiency" in output
    assert sorted(file.name for file in folder.iterdir()) == ["design.json", "readings.csv", "report.html"]
    assert f"wrote {folder / 'design.json'}, " in output
    assert "Control line, bench test" in (folder / "report.html").read_text()
    content = json.loads((folder / "design.json").read_text(), parse_constant=lambda word: pytest.fail(word))
    assert content["target_sd"] < content["target_sd_base"] and content["target_unit"] == "Pa"
    assert content["sensors"] == ["gauge"] and content["criterion"] == "c"
    assert content["improvement"] > 1.0
    assert content["parameters"][0]["unit"] == "Pa" and content["parameters"][0]["sd_before"] is None
    assert sum(content["choices"]["samples"]["counts"]) == 3
    readings = pd.read_csv(folder / "readings.csv")
    assert list(readings) == ["time [s]", "A.pressure [Pa]", "gauge [Pa]", "A.pressure readings", "gauge readings"]
    counts = readings[["A.pressure readings", "gauge readings"]].to_numpy().sum(axis=0)
    np.testing.assert_array_equal(counts, [0, 3])


def test_arguments_of_a_study(write):
    found = load_design(
        write(EXCITE, ('[[fit.free]]\npath = "initial.A.pressure"\nbounds = ["1 bar_a", "5 bar_a"]\n', ""))
    )
    flow = found.arguments["excite"][0]
    assert isinstance(flow, Knots)
    assert (flow.low, flow.high, flow.rate, flow.first) == pytest.approx((-1e-4, 1e-4, 1e-3, 0.0))
    np.testing.assert_allclose(flow.times, np.linspace(0.0, 3.98, 6))
    np.testing.assert_allclose(flow.start[1:3] * 6e4, [6.0, 6.0], atol=2e-3)  # of the recording
    assert flow.energy == pytest.approx(flow.energy_of(flow.start))
    assert found.arguments["limits"] == {"A.pressure": (pytest.approx(1.1e5), None)}
    assert found.arguments["noise"] == {"A.pressure": pytest.approx(1e4)}
    assert found.arguments["sensors"] == ["A.pressure"] and found.arguments["times"].size == 41
    assert found.arguments["initial"]["A.pressure"] == pytest.approx(2e5 + 101325.0)
    assert [k.path for k in found.arguments["known"]] == ["line.parts.0.length"]
    assert found.arguments["target"] is None and found.arguments["starts"] == 2


def test_limits_and_energy_have_units(write):
    """A gauge sensor shows 1 atm less; 60 (L/min)^2 min are 60^2/6e4^2 m^6/s."""
    found = load_design(write(EXCITE.replace('"A.pressure" =', "gauge =").replace('"start"', '"60 (L/min)^2*min"')))
    assert found.arguments["limits"]["gauge"][0] == pytest.approx(1.1e5 - 101325.0)
    assert found.arguments["excite"][0].energy == pytest.approx(60.0 / 6e4**2 * 60.0)


def test_a_measured_start_is_uncertain(write):
    free = '[[fit.free]]\npath = "initial.A.pressure"\nbounds = ["1 bar_a", "5 bar_a"]\n'
    found = load_design(write(EXCITE, (free, ""), ('"A.pressure" = "2 bar_g"', '"A.pressure" = "measured"')))
    assert Known("initial.A.pressure", 1e4) in found.arguments["known"]


def test_other_kinds_of_excitation(write):
    sines = 'kind = "multisine"\nfrequencies = ["0.5 Hz", "1 Hz"]\nstart = ["1 L/min", "2 L/min"]'
    found = load_design(write(EXCITE.replace("knots = 6", sines).replace('first = "0 L/min"\n', "")))
    one = found.arguments["excite"][0]
    assert isinstance(one, Multisine)
    np.testing.assert_allclose(one.amplitudes(one.start_coefficients), [1 / 6e4, 2 / 6e4])
    assert one.energy == pytest.approx((1 + 4) / 2 / 6e4**2 * 3.98, rel=0.02)
    scaled = load_design(write(EXCITE.replace("knots = 6", 'kind = "scaled"\nfactor = [0.5, 2.0]')), ["a"], "D")
    one = scaled.arguments["excite"][0]
    assert isinstance(one, Scaled) and (one.smallest, one.largest) == (0.5, 2.0)
    assert scaled.arguments["target"] == "a" and scaled.arguments["criterion"] == "D"


MISTAKES = [
    ("", (), "there is no test to design: add a table [design]"),
    ("[design]\nsampels = 3", (), "design: unknown key 'sampels', did you mean 'samples'? (at line "),
    (EXCITE.replace("knots =", "knot ="), (), "design.excite.0: unknown key 'knot', did you mean 'knots'? (at line "),
    (EXCITE.replace('"start"', '"2 (L/min)^2"'), (), "design.excite.0.energy: unit '(L/min)^2' does not measure"),
    (SENSORS.replace("gauge = ", "gage = "), (), "design.noise: no output is called 'gage', did you mean 'gauge'?"),
    (EXCITE.replace('"flow"', '"flwo"'), (), "design.excite.0: no input is called 'flwo', did you mean 'flow'?"),
    (EXCITE.replace('high = "6 L/min"\n', ""), (), "design.excite.0: 'high' is missing"),
    (EXCITE.replace('"6 L/min"', '"-6 L/min"'), (), "low and high must be finite and increasing"),
    (EXCITE.replace('"60 L/min/s"', '"60 L/min"'), (), "design.excite.0.rate: unit 'L/min' does not measure"),
    (EXCITE.replace("A.pressure", "B.pressure"), (), "design.limits: no output is called 'B.pressure'"),
    (EXCITE.replace('["1.1 bar_a", "none"]', '["1.1 bar", "none"]'), (), "does not say from where it counts"),
    (EXCITE, (('noise = { "A.pressure" = "0.1 bar" }\n', ""),), "design.noise: that of A.pressure is missing"),
    (EXCITE.replace("[[design.excite]]", "[design.excite]"), (), "write [[design.excite]] with two brackets"),
]


@pytest.mark.parametrize(("more", "changes", "message"), MISTAKES, ids=[text[:40] for *_, text in MISTAKES])
def test_mistakes_in_a_study(write, more, changes, message):
    study = write(more, *changes)
    with pytest.raises(StudyError) as caught:
        load_design(study)
    assert str(caught.value).startswith(str(study)) and message in str(caught.value)


def test_command_says_what_is_wrong_in_one_line(write):
    result = run(str(write(EXCITE)), "--target", "fluid.bulk_modulus", "--criterion", "G")
    assert result.exit_code == 2
    assert "design: criterion must be one of D, A, E, c, got 'G'" in result.output
    result = run(str(write(EXCITE)), "--target", "fluid.air_fraction")
    assert result.exit_code == 2 and "'fluid.air_fraction' is not free" in result.output
    result = run(str(write("\n[design]\n")))
    assert result.exit_code == 2 and "there is nothing to design" in result.output


def test_an_interrupted_design_is_one_line_and_130(write, monkeypatch):
    def stop(study, progress=None):
        raise KeyboardInterrupt

    monkeypatch.setattr(DesignStudy, "design", stop)
    result = run(str(write(SENSORS)))
    assert (result.exit_code, result.stderr) == (130, "jaxlines: interrupted\n")


def test_noise_of_a_fit_is_that_of_its_residuals(write, monkeypatch):
    """Where none is given; root mean square over the recordings."""
    asked = {}
    channels = {"A.pressure [run 1]": SimpleNamespace(sigma=1e4), "A.pressure [run 2]": SimpleNamespace(sigma=7e4)}
    fit = SimpleNamespace(status="converged", channels=channels)
    monkeypatch.setattr(Study, "fit", lambda study, progress=None: fit)
    monkeypatch.setattr(design_study, "design", lambda circuit, free, **options: asked.update(options))
    noise = ('noise = { "A.pressure" = "0.1 bar" }\n', "")
    load_design(write(SENSORS + "after_fit = true\n", noise)).design()
    assert asked["earlier"] is fit
    assert asked["noise"] == {"A.pressure": Noise(5e4), "gauge": Noise(2e3)}


@pytest.fixture(scope="module")
def with_profile(write):
    """A design of what to measure, with an input as if it had been chosen."""
    found = load_design(write(SENSORS)).design()
    times = np.array([0.0, 1.5, 4.0])
    excite = Knots("flow", times, -1e-4, 1e-4, np.array([0.0, 5e-5, 0.0]))
    energy = excite.energy_of(excite.start)
    profile = Profile(times, excite.start, 0.5 * excite.start, -1e-4, 1e-4, None, energy, energy / 4, "m^3/s")
    inputs = {"flow": excite.signal(excite.start_coefficients)}
    return dataclasses.replace(found, profiles={"flow": profile}, inputs=inputs)


def test_plots(with_profile):
    axes = plot_design_input(with_profile, "flow")
    assert axes.get_ylabel() == "flow [L/min]"
    np.testing.assert_allclose(np.asarray(axes.lines[-1].get_ydata()), [0.0, 3.0, 0.0])
    axes = plot_design_output(with_profile, "gauge")
    assert [line.get_label() for line in axes.lines] == ["starting test", "designed test", "readings"]
    assert np.size(axes.lines[-1].get_xdata()) == 3
    axes = plot_design_gain(with_profile)
    widths = [bar.get_width() for bar in axes.patches if isinstance(bar, Rectangle)]
    assert widths == pytest.approx([100.0 / row["ratio"] for row in with_profile.table() if row["ratio"] is not None])


def test_the_profile_runs_in_a_study(with_profile, write):
    """The tables that are written make the same input when they are read."""
    assert profile_csv(with_profile, "flow").splitlines()[:3] == [
        "time [s],flow [m^3/s],flow of the starting test [m^3/s]",
        "0,0,0",
        "1.5,5e-05,2.5e-05",
    ]
    tables = simulate_toml(with_profile, {})
    assert "# as before" not in tables
    more = dataclasses.replace(with_profile, inputs={**with_profile.inputs, "spool": 0.0})
    assert "[simulate.inputs]\n# as before: spool\n" in simulate_toml(more, {})
    study = write("")
    head = study.read_text().partition("[simulate]")[0]
    study.write_text(head + tables)
    loaded = load_study(study)
    assert loaded.times is not None and loaded.times.size == 21 and loaded.times[-1] == 4.0
    np.testing.assert_allclose(loaded.inputs["flow"].values, [0.0, 5e-5, 0.0])
    np.testing.assert_allclose(loaded.inputs["flow"].times, [0.0, 1.5, 4.0])


@pytest.mark.slow
def test_designed_profile_of_the_command_simulates_as_predicted(write):
    study = write(EXCITE, ('start = "2.2 GPa"\n', ""))  # designed for the number of the circuit, which is simulated
    folder = study.parent / "out"
    result = run(str(study), "--target", "fluid.bulk_modulus", "--out", str(folder))
    assert result.exit_code == 0, result.output
    content = json.loads((folder / "design.json").read_text())
    flow = content["profiles"]["flow"]
    assert content["improvement"] > 1.0 and flow["energy"] <= flow["base_energy"] * 1.001
    head = study.read_text().partition("[simulate]")[0]
    study.write_text(head + (folder / "simulate.toml").read_text())
    shown = load_study(study).simulate()
    readings = pd.read_csv(folder / "readings.csv")
    np.testing.assert_allclose(np.asarray(shown["A.pressure"]), readings["A.pressure [Pa]"], rtol=1e-5)
