"""Recordings from files: SI and absolute pressure, oddities noted, and every kind of bad file refused clearly."""

import numpy as np
import pandas as pd
import pytest

from jaxlines.edge.reading import read_recording

TIME, CHANNELS = "t [s]", {"A.pressure": "p [bar_g]", "flow": "q [L/min]"}


def table(samples=200):
    times = np.arange(samples) * 0.01
    return pd.DataFrame({"t [s]": times, "p [bar_g]": 10 + np.sin(40 * times), "q [L/min]": 6 * np.cos(7 * times)})


def written(folder, frame, suffix=".csv"):
    path = folder / f"run{suffix}"
    (frame.to_csv if suffix == ".csv" else frame.to_parquet)(path, index=False)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_values_become_si_and_absolute(tmp_path, suffix):
    frame = table()
    recording = read_recording(written(tmp_path, frame, suffix), time=TIME, channels=CHANNELS, atmospheric_pressure=9e4)
    np.testing.assert_allclose(recording.times, frame["t [s]"])
    np.testing.assert_allclose(recording.channels["A.pressure"], frame["p [bar_g]"] * 1e5 + 9e4)
    np.testing.assert_allclose(recording.channels["flow"], frame["q [L/min]"] / 6e4)
    assert recording.warnings == ()
    assert recording.name == f"run{suffix}"


def test_unit_apart_from_the_name_and_other_units(tmp_path):
    frame = table().rename(columns={"t [s]": "t", "p [bar_g]": "p", "q [L/min]": "spool"})
    frame["t"] *= 1e3
    channels = {"A.pressure": ("p", "psi_a"), "spool": ("spool", "%")}
    recording = read_recording(written(tmp_path, frame), time=("t", "ms"), channels=channels, name="test 27")
    np.testing.assert_allclose(recording.times, frame["t"] / 1e3)
    np.testing.assert_allclose(recording.channels["A.pressure"], frame["p"] * 6894.757293168, rtol=1e-9)
    np.testing.assert_allclose(recording.channels["spool"], frame["spool"] / 100)
    assert recording.name == "test 27"


def test_missing_samples_are_masked_and_noted(tmp_path):
    frame = table()
    frame.loc[3:6, "p [bar_g]"] = np.nan
    recording = read_recording(written(tmp_path, frame), time=TIME, channels=CHANNELS)
    assert np.flatnonzero(~recording.mask["A.pressure"]).tolist() == [3, 4, 5, 6]
    assert recording.mask["flow"].all()
    assert "4 of 200 samples are missing" in recording.warnings[0]


def shaken(change):
    frame = table()
    change(frame)
    return frame


def clip(frame):
    frame["p [bar_g]"] = frame["p [bar_g]"].clip(upper=10.8)


def gap(frame):
    frame.loc[100:, "t [s]"] += 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (gap, "time: gap of 0.51 s after 0.99 s"),
        (lambda f: f.update({"q [L/min]": np.full(200, 2.0)}), "flow (q [L/min]): constant at 2 L/min"),
        (clip, "sit exactly at the highest value 1.18132 MPa: clipped?"),
        (lambda f: f.update({"p [bar_g]": f["p [bar_g]"] * 500}), "is it kPa or psi, not bar?"),
        (lambda f: f.update({"t [s]": f["t [s]"] * 1000.0}), "the usual step is 10 s: are these milliseconds?"),
    ],
)
def test_oddities_are_noted(tmp_path, change, words):
    recording = read_recording(written(tmp_path, shaken(change)), time=TIME, channels=CHANNELS)
    assert len(recording.warnings) == 1
    assert words in recording.warnings[0]


def swap(frame):
    frame.loc[5, "t [s]"], frame.loc[6, "t [s]"] = frame.loc[6, "t [s]"], frame.loc[5, "t [s]"]


def words(column, cell):
    def change(frame):
        frame[column] = frame[column].astype(object)
        frame.loc[4, column] = cell

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (swap, r"time column 't \[s\]' does not increase in data row 7 .*out of order"),
        (lambda f: f.update({"t [s]": f["t [s]"].round(1)}), "does not increase in data row 2 .*rounded too far"),
        (lambda f: f.loc.__setitem__((2, "t [s]"), np.nan), "empty or not finite in data row 3"),
        (lambda f: f.update({"p [bar_g]": f["p [bar_g]"] - 20}), "absolute pressure falls to .* below zero"),
        (lambda f: f.__setitem__("p [bar_g]", np.nan), r"column 'p \[bar_g\]' has no number in it"),
        (words("p [bar_g]", "10,5"), "data row 5: '10,5' is no number: decimals take a point"),
        (words("q [L/min]", "high"), "data row 5: 'high' is no number"),
    ],
)
def test_bad_values_are_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_recording(written(tmp_path, shaken(change)), time=TIME, channels=CHANNELS)


@pytest.mark.parametrize(
    ("time", "channels", "message"),
    [
        ("t", CHANNELS, "run.csv: time: column 't' has no unit: use a name with its unit in brackets"),
        ("time [s]", CHANNELS, r"run.csv: no column 'time \[s\]'; the file has 't \[s\]'"),
        (TIME, {"A.pressure": ("p [bar_g]", "bar")}, r"write bar_a \(absolute\) or bar_g \(gauge\)"),
        (TIME, {"A.pressure": "p [bar]"}, r"no column 'p \[bar\]'; the file has 'p \[bar_g\]'"),
        (TIME, {"A.pressure": ("p [bar_g]", "barg")}, "unknown unit 'barg'"),
        (TIME, {"A.pressure": 3}, "A.pressure: column 3 has no unit"),
        (("t [s]", "mm"), CHANNELS, "unit 'mm' does not measure what is asked for, which is in s"),
    ],
)
def test_bad_columns_are_refused(tmp_path, time, channels, message):
    with pytest.raises(ValueError, match=message):
        read_recording(written(tmp_path, table()), time=time, channels=channels)


