"""`jaxlines new`: columns and units are recognised, every template gives a study that reads, simulates and fits."""

import contextlib
import json

import numpy as np
import pandas as pd
import pytest
import typer
from typer.testing import CliRunner

from jaxlines.edge.building import StudyError
from jaxlines.edge.column_roles import find_columns, find_time
from jaxlines.edge.formats import read_columns
from jaxlines.edge.new_commands import add_commands
from jaxlines.edge.proposing import TEMPLATES, propose_study
from jaxlines.edge.study import load_study
from jaxlines.edge.sweep_study import load_sweep

ATMOSPHERE = 101325.0
TIMES = np.arange(400) * 0.01
RAMP = np.clip(TIMES - 0.5, 0.0, 2.0)


def compression():
    """Chamber of 0.8 L with a constant modulus of 1.6 GPa: p = p0 + K ln(V0/(V0 - V))."""
    displaced = 1e-5 * RAMP
    pressure = ATMOSPHERE + 1.6e9 * np.log(8e-4 / (8e-4 - displaced))
    return pd.DataFrame({"time [s]": TIMES, "V [mL]": displaced * 1e6, "p [bar_a]": pressure / 1e5})


def dead_end():
    """Rigid volume of 1 L with a constant modulus of 1.4 GPa, flow in and out of it, in a German file."""
    flow = 2e-5 * (np.sin(TIMES) + 0.2)
    pressure = 2e6 + 1.4e9 / 1e-3 * 2e-5 * (1.0 - np.cos(TIMES) + 0.2 * TIMES)
    return pd.DataFrame(
        {"Zeit_ms": TIMES * 1e3, "Leitungsdruck": pressure / 1e5 - 1.01325, "Durchfluss [l/min]": flow * 6e4}
    )


def valve():
    """A line behind a valve: pressure rises and falls with the command."""
    spool = 0.3 * np.sin(2.0 * TIMES)
    pressure = 8e6 + 3e6 * (1.0 - np.cos(2.0 * TIMES))
    return pd.DataFrame(
        {"t [s]": TIMES, "u_spool [V]": 10 * spool, "pA (bar)": pressure / 1e5, "p_supply (bar)": 210.0 + spool}
    )


def cylinder():
    """A cylinder to and fro."""
    return pd.DataFrame(
        {"t": TIMES, "spool [%]": 20 * np.sin(3 * TIMES), "p_A [bar]": 90 + 9 * np.sin(3 * TIMES),
         "p_B [bar]": 90 - 9 * np.sin(3 * TIMES), "x [mm]": 120 - 60 * np.cos(3 * TIMES)}
    )  # fmt: skip


def accumulator():
    """Polytropic gas, 3 L at 120 bar, into which oil is pressed: p V^1.2 constant."""
    fed = 5e-4 * RAMP
    pressure = 120e5 * (3e-3 / (3e-3 - fed)) ** 1.2
    return pd.DataFrame({"t [s]": TIMES, "p_acc [bar_a]": pressure / 1e5, "Q [L/min]": np.gradient(fed, TIMES) * 6e4})


def long_pipe():
    """Lossless dead-ended pipe of 20 m at 1200 m/s: p_out(t) = 2 sum (-1)^k p_in(t - (2k + 1) T)."""
    delay, times = 20.0 / 1200.0, TIMES / 5.0

    def wave(t):
        return 1e6 * np.exp(-(((t - 0.2) / 0.03) ** 2))

    outlet = sum(2.0 * (-1.0) ** k * wave(times - (2 * k + 1) * delay) for k in range(120))
    outlet += 1e4 * np.random.default_rng(5).standard_normal(TIMES.size)
    return pd.DataFrame({"t [s]": times, "p_in [MPa_a]": 5 + wave(times) / 1e6, "p_out [MPa_a]": 5 + outlet / 1e6})


MADE = {
    "compression": compression, "dead-end": dead_end, "valve": valve, "cylinder": cylinder,
    "accumulator": accumulator, "long-pipe": long_pipe,
}  # fmt: skip
CHANNELS = {
    "compression": {"A.pressure": "p [bar_a]", "flow": ["V [mL]", "mL", "rate"]},
    "dead-end": {"A.pressure": ["Leitungsdruck", "bar_g"], "flow": ["Durchfluss [l/min]", "L/min"]},
    "valve": {"A.pressure": ["pA (bar)", "bar_g"], "spool": ["u_spool [V]", "10 %"],
              "supply": ["p_supply (bar)", "bar_g"]},
    "cylinder": {
        "A.pressure": ["p_A [bar]", "bar_g"], "B.pressure": ["p_B [bar]", "bar_g"],
        "spool": "spool [%]", "piston": "x [mm]",
    },
    "accumulator": {"A.pressure": "p_acc [bar_a]", "flow": "Q [L/min]"},
    "long-pipe": {"inlet": "p_in [MPa_a]", "outlet.pressure": "p_out [MPa_a]"},
}  # fmt: skip


