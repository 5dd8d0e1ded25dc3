"""Correlated noise: models of it, intervals that hold under it, and the rule that chooses among them."""

import numpy as np
import pytest
from scipy import signal, stats

from jaxlines.inference.least_squares import solve
from jaxlines.inference.noise_models import Autoregression, fit_autoregression, whiten, whiteness
from jaxlines.inference.robust_covariance import (
    between_recordings,
    block_bootstrap,
    block_length,
    sandwich_covariance,
    uncertainty_under_noise,
)


class Linear:
    """Rows design @ x - data, in plain NumPy: a problem of a host, not of JAX."""

    def __init__(self, design, data, recording=None, channel=None):
        self.design, self.data = design, data
        count = data.size
        self.labels = tuple(f"b{i}" for i in range(design.shape[1]))
        self.lower, self.upper = np.full(design.shape[1], -np.inf), np.full(design.shape[1], np.inf)
        self.recording = np.zeros(count, dtype=int) if recording is None else recording
        self.channel = np.zeros(count, dtype=int) if channel is None else channel
        self.time = np.concatenate([np.arange(np.sum(self.recording == r)) for r in np.unique(self.recording)])

    def residuals(self, x):
        return self.design @ np.asarray(x) - self.data

    def jacobian(self, x):
        return self.design


def coloured(rng, count, coefficients, sd=1.0) -> np.ndarray:
    """Stationary autoregressive noise: a long run-in is thrown away."""
    driven = signal.lfilter([sd], [1.0, *(-np.asarray(coefficients))], rng.standard_normal(count + 500))
    return np.asarray(driven)[500:]


def design_of(count):
    t = np.linspace(0.0, 1.0, count)
    return np.stack([np.ones(count), t, np.sin(7.0 * t)], axis=1)


def test_whitening_inverts_the_covariance_of_the_noise():
    """L with L'L = V^-1 for the exact covariance V of AR(2) noise, from its Yule-Walker equations."""
    a, sd = np.array([1.2, -0.5]), 0.7
    lag = np.linalg.solve([[1, -a[0], -a[1]], [-a[0], 1 - a[1], 0], [-a[1], -a[0], 1]], [sd**2, 0.0, 0.0])
    for _ in range(7):
        lag = np.append(lag, a[0] * lag[-1] + a[1] * lag[-2])
    covariance = lag[np.abs(np.subtract.outer(range(10), range(10)))]
    root = whiten(np.eye(10), Autoregression(a, sd))
    np.testing.assert_allclose(root.T @ root, np.linalg.inv(covariance), atol=1e-10)


def test_order_and_coefficients_are_found_again():
    rng = np.random.default_rng(0)
    pieces: list[np.ndarray] = [coloured(rng, 4000, [1.2, -0.5], 0.7), coloured(rng, 3000, [1.2, -0.5], 0.7)]
    found = fit_autoregression(pieces)
    assert found.order == 2
    np.testing.assert_allclose(found.coefficients, [1.2, -0.5], atol=0.03)
    assert found.sd == pytest.approx(0.7, rel=0.03)
    assert fit_autoregression([rng.standard_normal(5000)]).order == 0
    assert fit_autoregression([np.array([1.0, -1.0])]).order == 0


def test_the_rule_takes_white_noise_for_white():
    rng = np.random.default_rng(1)
    problem = Linear(design_of(200), rng.standard_normal(200))
    found = uncertainty_under_noise(problem, solve(problem, np.zeros(3)))
    exact = np.linalg.inv(problem.design.T @ problem.design) * np.sum(problem.residuals(found.x) ** 2) / 197
    assert found.method == "white" and "white" in found.sentence
    np.testing.assert_allclose(found.covariance, exact, rtol=1e-8)
    assert found.factor == pytest.approx(stats.t.ppf(0.975, 197), rel=1e-9)