def resting(level, unit):
    """A line that rests, vented, for a second and is then pressed to 60 bar; read in a unit."""
    frame = table().rename(columns={"p [bar_g]": "p"})
    frame["p"] = level + np.where(frame["t [s]"] < 1.0, 0.001 * np.sin(400 * frame["t [s]"]), 60 * frame["t [s]"])
    return frame, {"A.pressure": ("p", unit)}


@pytest.mark.parametrize(
    ("level", "unit", "words"),
    [
        (
            1.013,
            "bar_g",
            "starts one atmosphere above gauge zero, where a vented line read in absolute pressure would be",
        ),
        (0.01, "bar_a", "bar absolute, near vacuum, where a vented line in gauge pressure would be: is it bar_g?"),
        (1.013, "bar_a", None),
        (0.01, "bar_g", None),
    ],
)
def test_gauge_for_absolute_and_the_other_way_round(tmp_path, level, unit, words):
    frame, channels = resting(level, unit)
    recording = read_recording(written(tmp_path, frame), time=TIME, channels=channels)
    assert len(recording.warnings) == bool(words)
    assert words is None or words in recording.warnings[0]


def test_a_unit_with_a_number_is_what_one_in_the_file_means(tmp_path):
    frame = table().rename(columns={"p [bar_g]": "u1 [V]"})
    recording = read_recording(written(tmp_path, frame), time=TIME, channels={"A.pressure": ("u1 [V]", "40 bar_g")})
    np.testing.assert_allclose(recording.channels["A.pressure"], frame["u1 [V]"] * 40e5 + 101325.0)
    assert not [warning for warning in recording.warnings if "the file says" in warning]


def test_headings_that_say_otherwise(tmp_path):
    path = written(tmp_path, table())
    recording = read_recording(path, time=TIME, channels={"A.pressure": ("p [bar_g]", "psi_g")})
    assert recording.warnings == ("A.pressure (p [bar_g]): the file says bar_g, it is read in psi_g",)
    recording = read_recording(path, time=TIME, channels={"A.pressure": ("p [bar_g]", "bar_a")})
    assert recording.warnings == ("A.pressure (p [bar_g]): the file says bar_g, it is read as bar_a",)
    with pytest.raises(ValueError, match=r"'q \[L/min\]' is in L/min by its heading, .* are columns swapped\?"):
        read_recording(path, time=TIME, channels={"A.pressure": ("q [L/min]", "bar_g")})


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (("#", "1 mm"), "time from row numbers, .*: unit 'mm' does not measure"),
        (("t [s]", "s", "each 1 ms"), "the third word of the time can be \"every 10 ms\", got 'each 1 ms'"),
        (("t [s]", "s", "every 1 mm"), "unit 'mm' does not measure"),
        (("t [s]", "s", "every 1 s"), "a step of 1 s makes 2 samples"),
        (("t [s]", "timestamp"), "is no time stamp in a known format: say how it is written"),
    ],
)
def test_bad_times(tmp_path, time, message):
    with pytest.raises(ValueError, match=message):
        read_recording(written(tmp_path, table()), time=time, channels=CHANNELS)


def test_the_unit_that_a_channel_must_have(tmp_path):
    with pytest.raises(ValueError, match=r"column 'q \[L/min\]': unit 'L/min' does not measure .* in Pa"):
        read_recording(written(tmp_path, table()), time=TIME, channels={"q": "q [L/min]"}, units={"q": "Pa"})


def test_negative_absolute_pressure_asks_for_gauge(tmp_path):
    frame = table().rename(columns={"p [bar_g]": "p [bar_a]"})
    frame["p [bar_a]"] -= 10
    with pytest.raises(ValueError, match=r"is it gauge \(bar_g\)\?"):
        read_recording(written(tmp_path, frame), time=TIME, channels={"A.pressure": "p [bar_a]"})


@pytest.mark.parametrize(
    ("name", "content", "error", "message"),
    [
        ("gone.csv", None, FileNotFoundError, "gone.csv: no such file"),
        ("empty.csv", "", ValueError, "empty.csv: the file is empty"),
        ("blank.csv", "\n\n", ValueError, "blank.csv: cannot be read as csv"),
        ("run.xlsx", "t\n1\n", ValueError, "run.xlsx: recordings are read from .csv, .* files, not '.xlsx'"),
        ("bytes.csv", "a\0b,c\n1,2\n", ValueError, "bytes.csv: is not a text file, although its name ends like one"),
        ("run.parquet", "no parquet", ValueError, "run.parquet: cannot be read as parquet"),
        ("ragged.csv", "t [s],p\n1,2\n1,2,3,4\n", ValueError, "ragged.csv: cannot be read as csv"),
        ("few.csv", "t [s],p [bar_g],q [L/min]\n0,1,1\n1,1,1\n", ValueError, "2 samples; a recording needs 10 or more"),
        ("semi.csv", "t [s];p [bar_g]\n0;1\n", ValueError, r"no column 'q \[L/min\]'|1 samples; a recording needs 10"),
        (
            "twice.csv",
            "t [s],t [s]\n0,1\n",
            ValueError,
            r"column 't \[s\]' is there more than once: rename one of them",
        ),
    ],
)
def test_bad_files_are_refused(tmp_path, name, content, error, message):
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(error, match=message):
        read_recording(path, time=TIME, channels=CHANNELS)
