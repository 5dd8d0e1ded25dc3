"""The drive of an antenna axis: explicit, implicit, in float32, with air; its validity; a second call."""

import json
import logging

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.catalogue import dsn70m
from jaxlines.catalogue.dsn70m_drive import START, axis_drive
from jaxlines.simulation.validity import check_validity, spectral_edge

TIMES = np.linspace(0.0, 1.5, 301)
COMMAND = {"spool": jl.Sine(amplitude=0.5, frequency=1.0)}


def run(circuit, command=COMMAND, **options):
    return jl.simulate(circuit, TIMES, command, initial=START, **options)


@pytest.fixture(scope="module")
def drive():
    return run(axis_drive("azimuth"))


def test_forward_and_reverse(drive):
    assert drive.status == "ok"
    assert drive["shaft.speed"].max() > 5 and drive["shaft.speed"].min() < -5
    for node in "AB":  # between return, kept filled by the supercharge, and a little over the supply
        assert 4e5 < drive[f"{node}.pressure"].min() < 2e6 < 1.2e7 < drive[f"{node}.pressure"].max() < 2.3e7
    assert drive["servovalve.spool"].max() == pytest.approx(0.5, rel=0.01)


def test_the_other_axis_runs_on_the_same_program(drive, caplog):
    circuit = axis_drive("elevation").replace({"inertia.moment_of_inertia": 50.0, "fluid.bulk_modulus": 1.3e9})
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        sim = run(circuit, {"spool": jl.Sine(amplitude=0.4, frequency=1.5)})
    assert sim.status == "ok"
    assert [r.message for r in caplog.records if "Compiling" in r.message] == []


def test_explicit_and_implicit_agree_and_the_implicit_one_takes_few_steps(drive):
    """diffrax's default root finder takes 759 steps and rejects 121 of them."""
    stiff = run(axis_drive("azimuth"), solver=jl.implicit())
    assert stiff.status == "ok"
    for name in ("A.pressure", "B.pressure", "shaft.speed", "servovalve.spool"):
        np.testing.assert_allclose(stiff[name], drive[name], atol=1e-5 * np.max(np.abs(drive[name])))
    assert stiff.num_steps < 500 and stiff.num_rejected < 60


def test_float32(drive):
    sim = run(axis_drive("azimuth"), precision="float32", tolerance=1e-4)
    assert sim.status == "ok" and sim["A.pressure"].dtype == np.float32
    for name in ("A.pressure", "shaft.speed"):
        np.testing.assert_allclose(sim[name], drive[name], atol=5e-3 * np.max(np.abs(drive[name])))


def test_validity_of_the_drive(drive):
    report = drive.validity(dsn70m.COMMAND_RATE)
    line = report.lines[0]
    assert [line.name for line in report.lines] == ["control_1", "control_2"]
    assert line.article_condition and not line.ok and not report.ok
    assert line.impedance_error == pytest.approx(2.32, abs=0.02)
    assert line.first_resonance == pytest.approx(14.8, abs=0.05)
    assert line.frequency_10_percent == pytest.approx(5.11, abs=0.02)
    words = "2L/c0 = 33.8 ms < 1/f = 50 ms holds, but the input impedance of the lumped line is off by 232 % at 20 Hz"
    assert words in report.sentences()[0] and "it has no pipes" in report.sentences()[0]
    assert json.loads(json.dumps(report.to_dict()))["lines"][1]["ok"] is False


def test_frequency_from_inputs_and_responses(drive):
    report = drive.validity()
    assert report.frequency_source in ("spool", "A.pressure", "B.pressure")
    edges = [spectral_edge(TIMES, drive[f"{node}.pressure"]) for node in "AB"]
    assert report.highest_frequency >= max(edges) > 0.5
    assert drive.validity().highest_frequency < 5 and report.frequency_source != "given"