@pytest.mark.slow
def test_intervals_under_autoregressive_noise_cover_where_plain_ones_do_not():
    """120 data sets: the 99.9 % band of a binomial of 95 % is 105 to 120; plain ones miss half the time."""
    rng = np.random.default_rng(2)
    design, truth, hits, plain, methods = design_of(150), np.array([1.0, -2.0, 0.5]), np.zeros(3), np.zeros(3), []
    for _ in range(120):
        problem = Linear(design, design @ truth + coloured(rng, 150, [0.7]))
        solution = solve(problem, np.zeros(3))
        found = uncertainty_under_noise(problem, solution)
        methods.append(found.method)
        hits += np.abs(found.x - truth) < found.factor * found.sd
        sd = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * 2.0 * solution.cost / 147)
        plain += np.abs(solution.x - truth) < 1.96 * sd
    assert methods.count("autoregressive") >= 114  # the test of what is left fails once in a hundred
    assert np.all(hits >= 105), hits
    assert np.all(plain < 84), plain


def test_clusters_and_blocks_agree_with_the_known_covariance():
    rng = np.random.default_rng(3)
    design, truth = design_of(100), np.array([1.0, -2.0, 0.5])
    lag = 0.6 ** np.arange(100) / (1 - 0.36)
    covariance = lag[np.abs(np.subtract.outer(range(100), range(100)))]
    gain = np.linalg.pinv(design)
    one = gain @ covariance @ gain.T
    recording = np.repeat(np.arange(60), 100)
    data = np.concatenate([design @ truth + coloured(rng, 100, [0.6]) for _ in range(60)])
    problem = Linear(np.tile(design, (60, 1)), data, recording)
    solution = solve(problem, np.zeros(3))
    found = uncertainty_under_noise(problem, solution)
    assert found.method == "clusters" and found.factor == pytest.approx(stats.t.ppf(0.975, 59))
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(one) / 60), rtol=0.3)
    draws = block_bootstrap(problem, solution, count=300, block=20, refit=False)
    np.testing.assert_allclose(draws.std(axis=0), np.sqrt(np.diag(one) / 60), rtol=0.25)
    few = block_bootstrap(problem, solution, count=4, block=20)
    np.testing.assert_allclose(few, block_bootstrap(problem, solution, count=4, block=20, refit=False), rtol=1e-6)
    assert block_length(data[:100]) > block_length(rng.standard_normal(100))


def test_a_sandwich_of_one_row_a_cluster_is_the_known_one():
    """HC1 of statsmodels' textbook case y = a + b x by hand: each row its own cluster."""
    design = np.array([[1.0, 1], [1, 2], [1, 3], [1, 4]])
    rows = np.array([0.1, -0.2, 0.2, -0.1])
    bread = np.linalg.inv(design.T @ design)
    meat = design.T @ np.diag(rows**2) @ design
    found = sandwich_covariance(rows, design, np.arange(4))
    np.testing.assert_allclose(found, 4 / 2 * bread @ meat @ bread, rtol=1e-10)
    with pytest.raises(ValueError, match="at least two recordings"):
        sandwich_covariance(rows, design, np.zeros(4))


def test_scatter_between_recordings_is_found_and_absent_where_there_is_none():
    rng = np.random.default_rng(5)
    design, recording = np.ones((50, 1)), np.repeat(np.arange(40), 50)
    for sd in (0.0, 0.5):
        levels = np.repeat(1.0 + sd * rng.standard_normal(40), 50)
        problem = Linear(np.tile(design, (40, 1)), levels + rng.standard_normal(2000), recording)
        found = between_recordings(problem, solve(problem, [0.0]), variance=1.0)
        np.testing.assert_allclose(found.sd, 50**-0.5)
        assert found.between[0] == pytest.approx(sd, abs=0.12)
        assert (found.p[0] < 0.001) == (sd > 0)


def test_whiteness_looks_at_every_recording_and_a_wrong_model_ends_with_blocks():
    rng = np.random.default_rng(6)
    recording = np.repeat([0, 1], 150)
    rows = np.concatenate([rng.standard_normal(150), coloured(rng, 150, [0.8])])
    problem = Linear(np.ones((300, 1)), -rows, recording)
    assert whiteness(problem, rows) < 1e-6
    noise = rng.standard_normal(415)
    problem = Linear(np.ones((400, 1)), noise[15:] + 0.9 * noise[:-15])  # an echo: later than any order that is tried
    found = uncertainty_under_noise(problem, solve(problem, [0.0]))
    assert found.method == "blocks" and "term that the model lacks" in found.sentence
