"""The time integration: a compiled circuit from its start to its outputs, alone or with exact sensitivities."""

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
from jaxlines.simulation.vector_field import rates, starting_point


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
    """The scaled states at the start."""
    return ravel(plan, *starting_point(plan, values, t))


def _show(plan: Plan, wanted: tuple[str, ...], t, y, values: Values):
    """The wanted outputs in a state."""
    return observe(plan, values, wanted, t, *unravel(plan, y))


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


def _controller(values: Values, tolerance, max_step: float | None) -> diffrax.AbstractStepSizeController:
    """Adaptive steps that end on every jump and kink of the inputs.

    A step across samples of a noisy input can pass the error test by luck; ending on the samples makes the
    field smooth within each step, so that the tolerance means what it says. Where steps end does not change the
    solution, so that these times carry no derivative (it would grow from step to step).
    """
    controller = diffrax.PIDController(rtol=tolerance, atol=tolerance, pcoeff=0.3, icoeff=0.3, dtmax=max_step)
    jumps = [jnp.ravel(s.jump_times()) for s in values.signals if np.size(s.jump_times())]
    knots = [jnp.ravel(s.knot_times()) for s in values.signals if np.size(s.knot_times())]
    if not jumps and not knots:
        return controller
    times = [jax.lax.stop_gradient(jnp.sort(jnp.concatenate(g))) if g else None for g in (knots, jumps)]
    return diffrax.ClipStepSizeController(controller, step_ts=times[0], jump_ts=times[1])


def _solve(method: Method, adjoint, field, start, save, values: Values, times, tolerance) -> diffrax.Solution:
    """diffrax with everything that the two ways of integrating share."""
    return diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: field(t, y)),
        method.solver,
        t0=times[0],
        t1=times[-1],
        dt0=None,
        y0=start,
        saveat=diffrax.SaveAt(ts=times, fn=lambda t, y, args: save(t, y)),
        stepsize_controller=_controller(values, tolerance, method.max_step),
        adjoint=adjoint,
        max_steps=method.max_steps,
        throw=False,
    )


def _saved(solution: diffrax.Solution) -> tuple:
    """What was saved at the requested times."""
    assert solution.ys is not None
    return solution.ys


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

    def save(t, y):
        return _show(plan, wanted, t, y, values), _lowest_pressure(plan, y)

    def field(t, y):
        return _field(plan, t, y, values)

    solution = _solve(method, method.adjoint(), field, _start(plan, values, times[0]), save, values, times, tolerance)
    outputs, lowest = _saved(solution)
    return _trajectory(solution, outputs, lowest, values)


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
    start, start_slopes = _pushed(lambda leaves: _start(plan, rebuild(leaves), times[0]), (leaves,), (slopes,))
    size, count = start.size, start_slopes.shape[0]

    def split(y):
        return y[:size], y[size:].reshape(count, size)

    def field(t, y):
        state, tangents = split(y)
        rate, rate_slopes = _pushed(
            lambda state, leaves: _field(plan, t, state, rebuild(leaves)), (state, leaves), (tangents, slopes)
        )
        return jnp.concatenate([rate, rate_slopes.ravel()])

    def save(t, y):
        state, tangents = split(y)
        shown, shown_slopes = _pushed(
            lambda state, leaves: _show(plan, wanted, t, state, rebuild(leaves)), (state, leaves), (tangents, slopes)
        )
        return shown, _lowest_pressure(plan, state), shown_slopes.T

    start = jnp.concatenate([start, start_slopes.ravel()])
    solution = _solve(method, diffrax.ForwardMode(), field, start, save, values, times, tolerance)
    outputs, lowest, output_slopes = _saved(solution)
    return _trajectory(solution, outputs, lowest, values), output_slopes


def _pushed(function, primals: tuple, tangents: tuple):
    """The value of a function and its derivatives along several directions (leading axis of the tangents)."""
    value = function(*primals)
    pushed = jax.vmap(lambda *direction: jax.jvp(function, primals, direction)[1])(*tangents)
    return value, pushed
