"""Criteria and choice of measurements against optimum designs that are known in closed form."""

import itertools

import numpy as np
import pytest

from jaxlines.inference.curvature import gauss_newton_covariance
from jaxlines.inference.design_criteria import CRITERIA, Criterion, Goal, covariance_of, stated_covariance
from jaxlines.inference.design_selection import evenly, relaxed, select

NOTHING = 1e-10


def goal_for(kind: str, count: int, direction=None, how: str = "nominal") -> Goal:
    directions = np.eye(count) if direction is None else np.asarray(direction, dtype=float)[:, None]
    return Goal((Criterion(kind, directions, NOTHING * np.eye(count)),), how)


def blocks_of(rows) -> np.ndarray:
    """Information of one measurement at each point, one scenario."""
    rows = np.asarray(rows, dtype=float)
    return np.einsum("cp,cq->cpq", rows, rows)[None]


def polynomial(degree: int, low: float, points: int = 41) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(low, 1.0, points)
    return x, blocks_of(np.vander(x, degree + 1, increasing=True))


@pytest.mark.parametrize(
    ("kind", "degree", "low", "direction", "support", "share"),
    [
        ("D", 1, -1.0, None, (-1, 1), (1 / 2, 1 / 2)),
        ("c", 1, -1.0, (0, 1), (-1, 1), (1 / 2, 1 / 2)),  # slope of a straight line: the ends
        ("A", 1, 0.0, None, (0, 1), (2 - np.sqrt(2), np.sqrt(2) - 1)),
        ("E", 1, 0.0, None, (0, 1), (3 / 5, 2 / 5)),
        ("D", 2, -1.0, None, (-1, 0, 1), (1 / 3, 1 / 3, 1 / 3)),  # Smith, 1918
        ("A", 2, -1.0, None, (-1, 0, 1), (1 / 4, 1 / 2, 1 / 4)),
        ("E", 2, -1.0, None, (-1, 0, 1), (1 / 5, 3 / 5, 1 / 5)),  # Pukelsheim, 2006, sec. 9.12
        ("c", 2, -1.0, (0, 0, 1), (-1, 0, 1), (1 / 4, 1 / 2, 1 / 4)),  # Kiefer and Wolfowitz, 1959
        ("D", 3, -1.0, None, (-1, -1 / np.sqrt(5), 1 / np.sqrt(5), 1), (1 / 4,) * 4),  # Guest, 1958
    ],
)
def test_relaxed_weights_of_polynomials(kind, degree, low, direction, support, share):
    """Optimum designs of polynomial regression (Pukelsheim, "Optimal Design of Experiments", 2006, ch. 9)."""
    x, blocks = polynomial(degree, low)
    weights, bound = relaxed(blocks, goal_for(kind, degree + 1, direction), 1.0, repeats=True)
    for at, expected in zip(support, share, strict=True):
        near = np.abs(x - at) < 0.06
        assert weights[near].sum() == pytest.approx(expected, abs=0.01)
        assert x[near] @ weights[near] / weights[near].sum() == pytest.approx(at, abs=0.02)
    exact = np.einsum("i,ip,iq->pq", share, *(np.vander(support, degree + 1, increasing=True),) * 2)
    best = goal_for(kind, degree + 1, direction).value(exact[None])
    assert bound <= best + 1e-9
    assert bound == pytest.approx(best, abs=2e-3)


def test_rounding_of_quadratic_regression_is_nearly_efficient():
    """Seven measurements for the curvature: 2, 3, 2 of -1, 0, 1, found by exhaustion over all designs on 5 points."""
    _, blocks = polynomial(2, -1.0, 5)
    goal = goal_for("c", 3, (0, 0, 1))
    found = select(blocks, goal, 7, repeats=True)
    every = itertools.combinations_with_replacement(range(5), 7)
    best = min(float(goal.value(blocks[:, list(members)].sum(axis=1))) for members in every)
    assert found.value == pytest.approx(best, abs=1e-9)
    assert found.counts.sum() == 7
    assert 0.97 < found.efficiency <= 1.0
    assert found.method == "relaxed, rounded and exchanged"


