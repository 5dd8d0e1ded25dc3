"""One trajectory of a circuit, by diffrax."""

import functools

import diffrax
import jax
import numpy as np

from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.integration import integrate, make_method
from jaxlines.simulation.observation import quantities, sensor_units, shown_by_default
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.plan import Plan
from jaxlines.simulation.precision import cast, computing_in, is_traced
from jaxlines.simulation.result import Simulation
from jaxlines.simulation.segments import choose_segments
from jaxlines.simulation.steady import steady_state


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _run(plan, wanted, method, values, times, tolerance):
    return integrate(plan, wanted, method, values, times, tolerance)


def wanted_units(circuit: Circuit, plan: Plan, outputs) -> dict[str, str]:
    """Names of the outputs and their units: those asked for, else all sensors, potentials and states."""
    units = {name: q.unit for name, q in quantities(plan).items()} | sensor_units(circuit, plan)
    if outputs is None:
        return {name: units[name] for name in (*shown_by_default(plan), *circuit.sensors())}
    return {resolve(name, units, "output"): units[resolve(name, units, "output")] for name in outputs}


def checked_times(times):
    """Times as an array of two or more, strictly increasing."""
    times = times if isinstance(times, jax.Array) else np.asarray(times, dtype=float)
    if times.ndim != 1 or times.size < 2:
        raise ValueError(f"times must be a list of two or more times [s], got shape {times.shape}; batch with jax.vmap")
    if isinstance(times, np.ndarray) and not (np.all(np.isfinite(times)) and np.all(np.diff(times) > 0)):
        raise ValueError("times must be finite and strictly increasing [s]")
    return times


def _start(circuit: Circuit, bound: dict, times, initial: dict | str | None, precision: str) -> dict | None:
    """The start values by name, those of the steady state when that is asked for."""
    if not isinstance(initial, str):
        return initial
    if initial != "steady":
        raise ValueError(f'initial must be a table of start values or "steady", got {initial!r}')
    return steady_state(circuit, bound, time=times[0], precision=precision).initial


def simulate(
    circuit: Circuit,
    times,
    inputs: dict | None = None,
    *,
    initial: dict | str | None = None,
    outputs=None,
    solver: diffrax.AbstractSolver | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 100_000,
    max_step: float | None = None,
    gradient: str = "reverse",
    precision: str = "float64",
    throw: bool = True,
    highest_frequency: float | None = None,
) -> Simulation:
    """Simulate a circuit and return what its sensors see at the requested times.

    Main arguments:
        circuit: what to simulate; its numbers may be traced by JAX (jit, grad, vmap).
        times: where to save [s], shape (times,), strictly increasing; the simulation starts at the first.
        inputs: name -> number, samples at `times` (joined linearly) or signal, for the external inputs.
        initial: name of a potential or state -> start value in SI, such as {"A.pressure": 2e6}; others start
            at atmospheric pressure, at rest, at zero. "steady" starts from the `steady_state` of the inputs as
            they are at the first time.
        outputs: names of sensors and quantities ("A.pressure", "leak.a.flow"); by default all sensors,
            potentials and states.

    Other arguments:
        solver: a diffrax solver; Tsit5 by default, `jaxlines.implicit()` for stiff circuits.
        tolerance: relative tolerance; absolute tolerance of the states in units of their typical sizes.
        max_steps: limit of the step count.
        max_step: longest step [s]. Give it (well below the fastest time constant) when you differentiate through
            a circuit that rests: where nothing moves, steps grow without limit, and derivatives with them. `fit`
            does not need it, since it holds derivatives to the tolerance.
        gradient: "reverse" (jax.grad) or "forward" (jax.jacfwd); each refuses the other.
        precision: "float64" or "float32".
        throw: raise when the trajectory fails; else look at `status`.
        highest_frequency: that must be right [Hz], for lines with segments="auto" (see `choose_segments`).

    Returns: a `Simulation`: outputs by name, status, step counts, `validity()`, `to_xarray()`.
    Raises: ValueError and KeyError for a wrong call; RuntimeError (with `throw`) for a failed trajectory.
    """
    times = checked_times(times)
    traced = is_traced(circuit, times, inputs, initial)
    with computing_in(precision, circuit, times, inputs, initial):
        bound = bind_inputs(circuit, inputs, times)
        initial = _start(circuit, bound, times, initial, precision)
        circuit = choose_segments(circuit, times, bound, initial=initial, highest_frequency=highest_frequency)
        plan, values = compile_circuit(circuit, initial, bound)
        wanted = wanted_units(circuit, plan, outputs)
        method = make_method(solver, gradient, max_steps, max_step)
        values, times, tolerance = cast((values, times, np.asarray(tolerance)), precision)
        found = _run(plan, tuple(wanted), method, values, times, tolerance)
        if not traced:
            found = jax.tree.map(np.asarray, found)
    named = {name: found.outputs[..., i] for i, name in enumerate(wanted)}
    simulation = Simulation(
        times, named, found.status, found.num_steps, found.num_rejected, found.lowest_pressure, circuit, bound, wanted
    )
    if throw and not traced:
        simulation.raise_if_failed()
    return simulation
