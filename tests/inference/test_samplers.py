"""Samples are a pure function of seed and index, and lie where their designs say."""

import numpy as np
import pytest

from jaxlines.inference.samplers import (
    Grid,
    LatinHypercube,
    MonteCarlo,
    Morris,
    Rows,
    ShapleyEffects,
    Sobol,
    SobolIndices,
)

DIMS = 3
SAMPLERS = [
    MonteCarlo(5),
    Sobol(5),
    LatinHypercube(5, 3000),
    Grid((10, 20, 15)),
    SobolIndices(5),
    SobolIndices(5, second_order=True),
    Morris(5),
    ShapleyEffects(5),
]
IDS = [type(s).__name__ + ("2" if getattr(s, "second_order", False) else "") for s in SAMPLERS]


@pytest.mark.parametrize("sampler", SAMPLERS, ids=IDS)
def test_any_piece_is_the_same_in_any_order(sampler):
    whole = sampler.uniforms(0, 3000, DIMS)
    cuts = [(2999, 3000), (1000, 2100), (0, 7), (1023, 1025), (17, 49)]
    assert whole.shape == (3000, DIMS)
    assert np.all((whole > 0) & (whole < 1))
    for start, stop in cuts:
        assert np.array_equal(sampler.uniforms(start, stop, DIMS), whole[start:stop])


@pytest.mark.parametrize("kind", [MonteCarlo, Sobol, SobolIndices, Morris, ShapleyEffects])
def test_another_seed_gives_other_lanes(kind):
    assert not np.array_equal(kind(1).uniforms(0, 60, DIMS), kind(2).uniforms(0, 60, DIMS))


def test_monte_carlo_is_uniform_and_independent():
    u = MonteCarlo(0).uniforms(0, 40_000, 2)
    assert u.mean(axis=0) == pytest.approx([0.5, 0.5], abs=5 * 0.2887 / 200)
    assert abs(np.corrcoef(u.T)[0, 1]) < 5 / 200


def test_sobol_fills_every_cell():
    """2^8 points in base 2 have one point in each of 16 x 16 elementary cells of two leading dimensions."""
    u = Sobol(9).uniforms(0, 256, 2)
    cells = np.floor(u * 16).astype(int)
    assert len({tuple(cell) for cell in cells}) == 256


def test_latin_hypercube_has_one_lane_in_each_slice():
    u = LatinHypercube(1, 100).uniforms(0, 100, 4)
    assert all(np.array_equal(np.sort(np.floor(column * 100)), np.arange(100)) for column in u.T)
    assert not LatinHypercube().extendable
    with pytest.raises(ValueError, match="needs to know the count"):
        LatinHypercube().uniforms(0, 1, 1)


def test_grid_has_all_combinations():
    grid = Grid((2, 3))
    assert grid.total(2) == 6
    assert np.allclose(grid.uniforms(0, 6, 2)[:, 1] * 3, [0.5, 1.5, 2.5] * 2)
    with pytest.raises(ValueError, match="2 columns need 2"):
        Grid((2, 3, 4)).total(2)
    with pytest.raises(ValueError, match="whole number of levels"):
        Grid((0,))


def test_rows_pick_every_row_once():
    u = Rows(7).uniforms(0, 7, 1)[:, 0]
    assert np.array_equal(np.floor(u * 7), np.arange(7))


def test_sobol_indices_are_laid_out_as_salib_expects():
    """A, A with column j of B, B with column j of A, B, as in SALib.sample.sobol."""
    u = SobolIndices(0, second_order=True).uniforms(0, 8, 3)
    a, b = u[0], u[7]
    for j in range(3):
        mixed, other = a.copy(), b.copy()
        mixed[j], other[j] = b[j], a[j]
        assert np.array_equal(u[1 + j], mixed)
        assert np.array_equal(u[4 + j], other)
    first = SobolIndices(0).uniforms(0, 5, 3)
    assert np.array_equal(first[0], a)
    assert np.array_equal(first[4], b)
    assert np.array_equal(first[1:4], u[1:4])


@pytest.mark.parametrize("sampler", [Morris(0, 6), ShapleyEffects(0)], ids=["Morris", "Shapley"])
def test_trajectories_change_every_column_once(sampler):
    u = sampler.uniforms(0, 50 * (DIMS + 1), DIMS).reshape(50, DIMS + 1, DIMS)
    changed = np.diff(u, axis=1) != 0
    assert np.all(changed.sum(axis=1) == 1)
    assert np.all(changed.sum(axis=2) == 1)
    if isinstance(sampler, Morris):
        assert np.allclose(np.abs(np.diff(u, axis=1)).sum(axis=2), 0.5)
        assert set(np.round(u.ravel() * 6 - 0.5, 9)) == {0.0, 1.0, 2.0, 3.0, 4.0, 5.0}
