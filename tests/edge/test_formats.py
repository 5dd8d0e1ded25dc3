"""The same recording in every format and layout gives the same numbers; resampling lets nothing be folded down."""

import numpy as np
import pandas as pd
import pytest

from jaxlines.edge.csv_layout import find_layout
from jaxlines.edge.formats import read_columns
from jaxlines.edge.reading import read_recording
from jaxlines.edge.resampling import resample
from jaxlines.edge.unit_words import heading_parts, kind_of, unit_of
from jaxlines.inference.recording import Recording

ROWS = 40
TIMES = np.arange(ROWS) * 0.25
PRESSURE = np.round(12.0 + 2.5 * np.sin(TIMES), 3)
FLOW = np.round(1.5 * np.cos(TIMES), 3)
EXPECTED = PRESSURE * 1e5 + 101325.0


def text(path, rows, encoding="utf-8"):
    path.write_text("\n".join(rows) + "\n", encoding=encoding)
    return path


def rows(delimiter=",", decimal=".", times=None):
    cells = zip(TIMES if times is None else times, PRESSURE, FLOW, strict=True)
    return [delimiter.join(str(cell).replace(".", decimal) if not isinstance(cell, str) else cell for cell in row)
            for row in cells]  # fmt: skip


STAMPS = [str(stamp) for stamp in pd.Timestamp("2026-03-04T23:59:58") + pd.to_timedelta(TIMES, unit="s")]
LAYOUTS = {
    "semicolons, decimal commas": (["t;p;q", *rows(";", ",")], ("t", "s")),
    "tabs": (["t\tp\tq", *rows("\t")], ("t", "s")),
    "white space": (["t p q", *rows("   ")], ("t", "s")),
    "row of units": (["t,p,q", "s,bar,L/min", *rows()], ("t", "s")),
    "row of units in brackets, semicolons": (["t;p;q", "[s];[bar];[l/min]", *rows(";", ",")], ("t", "s")),
    "description above": (["Test bench 4", "Operator: K. M.", "", "t,p,q", *rows()], ("t", "s")),
    "quoted decimal commas": (["t,p,q", *[f'"{r}"' for r in rows('","', ",")]], ("t", "s")),
    "trailing delimiter": (["t;p;q;", *[f"{r};" for r in rows(";", ",")]], ("t", "s")),
    "ISO time stamps": (["t,p,q", *rows(times=STAMPS)], ("t", "timestamp")),
    "German time stamps": (
        ["t;p;q", *rows(";", ",", [pd.Timestamp(s).strftime("%d.%m.%Y %H:%M:%S.%f") for s in STAMPS])],
        ("t", "timestamp"),
    ),
    "clock times": (["t,p,q", *rows(times=[f"00:00:{t:06.3f}" for t in TIMES])], ("t", "timestamp")),
    "American time stamps, format given": (
        ["t,p,q", *rows(times=[pd.Timestamp(s).strftime("%m/%d/%Y %H:%M:%S.%f") for s in STAMPS])],
        ("t", "timestamp %m/%d/%Y %H:%M:%S.%f"),
    ),
    "row numbers": (["p,q,t", *[f"{r.partition(',')[2]},x" for r in rows()]], ("#", "250 ms")),
}  # fmt: skip


@pytest.mark.parametrize(("lines", "time"), LAYOUTS.values(), ids=list(LAYOUTS))
def test_layouts_of_text(tmp_path, lines, time):
    channels = {"A.pressure": ("p", "bar_g"), "flow": ("q", "L/min")}
    recording = read_recording(text(tmp_path / "run.csv", lines), time=time, channels=channels)
    np.testing.assert_allclose(recording.times, TIMES, atol=1e-9)
    np.testing.assert_allclose(recording.channels["A.pressure"], EXPECTED, rtol=1e-12)
    np.testing.assert_allclose(recording.channels["flow"], FLOW / 6e4, rtol=1e-12)
    assert recording.warnings == ()


def test_other_encodings(tmp_path):
    lines = ["t [s],p [bar_g],q [L/min],T [°C]", *[f"{row},20.5" for row in rows()]]
    for encoding, words in {"latin-1": "not UTF-8", "utf-16": "", "utf-8-sig": ""}.items():
        path = text(tmp_path / "run.csv", lines, encoding)
        recording = read_recording(path, time="t [s]", channels={"A.pressure": "p [bar_g]"})
        np.testing.assert_allclose(recording.channels["A.pressure"], EXPECTED)
        assert words in " ".join(recording.warnings)


