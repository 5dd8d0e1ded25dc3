"""Likelihood intervals: exact on linear models, one-sided at bounds, open where nothing is known; curvature."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxlines.inference.curvature import gauss_newton_covariance, hessian, hessian_covariance, laplace, noise_variance
from jaxlines.inference.least_squares import FunctionProblem, multi_start, solve
from jaxlines.inference.profiles import differentiable, interval, intervals, profile_curve

RNG = np.random.default_rng(4)
DESIGN = RNG.standard_normal((30, 3)) * np.array([1.0, 1e3, 1e-4])
DATA = DESIGN @ np.array([2.0, -1e-3, 5e4]) + RNG.standard_normal(30)


@pytest.fixture(scope="module")
def linear():
    problem = FunctionProblem(lambda x: DESIGN @ x - DATA, ("a", "b", "c"))
    return problem, solve(problem, np.zeros(3))


def test_intervals_of_a_linear_model_are_exact(linear):
    problem, solution = linear
    covariance = np.linalg.inv(DESIGN.T @ DESIGN)
    best = covariance @ DESIGN.T @ DATA
    freedom = DATA.size - 3
    level = np.sum((DESIGN @ best - DATA) ** 2) / freedom
    for noise, factor in (("known", stats.norm.ppf(0.975)), ("estimated", stats.t.ppf(0.975, freedom) * level**0.5)):
        for i, found in enumerate(intervals(problem, solution, noise=noise).values()):
            half = factor * covariance[i, i] ** 0.5
            assert found.kind == "two_sided"
            np.testing.assert_allclose(found.ends, (best[i] - half, best[i] + half), rtol=1e-7)
    spread = gauss_newton_covariance(solution.jacobian, noise_variance(solution.residuals, 3))
    np.testing.assert_allclose(spread, level * covariance, rtol=1e-8)


def test_a_prediction_of_a_linear_model_has_its_exact_interval(linear):
    problem, solution = linear
    weights = np.array([1.0, 5e2, 2e-4])
    found = interval(problem, solution, differentiable(lambda x: weights @ x), name="sum")
    half = stats.norm.ppf(0.975) * (weights @ np.linalg.inv(DESIGN.T @ DESIGN) @ weights) ** 0.5
    np.testing.assert_allclose(np.subtract(found.ends, weights @ solution.x), (-half, half), rtol=1e-6)
    assert "sum" in str(found)


TIMES = np.linspace(0.0, 3.0, 20)
DECAY = 2.0 * np.exp(-0.7 * TIMES) + 0.1 * RNG.standard_normal(20)


def decay(x):
    return (x[0] * jnp.exp(-x[1] * TIMES) - DECAY) / 0.1


@pytest.fixture(scope="module")
def curved():
    problem = FunctionProblem(decay, ("amplitude", "rate"), np.array([0.1, 0.0]), np.array([10.0, 5.0]))
    return problem, solve(problem, [5.0, 3.0])


def test_end_points_lie_where_the_profile_meets_its_limit(curved):
    """Against a dense scan: for every rate the best amplitude is linear least squares."""
    problem, solution = curved
    found = interval(problem, solution, "rate")
    rates = np.linspace(0.3, 1.3, 200_001)
    shapes = np.exp(-np.outer(rates, TIMES))
    height = (np.sum(DECAY**2) - (shapes @ DECAY) ** 2 / np.sum(shapes**2, axis=1)) / 0.01
    inside = rates[height <= height.min() + stats.chi2.ppf(0.95, 1)]
    np.testing.assert_allclose(found.ends, (inside[0], inside[-1]), atol=1.1e-5)
    curve = profile_curve(problem, solution, "rate", [*found.ends, solution.x[1]])
    np.testing.assert_allclose(curve, [3.8414588, 3.8414588, 0.0], atol=2e-4)


def test_a_nonlinear_prediction_agrees_with_the_transformed_interval(curved):
    """A likelihood interval does not depend on how a quantity is written: ends of 1/rate are 1/ends of the rate."""
    problem, solution = curved
    rate = interval(problem, solution, 1)
    period = interval(problem, solution, differentiable(lambda x: 1.0 / x[1]))
    np.testing.assert_allclose(period.ends, (1.0 / rate.ends[1], 1.0 / rate.ends[0]), rtol=1e-5)


def test_intervals_end_at_bounds_and_open_ones_say_so():
    design = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 2.0, 2.0], [1.0, 3.0, 3.0]])
    data = np.array([0.1, 1.2, 1.9, 3.1])
    bounds = np.array([-1.0, 0.0, 0.0]), np.array([0.5, 4.0, 4.0])
    problem = FunctionProblem(lambda x: (design @ x - data) / 0.5, ("offset", "first", "second"), *bounds)
    found = intervals(problem, solve(problem, [0.0, 2.0, 0.1]))
    # only first + second is seen, so that each alone goes down to its bound and up to the end of their sum
    assert found["first"].kind == found["second"].kind == "upper_limit"
    assert found["first"].ends[1] == pytest.approx(found["second"].ends[1], rel=1e-6)
    small = FunctionProblem(lambda x: (design @ x - data) / 50.0, ("offset", "first", "second"), *bounds)
    assert {i.kind for i in intervals(small, solve(small, [0.0, 2.0, 0.1])).values()} == {"open"}


def test_the_full_hessian_against_its_formula(curved):
    problem, solution = curved
    a, k = solution.x
    e, r = np.exp(-k * TIMES) / 0.1, solution.residuals
    cross, second = np.sum(-TIMES * e * r), np.sum(a * TIMES**2 * e * r)
    expected = solution.jacobian.T @ solution.jacobian + np.array([[0.0, cross], [cross, second]])
    np.testing.assert_allclose(hessian(problem, solution.x), expected, rtol=1e-9)

    class Opaque:
        """The same without second derivatives of its own."""

        labels, lower, upper = problem.labels, problem.lower, problem.upper
        recording, channel, time = problem.recording, problem.channel, problem.time
        residuals, jacobian = staticmethod(problem.residuals), staticmethod(problem.jacobian)

    np.testing.assert_allclose(hessian(Opaque(), solution.x), expected, rtol=1e-5)
    np.testing.assert_allclose(laplace(problem, solution.x).covariance, np.linalg.inv(expected), rtol=1e-8)


def test_the_evidence_of_a_linear_model_is_exact(linear):
    problem, solution = linear
    found = laplace(problem, solution.x)
    exact = -solution.cost + 0.5 * np.linalg.slogdet(2 * np.pi * np.linalg.inv(DESIGN.T @ DESIGN))[1]
    assert found.log_evidence == pytest.approx(exact, rel=1e-9)
    with pytest.raises(ValueError, match="not positive definite"):
        hessian_covariance(np.diag([1.0, -1.0]))


def test_open_parameters_have_no_finite_variance_and_wrong_calls_are_refused(curved):
    problem, solution = curved
    spread = gauss_newton_covariance(np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 2.0]]))
    assert np.isinf(spread[0, 0]) and np.isinf(spread[1, 1]) and spread[2, 2] == pytest.approx(0.25)
    with pytest.raises(KeyError, match="amplitude, rate"):
        interval(problem, solution, "speed")
    with pytest.raises(ValueError, match="per cent"):
        interval(problem, solution, "rate", level=95.0)
    with pytest.raises(ValueError, match="finite bounds"):
        multi_start(FunctionProblem(decay, ("a", "b")), 3)
    with pytest.raises(ValueError, match="one increasing pair"):
        FunctionProblem(decay, ("a", "b"), np.ones(2), np.zeros(2))


def test_ends_of_a_search_are_judged_by_their_own_slopes(curved):
    problem, solution = curved
    assert solution.status == "converged" and solution.ok
    tight = FunctionProblem(decay, ("amplitude", "rate"), np.array([0.1, 0.9]), np.array([10.0, 5.0]))
    held = solve(tight, [5.0, 3.0])
    assert held.status == "at_bound" and held.x[1] == 0.9 and "rate" in held.message
    assert solve(problem, [5.0, 3.0], max_evaluations=1).status == "stalled"
    broken = FunctionProblem(lambda x: jnp.log(-x) * TIMES, ("a",), np.array([1.0]), np.array([2.0]))
    assert solve(broken, [1.5]).status == "failed"
    ranked = multi_start(problem, 4, seed=1)
    assert [s.cost for s in ranked] == sorted(s.cost for s in ranked)
    assert ranked[0].cost == pytest.approx(solution.cost, rel=1e-9)
