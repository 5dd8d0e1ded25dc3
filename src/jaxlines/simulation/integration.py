"""The time integration: a compiled circuit from its start to its outputs, alone or with exact sensitivities."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from jaxlines.simulation.observation import observe
from jaxlines.simulation.plan import Plan, Values, ravel, unravel
from jaxlines.simulation.result import STATUS
from jaxlines.simulation.sampling import Clock, SamplingSolver, SamplingSteps, clock_of
from jaxlines.simulation.vector_field import rates, sampled, starting_point


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
    max_step: float | None = None

    def adjoint(self) -> diffrax.AbstractAdjoint:
        """How derivatives are taken: forward mode refuses reverse and the other way round."""
        return diffrax.ForwardMode() if self.gradient == "forward" else diffrax.RecursiveCheckpointAdjoint()


def make_method(solver, gradient: str, max_steps: int, max_step: float | None = None) -> Method:
    """A checked method; Tsit5 when no solver is given."""
    if gradient not in ("forward", "reverse"):
        raise ValueError(f'gradient must be "forward" or "reverse", got {gradient!r}')
    if solver is not None and not isinstance(solver, diffrax.AbstractSolver):
        raise TypeError(
            f"solver must be a diffrax solver such as diffrax.Tsit5() or jaxlines.implicit(), got {solver!r}"
        )
    if "MultiTerm" in str(getattr(solver, "term_structure", "")):
        name = type(solver).__name__
        raise TypeError(f"{name} splits the equations in two, which circuits do not: use Kvaerno5 or Tsit5")
    if max_step is not None and not max_step > 0.0:
        raise ValueError(f"max_step must be positive, got {max_step:g} s")
    step = None if max_step is None else float(max_step)
    return Method(diffrax.Tsit5() if solver is None else implicit(solver), gradient, int(max_steps), step)


class Trajectory(NamedTuple):
    """What `integrate` returns: outputs (times, outputs), status code, step counts, lowest pressure seen [Pa]."""

    outputs: Any
    status: Any
    num_steps: Any
    num_rejected: Any
    lowest_pressure: Any


def _field(plan: Plan, t, y, values: Values):
    """The vector field of the scaled states."""
    return ravel(plan, *rates(plan, values, t, *unravel(plan, y)))


def _start(plan: Plan, values: Values, t):
    """The scaled states at the start, which is the first sampling instant of every sampled controller."""
    potentials, states = starting_point(plan, values, t)
    return ravel(plan, potentials, sampled(plan, values, t, lambda period: True, potentials, states))


def _sample(plan: Plan, clock: Clock | None, t, y, values: Values):
    """The scaled states after the sampling instants at time t."""
    assert clock is not None
    potentials, states = unravel(plan, y)
    return ravel(plan, potentials, sampled(plan, values, t, functools.partial(clock.due, t), potentials, states))


def _show(plan: Plan, wanted: tuple[str, ...], t, y, values: Values):
    """The wanted outputs in a state."""
    return observe(plan, values, wanted, t, *unravel(plan, y))


def _show_late(plan: Plan, name: str, start, t, y, values: Values):
    """What a sensor with a delay shows later of a state at time t, with the derivative in the delay.

    Where to look is no derivative's business: the slope of what is shown stands for it.
    """

    def shown(t, y):
        return _show(plan, (name,), t, y, values)[0]

    delay = values.sensors[name].delay
    now, slope = jax.jvp(shown, (t, y), (jnp.ones_like(t), _field(plan, t, y, values)))
    return now - jnp.where(t > start, slope, 0.0) * (delay - jax.lax.stop_gradient(delay))


def _lowest_pressure(plan: Plan, y):
    """Lowest pressure of the free hydraulic nodes [Pa]; infinite when there is none."""
    hydraulic = np.asarray([i for i, (_, domain) in enumerate(plan.free_nodes) if domain == "hydraulic"], dtype=int)
    return jnp.min(unravel(plan, y)[0][hydraulic]) if hydraulic.size else jnp.asarray(jnp.inf, y.dtype)


def _status(result, outputs, lowest, fluid):
    """Status code of a trajectory; the first that applies."""
    air_free = fluid.air_content() <= 0.0
    failed = jnp.where(result == diffrax.RESULTS.max_steps_reached, STATUS["max_steps"], STATUS["solver_failed"])
    code = jnp.where(air_free & (lowest < fluid.vapour_pressure), STATUS["tension"], STATUS["ok"])
    code = jnp.where(jnp.all(jnp.isfinite(outputs)), code, STATUS["non_finite"])
    return jnp.where(result == diffrax.RESULTS.successful, code, failed)


def _controller(values: Values, tolerance, max_step: float | None, clock: Clock | None):
    """Adaptive steps that end on every jump and kink of the inputs, and at every sampling instant.

    A step across samples of a noisy input can pass the error test by luck; ending on the samples makes the
    field smooth within each step, so that the tolerance means what it says. Where steps end does not change the
    solution, so that these times carry no derivative (it would grow from step to step).
    """
    controller = diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.3, icoeff=0.3, dtmax=max_step)
    if clock is not None:
        controller = SamplingSteps(controller, clock)  # pyright: ignore[reportCallIssue]
    signals = values.every_signal()
    jumps = [jnp.ravel(s.jump_times()) for s in signals if np.size(s.jump_times())]
    knots = [jnp.ravel(s.knot_times()) for s in signals if np.size(s.knot_times())]
    if not jumps and not knots:
        return controller
    times = [jax.lax.stop_gradient(jnp.sort(jnp.concatenate(g))) if g else None for g in (knots, jumps)]
    return diffrax.ClipStepSizeController(controller, step_ts=times[0], jump_ts=times[1])


class Run(NamedTuple):
    """What is integrated: the field f(t, y), the state at the start, what is shown of it, and what sampling does to it.

    late: sensors with a delay by the column of their output: what they show of a state, and their delay [s].
    """

    field: Callable
    start: Any
    show: Callable
    sample: Callable
    late: dict[int, tuple[Callable, Any]]


def _solve(method: Method, adjoint, run: Run, values: Values, clock: Clock | None, times, tolerance):
    """diffrax with everything that the two ways of integrating share: solution, what was shown at times, and late."""
    solver, end = method.solver, times[-1]
    if clock is not None:
        solver, end = SamplingSolver(solver, run.sample, clock), end + clock.margin
    subs = [diffrax.SubSaveAt(ts=times, fn=lambda t, y, args: run.show(t, y))]
    for late, delay in run.late.values():
        earlier = jax.lax.stop_gradient(jnp.maximum(times - delay, times[0]))
        subs.append(diffrax.SubSaveAt(ts=earlier, fn=lambda t, y, args, late=late: late(t, y)))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: run.field(t, y)),
        solver,
        t0=times[0],
        t1=end,
        dt0=None,
        y0=run.start,
        saveat=diffrax.SaveAt(subs=subs),
        stepsize_controller=_controller(values, tolerance, method.max_step, clock),
        adjoint=adjoint,
        max_steps=method.max_steps,
        throw=False,
    )
    assert solution.ys is not None
    shown, *late = solution.ys
    return solution, shown, dict(zip(run.late, late, strict=True))


def _with_late(shown, late: dict):
    """Outputs (times, outputs, ...) with the columns of the sensors that have a delay."""
    for column, values in late.items():
        shown = shown.at[:, column].set(values)
    return shown


def _delayed(plan: Plan, wanted: tuple[str, ...]) -> dict[int, str]:
    """Column -> name of the wanted sensors that have a delay."""
    delayed = {sensor.name for sensor in plan.sensors if sensor.delayed}
    return {column: name for column, name in enumerate(wanted) if name in delayed}


def _trajectory(solution: diffrax.Solution, outputs, lowest, values: Values) -> Trajectory:
    """The outputs with their status."""
    lowest = jnp.min(lowest)
    status = _status(solution.result, outputs, lowest, values.fluid)
    return Trajectory(outputs, status, solution.stats["num_steps"], solution.stats["num_rejected_steps"], lowest)


def integrate(plan: Plan, wanted: tuple[str, ...], method: Method, values: Values, times, tolerance) -> Trajectory:
    """Integrate a compiled circuit and observe it at times; pure, to be called inside jit.

    Args: times [s], shape (times,), not decreasing (repeats at the end are padding);
    tolerance: relative tolerance, and absolute tolerance of the scaled states.
    """

    clock = clock_of(plan, values, times[0])

    def show(t, y):
        return _show(plan, wanted, t, y, values), _lowest_pressure(plan, y)

    def field(t, y):
        return _field(plan, t, y, values)

    def sample(t, y):
        return _sample(plan, clock, t, y, values)

    late = {
        column: (lambda t, y, name=name: _show_late(plan, name, times[0], t, y, values), values.sensors[name].delay)
        for column, name in _delayed(plan, wanted).items()
    }
    run = Run(field, _start(plan, values, times[0]), show, sample, late)
    solution, (outputs, lowest), seen_late = _solve(method, method.adjoint(), run, values, clock, times, tolerance)
    return _trajectory(solution, _with_late(outputs, seen_late), lowest, values)


def integrate_with_sensitivities(
    plan: Plan, wanted: tuple[str, ...], method: Method, rebuild, leaves, slopes, times, tolerance
) -> tuple[Trajectory, Any]:
    """Integrate a circuit together with its forward sensitivity equations, all under error control.

    With values = rebuild(leaves) and y' = f(y, leaves), each parameter i adds S_i' = (df/dy) S_i + (df/dleaves) l_i,
    where l_i = d leaves / d parameter i (`slopes`, each leaf with a leading axis of parameters).

    Differentiating the solver instead leaves the sensitivities without error control: where the solution rests, its
    steps grow until the sensitivities of the fast modes are wrong or diverge. Parameters should be scaled so that
    a change of one is a large change (the width of their bounds): S is then held to the tolerance with y.

    Returns: the trajectory, and d outputs / d parameters, shape (times, outputs, parameters).
    Reference: Hindmarsh et al., "SUNDIALS", ACM Trans. Math. Softw. 31, 2005 (simultaneous corrector of CVODES).
    """
    values = rebuild(leaves)
    clock = clock_of(plan, values, times[0])
    start, start_slopes = _pushed(lambda leaves: _start(plan, rebuild(leaves), times[0]), (leaves,), (slopes,))
    size, count = start.size, start_slopes.shape[0]

    def split(y):
        return y[:size], y[size:].reshape(count, size)

    def joined(state, tangents):
        return jnp.concatenate([state, tangents.ravel()])

    def pushed(function, y):
        """A function of states and values, with its derivatives in all parameters."""
        state, tangents = split(y)
        return _pushed(lambda state, leaves: function(state, rebuild(leaves)), (state, leaves), (tangents, slopes))

    def field(t, y):
        return joined(*pushed(lambda state, values: _field(plan, t, state, values), y))

    def sample(t, y):
        return joined(*pushed(lambda state, values: _sample(plan, clock, t, state, values), y))

    def show(t, y):
        shown, shown_slopes = pushed(lambda state, values: _show(plan, wanted, t, state, values), y)
        return shown, _lowest_pressure(plan, split(y)[0]), shown_slopes.T

    def show_late(name, t, y):
        return pushed(lambda state, values: _show_late(plan, name, times[0], t, state, values), y)

    late = {
        column: (functools.partial(show_late, name), values.sensors[name].delay)
        for column, name in _delayed(plan, wanted).items()
    }
    run = Run(field, joined(start, start_slopes), show, sample, late)
    solution, (outputs, lowest, output_slopes), seen_late = _solve(
        method, diffrax.ForwardMode(), run, values, clock, times, tolerance
    )
    outputs = _with_late(outputs, {column: shown for column, (shown, _) in seen_late.items()})
    output_slopes = _with_late(output_slopes, {column: slope for column, (_, slope) in seen_late.items()})
    return _trajectory(solution, outputs, lowest, values), output_slopes


def _pushed(function, primals: tuple, tangents: tuple):
    """The value of a function and its derivatives along several directions (leading axis of the tangents)."""
    value = function(*primals)
    pushed = jax.vmap(lambda *direction: jax.jvp(function, primals, direction)[1])(*tangents)
    return value, pushed