@pytest.mark.parametrize(
    ("cells", "decimal", "thousands", "doubt"),
    [
        (["0;1,5", "1;2,25"], ",", None, False),
        (["0;1.234,5", "1;1.111.222,25"], ",", ".", False),
        (["0;1,234", "1;2,345"], ",", None, True),
        (["0.5;1,234", "1.5;2,345"], ".", ",", False),
        (["0;1.5", "1;2.5"], ".", None, False),
    ],
)
def test_decimal_signs(tmp_path, cells, decimal, thousands, doubt):
    layout = find_layout(text(tmp_path / "a.csv", ["t;p", *cells * 5]))
    assert (layout.delimiter, layout.decimal, layout.thousands) == (";", decimal, thousands)
    assert bool(layout.notes) == doubt


def test_decimal_commas_far_down_a_file(tmp_path):
    assert find_layout(text(tmp_path / "a.csv", ["t;p", *[f"{i};0" for i in range(500)], "500;1,5"])).decimal == ","


def check(path, time, pressure, flow):
    recording = read_recording(path, time=time, channels={"A.pressure": (pressure, "bar_g"), "flow": (flow, "L/min")})
    np.testing.assert_allclose(recording.times, TIMES, atol=1e-12)
    np.testing.assert_allclose(recording.channels["A.pressure"], EXPECTED, rtol=1e-12)
    np.testing.assert_allclose(recording.channels["flow"], FLOW / 6e4, rtol=1e-12)
    assert recording.warnings == ()


