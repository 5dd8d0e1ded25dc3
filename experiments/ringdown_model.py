"""The circuit behind a ring-down, and what of it is free.

Inside the circuit one count of pressure stands for 1 kPa and one count of angle for 1e-8 m^3; the choice cancels.
"""

import numpy as np
from ringdown_data import Ringdown

import jaxlines as jl
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, port, quantity

PASCAL, CUBIC_METRE = 1e3, 1e-8  # what one count of pressure and one count of angle stand for
VOLUME = 2.4e-4  # of the hose node [m^3]; with the modulus below it only makes up the capacitance
INDEX = 1.3  # polytropic index of air, held


class SupplyLine(AbstractComponent):
    """Inertance and resistance between supply and hose, balanced in the steady stroke before the stop.

    I dQ/dt = p_a - p_b - R Q - R_2 Q|Q|, with R_2 such that the drop at `steady_flow` is `steady_drop`.
    """

    a: str = port()
    b: str = port()
    inertance: Number = quantity("Pa*s^2/m^3", low=0.0)
    resistance: Number = quantity("Pa*s/m^3", low=0.0)
    steady_flow: Number = quantity("m^3/s", low=0.0)
    steady_drop: Number = quantity("Pa")

    states = (State("volume_flow", "m^3/s", 1e-4),)

    def evaluate(self, at: Situation) -> Contribution:
        q, p_a, p_b = at.state["volume_flow"], at.potential["a"], at.potential["b"]
        share = q / self.steady_flow
        drop = self.resistance * q + (self.steady_drop - self.resistance * self.steady_flow) * share * abs(share)
        mass = at.fluid.mass_flow(q, p_a, p_b)
        return Contribution({"a": -mass, "b": mass}, {}, {"volume_flow": (p_a - p_b - drop) / self.inertance})


def circuit() -> jl.Circuit:
    """The circuit of every run; numbers that differ between runs are set a lane."""
    oil = jl.Oil(bulk_modulus=1e9, density=850.0, polytropic_index=INDEX, mass="article")
    return jl.Circuit(
        oil,
        {
            "supply": jl.PressureSource("source", 6e6),
            "line": SupplyLine("source", "hose", 2e8, 1.5e10, 1e-4, 2e6),
            "volume": jl.Line("hose", jl.Vessel(volume=VOLUME)),
            "actuator": jl.FlowSource("hose", "rate", gain=-1.0),
        },
    )


FREE = [
    jl.Free("line.resistance", (1e9, 2e11), transform="log"),
    jl.Free("line.inertance", (1e7, 3e9), transform="log"),
    jl.Free("fluid.bulk_modulus", (1.01e8, 3e10), transform="log"),
    jl.Free("rate.delay", (-8e-3, 8e-3), start=0.0),
]
AIR = jl.Free("fluid.air_fraction", (1e-5, 0.3), start=1e-2, transform="log")
MODELS = {"constant capacitance": FREE, "capacitance with air": [*FREE, AIR]}


def recording(run: Ringdown) -> jl.Recording:
    """The run as a recording in the circuit's nominal units."""
    channels = {"hose.pressure": run.pressure * PASCAL, "rate": run.rate * CUBIC_METRE}
    return jl.Recording(run.times, channels, name=f"run {run.run_id}")


def own_numbers(run: Ringdown) -> dict:
    """What is known of a run and not fitted: hold pressure, steady stroke, where the window starts."""
    return {
        "supply.pressure": run.hold * PASCAL,
        "line.steady_flow": run.speed * CUBIC_METRE,
        "line.steady_drop": (run.hold - run.first_pressure) * PASCAL,
        "initial.hose.pressure": run.first_pressure * PASCAL,
        "initial.line.volume_flow": run.speed * CUBIC_METRE,
    }


def start_values(run: Ringdown, free) -> list[float]:
    """Where the search starts: frequency from the first half period, damping ratio 1/4."""
    omega, drop = np.pi / run.half_period, (run.hold - run.first_pressure) * PASCAL
    resistance = 0.6 * max(drop, 0.05 * run.hold * PASCAL) / (run.speed * CUBIC_METRE)
    inertance = resistance / (2 * 0.25 * omega)
    values = [resistance, inertance, VOLUME * omega**2 * inertance, 0.0, 1e-2]
    return [float(np.clip(v, *f.bounds)) for v, f in zip(values, free, strict=False)]
