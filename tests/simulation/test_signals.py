"""Signals, sensors and port flows."""

import jax
import numpy as np
import pytest

import jaxlines as jl

OIL = jl.Oil(1.379e9, 850.0, mass="article")
KNOTS = np.array([0.0, 0.1, 0.25, 0.3, 0.6])
VALUES = np.array([1.0, 3.0, 3.0, -1.0, 0.5])
EVERYWHERE = np.linspace(-0.2, 0.8, 201)


def evaluate(signal, times=EVERYWHERE):
    with jax.enable_x64(True):
        return np.asarray(jax.vmap(signal)(times))


def test_linear_samples():
    np.testing.assert_allclose(evaluate(jl.Sampled(KNOTS, VALUES)), np.interp(EVERYWHERE, KNOTS, VALUES), atol=1e-13)
    delayed = evaluate(jl.Sampled(KNOTS, VALUES, delay=0.05))
    np.testing.assert_allclose(delayed, np.interp(EVERYWHERE - 0.05, KNOTS, VALUES), atol=1e-13)


def test_held_samples():
    signal = jl.Sampled(KNOTS, VALUES, "hold")
    index = np.clip(np.searchsorted(KNOTS, EVERYWHERE, side="right") - 1, 0, None)
    np.testing.assert_array_equal(evaluate(signal), VALUES[index])
    np.testing.assert_array_equal(signal.jump_times(), KNOTS)


def test_cubic_samples_are_monotone_and_smooth():
    signal = jl.Sampled(KNOTS, VALUES, "cubic")
    np.testing.assert_allclose(evaluate(signal, KNOTS), VALUES, atol=1e-14)
    fine = np.linspace(0, 0.6, 601)
    shown, low, high = evaluate(signal, fine), *np.sort([VALUES[:-1], VALUES[1:]], axis=0)
    index = np.clip(np.searchsorted(KNOTS, fine, side="right") - 1, 0, 3)
    assert np.all((shown >= low[index] - 1e-12) & (shown <= high[index] + 1e-12))
    assert np.max(np.abs(np.diff(shown, 2))) < 1e-2


@pytest.mark.parametrize("method", ["linear", "hold", "cubic"])
def test_padding_changes_nothing(method):
    signal = jl.Sampled(KNOTS[:-1], VALUES[:-1], method)
    padded = signal.padded(9)
    assert padded.times.shape == (9,) and signal.padded(3) is signal
    np.testing.assert_allclose(evaluate(padded), evaluate(signal), atol=1e-13)


def test_formula_signals():
    np.testing.assert_allclose(evaluate(jl.Constant(2.5)), np.full(201, 2.5))
    np.testing.assert_array_equal(evaluate(jl.Step(1.0, 2.0, 0.3), np.array([0.2999, 0.3, 0.4])), [1.0, 2.0, 2.0])
    sine = jl.Sine(1.0, 0.5, 2.0, 0.3)
    np.testing.assert_allclose(evaluate(sine), 1 + 0.5 * np.sin(4 * np.pi * EVERYWHERE + 0.3), atol=1e-14)


@pytest.fixture(scope="module")
def fed():
    """A capacitance of 1e12 Pa/m^3 fed by an input, with a leak to a tank and sensors."""
    volume = 1.379e9 / 1e12
    circuit = jl.Circuit(
        OIL,
        {
            "pump": jl.FlowSource("A", "flow"),
            "leak": jl.LaminarLeak("A", "T", 1e-11),
            "tank": jl.Tank("T", 2e5),
            "line": jl.Line("A", jl.Vessel(volume)),
            "absolute": jl.PressureSensor("A", gain=1.01, offset=2e3),
            "gauge": jl.PressureSensor("A", reference="gauge"),
            "meter": jl.FlowSensor("leak.a", gain=-1.0, offset=1e-6),
        },
    )
    times = np.array([0.0, 0.05, 0.1, 0.2, 0.3])
    signal = jl.Sampled([0.0, 0.1, 0.2], [1e-5, 3e-5, -1e-5], "hold")
    outputs = ["A.pressure", "T.pressure", "absolute", "gauge", "meter", "leak.a.flow", "leak.b.flow", "pump.node.flow"]
    return times, jl.simulate(circuit, times, {"flow": signal}, outputs=outputs, tolerance=1e-10)


def test_held_input_between_saved_times(fed):
    """dp/dt = K (Q - G (p - p_t)): exponential towards p_t + Q/G, piece by piece."""
    _, sim = fed

    def after(p, flow, time):
        end = 2e5 + flow / 1e-11
        return end + (p - end) * np.exp(-10 * time)

    first = after(101325.0, 1e-5, 0.1)
    second = after(first, 3e-5, 0.1)
    expected = [101325.0, after(101325.0, 1e-5, 0.05), first, second, after(second, -1e-5, 0.1)]
    np.testing.assert_allclose(sim["A.pressure"], expected, rtol=1e-8)


def test_sensors(fed):
    _, sim = fed
    p = sim["A.pressure"]
    np.testing.assert_allclose(sim["absolute"], 1.01 * p + 2e3, rtol=1e-14)
    np.testing.assert_allclose(sim["gauge"], p - 101325.0, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(sim["meter"], 1e-6 - 1e-11 * (p - 2e5), rtol=1e-12)


def test_flows_into_the_ports_of_a_component(fed):
    _, sim = fed
    np.testing.assert_allclose(sim["leak.a.flow"], 1e-11 * (sim["A.pressure"] - 2e5), rtol=1e-12)
    np.testing.assert_allclose(sim["leak.b.flow"], -sim["leak.a.flow"], rtol=1e-14)
    np.testing.assert_allclose(sim["pump.node.flow"][:4], [-1e-5, -1e-5, -3e-5, 1e-5], rtol=1e-14)
    np.testing.assert_array_equal(sim["T.pressure"], np.full(5, 2e5))
    assert sim.units["leak.a.flow"] == "m^3/s" and sim.units["gauge"] == "Pa"


def test_port_flow_is_at_the_density_of_its_port():
    airy = jl.Oil(1.4e9, 850.0, air_fraction=0.05)
    parts = {"supply": jl.PressureSource("P", 1e7), "leak": jl.LaminarLeak("P", "A", 1e-12)}
    circuit = jl.Circuit(airy, {**parts, "line": jl.Line("A", jl.Vessel(1e-3))})
    sim = jl.simulate(circuit, [0.0, 0.01], outputs=["leak.a.flow", "leak.b.flow", "A.pressure"])
    ratio = airy.density_at(1e7) / airy.density_at(sim["A.pressure"])
    np.testing.assert_allclose(-sim["leak.b.flow"] / sim["leak.a.flow"], ratio, rtol=1e-12)
    assert ratio[0] > 1.04


def test_as_a_dataset(fed):
    times, sim = fed
    dataset = pytest.importorskip("xarray") and sim.to_xarray()
    assert dataset["A.pressure"].attrs["units"] == "Pa" and dataset.attrs["status"] == "ok"
    np.testing.assert_array_equal(dataset["time"], times)