def test_every_template_is_tried():
    assert set(MADE) == set(TEMPLATES) == set(CHANNELS)


def written(folder, name):
    path = folder / f"{name}.csv"
    german = name == "dead-end"
    MADE[name]().to_csv(path, index=False, sep=";" if german else ",", decimal="," if german else ".")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("new")


def proposed(folder, name):
    """A proposal for a recording, written beside it, and the study that is read from it."""
    found = propose_study(written(folder, name), base=folder)
    path = folder / f"{name}.toml"
    path.write_text(found.text, encoding="utf-8")
    return found, load_study(path)


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_chosen_and_can_be_read(folder, name):
    found, study = proposed(folder, name)
    assert found.template == name
    import tomllib

    content = tomllib.loads(found.text)
    assert content["recording"]["channels"] == CHANNELS[name]
    assert content["recording"]["file"] == f"{name}.csv"
    assert study.recording is not None and study.recording.times.size == 400
    np.testing.assert_allclose(study.recording.times, TIMES / 5 if name == "long-pipe" else TIMES, atol=1e-12)
    assert study.free and max(len(line) for line in found.text.splitlines()) < 240
    assert "CHECK" in found.text
    swept = load_sweep(folder / f"{name}.toml")
    assert swept.count == 512 and "peak" in swept.plan.model.reductions


def test_doubts_are_named(folder):
    found, _ = proposed(folder, "dead-end")
    assert any("A.pressure: the file states no unit: bar is a guess" in doubt for doubt in found.doubts)
    found, _ = proposed(folder, "cylinder")
    assert any("gauge (_g) or absolute (_a)?" in doubt for doubt in found.doubts)
    found, _ = proposed(folder, "valve")
    assert any("10 V is taken as a full command" in doubt for doubt in found.doubts)
    assert not proposed(folder, "long-pipe")[0].doubts


def test_a_piston_of_which_the_travel_is_recorded(tmp_path):
    frame = compression()
    frame["x [cm]"] = frame.pop("V [mL]") / 1.0  # of 1 cm^2: one mL a cm
    frame.to_csv(tmp_path / "press.csv", index=False)
    found = propose_study(tmp_path / "press.csv", base=tmp_path)
    assert found.template == "compression" and '"flow" = ["x [cm]", "10000 mm^3", "rate"]' in found.text
    assert any("a piston area of 1000 mm^2 is a guess" in doubt for doubt in found.doubts)


def test_moduli_of_a_compression_test_come_straight_from_the_recording(folder):
    text = proposed(folder, "compression")[0].text
    lines = [line for line in text.splitlines() if "modulus" in line and "GPa" in line and line.startswith("# ")]
    volume = load_study(folder / "compression.toml").circuit["chamber.parts.0.volume"]
    secant = float(lines[0].split()[-2])
    displaced = 2e-5  # of 0.8 L: the closed form's secant modulus, in proportion to the volume that was guessed
    exact = 1.6e9 * np.log(8e-4 / (8e-4 - displaced)) / displaced * volume / 1e9
    assert secant == pytest.approx(exact, rel=0.01)
    assert "tangent" in lines[1] and float(lines[1].split()[-2]) > secant


def test_a_study_simulates(folder):
    """With its volume guessed from the flow, the model is near the recording before any fit."""
    _, study = proposed(folder, "dead-end")
    assert study.recording is not None
    measured, simulated = study.recording.channels["A.pressure"], study.simulate(on_recording=True)["A.pressure"]
    assert np.sqrt(np.mean((measured - simulated) ** 2)) < 0.3 * np.ptp(measured)


@pytest.mark.slow
@pytest.mark.parametrize("name", TEMPLATES)
def test_a_study_fits(folder, name):
    _, study = proposed(folder, name)
    fit = study.fit()
    assert fit.status != "failed", fit.message
    if name == "compression":  # the modulus in proportion to the guessed volume
        volume = study.circuit["chamber.parts.0.volume"]
        modulus = fit.derived["chamber.effective_bulk_modulus"].value
        assert modulus == pytest.approx(1.6e9 * volume / 8e-4, rel=0.02)
    if name == "long-pipe":
        assert fit.derived["pipe.wave_speed"].value == pytest.approx(1200.0, rel=0.02)
    if name == "accumulator":
        gas = study.circuit["accumulator.precharge_pressure"] ** (1 / 1.2) * fit.parameters["accumulator.volume"].value
        assert gas == pytest.approx(120e5 ** (1 / 1.2) * 3e-3, rel=0.02)


def columns_of(tmp_path, frame):
    frame.to_csv(tmp_path / "x.csv", index=False)
    return read_columns(tmp_path / "x.csv")


