"""Sampling instants: steps that end just before them, states that change there.

Instants are start + k period with k = 0, 1, 2, ...; the one at the start is part of the initial state.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp

from jaxlines.physics.controllers import AbstractSampledController
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.signals import jump_time


def clock_of(plan: Plan, values: Values, start) -> "Clock | None":
    """The instants of the sampled controllers of a circuit; None when it has none."""
    sampled = [values.kinds[controller.kind] for controller in plan.controllers if controller.sampled]
    periods = [jnp.ravel(law.period) for law in sampled if isinstance(law, AbstractSampledController)]
    return Clock(start, jump_time(jnp.concatenate(periods))) if periods else None


class Clock(eqx.Module):
    """The instants of some controllers: the start [s] and their periods [s], which cannot be differentiated."""

    start: Any
    periods: Any

    def due(self, t, period):
        """Whether t is a sampling instant after the start, up to rounding."""
        period = jump_time(period)
        count = jnp.round((t - self.start) / period)
        return (count > 0.0) & (jnp.abs(t - self.start - count * period) <= _rounding(t, self.start))

    def before(self, instant):
        """Where the step before an instant ends: what is saved at the instant, up to rounding, is what was sampled."""
        return instant - 2.0 * _rounding(instant, self.start)

    @property
    def after(self):
        """A time that is short against all periods [s]."""
        return 0.125 * jnp.min(self.periods)

    def next(self, t):
        """The first instant of any controller after t."""
        count = jnp.round((t - self.start) / self.periods)
        instant = self.start + count * self.periods
        late = instant > t + _rounding(t, self.start)
        return jnp.min(self.start + (count + jnp.where(late, 0.0, 1.0)) * self.periods)


def _rounding(t, start):
    """By how much an instant may be off for its rounding; far less than any step."""
    return 16.0 * jnp.finfo(jnp.result_type(t)).eps * jnp.maximum(jnp.abs(t), jnp.abs(start))


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
    """Step sizes of another controller, cut so that steps end just before sampling instants and begin at them.

    The value at an instant belongs to the step that begins there, so that what is saved at an instant is what was
    sampled.
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
        return SamplingSteps(self.controller.wrap(direction), self.clock)

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        t1, state = self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)
        return jnp.minimum(t1, self.clock.before(self.clock.next(t0))), state

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        keep, next_t0, next_t1, made_jump, state, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )
        instant = self.clock.next(t0)
        arrived = keep & (next_t0 < instant) & (next_t0 >= self.clock.before(instant))
        next_t0 = jnp.where(arrived, instant, next_t0)
        next_t1 = jnp.maximum(next_t1, eqxi.nextafter(next_t0))
        next_t1 = jnp.minimum(next_t1, self.clock.before(self.clock.next(next_t0)))
        return keep, next_t0, next_t1, made_jump | arrived, state, result
