"""Correlated noise: models of it, intervals that hold under it, and the rule that chooses among them."""

from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from jaxlines.inference.least_squares import solve
from jaxlines.inference.noise_models import Autoregression, carry, fit_autoregression, whiten, whiteness
from jaxlines.inference.restricted_likelihood import coefficients_of, partial_of, restricted_fit
from jaxlines.inference.robust_covariance import (
    between_recordings,
    block_bootstrap,
    block_length,
    sandwich_covariance,
    uncertainty_under_noise,
)
from jaxlines.inference.stated_noise import state_noise


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
    rng = np.random.default_rng(11)
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


def stationary(coefficients, sd, count) -> np.ndarray:
    """Covariance of AR(1) or AR(2) noise from its Yule-Walker equations, (count, count)."""
    a = np.append(coefficients, 0.0)[:2]
    lag = np.linalg.solve([[1, -a[0], -a[1]], [-a[0], 1 - a[1], 0], [-a[1], -a[0], 1]], [sd**2, 0.0, 0.0])
    for _ in range(count - 3):
        lag = np.append(lag, a[0] * lag[-1] + a[1] * lag[-2])
    return lag[np.abs(np.subtract.outer(range(count), range(count)))]


def test_gains_are_carried_by_the_covariance_of_the_noise():
    model, gain = Autoregression(np.array([1.2, -0.5]), 0.7), np.random.default_rng(7).standard_normal((12, 3))
    carried = carry(gain, model)
    np.testing.assert_allclose(carried.T @ carried, gain.T @ stationary([1.2, -0.5], 0.7, 12) @ gain, rtol=1e-9)
    single = carry(gain[:1], model)
    assert (single.T @ single)[0, 0] == pytest.approx(gain[0, 0] ** 2 * stationary([1.2, -0.5], 0.7, 3)[0, 0])


def test_partial_autocorrelations_turn_into_coefficients_and_back():
    np.testing.assert_allclose(coefficients_of([0.8, -0.5]), [1.2, -0.5])  # phi_1 = r1 (1 - r2)
    np.testing.assert_allclose(partial_of(coefficients_of([0.8, -0.5, 0.3])), [0.8, -0.5, 0.3])


def test_restricted_likelihood_takes_the_bias_out():
    """60 series of 60 samples under a line and a sine: plain estimates of 0.6 are too low by 0.1 or so."""
    rng, design = np.random.default_rng(8), design_of(60)
    plain, restricted = [], []
    for _ in range(60):
        noise = coloured(rng, 60, [0.6])
        rows = design @ np.linalg.lstsq(design, noise, rcond=None)[0] - noise
        first = Autoregression(np.array([rows[1:] @ rows[:-1] / (rows[:-1] @ rows[:-1])]), 1.0)
        found = restricted_fit(rows, design, [[np.arange(60)]], [first], np.zeros(0, dtype=int))
        plain.append(first.coefficients[0])
        restricted.append(found.models[0].coefficients[0])
    assert np.mean(plain) < 0.53
    assert np.mean(restricted) == pytest.approx(0.6, abs=0.045)


def test_the_restricted_likelihood_is_its_definition():
    """-ln L_R = (ln|V| + ln|X'V^-1 X| + r'P r)/2 with V written out, up to a constant; differences are compared."""
    rng, design = np.random.default_rng(9), design_of(30)
    rows = coloured(rng, 30, [0.5])
    first = [Autoregression(np.array([0.5]), 1.0)]
    found = restricted_fit(rows, design, [[np.arange(30)]], first, np.zeros(0, dtype=int))

    def direct(phi, sd):
        inverse = np.linalg.inv(stationary([phi], sd, 30))
        inner = design.T @ inverse @ design
        left = rows - design @ np.linalg.solve(inner, design.T @ inverse @ rows)
        return 0.5 * (np.linalg.slogdet(inner)[1] - np.linalg.slogdet(inverse)[1] + rows @ inverse @ left)

    model = found.models[0]
    best = direct(model.coefficients[0], model.sd)
    for factor in (0.97, 1.03):
        assert direct(model.coefficients[0] * factor, model.sd) > best
        assert direct(model.coefficients[0], model.sd * factor) > best


def test_least_squares_under_autoregressive_noise_is_stated_as_it_is():
    """Without another search: the covariance G V G' of the known noise, and fewer degrees of freedom than samples."""
    rng, design = np.random.default_rng(10), design_of(800)
    data = coloured(rng, 800, [0.7])
    problem = Linear(design, data)
    solution = solve(problem, np.zeros(3))
    stated = state_noise(problem, solution.residuals, design)
    gain = np.linalg.pinv(design)
    lag = 0.7 ** np.arange(800) / (1 - 0.49)
    exact = gain @ lag[np.abs(np.subtract.outer(range(800), range(800)))] @ gain.T
    assert stated.method == "autoregressive" and stated.models[0].order == 1
    np.testing.assert_allclose(np.sqrt(np.diag(stated.spread(gain))), np.sqrt(np.diag(exact)), rtol=0.25)
    assert np.all((stated.freedom(gain) > 20) & (stated.freedom(gain) < 600))
    normal: Any = stats.multivariate_normal  # its stubs take covariances to be numbers
    likelihood = normal(np.zeros(300), stationary([0.7], stated.models[0].sd, 300))
    part = state_noise(Linear(design[:300], data[:300]), solution.residuals[:300], design[:300])
    near = normal(np.zeros(300), stationary(part.models[0].coefficients, part.models[0].sd, 300))
    assert part.log_likelihood() == pytest.approx(near.logpdf(part.rows), abs=1e-6)
    assert part.log_likelihood() > likelihood.logpdf(part.rows) - 5.0


def test_a_local_parameter_is_not_judged_by_clusters():
    """Each recording has an offset of its own, whose score there is zero: clusters would call it certain."""
    rng = np.random.default_rng(12)
    recording = np.repeat(np.arange(25), 60)
    local = (recording[:, None] == np.arange(25)).astype(float)
    data = np.concatenate([coloured(rng, 60, [0.6]) for _ in range(25)])
    problem = Linear(local, data, recording)
    found = uncertainty_under_noise(problem, solve(problem, np.zeros(25)))
    assert found.method == "autoregressive"
    expected = np.sqrt(np.full(60, 1 / 60) @ stationary([0.6], 1.0, 60) @ np.full(60, 1 / 60))
    np.testing.assert_allclose(found.sd, expected, rtol=0.2)


def test_few_samples_are_not_called_white():
    rng = np.random.default_rng(13)
    problem = Linear(np.ones((12, 1)), rng.standard_normal(12))
    found = uncertainty_under_noise(problem, solve(problem, [0.0]))
    assert np.isnan(found.whiteness_p) and "too few to tell" in found.sentence
