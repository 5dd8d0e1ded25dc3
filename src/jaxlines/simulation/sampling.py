"""Sampling instants: steps that end just before them, states that change there.

Instants are start + k period with k = 0, 1, 2, ...; the one at the start is part of the initial state.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from jaxlines.physics.controllers import AbstractSampledController
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.signals import jump_time


def clock_of(plan: Plan, values: Values, start) -> "Clock | None":
    """The instants of the sampled controllers of a circuit; None when it has none."""
    sampled = [values.kinds[controller.kind] for controller in plan.controllers if controller.sampled]
    periods = [jnp.ravel(law.sampling_period()) for law in sampled if isinstance(law, AbstractSampledController)]
    return Clock(start, jump_time(jnp.concatenate(periods))) if periods else None


class Clock(eqx.Module):
    """The instants of some controllers: the start [s] and their periods [s], which cannot be differentiated."""

    start: Any
    periods: Any

    def _blur(self, t):
        """Times so close are one, however they were rounded: a knot of an input, a saved time, an instant."""
        return 32.0 * jnp.finfo(jnp.result_type(t)).eps * jnp.maximum(jnp.abs(t), jnp.abs(self.start))

    def due(self, t, period):
        """Whether t is a sampling instant after the start."""
        period = jump_time(period)
        count = jnp.round((t - self.start) / period)
        return (count > 0.0) & (jnp.abs(t - self.start - count * period) <= 1.5 * self._blur(t))

    def next(self, t):
        """The first instant of any controller after t."""
        count = jnp.round((t - self.start) / self.periods)
        late = self.start + count * self.periods > t + 0.5 * self._blur(t)
        return jnp.min(self.start + (count + jnp.where(late, 0.0, 1.0)) * self.periods)

    def around(self, instant):
        """Where the step before an instant ends and the one after it begins; nothing happens in between."""
        return instant - self._blur(instant), instant + self._blur(instant)

    def shortest(self, t):
        """Length of a step that leaves an instant behind, so that it is not met again [s]."""
        return 4.0 * self._blur(t)

    @property
    def margin(self):
        """A time that is short against all periods [s]."""
        return 0.125 * jnp.min(self.periods)


class SamplingSolver(diffrax.AbstractWrappedSolver):
    """A solver that samples before it makes a step from an instant.

    sample(t, y): y after the instants at time t.
    """

    solver: diffrax.AbstractSolver
    sample: Callable
    clock: Clock

    @property
    def term_structure(self):
        return self.solver.term_structure

    @property
    def interpolation_cls(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.solver.interpolation_cls

    # diffrax sets these: tolerances of an implicit solver's root finder, the kind of loop that an adjoint needs.
    @property
    def root_finder(self):
        return self.solver.root_finder  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def scan_kind(self):
        return self.solver.scan_kind  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def term_compatible_contr_kwargs(self):
        return self.solver.term_compatible_contr_kwargs

    def order(self, terms):
        return self.solver.order(terms)

    def strong_order(self, terms):
        return self.solver.strong_order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        return self.solver.init(terms, t0, t1, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        due = jnp.any(self.clock.due(t0, self.clock.periods))
        y0 = jax.lax.cond(due, self.sample, lambda t, y: y, t0, y0)
        return self.solver.step(terms, t0, t1, y0, args, solver_state, made_jump | due)

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)


class SamplingSteps(diffrax.AbstractAdaptiveStepSizeController):
    """Step sizes of another controller, cut so that steps end just before sampling instants and begin just after them.

    What is saved at an instant belongs to the step that begins there: it is what was sampled.
    """

    controller: diffrax.AbstractAdaptiveStepSizeController
    clock: Clock

    @property
    def rtol(self):
        return self.controller.rtol

    @property
    def atol(self):
        return self.controller.atol

    @property
    def norm(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.controller.norm

    def wrap(self, direction):
        return SamplingSteps(self.controller.wrap(direction), self.clock)  # pyright: ignore[reportCallIssue]

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        t1, state = self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return jnp.minimum(t1, self.clock.around(self.clock.next(t0))[0]), state

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        keep, next_t0, next_t1, made_jump, state, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )
        before, after = self.clock.around(self.clock.next(t0))
        arrived = keep & (next_t0 >= before)
        next_t0 = jnp.where(arrived, after, next_t0)
        next_t1 = jnp.where(arrived, jnp.maximum(next_t1, after + self.clock.shortest(after)), next_t1)
        next_t1 = jnp.minimum(next_t1, self.clock.around(self.clock.next(next_t0))[0])
        return keep, next_t0, next_t1, made_jump | arrived, state, result
