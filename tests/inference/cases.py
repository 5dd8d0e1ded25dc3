"""Circuits and recordings that the tests of inference share."""

import numpy as np

import jaxlines as jl

TIMES = np.linspace(0.0, 20.0, 201)
FLOW = np.where(TIMES < 8, 6e-5, np.where(TIMES < 12, 0.0, -4e-5))
MILD_FLOW = np.where(TIMES < 8, 6e-5, np.where(TIMES < 12, 0.0, -1e-5))  # keeps an air-free line under pressure
TRUTH = {
    "fluid.bulk_modulus": 1.4e9,
    "fluid.air_fraction": 7e-3,
    "leak.conductance": 1e-12,
    "initial.A.pressure": 3e5,
}
NOISE = 4e4

FREE = [
    jl.Free("fluid.bulk_modulus", (0.5e9, 4e9), start=2.2e9, transform="log"),
    jl.Free("fluid.air_fraction", (1e-5, 0.1), start=2e-3, transform="log"),
    jl.Free("leak.conductance", (0.0, 2e-11), start=3e-12),
    jl.Free("initial.A.pressure", (1.1e5, 8e5), start=1.5e5),
]


def control_line(mass: str = "conserved", **oil) -> jl.Circuit:
    """A dead-ended line fed with a measured flow, leaking to the tank."""
    numbers: dict = {"bulk_modulus": 1.4e9, "density": 850.0, "air_fraction": 7e-3, "polytropic_index": 1.2} | oil
    return jl.Circuit(
        jl.Oil(**numbers, mass=mass),
        {
            "line": jl.Line("A", jl.Vessel(volume=0.03, wall_modulus=3e10)),
            "valve": jl.FlowSource("A", "flow"),
            "leak": jl.LaminarLeak("A", "T", conductance=1e-12),
            "tank": jl.Tank("T"),
        },
    )


def simulated_pressure(circuit: jl.Circuit, start: float = 3e5, flow=FLOW) -> np.ndarray:
    """Pressure of the line without noise [Pa]."""
    simulation = jl.simulate(
        circuit, TIMES, {"flow": flow}, initial={"A.pressure": start}, outputs=["A.pressure"], tolerance=1e-8
    )
    return np.asarray(simulation["A.pressure"])


def recording(pressure: np.ndarray, seed: int, noise: float = NOISE, flow=FLOW) -> jl.Recording:
    """The pressure with white noise, and the flow."""
    noisy = pressure + noise * np.random.default_rng(seed).standard_normal(pressure.size)
    return jl.Recording(TIMES, {"A.pressure": noisy, "flow": flow})


def linear_line(conductance: float = 0.0) -> jl.Circuit:
    """A line of 0.03 m^3 fed by a recorded flow, without air: p' = (K/V)(Q - G (p - p_tank)), linear in 1/V and K G."""
    return jl.Circuit(
        jl.Oil(bulk_modulus=1.4e9, density=850.0, air_fraction=0.0, mass="article"),
        {
            "line": jl.Line("A", jl.Vessel(volume=0.03)),
            "valve": jl.FlowSource("A", "flow"),
            "leak": jl.LaminarLeak("A", "T", conductance=conductance),
            "tank": jl.Tank("T"),
        },
    )
