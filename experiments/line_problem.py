"""The line variant of the ensemble benchmark: a valve feeds a volume with a leak through a line of 40 segments.

A 2/2 valve between the supply and the line throttles with the size of the servo axis's command; at the far end of the
pipe a vessel drains through a laminar leak. Each change of the command sends waves along the line. Nine numbers vary.
81 states of the line and its ends, two of the valve; the output is the pressure at the far end.
"""

import itertools

import jax
import numpy as np
from scipy.integrate import solve_ivp
from servo_axis import RETURN, SUPPLY, Compiled, Reference, command, compiled, times

import jaxlines as jl
from jaxlines.simulation.plan import ravel, scales, unravel
from jaxlines.simulation.vector_field import rates, starting_point

SEGMENTS = 40
START = 5e6
"""Pressure everywhere at the start [Pa absolute]."""
OUTPUT = "C"


def circuit(segments: int = SEGMENTS) -> jl.Circuit:
    """The circuit; input "opening"."""
    return jl.Circuit(
        jl.Oil(1.29e9, 850.0, 30e-6, air_fraction=0.003, polytropic_index=1.2),
        {
            "supply": jl.PressureSource("P", SUPPLY),
            "return": jl.Tank("T", RETURN),
            "valve": jl.Valve22("P", "A", "opening", 2e-5, natural_frequency=250.0, damping_ratio=0.7, order="second"),
            "line": jl.Line("A", jl.Pipe(20.0, 0.02, 0.026), to="C", segments=segments),
            "vessel": jl.Line("C", jl.Vessel(1e-3)),
            "leak": jl.LaminarLeak("C", "T", conductance=4e-11),
        },
    )


def initial() -> dict[str, float]:
    """Start values by name; the line starts between those of its ends, at rest."""
    return {"A.pressure": START, "C.pressure": START}


def inputs() -> dict[str, jl.Sampled]:
    """Inputs by name."""
    return {"opening": jl.Sampled(times, np.abs(command))}


def varied(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """The nine varied numbers of `count` lanes, path -> array (count,); more lanes leave the first as they are."""
    draw = iter(np.random.default_rng(seed).uniform(size=(count, 9)).T)

    def between(low, high):
        return low + (high - low) * next(draw)

    return {
        "fluid.bulk_modulus": 1.29e9 * between(0.8, 1.1),
        "fluid.air_fraction": 10.0 ** between(-4.0, -2.0),
        "fluid.polytropic_index": between(1.0, 1.4),
        "line.parts.0.length": between(15.0, 25.0),
        "line.parts.0.inner_diameter": between(0.018, 0.022),
        "vessel.parts.0.volume": 1e-3 * between(0.5, 2.0),
        "leak.conductance": 4e-11 * between(0.8, 1.2),
        "valve.area": 2e-5 * between(0.8, 1.2),
        "valve.natural_frequency": 2.0 * np.pi * between(20.0, 60.0),
    }


def program(segments: int = SEGMENTS) -> Compiled:
    """The circuit compiled with places for the varied numbers."""
    return compiled(circuit(segments), varied(1), initial(), inputs())


def reference(columns: dict[str, np.ndarray], lanes, tolerance: float = 1e-9, segments: int = SEGMENTS) -> Reference:
    """Pressure at the far end in chosen lanes by SciPy's DOP853, started afresh at every knot of the command.

    It integrates the circuit's own vector field: what it checks is the integration, not the model.
    """
    with jax.enable_x64(True):
        made, numbers = program(segments), np.stack(list(columns.values()), axis=-1)[np.asarray(lanes)]
        plan = made.plan
        place = [name for name, _ in plan.free_nodes].index(OUTPUT)
        begin = jax.jit(lambda values: ravel(plan, *starting_point(plan, values, 0.0)))
        field = jax.jit(lambda t, y, values: ravel(plan, *rates(plan, values, t, *unravel(plan, y))))
        shown = []
        for n in numbers:
            values = made.values(n)
            path = [np.asarray(begin(values))]
            for first, last in itertools.pairwise(times):

                def rates_at(t, y, values=values):
                    return np.asarray(field(t, y, values))

                span = (first, last)
                with np.errstate(all="ignore"):  # trial steps that are rejected may leave the range of the gas law
                    found = solve_ivp(rates_at, span, path[-1], method="DOP853", rtol=tolerance, atol=tolerance)
                if not found.success:
                    raise RuntimeError(f"no reference at {first:g} s: {found.message}")
                path.append(found.y[:, -1])
            shown.append(np.stack(path)[:, place] * scales(plan)[place])
    return Reference(np.asarray(lanes), np.stack(shown))
