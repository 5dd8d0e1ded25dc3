"""What people get wrong: every mistake ends with code 2 and one line that names file, place and remedy."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxlines
import jaxlines.edge.study
from jaxlines.edge.commands import run

EXAMPLES = Path(jaxlines.__file__).parent / "examples"
TEXT = (EXAMPLES / "control-line.toml").read_text(encoding="utf-8")
TABLE = pd.read_csv(EXAMPLES / "control-line.csv")[:60]
TIME, PRESSURE, FLOW = TABLE.columns
HEADINGS = ",".join(TABLE.columns)
LEAK = 'path = "leak.conductance"\nbounds = ["0 m^3/(s*Pa)", "2e-11 m^3/(s*Pa)"]'
RESERVOIR = "[circuit.reservoir]"
CHANNELS = 'channels = { "A.pressure" = "p_line [bar_g]", flow = "q_valve [L/min]" }'


def between(start: str, stop: str) -> str:
    """A piece of the example."""
    return TEXT[TEXT.index(start) : TEXT.index(stop)]


def source(node: str) -> str:
    """A pressure source at a node, before the reservoir."""
    return f'[circuit.supply]\ntype = "PressureSource"\nnode = "{node}"\npressure = "3 bar_a"\n{RESERVOIR}'


IN_STUDY = [
    (("conductance =", "conductanse ="), "circuit.leak: unknown key 'conductanse', did you mean 'conductance'?"),
    (("density =", "densty ="), "fluid: unknown key 'densty', did you mean 'density'?"),
    (("derived =", "derivd ="), "fit: unknown key 'derivd', did you mean 'derived'?"),
    (("[fluid]", "[fluit]"), "unknown key 'fluit', did you mean 'fluid'?"),
    (('"FlowSource"', '"Flowsource"'), "circuit.valve: unknown type 'Flowsource', did you mean 'FlowSource'?"),
    (('"Line"', '"Hose"'), "circuit.line: unknown type 'Hose', known: Accumulator, "),
    (('"FlowSource"\nnode = "A"', '"FlowSource"\nnode = "AA"'), "node 'AA' has no capacity, so that its pressure is"),
    (('"Tank"\nnode = "tank"', '"Tank"\nnode = "tnk"'), "or a PressureSource, or correct the name"),
    (('"1.5 bar_a"', '"1.5 bar"'), "fit.free.3.start: 'bar' does not say from where it counts: write bar_a (absolute)"),
    (('"1.5 bar_a"', '"1.5 m"'), "fit.free.3.start: unit 'm' does not measure what is asked for, which is in Pa"),
    (('"2.2 GPa"', '"2.2 MPa"'), "fluid: bulk_modulus must be 1e+08..1e+11 Pa, got 2.2e+06 Pa: was it given in bar"),
    (('"20.83 m"\nparts', "20.83\nparts"), 'circuit.line.path_length: 20.83 has no unit: write it as a text such as "'),
    (('["0.6 GPa", "3 GPa"]', "[0.6e9, 3e9]"), "fit.free.0.bounds: 600000000.0 has no unit"),
    (('["0.6 GPa", "3 GPa"]', '["3 GPa", "0.6 GPa"]'), "fit.free.0 (numbers in Pa): fluid.bulk_modulus: bounds must"),
    (('"1.5 bar_a"', '"15 bar_a"'), "fit.free.3 (numbers in Pa): initial.A.pressure: start 1.5e+06 is outside its bou"),
    (('["0.001 %", "10 %"]', '["0.001 %", "150 %"]'), "fit: fluid.air_fraction: bounds must lie in 0..0.5"),
    (('path = "leak.', 'path = "leek.'), "fit.free.2: no number is called 'leek.conductance'; did you mean leak.cond"),
    (('path = "valve.gain"', 'path = "valve.gian"'), "fit.known.1: no number is called 'valve.gian'; did you mean"),
    (("line.wave_speed", "line.wavespeed"), "fit.derived: no derived number is called 'line.wavespeed'; there are li"),
    ((LEAK, 'path = "fluid.bulk_modulus"\nbounds = ["1 GPa", "2 GPa"]'), "fit: fluid.bulk_modulus is given twice"),
    ((LEAK, 'path = "valve.gain"\nbounds = [0.9, 1.1]'), "fit: valve.gain is given twice among the free and known"),
    ((RESERVOIR, source("tank")), "circuit: the pressure of node 'tank' is set by both 'supply' and 'reservoir'"),
    ((RESERVOIR, source("A")), "fit.free.3: 'A.pressure' is given by 'supply', so that it has no initial value"),
    ((between("[recording]", "[fit]"), ""), "there is nothing to fit to: add a table [recording]"),
    ((between("[[fit.free]]", "[[fit.known]]"), ""), "fit: 'free' is missing"),
    ((between("[fit]", "[simulate]"), ""), "nothing is free: add [[fit.free]] with path and bounds"),
    (("p_line [bar_g]", "p_lin [bar_g]"), "control-line.csv: no column 'p_lin [bar_g]'; the file has 'p_line [bar_g]'"),
    ((CHANNELS, CHANNELS.replace(', flow = "q_valve [L/min]"', "")), "the circuit needs a channel 'flow' as input"),
    ((CHANNELS, 'channels = ["p"]'), "recording.channels: input should be a valid table, got ['p']"),
    (('"control-line.csv"', '"line.csv"'), "line.csv: no such file (a relative path of a study counts from the study"),
    (("[fluid]", "[fluid"), "not valid TOML: Expected ']' at the end of a table declaration (at line 6, column 7)"),
]  # fmt: skip


def with_cell(column: str, cell):
    """The table with another cell in its sixth row."""
    table = TABLE.astype({column: object}) if isinstance(cell, str) else TABLE.copy()
    table.loc[5, column] = cell
    return table


IN_RECORDING = {
    "column missing": (TABLE.drop(columns=FLOW), "no column 'q_valve [L/min]'; the file has "),
    "empty": ("", "control-line.csv: the file is empty"),
    "headings only": (TABLE[:0], "0 samples; a recording needs 10 or more"),
    "missing flow": (with_cell(FLOW, np.nan), "input channel 'flow' has 1 missing samples, the first at 0.1 s"),
    "missing time": (with_cell(TIME, np.nan), "time column 't [s]' is empty or not finite in data row 6"),
    "no pressure": (TABLE.assign(**{PRESSURE: np.nan}), "column 'p_line [bar_g]' has no number in it"),
    "text": (with_cell(PRESSURE, "high"), "data row 6: 'high' is no number: leave the cell empty where the sample is"),
    "third headings": (f"{HEADINGS}\n0,1,2\nlow,high,high\n", "column 't [s]', data row 2: 'low' is no number: leave"),
    "no numbers": ("\n".join([HEADINGS, *["low,high,high"] * 12]), "data row 1: 'low' is no number: one row of head"),
    "swapped headings": (
        TABLE.assign(**{FLOW: TABLE[PRESSURE], PRESSURE: TABLE[FLOW] - 20}),
        "absolute pressure falls to -1.899e+06 Pa, below zero: is the zero of the sensor wrong?",
    ),
    "decimal commas in a file of commas": (with_cell(PRESSURE, "1,5"), "'1,5' is no number: decimals take a point, "),
    "time stamps": (TABLE.assign(**{TIME: "12:00:01.5"}), "is it a time stamp? Read it as (\"t [s]\", \"timestamp\")"),
    "one column": (TABLE.drop(columns=[PRESSURE, FLOW]), "no column 'p_line [bar_g]'; the file has 't [s]'"),
    "more cells than headings": (f"{HEADINGS}\n0,1,2\n0.1,1,2,3,4\n", "cannot be read as csv ("),
    "unsorted": (TABLE.iloc[[*range(10), 11, 10, *range(12, 60)]], "(0.22 s, then 0.2 s): are rows out of order, or"),
    "repeated": (TABLE.iloc[[*range(10), 9, *range(10, 60)]], "is the time rounded too far, or a row repeated?"),
    "constant": (TABLE.assign(**{PRESSURE: 2.0}), "'A.pressure' is constant, so that nothing can be fitted to it: is "),
}  # fmt: skip
OTHER_COLUMNS = [
    ("p_line [bar]", "column 'p_line [bar]': 'bar' does not say from where it counts: write bar_a (absolute) or bar_g"),
    ("p_line [L/min]", "column 'p_line [L/min]': unit 'L/min' does not measure what is asked for, which is in Pa"),
    ("p_line [barg]", "column 'p_line [barg]': unknown unit 'barg': write it like mm, L/min, "),
    ("p_line", "column 'p_line' has no unit: use a name with its unit in brackets"),
    ("p_line [bar_a]", "absolute pressure falls to -4500 Pa, below zero: is it gauge (bar_g)?"),
]
USAGE = [
    (["fit"], "Missing argument 'STUDY': see jaxlines fit --help"),
    (["fitt", "x.toml"], "No such command 'fitt'"),
    (["fit", "x.toml", "--outt", "y"], "No such option: --outt"),
    (["fit", "x.toml", "--out"], "Option '--out' requires an argument"),
    (["simulate", "x.toml", "y.toml"], "unexpected extra argument"),
    (["check", "nope.toml"], "nope.toml: no such file"),
    (["check", "example:controlline"], "example:controlline: no such example; there are control-line"),
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the study and a short recording to make mistakes in; a fit would be one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jaxlines.edge.study, "fit", lambda *_, **__: pytest.fail("the mistake went through"))
    Path("study.toml").write_text(TEXT, encoding="utf-8")
    TABLE.to_csv("control-line.csv", index=False)
    return tmp_path


def refused(capsys, words: str, arguments=("fit", "study.toml", "--quiet"), start: str = "study.toml: ") -> None:
    """Code 2, and one line on stderr."""
    code = run(list(arguments))
    lines = capsys.readouterr().err.splitlines()
    assert (code, len(lines)) == (2, 1), lines
    assert lines[0].startswith(f"jaxlines: {start}")
    assert words in lines[0]


@pytest.mark.parametrize(("change", "words"), IN_STUDY, ids=[words[:40] for _, words in IN_STUDY])
def test_in_a_study(folder, capsys, change, words):
    assert change[0] in TEXT
    Path("study.toml").write_text(TEXT.replace(change[0], change[1], 1), encoding="utf-8")
    refused(capsys, words)


@pytest.mark.parametrize(("content", "words"), IN_RECORDING.values(), ids=list(IN_RECORDING))
def test_in_a_recording(folder, capsys, content, words):
    text = content if isinstance(content, str) else content.to_csv(index=False)
    Path("control-line.csv").write_text(text, encoding="utf-8")
    refused(capsys, words, start="study.toml: recording")


@pytest.mark.parametrize(("column", "words"), OTHER_COLUMNS)
def test_in_a_heading(folder, capsys, column, words):
    lowest = TABLE[PRESSURE] - TABLE[PRESSURE].min() - 0.045
    TABLE.assign(**{column: lowest}).to_csv("control-line.csv", index=False)
    Path("study.toml").write_text(TEXT.replace("p_line [bar_g]", column), encoding="utf-8")
    refused(capsys, words, start="study.toml: recording: control-line.csv: ")


def test_file_of_ten_gigabytes(folder, capsys):
    with open("control-line.csv", "ab") as file:
        file.truncate(10_000_000_000)  # sparse: it takes no place
    refused(
        capsys, "10.0 GB of text is more than a fit can use: export the test alone, at the rate that it needs, or sa"
    )


SWAPPED = 'channels = { "A.pressure" = ["q_valve [L/min]", "bar_g"], flow = ["p_line [bar_g]", "L/min"] }'


def test_swapped_columns(folder, capsys):
    Path("study.toml").write_text(TEXT.replace(CHANNELS, SWAPPED), encoding="utf-8")
    refused(
        capsys, "column 'q_valve [L/min]' is in L/min by its heading, which measures flow, but A.pressure reads it in"
    )


@pytest.mark.parametrize(("arguments", "words"), USAGE)
def test_wrong_calls(folder, capsys, arguments, words):
    refused(capsys, words, arguments, start="")


def test_other_files_as_study(folder, capsys):
    refused(capsys, "is a folder, not a study file", ("fit", ".", "--quiet"), start=".: ")
    refused(capsys, "not valid TOML: ", ("fit", "control-line.csv", "--quiet"), start="control-line.csv: ")


@pytest.mark.parametrize("out", ["control-line.csv", "control-line.csv/deeper"])
def test_results_that_cannot_be_written(folder, capsys, out):
    refused(capsys, f"{out}: no folder can be made there (", ("fit", "study.toml", "--quiet", "--out", out))


def test_help_without_arguments(capsys):
    assert run([]) == 0
    assert "simulate" in capsys.readouterr().out
