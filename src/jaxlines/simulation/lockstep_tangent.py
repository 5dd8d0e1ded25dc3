"""Forward sensitivities of many lanes in step, from the partial derivatives of the vector field.

Differentiating each stage of d <- A_i d + h f, y <- y + B_i d in the varied numbers p gives the same scheme for
S = dy/dp: D <- A_i D + h (J S + P), S <- S + B_i D, with J = df/dy and P = df/dp, so that the derivatives are those
of the discrete solution, exactly. J and P are evaluated once for all parameters, and only where they are not zero
by structure; parameters that reach the same states are carried side by side, shape (parameters, lanes).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.bound_field import BoundField
from jaxlines.simulation.evaluation import kept_apart
from jaxlines.simulation.lockstep import coefficients, stage_signals


class Group(NamedTuple):
    """Parameters (columns) that reach the same states."""

    columns: tuple[int, ...]
    states: tuple[int, ...]


class Tangent(NamedTuple):
    """A state with its sensitivities: for each group, one array (parameters, lanes) for each state it reaches."""

    state: tuple
    slopes: tuple[tuple, ...]


def _inputs(field: BoundField, partials: dict[int, Any], pushed: list[dict[int, Any]]) -> dict[int, Any]:
    """df/dp of one number: through the columns themselves and through the signals that they vary."""
    size, count = field.field.size, len(field.columns)
    found: dict[int, Any] = {}
    for place, value in partials.items():
        if place < size:
            continue
        if place < size + count:
            found[place - size] = found.get(place - size, 0.0) + value
        else:
            for column, slope in pushed[place - size - count].items():
                found[column] = found.get(column, 0.0) + value * slope
    return found


def _reach(field: BoundField, seeds: list[set[int]]) -> list[set[int]]:
    """For each column the states that depend on it, from those that do directly."""
    reached = [set(seed) for seed in seeds]
    size = field.field.size
    depends = [{j for j in row if j < size} for row in field.rate_partials]
    changed = True
    while changed:
        changed = False
        for states in reached:
            more = {i for i, row in enumerate(depends) if row & states} - states
            states |= more
            changed = changed or bool(more)
    return reached


def grouped(field: BoundField, start: list[dict[int, Any]], signal_columns: list[set[int]]) -> list[Group]:
    """Differentiated columns by the states that they reach."""
    size, count = field.field.size, len(field.columns)
    seeds: list[set[int]] = [{i for i, row in enumerate(start) if c in row} for c in range(count)]
    for i, row in enumerate(field.rate_partials):
        for place in row:
            if size <= place < size + count:
                seeds[place - size].add(i)
            elif place >= size + count:
                for column in signal_columns[place - size - count]:
                    seeds[column].add(i)
    groups: dict[tuple[int, ...], list[int]] = {}
    reached = _reach(field, seeds)
    for column in field.differentiated:
        groups.setdefault(tuple(sorted(reached[column])), []).append(column)
    return [Group(tuple(columns), states) for states, columns in groups.items()]


def _combined(group: Group, slopes: dict[int, Any], row: dict[int, Any], direct: dict[int, Any]):
    """J S + P of one number for the parameters of a group, shape (parameters, lanes), or None where it is zero."""
    terms = [value[None] * slopes[j] for j, value in row.items() if j in slopes]
    for place, column in enumerate(group.columns):
        if column in direct:
            chosen = jnp.asarray(np.eye(len(group.columns))[place][:, None], direct[column].dtype)
            terms.append(chosen * direct[column][None])
    if not terms:
        return None
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def tangent_start(field: BoundField, t) -> tuple[Tangent, list[Group]]:
    """The state at the start with its sensitivities, and the groups of parameters."""
    start, pushed = field.start_partials(), field.pushed(t)
    signal_columns = [set(row) for row in pushed]
    direct = [_inputs(field, {k + field.field.size: v for k, v in row.items()}, pushed) for row in start]
    groups = grouped(field, direct, signal_columns)
    nothing = jnp.zeros_like(field.start()[0])
    slopes = tuple(
        tuple(jnp.stack([direct[i].get(c, nothing) for c in group.columns]) for i in group.states) for group in groups
    )
    return Tangent(field.start(), slopes), groups


def tangent_interval(field: BoundField, groups: list[Group], begin, end, steps, start: Tangent) -> Tangent:
    """Advance states and sensitivities over an interval in equal steps; see `explicit_interval`."""
    dtype = start.state[0].dtype
    step = (end - begin) / steps
    decay, advance, when, _ = coefficients(dtype)

    def one_step(k, now: Tangent) -> Tangent:
        def stage(carry, numbers):
            now, memory, went = carry
            now = jax.tree.map(lambda y, d: y + went * d, now, memory)  # here, so that the sum below is done once
            keep, go, t, signals = numbers

            def compute(state):
                rates, partials = field.rates_and_partials(signals, state, step != 0.0)
                pushed = field.pushed(t)
                return rates, partials, [_inputs(field, row, pushed) for row in partials]

            rates, partials, direct = kept_apart(step != 0.0, compute, now.state)

            def moved(group, slopes, memories):
                known = dict(zip(group.states, slopes, strict=True))
                found = []
                for i, d in zip(group.states, memories, strict=True):
                    total = _combined(group, known, partials[i], direct[i])
                    found.append(keep * d + (0.0 if total is None else step * total))
                return tuple(found)

            state_memory = tuple(keep * d + step * f for d, f in zip(memory.state, rates, strict=True))
            slope_memory = tuple(map(moved, groups, now.slopes, memory.slopes))
            memory = Tangent(state_memory, slope_memory)
            return (now, memory, go), None

        times = begin + k * step + step * when
        signals = stage_signals(field, begin + k * step, step, dtype)
        rest = jax.tree.map(jnp.zeros_like, now)
        start = (now, rest, jnp.zeros((), dtype))
        (now, memory, went), _ = jax.lax.scan(stage, start, (decay, advance, times, signals))
        return jax.tree.map(lambda y, d: y + went * d, now, memory)

    return jax.lax.fori_loop(0, steps, one_step, start)


def observed(field: BoundField, groups: list[Group], t, now: Tangent):
    """Outputs (wanted, lanes) and their derivatives (differentiated columns, wanted, lanes)."""
    shown, partials = field.outputs_and_partials(field.signals(t), now.state)
    pushed, place_of = field.pushed(t), {column: k for k, column in enumerate(field.differentiated)}
    rows = []
    for row in partials:
        by_column = [jnp.zeros_like(shown[0])] * len(place_of)
        direct = _inputs(field, row, pushed)
        for group, slopes in zip(groups, now.slopes, strict=True):
            total = _combined(group, dict(zip(group.states, slopes, strict=True)), row, direct)
            for place, column in enumerate(group.columns):
                k = place_of[column]
                by_column[k] = by_column[k] if total is None else total[place]
        rows.append(jnp.stack(by_column))
    return jnp.stack(shown), jnp.stack(rows, axis=1)


def march_tangent(field: BoundField, grid, steps):
    """Outputs (samples, wanted, lanes) and their derivatives (samples, differentiated columns, wanted, lanes); see
    `march`."""
    start, groups = tangent_start(field, grid[0, -1])
    return _marched(field, groups, grid, steps, start)


def _marched(field: BoundField, groups: list[Group], grid, steps, start: Tangent):
    """The same from a start."""

    def between(now: Tangent, ends):
        def piece(now, at):
            return tangent_interval(field, groups, at[0], at[1], steps, now), None

        now, _ = jax.lax.scan(piece, now, (ends[:-1], ends[1:]))
        return now, observed(field, groups, ends[-1], now)

    first = observed(field, groups, grid[0, -1], start)
    _, rest = jax.lax.scan(between, start, grid[1:])
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)
