"""Derivatives of trajectories against central differences, and batches against loops."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.catalogue.dsn70m import OIL, control_line

TIMES = np.linspace(0.0, 0.4, 9)
PATHS = ["fluid.bulk_modulus", "fluid.air_fraction", "orifice.area", "leak.conductance", "line.volume", "low.pressure"]
INITIAL = {"A.pressure": 2e6}


def circuit(low: float, air: float) -> jl.Circuit:
    """A control line between a pulsating source, an orifice and a leak."""
    return jl.Circuit(
        OIL,
        {
            "source": jl.FlowSource("A", "flow"),
            "low": jl.PressureSource("B", low),
            "orifice": jl.Orifice("A", "B", 3e-6, transition=1e4),
            "leak": jl.LaminarLeak("A", "B", 5e-12),
            "line": control_line("azimuth_1", "A"),
        },
    ).replace({"fluid.air_fraction": air})


# pressure at the other side [Pa], air fraction [-], amplitude of the flow [m^3/s]
CASES = {
    "at rest, zero flow": (2e6, 0.01, 0.0),
    "reversing": (2e6, 0.01, 2e-3),
    "no air": (2e6, 0.0, 5e-4),
    "emptying": (2e5, 0.03, -2e-4),
}
SCALES = np.array([1e9, 0.01, 3e-6, 5e-12, 0.0271, 2e6])
SAMPLES = np.linspace(0.0, 0.4, 401)


def pressures(numbers, case, gradient):
    low, air, amplitude = CASES[case]
    changed = circuit(low, air).replace(dict(zip(PATHS, numbers, strict=True)))
    flow = jl.Sampled(SAMPLES, amplitude * np.sin(10 * np.pi * SAMPLES))
    options = {"initial": INITIAL, "outputs": ["A.pressure"], "tolerance": 1e-10, "gradient": gradient}
    return jl.simulate(changed, TIMES, {"flow": flow}, **options)["A.pressure"]


def differences(case, numbers):
    """Jacobian by central differences; one-sided of second order where there is no air, which cannot be negative."""
    columns = []
    for i, scale in enumerate(SCALES):
        step = np.eye(len(SCALES))[i] * scale * 1e-5
        points = [(0, -1.5), (1, 2.0), (2, -0.5)] if numbers[i] == 0.0 else [(1, 0.5), (-1, -0.5)]
        columns.append(sum(w * pressures(numbers + k * step, case, "forward") for k, w in points) / step[i])
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("case", CASES)
def test_forward_and_reverse_against_central_differences(case):
    numbers, weights = np.array([circuit(*CASES[case][:2])[path] for path in PATHS]), np.linspace(1.0, 2.0, TIMES.size)
    with jax.enable_x64(True):
        forward = np.asarray(jax.jacfwd(lambda x: pressures(x, case, "forward"))(jnp.asarray(numbers)))
        reverse = np.asarray(jax.grad(lambda x: weights @ pressures(x, case, "reverse"))(jnp.asarray(numbers)))
    exact, approximate = forward * SCALES, differences(case, numbers) * SCALES
    largest = np.max(np.abs(exact), axis=0)  # Pa for a change by the whole size of a number
    assert np.all(np.isfinite(exact)) and largest[5] > 1e5
    assert np.all(largest[:5] < 1.0 if case == "at rest, zero flow" else largest[:5] > 1e3)
    np.testing.assert_allclose(exact, approximate, rtol=1e-5, atol=1e-5 * np.max(largest))
    np.testing.assert_allclose(reverse * SCALES, weights @ exact, rtol=1e-6, atol=1e-6 * np.max(largest))


@pytest.mark.parametrize("gradient", ["reverse", "forward"])
def test_gradient_at_rest_with_a_longest_step(gradient):
    """At rest every step passes the error test, however long; `max_step` keeps the derivative from running away."""
    base = circuit(2e6, 0.0)

    def end(low):
        simulation = jl.simulate(
            base.replace({"low.pressure": low}),
            TIMES,
            {"flow": 0.0},
            initial=INITIAL,
            outputs=["A.pressure"],
            max_step=2e-4,
            gradient=gradient,
        )
        return simulation["A.pressure"][-1]

    differentiate = jax.grad if gradient == "reverse" else jax.jacfwd
    with jax.enable_x64(True):
        assert float(differentiate(end)(2e6)) == pytest.approx(1.0, abs=1e-3)


def test_each_mode_refuses_the_other():
    numbers = jnp.asarray(SCALES)
    with jax.enable_x64(True):
        with pytest.raises(Exception, match=r"Reverse-mode"):
            jax.grad(lambda x: pressures(x, "reversing", "forward")[-1])(numbers)
        with pytest.raises(Exception, match=r"[Ff]orward-mode|custom_vjp"):
            jax.jacfwd(lambda x: pressures(x, "reversing", "reverse")[-1])(numbers)


def test_vmap_equals_loop():
    """Over a number of the fluid, one of a component and an initial value at once."""
    moduli, areas, starts = np.array([1.2e9, 1.379e9, 1.5e9]), np.array([1e-6, 3e-6, 1e-5]), np.array([1e6, 2e6, 5e6])
    base = circuit(2e6, 0.01)

    def end(modulus, area, start):
        changed = base.replace({"fluid.bulk_modulus": modulus, "orifice.area": area})
        return jl.simulate(changed, TIMES, {"flow": 1e-4}, initial={"A.pressure": start})["A.pressure"]

    with jax.enable_x64(True):
        together = np.asarray(jax.vmap(end)(moduli, areas, starts))
    one_by_one = np.stack([end(*row) for row in zip(moduli, areas, starts, strict=True)])
    np.testing.assert_allclose(together, one_by_one, rtol=1e-9)
    assert np.ptp(together[:, -1]) > 1e5


def test_second_call_with_other_values_compiles_nothing(caplog):
    def run(low, air, flow):
        jl.simulate(circuit(low, air).replace({"orifice.area": 4e-6}), TIMES, {"flow": flow}, initial=INITIAL)

    run(2e6, 0.01, np.zeros(9))
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        run(1e6, 0.0, np.linspace(0, 1e-4, 9))
        assert [record.message for record in caplog.records if "Compiling" in record.message] == []
        run(1e6, 0.0, jl.Sampled(SAMPLES, 0.0 * SAMPLES))  # another program: the test can see compilations
    assert [record.message for record in caplog.records if "Compiling jit(_run)" in record.message]


def test_replacing_keeps_the_order_of_the_components():
    base = circuit(2e6, 0.01)
    assert list(base.components) == ["source", "low", "orifice", "leak", "line"]
    assert list(base.replace({"low.pressure": 3e6}).components) == list(base.components)
