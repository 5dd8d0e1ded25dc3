"""Gradients backwards in time: against a closed form, in any chunks, with few or all steps stored at once."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.simulation import lockstep_adjoint
from tests.simulation.test_ensemble import TIMES, draining

LANES = 256
VALUES = {
    "vessel.volume": np.linspace(5e-4, 2e-3, LANES),
    "leak.conductance": np.geomspace(1e-12, 1e-11, LANES),
    "initial.A.pressure": np.full(LANES, 2e7),
}


def final_pressure(times, outputs):
    return outputs["A.pressure"][-1] / 1e6


@pytest.fixture(scope="module")
def program() -> jl.EnsembleProgram:
    return jl.prepare_ensemble(
        draining(), TIMES, VALUES, outputs=["A.pressure"], steps=4, engine="explicit", audit=0
    )  # fmt: skip


@pytest.fixture(scope="module")
def gradient(program) -> dict[str, np.ndarray]:
    return jl.ensemble_gradient(program, final_pressure, VALUES, chunk=128).gradient


def test_closed_form(gradient):
    """p = p_0 + (p_start - p_0) exp(-r t), r = K C/V."""
    rate, end = 1.4e9 * VALUES["leak.conductance"] / VALUES["vessel.volume"], TIMES[-1]
    decay = np.exp(-rate * end)
    by_rate = -19.9 * end * decay
    np.testing.assert_allclose(gradient["initial.A.pressure"], 1e-6 * decay, rtol=1e-6)
    np.testing.assert_allclose(gradient["leak.conductance"], by_rate * rate / VALUES["leak.conductance"], rtol=1e-5)
    volume = next(value for path, value in gradient.items() if path.endswith("volume"))
    np.testing.assert_allclose(volume, -by_rate * rate / VALUES["vessel.volume"], rtol=1e-5)


def test_bitwise_the_same_in_any_chunks(program, gradient):
    for path, value in jl.ensemble_gradient(program, final_pressure, VALUES, chunk=256).gradient.items():
        np.testing.assert_array_equal(value, gradient[path])


def test_fewer_steps_at_once(program, gradient, monkeypatch):
    """Where the steps would fill the memory, they are stored for a part of the samples at a time."""
    monkeypatch.setattr(lockstep_adjoint, "STORED_BYTES", 1)

    def objective(times, outputs):  # another one, so that it is compiled with the limit
        return jnp.asarray(final_pressure(times, outputs))

    for path, value in jl.ensemble_gradient(program, objective, VALUES, chunk=128).gradient.items():
        np.testing.assert_allclose(value, gradient[path], rtol=1e-12)


@pytest.mark.parametrize(("precision", "rtol"), [("float64", 1e-12), ("float32", 5e-5)])
def test_backwards_at_the_edge_of_stability(precision, rtol):
    """Steps of up to four time constants, where a scheme that runs backwards could magnify rounding."""
    in_time_constants = np.linspace(0.2, 4.2, LANES)
    values = VALUES | {"vessel.volume": np.full(LANES, 1e-3)}
    values["leak.conductance"] = in_time_constants / (TIMES[1] - TIMES[0]) * 1e-3 / 1.4e9

    def program(precision):
        return jl.prepare_ensemble(
            draining(), TIMES, values, outputs=["A.pressure"], steps=1, engine="explicit", audit=0, precision=precision
        )

    forward = jl.ensemble_jacobian(program("float64"), values).slopes["A.pressure"]
    found = jl.ensemble_gradient(program(precision), lambda times, outputs: outputs["A.pressure"].sum(0) / 1e6, values)
    for path, exact in forward.items():
        total = exact.sum(axis=1) / 1e6
        np.testing.assert_allclose(found.gradient[path], total, rtol=rtol, atol=1e-2 * rtol * np.abs(total).max())


@pytest.mark.parametrize("chunk", [0, 100, -128])
def test_a_chunk_of_any_other_size_is_refused(program, chunk):
    for call in (
        lambda: jl.ensemble_gradient(program, final_pressure, VALUES, chunk=chunk),
        lambda: jl.ensemble_jacobian(program, VALUES, chunk=chunk),
        lambda: program.run(VALUES, chunk=chunk),
    ):
        with pytest.raises(ValueError, match=f"multiple of 128 lanes, got {chunk}"):
            call()