@pytest.mark.parametrize("frequency", [3.0, 20.0])
def test_spectral_edge(frequency):
    times = np.linspace(0, 4, 801)
    sine = 5e6 + 3e5 * times + 1e5 * np.sin(2 * np.pi * frequency * times)
    assert spectral_edge(times, sine) == pytest.approx(frequency, abs=0.5)
    uneven = np.sort(np.concatenate([times, times[:-1] + 0.001]))
    assert spectral_edge(uneven, np.interp(uneven, times, sine)) == pytest.approx(frequency, abs=0.5)
    assert spectral_edge(times, np.full(801, 5e6)) == 0.0
    assert spectral_edge(times, 5e6 + 1e6 * times) == 0.0


def test_drops_in_pipes():
    """Laminar friction and inertia of 20.83 m of 2-in pipe at an oscillating flow of 1e-3 m^3/s."""
    pipe = dsn70m.pipe("2", 20.83)
    circuit = jl.Circuit(dsn70m.OIL, {"pump": jl.FlowSource("A", "flow"), "line": jl.Line("A", pipe, 20.83)})
    times = np.linspace(0, 2, 2001)
    flow = 1e-3 * np.sin(2 * np.pi * 2.0 * times)
    pressure = 5e6 + 1e6 * np.cos(2 * np.pi * 2.0 * times)
    report = check_validity(circuit, times, {"A": pressure}, {"line": flow}, {"flow": (times, flow)})
    line = report.lines[0]
    assert line.highest_frequency == pytest.approx(2.0, abs=0.6)
    assert line.lowest_pressure == pytest.approx(4e6) and line.median_pressure == pytest.approx(5e6, rel=1e-3)
    assert line.friction_drop == pytest.approx(5.93e3, rel=2e-3) and line.reynolds_number == pytest.approx(
        1073, rel=1e-3
    )
    inertia = 850 * 20.83 / pipe.reference_volume() * 20.83 * 1e-3 * 4 * np.pi
    assert line.inertia_drop == pytest.approx(inertia, rel=1e-3)
    assert line.relative_inertia_drop == pytest.approx(inertia / 5e6, rel=2e-3)
    assert report.ok and line.impedance_error < 0.03
    fast = check_validity(circuit, times, {"A": pressure}, {"line": 3 * flow}, {}, highest_frequency=40.0)
    assert not fast.lines[0].article_condition and "turbulent (Re = 32" in fast.sentences()[0]


def test_flow_of_a_line_is_what_enters_its_node():
    """A pump feeds a line with a leak: the flow of the line is the pump's."""
    parts = {
        "pump": jl.FlowSource("A", 2e-4),
        "line": jl.Line("A", dsn70m.pipe("1", 10.0), 10.0),
        "leak": jl.LaminarLeak("A", "T", 1e-11),
        "tank": jl.Tank("T"),
    }
    sim = jl.simulate(jl.Circuit(dsn70m.OIL, parts), np.linspace(0, 3, 31), initial={"A.pressure": 2e7})
    line = sim.validity().lines[0]
    resistance = 128 * 27.7e-6 * 850 * 10 / (np.pi * (0.815 * 0.0254) ** 4)
    assert line.friction_drop == pytest.approx(2e-4 * resistance, rel=1e-9)
    assert line.inertia_drop == pytest.approx(0.0, abs=1e-3)


def test_validity_needs_its_outputs():
    sim = run(axis_drive("azimuth"), outputs=["A.pressure", "shaft.speed"])
    with pytest.raises(ValueError, match=r"validity check needs .*B\.pressure.* not saved: simulate without `outputs`"):
        sim.validity()


def test_nothing_to_check():
    parts = {"pump": jl.FlowSource("A", 2e-6), "line": jl.Line("A", jl.Vessel(1e-3))}
    report = jl.simulate(jl.Circuit(dsn70m.OIL, parts), [0.0, 0.1, 0.2]).validity()
    assert report.ok and report.lines == () and "no line has a path_length" in report.sentences()[0]


def test_an_unknown_axis_is_refused():
    with pytest.raises(ValueError, match='axis must be "azimuth" or "elevation", got \'polar\''):
        axis_drive("polar")