@pytest.mark.parametrize(
    ("heading", "values", "unit", "words"),
    [
        ("p", [-0.2, 50.0], "bar_g", "states no unit"),
        ("p [psi]", [0.0, 3000.0], "psi_g", ""),
        ("p [bar]", [1.01, 90.0], "bar_a", "one atmosphere"),
        ("p [bar]", [40.0, 90.0], "bar_g", "gauge (_g) or absolute (_a)?"),
        ("p [barA]", [40.0, 90.0], "bar_a", ""),
        ("Pressure", [0.0, 2.5e7], "Pa_g", "Pa is a guess"),
        ("druck", [0.0, 3000.0], "psi_g", "psi is a guess"),
    ],
)
def test_units_of_pressure(tmp_path, heading, values, unit, words):
    columns = columns_of(tmp_path, pd.DataFrame({"t": np.arange(200), heading: np.linspace(values[0], values[1], 200)}))
    (found,) = [column for column in find_columns(columns) if column.role == "pressure"]
    assert found.unit == unit and words in found.doubt
    assert bool(found.doubt) == bool(words)


def test_times(tmp_path):
    rows = np.arange(3000.0)
    assert find_time(columns_of(tmp_path, pd.DataFrame({"t": rows, "p": rows})))[0] == ["t", "ms"]
    assert find_time(columns_of(tmp_path, pd.DataFrame({"Time": rows * 1e-3, "p": rows})))[0] == ["Time", "s"]
    spec, times, doubt = find_time(columns_of(tmp_path, pd.DataFrame({"p": rows, "q": rows})))
    assert spec == ["#", "1 ms"] and times[-1] == pytest.approx(2.999) and "the file has no time" in doubt
    assert find_time(columns_of(tmp_path, pd.DataFrame({"p": rows, "q": rows})), "2 ms")[0] == ["#", "2 ms"]
    stamps = pd.date_range("2026-01-05 09:00", periods=rows.size, freq="ms")
    spec, times, _ = find_time(
        columns_of(tmp_path, pd.DataFrame({"Date": stamps.strftime("%d.%m.%Y %H:%M:%S.%f"), "p": rows}))
    )
    assert spec == ["Date", "timestamp %d.%m.%Y %H:%M:%S.%f"] and times[-1] == pytest.approx(2.999)


@contextlib.contextmanager
def plain_errors(_):
    try:
        yield
    except (ValueError, OSError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None


app = typer.Typer()
add_commands(app, plain_errors)


def run(*arguments):
    return CliRunner().invoke(app, [str(word) for word in arguments])


def test_the_command(folder, tmp_path):
    recording, study = written(folder, "valve"), tmp_path / "study.toml"
    done = run("new", study, "--from", recording)
    assert done.exit_code == 0, done.output
    assert f"wrote {study}: valve, a line filled" in done.stdout and f"next: jaxlines check {study}" in done.stdout
    assert load_study(study).recording is not None  # from another folder than the recording's
    again = run("new", study, "--from", recording)
    assert again.exit_code == 2 and "is there already: give another name, or --force" in again.stderr
    forced = run("new", study, "--from", recording, "--force", "--template", "dead-end")
    assert forced.exit_code == 0 and "wrote" in forced.stdout


def test_what_must_be_mended_first_is_said(tmp_path):
    rows = [f"{i % 20},{5 + i % 3}" for i in range(40)]
    (tmp_path / "two.csv").write_text("\n".join(["t [s],PS1 [bar_g]", *rows]))
    done = run("new", tmp_path / "s.toml", "--from", tmp_path / "two.csv")
    assert done.exit_code == 0 and "FIRST recording: " in done.stdout
    assert (
        "does not increase in data row 21 (19 s, then 0 s): are rows out of order, or two runs in one file?"
        in done.stdout
    )


@pytest.mark.parametrize(
    ("content", "arguments", "words"),
    [
        ("a [V],b [V]\n" + "1,2\n" * 20, (), "no column of a pressure found among 'a [V]', 'b [V]': name its unit"),
        ("t [s],p [bar_g]\n" + "1,2\n" * 20, ("--template", "cylinder"), "template 'cylinder' needs more columns than"),
        (
            "t [s],p [bar_g]\n" + "1,2\n" * 20,
            ("--template", "cyl"),
            "unknown template 'cyl'; known: compression, dead-",
        ),
        ("", (), "the file is empty"),
        (None, (), "no such file"),
    ],
)
def test_what_cannot_be_proposed(tmp_path, content, arguments, words):
    path = tmp_path / "x.csv"
    if content is not None:
        path.write_text(content)
    done = run("new", tmp_path / "s.toml", "--from", path, *arguments)
    assert done.exit_code == 2 and words in done.stderr
    assert not (tmp_path / "s.toml").exists()


def test_a_template_that_is_unknown_names_the_known(folder):
    with pytest.raises(StudyError, match=f"known: {', '.join(TEMPLATES)}"):
        propose_study(written(folder, "valve"), template="cyl")


def test_json_of_specs_is_toml():
    assert json.dumps(["a", "µ"], ensure_ascii=False) == '["a", "µ"]'
