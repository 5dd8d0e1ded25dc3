"""Sensors with a first-order lag and a delay: closed forms, derivatives, a fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.sensors import DifferentialPressureSensor, FlowSensor, PressureSensor
from jaxlines.simulation.assembly import compile_circuit

OIL = jl.Oil(1.4e9, 850.0, 30e-6, mass="article")
TIMES = np.linspace(0.0, 0.5, 26)
START, AMPLITUDE, FREQUENCY, VOLUME = 2e7, 1e-5, 3.0, 1e-3


def circuit(**sensors) -> jl.Circuit:
    """A vessel that a sine of flow fills and empties, and a second one that nothing moves."""
    parts = {
        "vessel": jl.Line("A", jl.Vessel(VOLUME)),
        "pump": jl.FlowSource("A", jl.Sine(0.0, AMPLITUDE, FREQUENCY)),
        "other": jl.Line("B", jl.Vessel(VOLUME)),
    }
    return jl.Circuit(OIL, parts | sensors)


def run(model, **options):
    return jl.simulate(model, TIMES, initial={"A.pressure": START, "B.pressure": 1e7}, **{"tolerance": 1e-9, **options})


def pressure(t):
    """Of the first vessel."""
    w = 2 * np.pi * FREQUENCY
    return START + 1.4e9 / VOLUME * AMPLITUDE / w * (1 - np.cos(w * t))


def lagged(t, lag):
    """Of a + b (1 - cos w t) behind a lag that starts in equilibrium."""
    w = 2 * np.pi * FREQUENCY
    size = 1.4e9 / VOLUME * AMPLITUDE / w
    swing = (np.cos(w * t) + w * lag * np.sin(w * t) - np.exp(-t / lag)) / (1 + (w * lag) ** 2)
    return START + size * (1 - np.exp(-t / lag)) - size * swing


def test_lag_and_delay_against_closed_forms():
    """Absolute, gauge, differential and flow; both at once; a delay longer than the record shows the start."""
    sim = run(
        circuit(
            slow=PressureSensor("A", lag=0.04),
            late=PressureSensor("A", 2.0, 1e5, "gauge", delay=0.11),
            both=PressureSensor("A", lag=0.04, delay=0.11),
            difference=DifferentialPressureSensor("A", "B", lag=0.04),
            flow=FlowSensor("pump.node", -1.0, lag=0.04),
            never=PressureSensor("A", delay=7.0),
        )
    )
    assert sim.status == "ok"
    earlier = np.maximum(TIMES - 0.11, 0.0)
    np.testing.assert_allclose(sim["slow"], lagged(TIMES, 0.04), rtol=1e-8)
    np.testing.assert_allclose(sim["late"], 2.0 * (pressure(earlier) - 101325.0) + 1e5, rtol=1e-8)
    np.testing.assert_allclose(sim["both"], lagged(earlier, 0.04), rtol=1e-8)
    np.testing.assert_allclose(sim["difference"], lagged(TIMES, 0.04) - 1e7, rtol=1e-8)
    np.testing.assert_allclose(sim["never"], START, rtol=1e-12)
    w, lag = 2 * np.pi * FREQUENCY, 0.04
    swing = np.sin(w * TIMES) - w * lag * np.cos(w * TIMES) + w * lag * np.exp(-TIMES / lag)
    np.testing.assert_allclose(sim["flow"], AMPLITUDE * swing / (1 + (w * lag) ** 2), atol=1e-6 * AMPLITUDE)


def test_a_sensor_without_lag_costs_no_state():
    plan, _ = compile_circuit(circuit(plain=PressureSensor("A"), late=PressureSensor("A", delay=0.1)))
    assert len(plan.kinds) == 2 + 0 * len(plan.sensors)
    assert len(compile_circuit(circuit(slow=PressureSensor("A", lag=0.1)))[0].kinds) == 3


@pytest.mark.parametrize("gradient", ["forward", "reverse"])
def test_derivatives_in_lag_and_delay(gradient):
    model = circuit(gauge=PressureSensor("A", lag=0.04, delay=0.11))

    def shown(numbers):
        changed = model.replace({"gauge.lag": numbers[0], "gauge.delay": numbers[1], "gauge.gain": numbers[2]})
        return run(changed, gradient=gradient, outputs=["gauge"])["gauge"]

    at = np.array([0.04, 0.11, 1.0])
    differentiate = jax.jacfwd if gradient == "forward" else jax.jacrev
    with jax.enable_x64(True):
        exact = np.asarray(differentiate(shown)(jnp.asarray(at)))

    def closed(numbers):
        return numbers[2] * lagged(np.maximum(TIMES - numbers[1], 0.0), numbers[0])

    columns = [(closed(at + step) - closed(at - step)) / (2e-6 * at[i]) for i, step in enumerate(np.diag(1e-6 * at))]
    for i, column in enumerate(columns):
        np.testing.assert_allclose(exact[:, i], column, atol=1e-5 * np.max(np.abs(column)))


def test_a_fit_finds_lag_and_delay():
    truth = circuit(gauge=PressureSensor("A", lag=0.04, delay=0.11))
    recording = jl.Recording(TIMES, {"gauge": run(truth)["gauge"]})
    free = [jl.Free("gauge.lag", (0.005, 0.3)), jl.Free("gauge.delay", (0.01, 0.3))]
    wrong = truth.replace({"gauge.lag": 0.07, "gauge.delay": 0.07})
    start = {"A.pressure": START, "B.pressure": 1e7}
    fit = jl.fit(wrong, recording, free=free, initial=start, noise={"gauge": 1e3})
    assert fit.parameters["gauge.lag"].value == pytest.approx(0.04, rel=1e-4)
    assert fit.parameters["gauge.delay"].value == pytest.approx(0.11, rel=1e-4)
