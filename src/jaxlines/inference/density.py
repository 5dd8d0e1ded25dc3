"""The posterior density of a least-squares problem in unbounded coordinates, with its gradient by forward mode."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

NOISE_PRIOR = (0.0, 1.0)
"""Mean and standard deviation of the prior of ln s, s the noise over the level that the rows are divided by."""


class Density(NamedTuple):
    """A posterior in coordinates z that know no bounds.

    log_density: z -> ln p(z | data) up to a constant, differentiable in reverse mode, which calls forward mode inside;
    to_x: z -> (x, ln s), coordinates of the problem and logarithms of noise factors; to_z: (x, ln s) -> z.
    """

    log_density: Callable
    to_x: Callable
    to_z: Callable


def _maps(lower, upper):
    """x of z and z of x for each kind of bounds, and ln |dx/dz|."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    both = np.isfinite(lower) & np.isfinite(upper)
    below, above = np.isfinite(lower) & ~both, np.isfinite(upper) & ~both
    low, width = np.where(np.isfinite(lower), lower, 0.0), np.where(both, upper - lower, 1.0)
    high = np.where(above, upper, 0.0)

    def to_x(z):
        inside = low + width * jax.nn.sigmoid(z)
        return jnp.where(both, inside, jnp.where(below, low + jnp.exp(z), jnp.where(above, high - jnp.exp(z), z)))

    def log_slope(z):
        within = jax.nn.log_sigmoid(z) + jax.nn.log_sigmoid(-z) + jnp.log(width)
        return jnp.sum(jnp.where(both, within, jnp.where(below | above, z, 0.0)))

    def to_z(x):
        share = np.clip((x - low) / width, 1e-3, 1.0 - 1e-3)
        one_sided = np.log(np.maximum(np.where(above, high - x, x - low), 1e-12))
        return np.where(both, np.log(share / (1.0 - share)), np.where(below | above, one_sided, x))

    return to_x, log_slope, to_z


def make_density(
    rows_and_slopes: Callable,
    lower,
    upper,
    channel,
    recording,
    *,
    noise: str = "inferred",
    noise_prior: tuple[float, float] = NOISE_PRIOR,
) -> Density:
    """The posterior with a flat prior of the coordinates within their bounds, beside the rows of priors.

    ln p = sum_c (-r_c'r_c/(2 s_c^2) - n_c ln s_c) - rows of priors - (ln s - m)^2/(2 v^2), plus ln |dx/dz|.

    Args:
        rows_and_slopes: x -> weighted rows (rows,) and their slopes (rows, parameters), traceable.
        lower, upper: bounds of x; channel, recording: of every row, recording -1 for a prior.
        noise: "inferred", a factor s_c on each channel's noise, or "known"; noise_prior: mean and standard deviation
            of the normal prior of ln s_c.
    """
    if noise not in ("inferred", "known"):
        raise ValueError(f'noise must be "inferred" or "known", got {noise!r}')
    data = np.asarray(recording) >= 0
    channel = np.where(data, channel, 0)
    levels = int(channel.max(initial=0)) + 1 if noise == "inferred" else 0
    counts = np.bincount(channel[data], minlength=levels)[:levels].astype(float)
    to_bounded, log_slope, from_bounded = _maps(lower, upper)
    size = np.size(lower)

    def terms(z):
        """The parts that do not depend on the rows."""
        logs = z[size:]
        prior = -0.5 * jnp.sum(((logs - noise_prior[0]) / noise_prior[1]) ** 2)
        return log_slope(z[:size]) + prior - jnp.sum(counts * logs)

    def value_and_slopes(z):
        x, turn = jax.jvp(to_bounded, (z[:size],), (jnp.ones(size),))  # elementwise: one tangent is the diagonal
        rows, slopes = rows_and_slopes(x)
        weights = jnp.where(data, jnp.exp(-2.0 * z[size:])[channel], 1.0) if levels else jnp.ones_like(rows)
        squares = weights * rows**2
        other, slope = jax.value_and_grad(terms)(z)
        value = other - 0.5 * jnp.sum(squares)
        by_x = -((weights * rows) @ slopes) * turn
        by_level = jax.ops.segment_sum(jnp.where(data, squares, 0.0), channel, levels) if levels else jnp.zeros(0)
        good = jnp.isfinite(value)
        slope = jnp.where(good, slope + jnp.concatenate([by_x, by_level]), 0.0)
        return jnp.where(good, value, -jnp.inf), slope

    @jax.custom_vjp
    def log_density(z):
        return value_and_slopes(z)[0]

    log_density.defvjp(value_and_slopes, lambda slope, seed: (seed * slope,))
    return Density(
        log_density,
        lambda z: (to_bounded(z[:size]), z[size:]),
        lambda x, logs: np.concatenate([from_bounded(np.asarray(x, dtype=float)), np.asarray(logs)[:levels]]),
    )


def with_slopes(function: Callable) -> Callable:
    """x -> (rows, slopes) from x -> rows by forward mode, in one pass."""

    def twice(x):
        rows = function(x)
        return rows, rows

    def both(x):
        slopes, rows = jax.jacfwd(twice, has_aux=True)(x)
        return rows, slopes

    return both


def called_on_host(problem) -> Callable:
    """x -> (rows, slopes) of a problem whose rows are not traceable, through a callback.

    The rows must not themselves call JAX: a callback that waits for JAX on the same processor can wait for ever.
    """
    count, rows = len(problem.labels), np.size(problem.recording)
    shapes = (jax.ShapeDtypeStruct((rows,), np.float64), jax.ShapeDtypeStruct((rows, count), np.float64))

    def both(x):
        x = np.asarray(x)
        found = np.asarray(problem.residuals(x), dtype=float), np.asarray(problem.jacobian(x), dtype=float)
        return found

    return lambda x: jax.pure_callback(both, shapes, x, vmap_method="sequential")
