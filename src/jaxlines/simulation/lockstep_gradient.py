"""Outputs of an ensemble as a function of its columns that is differentiable in reverse."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxlines.simulation.bound_field import BoundField
from jaxlines.simulation.ensemble_program import LaneProgram, marched, small_field
from jaxlines.simulation.lockstep import explicit_interval, march
from jaxlines.simulation.lockstep_adjoint import count_parts, march_adjoint, march_steps, outputs_of_steps
from jaxlines.simulation.plan import Values


def lane_outputs(program: LaneProgram, values: Values, grid, steps: int) -> Callable:
    """A function of the columns that gives outputs (samples, observed, lanes), differentiable in reverse."""
    if not program.small or program.engine != "explicit":
        by_transposing = lambda columns: marched(program, values, columns, grid, steps)[0]  # noqa: E731
        # The implicit engine decides itself what it computes again in reverse.
        return by_transposing if program.engine == "implicit" else jax.checkpoint(by_transposing)

    def bound(columns, derivatives=""):
        return small_field(program, values, columns, grid[0, -1], derivatives)

    @jax.custom_vjp
    def outputs(columns):
        field = bound(columns)
        return march(field, explicit_interval, grid, steps, field.start(), jnp.zeros(field.shape, grid.dtype))[0]

    def forward(columns):
        field = bound(columns)
        if count_parts(field, grid, steps) > 1:
            stored, shown = march_states(field, grid, steps)
        else:
            stored = march_steps(field, grid[1:], steps, field.start())
            shown = outputs_of_steps(field, grid, stored)
        return shown, (columns, stored)

    def backward(kept, given):
        columns, stored = kept
        return (march_adjoint(bound(columns, "pulled"), grid, steps, stored, given),)

    outputs.defvjp(forward, backward)
    return outputs


class _Seen:
    """A field with its states shown before its outputs."""

    def __init__(self, field: BoundField):
        self._field = field
        self.signals, self.rates, self.total, self.shape = field.signals, field.rates, field.total, field.shape

    def outputs(self, signals, state):
        return state, self._field.outputs(signals, state)


def march_states(field: BoundField, grid, steps):
    """States at the samples, one array (samples, lanes) each, and the outputs (samples, observed, lanes)."""
    start = field.start()
    return march(_Seen(field), explicit_interval, grid, steps, start, jnp.zeros_like(start[0]))[0]