def test_mat(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "run.mat"
    savemat(
        path, {"run": {"t": TIMES, "p": PRESSURE, "text": "bench 4"}, "q": FLOW[:, None], "both": np.c_[TIMES, FLOW]}
    )
    check(path, ("run.t", "s"), "run.p", "q")
    check(path, ("both(:,1)", "s"), "run.p", "both(:,2)")
    with pytest.raises(ValueError, match=r"run.mat: no column 'run.pp'; the file has 'run.p'"):
        check(path, ("run.t", "s"), "run.pp", "q")


def test_hdf5(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for name, values, unit in (("t", TIMES, "s"), ("a/p", PRESSURE, "bar"), ("a/q", FLOW, "l/min")):
            file[name] = values
            file[name].attrs["unit"] = unit
        file["both"] = np.c_[TIMES, FLOW]
    check(path, ("t", "s"), "a/p", "a/q")
    check(path, ("both[:,0]", "s"), "a/p", "both[:,1]")
    assert read_columns(path).units == {"t": "s", "a/p": "bar", "a/q": "l/min"}
    with pytest.raises(
        ValueError, match=r"column 'a/p' is in bar by its heading, which measures pressure, but flow rea"
    ):
        check(path, ("t", "s"), "a/p", "a/p")


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path, wave = tmp_path / "run.tdms", {"wf_increment": 0.25, "wf_start_offset": 0.0, "unit_string": "bar"}
    channels = [
        nptdms.ChannelObject("Bench", "p", PRESSURE, wave),
        nptdms.ChannelObject("Bench", "q", FLOW, wave | {"unit_string": "l/min"}),
        nptdms.ChannelObject("Slow", "T", FLOW[:20], {"wf_increment": 0.5}),
    ]
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(channels)
    check(path, ("Bench/time", "s"), "Bench/p", "Bench/q")
    both = {"A.pressure": ("Bench/p", "bar_g"), "flow": ("Slow/T", "L/min")}
    with pytest.raises(ValueError, match=r"'Slow/T' has 20 samples, the time has 40: they were sampled apart"):
        read_recording(path, time=("Bench/time", "s"), channels=both)
    recording = read_recording(path, time=("Bench/time", "s", "every 500 ms"), channels=both)
    np.testing.assert_allclose(recording.channels["flow"], FLOW[:20] / 6e4, rtol=1e-9)


def test_mdf4(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    path = tmp_path / "run.mf4"
    signals = [asammdf.Signal(v, TIMES, name=n, unit=u) for n, v, u in (("p", PRESSURE, "bar"), ("q", FLOW, "l/min"))]
    with asammdf.MDF() as mdf:
        mdf.append(signals)
        mdf.save(path, overwrite=True)
    check(path, ("time", "s"), "p", "q")
    assert read_columns(path).units == {"time": "s", "p": "bar", "q": "l/min"}


def test_a_format_without_its_library(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "nptdms", None)
    (tmp_path / "run.tdms").write_bytes(b"TDSm")
    with pytest.raises(
        ImportError, match=r'run.tdms: .tdms files need nptdms: install it with .*"jaxlines\[formats\]"'
    ):
        read_columns(tmp_path / "run.tdms")


@pytest.mark.parametrize("suffix", [".mat", ".h5", ".tdms", ".mf4", ".parquet"])
def test_damaged_files(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    path.write_bytes(b"this is no measurement")
    with pytest.raises(ValueError, match=rf"run{suffix}: cannot be read as {suffix[1:]} \("):
        read_columns(path)


def test_rate_of_a_displaced_volume(tmp_path):
    """A quadratic's central differences are its derivative exactly."""
    frame = pd.DataFrame({"t": TIMES, "V": 3.0 + 2.0 * TIMES + 0.5 * TIMES**2})
    frame.to_csv(tmp_path / "run.csv", index=False)
    recording = read_recording(tmp_path / "run.csv", time=("t", "s"), channels={"flow": ("V", "mL", "rate")})
    np.testing.assert_allclose(recording.channels["flow"][1:-1], (2.0 + TIMES[1:-1]) * 1e-6, rtol=1e-9)
    with pytest.raises(ValueError, match="the third word of a channel can be \"rate\", got 'rates'"):
        read_recording(tmp_path / "run.csv", time=("t", "s"), channels={"flow": ("V", "mL", "rates")})


def test_resampling_passes_what_is_slow_and_suppresses_what_would_fold():
    times = np.arange(0.0, 10.0, 1e-3)
    for frequency, seen in ((5.0, 1.0), (14.0, 1.0), (60.0, 0.0), (95.0, 0.0)):
        waves = {"x": 7.0 + np.sin(2 * np.pi * frequency * times)}
        found = resample(Recording(times, waves), 0.02)
        inner = (found.times > 1.0) & (found.times < 9.0)
        expected = 7.0 + seen * np.sin(2 * np.pi * frequency * found.times)
        assert np.abs(found.channels["x"] - expected)[inner].max() < (0.01 if seen else 1e-3)
        assert np.abs(found.channels["x"] - 7.0).max() < 1.3
    assert "resampled from a step of 0.001 s to 0.02 s" in found.warnings[-1]
    naive = np.sin(2 * np.pi * 60.0 * times[::20])
    assert np.abs(naive).max() > 0.9  # what taking every 20th sample would have shown


def test_resampling_keeps_gaps_and_steady_levels():
    times = np.arange(0.0, 10.0, 1e-2)
    values = np.full(times.size, 3.0)
    values[400:600] = np.nan
    found = resample(Recording(times, {"x": values}), 0.1)
    inside = (found.times > 4.2) & (found.times < 5.8)
    assert not found.mask["x"][inside].any() and found.mask["x"][~inside].sum() > 75
    np.testing.assert_allclose(found.channels["x"][found.mask["x"]], 3.0, rtol=1e-9)
    with pytest.raises(ValueError, match="a step of 5 s makes 2 samples"):
        resample(Recording(times, {"x": values}), 5.0)


def test_units_as_instruments_write_them():
    words = {
        "barg": "bar_g",
        "bar(a)": "bar_a",
        "psia": "psi_a",
        "l/min": "L/min",
        "cm³": "cm^3",
        "[s]": "s",
        "°C": "degC",
    }
    assert {word: unit_of(word) for word in words} == words
    assert [unit_of(word) for word in ("p_line", "", "hello", "7")] == [None] * 4
    assert [kind_of(unit_of(word)) for word in ("barg", "lpm", "mL", "mm", "%")] == [
        "pressure", "flow", "volume", "length", "share",
    ]  # fmt: skip
    headings = {"p_line [bar_g]": ("p_line", "bar_g"), "p (psi)": ("p", "psi"), "p, bar": ("p", "bar")}
    headings |= {"t_ms": ("t", "ms"), "p_in": ("p_in", None), "q_min": ("q_min", None), "Druck": ("Druck", None)}
    assert {heading: heading_parts(heading) for heading in headings} == headings
