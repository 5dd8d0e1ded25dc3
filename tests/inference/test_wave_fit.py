"""A fit through a line in segments, whose number is chosen once, for the slowest waves within the bounds."""

import numpy as np
import pytest

import jaxlines as jl

TRUTH = {"fluid.bulk_modulus": 1.45e9, "fluid.kinematic_viscosity": 46e-6}
TIMES = np.linspace(0.0, 0.2, 401)


def circuit(modulus, viscosity) -> jl.Circuit:
    """A closed pipe behind a flow that starts and stops."""
    oil = jl.Oil(modulus, 870.0, viscosity, air_fraction=1e-3)
    line = jl.Line("A", jl.Pipe(8.0, 0.016, 0.022), to="B", weights=jl.TrikhaWeights())
    return jl.Circuit(oil, {"line": line, "pump": jl.FlowSource("A", "flow")})


@pytest.mark.slow
def test_modulus_and_viscosity_from_a_ringing_line():
    """Truth within three standard deviations, from starts 30 % and more away, noise 2 kPa on a swing of 1 MPa."""
    flow = 1e-4 * np.where(TIMES < 0.1, np.sin(np.pi * TIMES / 0.1) ** 2, 0.0)
    truth = circuit(*TRUTH.values())
    start = {"A.pressure": 5e6, "B.pressure": 5e6}
    chosen = jl.choose_segments(truth, TIMES, {"flow": jl.Sampled(TIMES, flow)}, initial=start)
    sim = jl.simulate(chosen, TIMES, {"flow": flow}, initial=start)
    noise = np.random.default_rng(3).normal(0.0, 2e3, TIMES.size)
    channels = {"B.pressure": sim["B.pressure"] + noise, "flow": flow}
    recording = jl.Recording(TIMES, channels)
    free = [
        jl.Free("fluid.bulk_modulus", (0.7e9, 2.5e9), start=1.0e9),
        jl.Free("fluid.kinematic_viscosity", (1e-5, 2e-4), start=1e-4, transform="log"),
    ]
    fit = jl.fit(circuit(1.0e9, 1e-4), recording, free=free, initial=start)
    assert fit.status == "converged"
    for name, value in TRUTH.items():
        estimate = fit.parameters[name]
        sd = estimate.sd or 0.0
        assert abs(estimate.value - value) < 3 * sd and sd < 0.1 * value
    line = fit.circuit.components["line"]
    assert isinstance(line, jl.Line) and line.segments == 8
    assert "8 segments" in str(fit)
