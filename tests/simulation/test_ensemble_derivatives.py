"""Derivatives of ensembles: against a closed form, finite differences, and each other."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl
from tests.simulation.test_ensemble import COMMAND, START, TIMES, draining, driven, varied


@pytest.fixture(scope="module")
def program() -> jl.EnsembleProgram:
    return jl.prepare_ensemble(
        driven(),
        TIMES,
        varied(128) | {"spool.delay": np.linspace(0.001, 0.003, 128)},
        {"spool": jl.Sampled(COMMAND.times, COMMAND.values, "cubic")},
        initial=START,
        outputs=["A.pressure", "gauge"],
        reductions={"final": jl.Final("A.pressure")},
        engine="explicit",
        steps=4,
        audit=0,
    )


@pytest.fixture(scope="module")
def values() -> dict:
    return varied(128) | {"spool.delay": np.linspace(0.001, 0.003, 128)}


@pytest.fixture(scope="module")
def jacobian(program, values) -> jl.EnsembleJacobian:
    return jl.ensemble_jacobian(program, values)


def test_closed_form():
    volume, conductance = np.linspace(5e-4, 2e-3, 20), np.geomspace(1e-12, 1e-11, 20)
    values = {"vessel.volume": volume, "leak.conductance": conductance, "initial.A.pressure": np.full(20, 2e7)}
    program = jl.prepare_ensemble(
        draining(), TIMES, values, outputs=["A.pressure"], steps=4, engine="explicit", audit=0
    )
    found = jl.ensemble_jacobian(program, values).slopes["A.pressure"]
    rate = 1.4e9 * conductance / volume
    decay = np.exp(-rate[:, None] * TIMES)
    by_rate = -1.99e7 * TIMES * decay
    np.testing.assert_allclose(found["initial.A.pressure"], decay, rtol=1e-6)
    np.testing.assert_allclose(found["leak.conductance"], by_rate * (1.4e9 / volume)[:, None], rtol=1e-5)
    np.testing.assert_allclose(found["vessel.parts.0.volume"], by_rate * (-rate / volume)[:, None], rtol=1e-5)


def test_forward_against_differences_of_the_same_program(program, values, jacobian):
    for key in values:
        label = key if isinstance(key, str) else key[0]
        step = 1e-5 * np.maximum(np.abs(values[key]), 1e-4)
        up, down = (program.run(values | {key: values[key] + sign * step}) for sign in (1.0, -1.0))
        for name in ("A.pressure", "gauge"):
            difference = (up[name] - down[name]) / (2.0 * step[:, None])
            slope = jacobian.slopes[name][label]
            np.testing.assert_allclose(slope, difference, rtol=0, atol=2e-6 * np.abs(difference).max())
        final = (up["final"] - down["final"]) / (2.0 * step)
        np.testing.assert_allclose(
            jacobian.reduction_slopes["final"][label], final, rtol=0, atol=2e-6 * np.abs(final).max()
        )


def test_backwards_as_forward(program, values, jacobian):
    def objective(times, outputs):
        return jnp.mean((outputs["A.pressure"] / 1e6) ** 2 + outputs["gauge"] / 1e6, axis=0)

    found = jl.ensemble_gradient(program, objective, values)
    pressure, gauge = jacobian.outputs["A.pressure"], jacobian.outputs["gauge"]
    np.testing.assert_allclose(found.value, np.mean((pressure / 1e6) ** 2 + gauge / 1e6, axis=1), rtol=1e-12)
    for label, slope in found.gradient.items():
        by_pressure, by_gauge = (jacobian.slopes[name][label] / 1e6 for name in ("A.pressure", "gauge"))
        exact = np.mean(2.0 * pressure / 1e6 * by_pressure + by_gauge, axis=1)
        np.testing.assert_allclose(slope, exact, rtol=1e-9, atol=1e-11 * np.abs(exact).max())


def test_gradient_in_whole_records():
    """The cotangent of a record that drives a lane, against differences."""
    records = np.tile(np.asarray(COMMAND.values), (3, 1)) * np.array([[0.5], [1.0], [1.5]])
    program = jl.prepare_ensemble(
        driven(), TIMES, {"spool.values": records}, {"spool": COMMAND}, initial=START, outputs=["shaft.speed"],
        engine="explicit", steps=4, audit=0,
    )  # fmt: skip

    def objective(times, outputs):
        return outputs["shaft.speed"][-1]

    found = jl.ensemble_gradient(program, objective, {"spool.values": records}).gradient["spool.values"]
    assert found.shape == records.shape
    for sample in (2, 7):
        step = np.zeros_like(records)
        step[:, sample] = 1e-5
        up, down = (program.run({"spool.values": records + s * step})["shaft.speed"][:, -1] for s in (1.0, -1.0))
        np.testing.assert_allclose(found[:, sample], (up - down) / 2e-5, rtol=1e-5)
    with pytest.raises(ValueError, match="ensemble_gradient"):
        jl.ensemble_jacobian(program, {"spool.values": records})


def test_a_time_of_peak_has_no_derivative():
    values = {"vessel.volume": np.array([1e-3, 2e-3])}
    when = {"when": jl.TimeOfPeak("A.pressure")}
    program = jl.prepare_ensemble(draining(), TIMES, values, reductions=when, steps=1, engine="explicit", audit=0)
    with pytest.raises(ValueError, match="no derivative"):
        jl.ensemble_jacobian(program, values)


def test_an_objective_that_asks_for_what_is_not_there_is_told(program, values):
    with pytest.raises(KeyError, match=r"no output of this ensemble .*A\.presure.*A\.pressure"):
        jl.ensemble_gradient(program, lambda times, outputs: outputs["A.presure"][-1], values)


def test_an_objective_of_the_wrong_shape_is_refused(program, values):
    with pytest.raises(ValueError, match="one number for each lane"):
        jl.ensemble_gradient(program, lambda times, outputs: jnp.sum(outputs["gauge"]), values)
