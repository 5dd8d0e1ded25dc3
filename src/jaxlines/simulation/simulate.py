"""One trajectory of a circuit, by diffrax."""

import functools
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from jaxlines.physics.fields import AbstractSignal, check_range, driven_of
from jaxlines.simulation.assembly import Plan, Values, compile_circuit, rates, ravel, unravel
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.observation import observe, quantities, sensor_units
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import cast, computing_in, is_traced
from jaxlines.simulation.result import STATUS, Simulation
from jaxlines.simulation.signals import Constant, Sampled, Step, as_signal


def implicit(solver: diffrax.AbstractSolver | None = None) -> diffrax.AbstractSolver:
    """An implicit solver for stiff circuits (small volumes behind large valves), with Newton's method inside.

    Args: solver: an implicit solver of diffrax; Kvaerno5 by default. diffrax 0.7.2 with optimistix 0.1.0
    rejects good steps with its default root finder, so that it is replaced here.
    """
    newton = diffrax.with_stepsize_controller_tols(optimistix.Newton)()
    if solver is None:
        return diffrax.Kvaerno5(root_finder=newton)
    return eqx.tree_at(lambda s: s.root_finder, solver, newton) if hasattr(solver, "root_finder") else solver


class Method(NamedTuple):
    """How to integrate: everything static about it."""

    solver: diffrax.AbstractSolver
    gradient: str
    max_steps: int

    def adjoint(self) -> diffrax.AbstractAdjoint:
        """How derivatives are taken: forward mode refuses reverse and the other way round."""
        if self.gradient == "forward":
            return diffrax.ForwardMode()
        # A checkpoint for every step, so that none is replayed: a replay differs in its last bits, now and then
        # accepts a step that was rejected, and from there the gradient is wrong (1 to 40 % were seen).
        return diffrax.RecursiveCheckpointAdjoint(checkpoints=self.max_steps)


def make_method(solver, gradient: str, max_steps: int) -> Method:
    """A checked method; Tsit5 when no solver is given."""
    if gradient not in ("forward", "reverse"):
        raise ValueError(f'gradient must be "forward" or "reverse", got {gradient!r}')
    if solver is not None and not isinstance(solver, diffrax.AbstractSolver):
        raise TypeError(
            f"solver must be a diffrax solver such as diffrax.Tsit5() or jaxlines.implicit(), got {solver!r}"
        )
    return Method(diffrax.Tsit5() if solver is None else implicit(solver), gradient, int(max_steps))


class Trajectory(NamedTuple):
    """What `integrate` returns: outputs (times, outputs), status code, step counts, lowest pressure seen [Pa]."""

    outputs: Any
    status: Any
    num_steps: Any
    num_rejected: Any
    lowest_pressure: Any


def _vector_field(t, y, args):
    """The scaled vector field for diffrax; args = (plan wrapper, values)."""
    plan, values = args
    potentials, states = unravel(plan.value, y)
    return ravel(plan.value, *rates(plan.value, values, t, potentials, states))


class _Static(eqx.Module):
    """Carries a static plan through a pytree."""

    value: Any = eqx.field(static=True)


def _status(result, outputs, lowest, fluid):
    """Status code of a trajectory; the first that applies."""
    air_free = fluid.air_fraction <= 0.0
    failed = jnp.where(result == diffrax.RESULTS.max_steps_reached, STATUS["max_steps"], STATUS["solver_failed"])
    code = jnp.where(air_free & (lowest < fluid.vapour_pressure), STATUS["tension"], STATUS["ok"])
    code = jnp.where(jnp.all(jnp.isfinite(outputs)), code, STATUS["non_finite"])
    return jnp.where(result == diffrax.RESULTS.successful, code, failed)


def _controller(values: Values, tolerance) -> diffrax.AbstractStepSizeController:
    """Adaptive steps that end on every jump and kink of the inputs.

    A step across samples of a noisy input can pass the error test by luck; ending on the samples makes the
    field smooth within each step, so that the tolerance means what it says. Where steps end does not change the
    solution, so that these times carry no derivative (it would grow from step to step).
    """
    controller = diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.3, icoeff=0.3)
    jumps = [jnp.ravel(s.jump_times()) for s in values.signals if np.size(s.jump_times())]
    knots = [jnp.ravel(s.knot_times()) for s in values.signals if np.size(s.knot_times())]
    if not jumps and not knots:
        return controller
    times = [jax.lax.stop_gradient(jnp.sort(jnp.concatenate(g))) if g else None for g in (knots, jumps)]
    return diffrax.ClipStepSizeController(controller, step_ts=times[0], jump_ts=times[1])