def test_each_candidate_once():
    """The slope of a line from 10 of 41 points: five at each end, as the variance of a slope says."""
    x, blocks = polynomial(1, -1.0)
    found = select(blocks, goal_for("c", 2, (0, 1)), 10)
    np.testing.assert_array_equal(np.flatnonzero(found.counts), [0, 1, 2, 3, 4, 36, 37, 38, 39, 40])
    np.testing.assert_allclose(np.exp(2 * found.value), 1 / np.sum((x[found.counts > 0]) ** 2), rtol=1e-6)
    assert found.efficiency == pytest.approx(1.0, abs=2e-4)
    spread, value = evenly(blocks, goal_for("c", 2, (0, 1)), 5)
    np.testing.assert_array_equal(np.flatnonzero(spread), [0, 10, 20, 30, 40])
    assert np.exp(2 * value) == pytest.approx(1 / 2.5, rel=1e-6)


def test_subset_of_few_is_exhaustive():
    rows = np.random.default_rng(3).normal(size=(8, 3))
    goal = goal_for("D", 3)
    found = select(blocks_of(rows), goal, 4)
    best = max(np.linalg.det(rows[list(m)].T @ rows[list(m)]) for m in itertools.combinations(range(8), 4))
    assert found.method == "exhaustive"
    assert np.exp(-6 * found.value) == pytest.approx(best, rel=1e-6)
    assert found.value >= found.bound


def test_too_many_are_refused():
    with pytest.raises(ValueError, match="9 of 8 candidates cannot be chosen: give a number from 1 to 8"):
        select(blocks_of(np.ones((8, 1))), goal_for("D", 1), 9)
    with pytest.raises(ValueError, match="1 evenly spaced of 8"):
        evenly(blocks_of(np.ones((8, 1))), goal_for("D", 1), 1)


@pytest.mark.parametrize("held", [0, 1, 2])
@pytest.mark.parametrize("kind", CRITERIA)
def test_slopes_of_criteria(kind, held):
    """Against central differences, with one number that is held (known), of which something may be known before."""
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(12, 4))
    information, other = rows.T @ rows, rng.normal(size=(4, 4))
    other = other + other.T
    directions = rng.normal(size=(3, 1 if kind == "c" else 2))
    criterion = Criterion(kind, directions, np.concatenate([0.3 * np.eye(3), rng.normal(size=(3, held))], axis=1))
    step = 1e-6
    expected = criterion.value(information + step * other) - criterion.value(information - step * other)
    assert np.sum(criterion.slope(information) * other) == pytest.approx(expected / (2 * step), rel=1e-6)
    worst = Goal((criterion, criterion), "worst")
    both = np.stack([information, 2.0 * information])
    assert worst.value(both) == criterion.value(information)
    np.testing.assert_array_equal(worst.slope(both)[1], 0.0)


def test_covariance_with_held_numbers_is_that_of_many_fits():
    """A line fitted with a wrong, uncertain quadratic term: scatter over 100 000 draws of it and of the noise."""
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 1.0, 9)
    free, sd = np.stack([np.ones(9), x], axis=1), 0.7
    seen = rng.normal(size=(100_000, 9)) + sd * rng.normal(size=(100_000, 1)) * x**2
    scatter = np.cov(seen @ np.linalg.pinv(free).T, rowvar=False)
    rows = np.concatenate([free, sd * x[:, None] ** 2], axis=1)
    stated = stated_covariance(rows, 2)
    np.testing.assert_allclose(stated, scatter, rtol=0.02)
    np.testing.assert_allclose(covariance_of(rows.T @ rows, NOTHING * np.eye(2)), stated, rtol=1e-6)
    np.testing.assert_allclose(stated_covariance(free, 2), gauss_newton_covariance(free))


def test_what_is_not_told_is_infinite():
    rows = np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0], [3.0, 6.0, 0.1]])  # first two only together, one held
    sd = np.diag(stated_covariance(rows, 2))
    assert np.all(np.isinf(sd))
    told = stated_covariance(np.concatenate([rows, [[0.0, 10.0, 0.0]]]), 2)
    assert np.all(np.isfinite(told))
