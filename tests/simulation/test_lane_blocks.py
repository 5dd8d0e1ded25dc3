"""Lanes in blocks: the same numbers as all lanes at once, in one function where that is possible."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlines.simulation.lane_blocks import BLOCK_BYTES, in_blocks

LANES = 4 * BLOCK_BYTES // 8
RECORDS = {"times": np.linspace(0.0, 1.0, 3 * LANES).reshape(3, LANES), "rate": np.linspace(1.0, 2.0, LANES)}


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def decay(lanes):
    """exp(-rate t) by many small steps, with the steps' sum."""

    def step(y, dt):
        y = y * (1.0 - 0.01 * dt * lanes["rate"])
        return y, y

    y, path = jax.lax.scan(step, jnp.ones_like(lanes["rate"]), jnp.tile(lanes["times"], (10, 1)))
    return {"end": y, "path": path}


def compiled_text(function, lanes) -> str:
    return jax.jit(lambda lanes: in_blocks(function, lanes)).lower(lanes).compile().as_text()


def test_as_all_lanes_at_once():
    blocks, whole = jax.jit(lambda x: in_blocks(decay, x))(RECORDS), jax.jit(decay)(RECORDS)
    assert blocks["end"].shape == (LANES,) and blocks["path"].shape == (30, LANES)
    for name in ("end", "path"):
        np.testing.assert_allclose(blocks[name], whole[name], rtol=1e-13)
    exact = np.prod(1.0 - 0.01 * RECORDS["times"] * RECORDS["rate"], axis=0) ** 10
    np.testing.assert_allclose(blocks["end"], exact, rtol=1e-12)


def test_lanes_are_the_same_among_others():
    """Bit by bit: what a lane gives does not depend on the others, nor on how many there are."""
    order = np.random.default_rng(0).permutation(LANES)
    mixed = jax.jit(lambda x: in_blocks(decay, x))(jax.tree.map(lambda x: x[..., order], RECORDS))
    one = jax.jit(lambda x: in_blocks(decay, x))(jax.tree.map(lambda x: x[..., : LANES // 4], RECORDS))
    every = jax.jit(lambda x: in_blocks(decay, x))(RECORDS)
    np.testing.assert_array_equal(mixed["end"], every["end"][order])
    np.testing.assert_array_equal(one["path"], every["path"][:, : LANES // 4])


def test_one_function_where_possible():
    assert 'xla_cpu_small_call="true"' in compiled_text(decay, RECORDS)
    assert "small_call" not in compiled_text(lambda x: jnp.sort(x["times"], axis=0), RECORDS)  # a call of a library
    odd = jax.tree.map(lambda x: x[..., : LANES - 1], RECORDS)
    assert "small_call" not in compiled_text(decay, odd)  # not whole blocks
    np.testing.assert_allclose(jax.jit(lambda x: in_blocks(decay, x))(odd)["end"], decay(odd)["end"], rtol=1e-13)