def integrate(plan: Plan, wanted: tuple[str, ...], method: Method, values: Values, times, tolerance) -> Trajectory:
    """Integrate a compiled circuit and observe it at times; pure, to be called inside jit.

    Args: times [s], shape (times,), not decreasing (repeats at the end are padding);
    tolerance: relative tolerance, and absolute tolerance of the scaled states.
    """
    hydraulic = np.asarray([i for i, (_, domain) in enumerate(plan.free_nodes) if domain == "hydraulic"], dtype=int)

    def save(t, y, args):
        potentials, states = unravel(plan, y)
        shown = observe(plan, args[1], wanted, t, potentials, states)
        lowest = jnp.min(potentials[hydraulic]) if hydraulic.size else jnp.asarray(jnp.inf, shown.dtype)
        return shown, lowest

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_vector_field),
        method.solver,
        t0=times[0],
        t1=times[-1],
        dt0=None,
        y0=ravel(plan, values.initial.potentials, values.initial.states),
        args=(_Static(plan), values),
        saveat=diffrax.SaveAt(ts=times, fn=save),
        stepsize_controller=_controller(values, tolerance),
        adjoint=method.adjoint(),
        max_steps=method.max_steps,
        throw=False,
    )
    outputs, lowest = solution.ys
    lowest = jnp.min(lowest)
    status = _status(solution.result, outputs, lowest, values.fluid)
    stats = solution.stats
    return Trajectory(outputs, status, stats["num_steps"], stats["num_rejected_steps"], lowest)


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _run(plan, wanted, method, values, times, tolerance):
    return integrate(plan, wanted, method, values, times, tolerance)


_LEVELS = {Sampled: ("values",), Constant: ("value",), Step: ("before", "after")}
"""Fields of a signal that hold values which it takes."""


def bind_inputs(circuit: Circuit, inputs: dict | None, times) -> dict[str, AbstractSignal]:
    """The external inputs of a circuit as signals, checked: all there, none too many, values in range."""
    needed, inputs = circuit.external_inputs(), dict(inputs or {})
    missing, unknown = sorted(set(needed) - set(inputs)), sorted(set(inputs) - set(needed))
    if missing:
        component, field = needed[missing[0]][0]
        raise ValueError(
            f"the circuit needs an input {missing[0]!r} (it drives {component}.{field}); given: {sorted(inputs) or 'none'}"
        )
    if unknown:
        raise ValueError(f"the circuit has no input {unknown[0]!r}; it has {sorted(needed) or 'none'}")
    bound = {name: as_signal(value, times) for name, value in inputs.items()}
    for name, places in needed.items():
        signal = bound[name]
        for component, field in places:
            metadata = driven_of(circuit.components[component])[field]
            for level in _LEVELS.get(type(signal), ()):
                check_range(f"input {name!r} ({component}.{field})", getattr(signal, level), metadata)
    return bound


def _wanted(circuit: Circuit, plan: Plan, outputs) -> dict[str, str]:
    """Names of the outputs and their units: those asked for, else all sensors, potentials and states."""
    units = {name: q.unit for name, q in quantities(plan).items()} | sensor_units(circuit, plan)
    if outputs is None:
        rooms = {name: q.room for name, q in quantities(plan).items()}
        return {name: unit for name, unit in units.items() if rooms.get(name) != "port"}
    return {resolve(name, units, "output"): units[resolve(name, units, "output")] for name in outputs}


def _checked_times(times):
    """Times as an array of two or more, strictly increasing."""
    times = times if isinstance(times, jax.Array) else np.asarray(times, dtype=float)
    if times.ndim != 1 or times.size < 2:
        raise ValueError(f"times must be a list of two or more times [s], got shape {times.shape}; batch with jax.vmap")
    if isinstance(times, np.ndarray) and not (np.all(np.isfinite(times)) and np.all(np.diff(times) > 0)):
        raise ValueError("times must be finite and strictly increasing [s]")
    return times


def simulate(
    circuit: Circuit,
    times,
    inputs: dict | None = None,
    *,
    initial: dict | None = None,
    outputs=None,
    solver: diffrax.AbstractSolver | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 100_000,
    gradient: str = "reverse",
    precision: str = "float64",
    throw: bool = True,
) -> Simulation:
    """Simulate a circuit and return what its sensors see at the requested times.

    Main arguments:
        circuit: what to simulate; its numbers may be traced by JAX (jit, grad, vmap).
        times: where to save [s], shape (times,), strictly increasing; the simulation starts at the first.
        inputs: name -> number, samples at `times` (joined linearly) or signal, for the external inputs.
        initial: name of a potential or state -> start value in SI, such as {"A.pressure": 2e6}; others start
            at atmospheric pressure, at rest, at zero.
        outputs: names of sensors and quantities ("A.pressure", "leak.a.flow"); by default all sensors,
            potentials and states.

    Other arguments:
        solver: a diffrax solver; Tsit5 by default, `jaxlines.implicit()` for stiff circuits.
        tolerance: relative tolerance; absolute tolerance of the states in units of their typical sizes.
        max_steps: limit of the step count.
        gradient: "reverse" (jax.grad) or "forward" (jax.jacfwd); each refuses the other.
        precision: "float64" or "float32".
        throw: raise when the trajectory fails; else look at `status`.

    Returns: a `Simulation`: outputs by name, status, step counts, `validity()`, `to_xarray()`.
    Raises: ValueError and KeyError for a wrong call; RuntimeError (with `throw`) for a failed trajectory.
    """
    times = _checked_times(times)
    traced = is_traced(circuit, times, inputs, initial)
    with computing_in(precision, circuit, times, inputs, initial):
        bound = bind_inputs(circuit, inputs, times)
        plan, values = compile_circuit(circuit, initial, bound)
        wanted = _wanted(circuit, plan, outputs)
        method = make_method(solver, gradient, max_steps)
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
