"""Tables of conditions and measurements: read in their units, written and read back bit by bit, mistakes named."""

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.edge.experiment_tables import (
    read_conditions,
    read_measurements,
    read_recordings,
    write_conditions,
    write_measurements,
)

CONDITIONS = """name,file,line.volume [L],fluid.bulk_modulus [GPa],initial.A.pressure [bar_g]
cold,cold.csv,30,1.4,2
warm,warm.csv,20,,3.5
"""
MEASUREMENTS = """recording\tchannel\tunit\ttime [s]\tvalue\tnoise
cold\tA.pressure\tbar_g\t0.0\t10\t0.5
cold\tA.pressure\tbar_g\t0.2\t12\t
cold\tflow\tL/min\t0.0\t6\t
cold\tflow\tL/min\t0.1\t12\t
cold\tflow\tL/min\t0.2\t6\t
warm\tA.pressure\tbar_g\t0.0\t20\t
warm\tA.pressure\tbar_g\t0.1\t21\t
"""


def circuit() -> jl.Circuit:
    """A vessel fed by a recorded flow, with a gauge sensor."""
    parts = {"line": jl.Line("A", jl.Vessel(volume=0.03)), "valve": jl.FlowSource("A", "flow")}
    oil = jl.Oil(bulk_modulus=1.4e9, density=850.0)
    return jl.Circuit(oil, {**parts, "gauge": jl.PressureSensor("A", reference="gauge")})


def written(folder, name: str, text: str):
    """A file with a text in it."""
    path = folder / name
    path.write_text(text)
    return path


def test_conditions_arrive_in_si(tmp_path):
    cold, warm = read_conditions(written(tmp_path, "conditions.csv", CONDITIONS))
    assert (cold.name, cold.file, warm.name) == ("cold", tmp_path / "cold.csv", "warm")
    assert cold.conditions["line.volume"] == pytest.approx(0.03)
    assert cold.conditions["fluid.bulk_modulus"] == pytest.approx(1.4e9)
    assert cold.conditions["initial.A.pressure"] == pytest.approx(2e5 + 101325.0)
    assert set(warm.conditions) == {"line.volume", "initial.A.pressure"}  # an empty cell is no condition


def test_measurements_arrive_in_si_with_what_is_missing_masked(tmp_path):
    cold, warm = read_measurements(written(tmp_path, "measurements.tsv", MEASUREMENTS))
    np.testing.assert_allclose(cold.times, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(cold.channels["A.pressure"], [1.101325e6, np.nan, 1.301325e6])
    np.testing.assert_allclose(cold.channels["flow"], [1e-4, 2e-4, 1e-4])
    assert cold.mask["A.pressure"].tolist() == [True, False, True]
    np.testing.assert_allclose(cold.noise["A.pressure"], [5e4, np.nan, np.nan])
    assert list(warm.channels) == ["A.pressure"] and warm.noise == {}


def test_recordings_from_files_and_from_a_table(tmp_path):
    conditions = written(tmp_path, "conditions.csv", CONDITIONS)
    measurements = written(tmp_path, "measurements.tsv", MEASUREMENTS)
    from_table = read_recordings(conditions, measurements=measurements)
    assert [r.name for r in from_table] == ["cold", "warm"]
    assert from_table[1].conditions["line.volume"] == pytest.approx(0.02)
    for name in ("cold", "warm"):
        rows = "\n".join(f"{0.1 * i},{10 + i}" for i in range(12))
        written(tmp_path, f"{name}.csv", f"t [s],p [bar_a]\n{rows}\n")
    files = read_recordings(conditions, time="t [s]", channels={"A.pressure": "p [bar_a]"})
    assert [r.name for r in files] == ["cold", "warm"] and files[0].channels["A.pressure"][0] == pytest.approx(1e6)
    assert files[0].conditions["line.volume"] == pytest.approx(0.03)


def test_written_tables_are_read_back_to_the_last_bit(tmp_path):
    rng, times = np.random.default_rng(1), np.cumsum(np.random.default_rng(2).random(7))
    pressure = np.where(np.arange(7) == 3, np.nan, 1e6 * rng.random(7))
    channels = {"A.pressure": pressure, "gauge": -1e4 * rng.random(7), "flow": 1e-4 * rng.random(7)}
    conditions = {"line.volume": 0.1 / 3.0, "initial.A.pressure": 1e6 / 7.0, "fluid.bulk_modulus": 1e9 / 0.7}
    one = jl.Recording(times, channels, name="one", conditions=conditions, noise={"flow": 1e-7 * (1.0 + rng.random(7))})
    two = jl.Recording(times[:4], {"gauge": channels["gauge"][:4]}, name="two", conditions={"line.volume": 0.02})
    for suffix in ("csv", "tsv"):
        first = write_conditions(tmp_path / f"c.{suffix}", [one, two], circuit())
        second = write_measurements(tmp_path / f"m.{suffix}", [one, two], circuit())
        again = read_recordings(first, measurements=second)
        for old, new in zip([one, two], again, strict=True):
            assert new.name == old.name and new.conditions == old.conditions
            assert np.array_equal(new.times, old.times)
            for channel, values in old.channels.items():
                assert np.array_equal(new.channels[channel], values, equal_nan=True)
            for channel, level in old.noise.items():
                assert np.array_equal(new.noise[channel], level)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("name,", "run,", "no column 'name'; the file has 'run'"),
        ("line.volume [L]", "line.volume", "column 'line.volume' has no unit"),
        ("line.volume [L]", "line.volume [Litre]", "Litre"),
        ("cold,cold.csv,30", "cold,cold.csv,3O", r"row 1, column 'line.volume \[L\]': '3O' is no number"),
        ("warm,warm", "cold,warm", "two rows are called 'cold'"),
        ("warm,warm", ",warm", "row 2 has no name"),
    ],
)
def test_mistakes_in_conditions_are_named(tmp_path, old, new, message):
    path = written(tmp_path, "conditions.csv", CONDITIONS.replace(old, new))
    with pytest.raises(ValueError, match=message) as caught:
        read_conditions(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\tunit\t", "\tunits\t", "no column 'unit'"),
        ("0.1\t12", "0.1\ttwelve", "channel 'flow': 'twelve' is no number"),
        ("0.1\t12", "0.0\t12", "two values at one time"),
        ("flow\tL/min\t0.1", "flow\tm^3/s\t0.1", "has several units"),
    ],
)
def test_mistakes_in_measurements_are_named(tmp_path, old, new, message):
    with pytest.raises(ValueError, match=message):
        read_measurements(written(tmp_path, "measurements.tsv", MEASUREMENTS.replace(old, new)))


def test_files_that_are_not_there_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_conditions(tmp_path / "none.csv")
    conditions = written(tmp_path, "conditions.csv", CONDITIONS)
    with pytest.raises(ValueError, match="'cold' has no measurements: name its `file` with time and channels"):
        read_recordings(conditions)
    other = written(tmp_path, "m.tsv", MEASUREMENTS.replace("warm", "hot"))
    with pytest.raises(ValueError, match="there is no recording 'warm'; it has cold, hot"):
        read_recordings(conditions, measurements=other)
