"""The structures that are fitted to a ring-down, and what of each is free.

Inside the circuits one count of pressure stands for 1 kPa and one count of angle for 1e-8 m^3; the choice cancels.
"""

import dataclasses

import numpy as np
from ringdown_data import Ringdown
from ringdown_two_lumps import ArrestedFlow, TwoLumpLine

import jaxlines as jl
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, port, quantity

PASCAL, CUBIC_METRE = 1e3, 1e-8  # what one count of pressure and one count of angle stand for
SCALE = PASCAL / CUBIC_METRE  # what one count of a resistance, an inertance or a stiffness stands for
VOLUME = 2.4e-4  # of the node where the gauge sits [m^3]; with the modulus below it only makes up the capacitance
INDEX = 1.3  # polytropic index of air, held
SHARES = {"inertance": 0.75, "resistance": 0.5, "volume": 2.0 / 3.0}  # of the first lump where searches start


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

    def start(self, at: Situation) -> dict:
        return {"volume_flow": self.steady_flow}

    def evaluate(self, at: Situation) -> Contribution:
        q, p_a, p_b = at.state["volume_flow"], at.potential["a"], at.potential["b"]
        share = q / self.steady_flow
        drop = self.resistance * q + (self.steady_drop - self.resistance * self.steady_flow) * share * abs(share)
        mass = at.fluid.mass_flow(q, p_a, p_b)
        return Contribution({"a": -mass, "b": mass}, {}, {"volume_flow": (p_a - p_b - drop) / self.inertance})


def _circuit(line: AbstractComponent, actuator: AbstractComponent) -> jl.Circuit:
    """Supply, line, the volume where the gauge sits, and what the actuator takes."""
    oil = jl.Oil(bulk_modulus=1e9, density=850.0, polytropic_index=INDEX, mass="article")
    volume = jl.Line("gauge", jl.Vessel(volume=VOLUME))
    source = jl.PressureSource("source", 6e6)
    return jl.Circuit(oil, {"supply": source, "line": line, "volume": volume, "actuator": actuator})


ONE_LUMP = SupplyLine("source", "gauge", 2e8, 1.5e10, 1e-4, 2e6)
TWO_LUMPS = TwoLumpLine("source", "gauge", 1.5e8, 1.2e10, 4.7e7, 9.3e9, 4.7e-4, 1e-4, 2e6)
MEASURED = jl.FlowSource("gauge", "rate", gain=-1.0)
ARRESTED = ArrestedFlow("gauge", "approach", "clock", -1e-3, 3.5e-3)
RESISTANCE = jl.Free("line.resistance", (1e9, 2e11), transform="log")
INERTANCE = jl.Free("line.inertance", (1e7, 3e9), transform="log")
MODULUS = jl.Free("fluid.bulk_modulus", (1.01e8, 3e10), transform="log")
SECOND = [
    jl.Free("line.passage_resistance", (1e8, 2e11), transform="log"),
    jl.Free("line.passage_inertance", (2e6, 1e9), transform="log"),
    jl.Free("line.hose_volume", (2e-5, 5e-3), transform="log"),
]
LATE = jl.Free("rate.delay", (-8e-3, 8e-3), start=0.0)
STOP = [
    jl.Free("actuator.delay", (-8e-3, 8e-3), start=-1e-3),
    jl.Free("actuator.duration", (5e-4, 2e-2), start=3.5e-3, transform="log"),
]
AIR = jl.Free("fluid.air_fraction", (1e-5, 0.3), start=1e-2, transform="log")


def start_values(run: Ringdown, lumps: int) -> dict[str, float]:
    """Where searches start: frequency from the first half period, damping ratio 1/4, lumps by `SHARES`."""
    omega, drop = np.pi / run.half_period, (run.hold - run.first_pressure) * PASCAL
    resistance = 0.6 * max(drop, 0.05 * run.hold * PASCAL) / (run.speed * CUBIC_METRE)
    inertance = resistance / (2 * 0.25 * omega)
    stiffness = omega**2 * inertance  # 1/C of the whole
    whole = {"line.resistance": resistance, "line.inertance": inertance, "fluid.bulk_modulus": VOLUME * stiffness}
    if lumps == 1:
        return whole
    second = 1.0 - SHARES["volume"]
    return {
        "line.resistance": SHARES["resistance"] * resistance,
        "line.inertance": SHARES["inertance"] * inertance,
        "line.passage_resistance": (1.0 - SHARES["resistance"]) * resistance,
        "line.passage_inertance": (1.0 - SHARES["inertance"]) * inertance,
        "fluid.bulk_modulus": VOLUME * stiffness / second,
        "line.hose_volume": VOLUME * SHARES["volume"] / second,
    }


@dataclasses.dataclass(frozen=True)
class Structure:
    """A circuit, what of it is free in a run, in how many lumps, and whether the flow is the measured one."""

    circuit: jl.Circuit
    free: list[jl.Free]
    lumps: int
    measured: bool

    def recording(self, run: Ringdown) -> jl.Recording:
        """The run in the circuit's nominal units."""
        flow = {"rate": run.rate * CUBIC_METRE}
        if not self.measured:
            flow = {"approach": run.approach * CUBIC_METRE, "clock": run.clock}
        return jl.Recording(run.times, {"gauge.pressure": run.pressure * PASCAL, **flow}, name=f"run {run.run_id}")

    def own_numbers(self, run: Ringdown) -> dict[str, float]:
        """What is known of a run and not fitted: hold pressure, steady stroke, where the window starts."""
        flow = run.speed if self.measured else run.approach[0]
        return {
            "supply.pressure": run.hold * PASCAL,
            "line.steady_flow": flow * CUBIC_METRE,
            "line.steady_drop": (run.hold - run.first_pressure) * PASCAL,
            "initial.gauge.pressure": run.first_pressure * PASCAL,
        }

    def starts(self, run: Ringdown, moved: dict[str, float]) -> list[float]:
        """Start values in the order of `free`; moved: path -> factor; any at all moves delays by -2 ms as well."""
        known = start_values(run, self.lumps)
        found = []
        for one in self.free:
            value = float(known.get(one.paths[0], one.start or 0.0))
            value = value - 2e-3 * bool(moved) if one.transform == "identity" else value * moved.get(one.paths[0], 1.0)
            found.append(float(np.clip(value, *one.bounds)))
        return found


BASELINE, SHORT, MAIN, AIRY = "one lump", "two lumps, stop of 3.5 ms", "two lumps", "two lumps with air"
_ONE, _TWO = [RESISTANCE, INERTANCE, MODULUS], [RESISTANCE, INERTANCE, MODULUS, *SECOND]
STRUCTURES = {
    BASELINE: Structure(_circuit(ONE_LUMP, MEASURED), [*_ONE, LATE], 1, True),
    "one lump with air": Structure(_circuit(ONE_LUMP, MEASURED), [*_ONE, LATE, AIR], 1, True),
    "one lump, smooth stop": Structure(_circuit(ONE_LUMP, ARRESTED), [*_ONE, *STOP], 1, False),
    "two lumps, measured flow": Structure(_circuit(TWO_LUMPS, MEASURED), [*_TWO, LATE], 2, True),
    SHORT: Structure(_circuit(TWO_LUMPS, ARRESTED), [*_TWO, STOP[0]], 2, False),
    MAIN: Structure(_circuit(TWO_LUMPS, ARRESTED), [*_TWO, *STOP], 2, False),
    AIRY: Structure(_circuit(TWO_LUMPS, ARRESTED), [*_TWO, *STOP, AIR], 2, False),
}
