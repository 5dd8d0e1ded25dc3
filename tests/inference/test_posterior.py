"""Posteriors against closed forms, and the test of calibration against right and wrong samplers."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxlines.inference.calibration import band_limit, calibrate, rank_of, thin
from jaxlines.inference.least_squares import FunctionProblem, solve
from jaxlines.inference.posterior import sample_posterior

from .test_noise_models import Linear

RNG = np.random.default_rng(11)
DESIGN = np.stack([np.ones(40), np.linspace(-1.0, 1.0, 40)], axis=1) * np.array([1.0, 30.0])
DATA = DESIGN @ np.array([2.0, -0.1]) + 1.5 * RNG.standard_normal(40)


@pytest.fixture(scope="module")
def drawn():
    problem = FunctionProblem(lambda x: DESIGN @ x - DATA, ("level", "slope"))
    solution = solve(problem, [0.0, 0.0])
    return solution, sample_posterior(problem, solution, noise_prior=(0.0, 10.0), warmup=300, draws=800, chains=2)


def test_a_linear_model_with_unknown_noise_has_a_student_posterior(drawn):
    """Flat priors of x and ln s: (x - best)/sd is Student's t with n - p degrees, sum r^2/s^2 chi-squared."""
    solution, posterior = drawn
    covariance = np.linalg.inv(DESIGN.T @ DESIGN) * 2.0 * solution.cost / 38
    scaled = (posterior.draws - solution.x) / np.sqrt(np.diag(covariance))
    for i in range(2):
        thinned = thin(scaled[..., i].T.ravel(), 250)
        assert stats.kstest(thinned, stats.t(38).cdf).pvalue > 1e-3
    chi = thin((2.0 * solution.cost / posterior.noise_factors[..., 0] ** 2).T.ravel(), 250)
    assert stats.kstest(chi, stats.chi2(38).cdf).pvalue > 1e-3
    half = stats.t.ppf(0.975, 38) * np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(posterior.interval(), solution.x + np.outer([-1, 1], half), atol=0.15 * half.max())


def test_chains_are_judged_and_handed_to_arviz(drawn):
    _, posterior = drawn
    assert posterior.divergences == 0 and np.all(posterior.rhat < 1.02) and np.all(posterior.ess > 300)
    data = posterior.to_arviz(lambda x: 2.0 * x)
    values = data["posterior"]["slope"].to_numpy()
    np.testing.assert_allclose(values, 2.0 * posterior.draws[..., 1])
    assert data["posterior"]["noise factor"].shape == (2, 800, 1)


@pytest.mark.slow
def test_a_parameter_that_data_leave_open_fills_its_bounds():
    """The data see only the sum; with bounds the posterior of the difference is known by integration."""
    problem = FunctionProblem(
        lambda x: jnp.stack([(x[0] + x[1] - 1.0) / 0.2]), ("a", "b"), np.zeros(2), np.full(2, 1.0)
    )
    posterior = sample_posterior(problem, solve(problem, [0.3, 0.3]), noise="known", warmup=300, draws=800, chains=2)
    grid = np.linspace(0.0, 1.0, 401)
    density = np.exp(-0.5 * ((grid[:, None] + grid - 1.0) / 0.2) ** 2).sum(axis=1)
    mean = (grid * density).sum() / density.sum()
    sd = np.sqrt(((grid - mean) ** 2 * density).sum() / density.sum())
    assert posterior.draws[..., 0].mean() == pytest.approx(mean, abs=0.05)
    assert posterior.draws[..., 0].std() == pytest.approx(sd, rel=0.1)
    assert posterior.noise_factors.shape[-1] == 0 and np.all((posterior.draws > 0) & (posterior.draws < 1))


@pytest.mark.slow
def test_rows_of_the_host_are_sampled_too():
    """A problem in NumPy with a prior row: the posterior is normal, precision the sum of both."""
    problem = Linear(np.concatenate([DESIGN[:, :1] / 1.5, [[2.0]]]), np.append(DATA / 1.5, 0.0))
    problem.recording = np.append(np.zeros(40, dtype=int), -1)
    posterior = sample_posterior(problem, solve(problem, [0.0]), noise="known", warmup=200, draws=500, chains=2)
    precision = 40 / 1.5**2 + 4.0
    assert posterior.draws.mean() == pytest.approx(DATA.sum() / 1.5**2 / precision, abs=0.05)
    assert posterior.draws.std() == pytest.approx(precision**-0.5, rel=0.15)


def test_calibration_passes_right_ranks_and_fails_wrong_ones():
    rng = np.random.default_rng(0)
    truth = rng.standard_normal(400)
    draws = rng.standard_normal((400, 49))
    ranks = {
        "right": np.array([rank_of(t, d, rng) for t, d in zip(truth, draws, strict=True)]),
        "narrow": np.array([rank_of(t, 0.7 * d) for t, d in zip(truth, draws, strict=True)]),
        "shifted": np.array([rank_of(t, d + 0.3) for t, d in zip(truth, draws, strict=True)]),
    }
    found = {c.name: c.inside for c in calibrate(ranks, 49)}
    assert found == {"right": True, "narrow": False, "shifted": False}
    with pytest.raises(ValueError, match="draw more"):
        thin(np.zeros(3), 4)


def test_the_band_holds_as_often_as_it_says():
    """A single point of the cumulative distribution is a plain binomial test; many points need a wider band."""
    single = band_limit(200, 1, 0.95, simulations=4000)
    many = band_limit(200, 99, 0.95)
    assert single == pytest.approx(0.05, abs=0.012)
    assert many < 0.2 * single
    rng, inside = np.random.default_rng(99), 0
    for _ in range(400):
        inside += calibrate({"fresh": rng.integers(0, 20, 100)}, 19, 0.9, simulations=500)[0].inside
    assert 336 <= inside <= 384  # 360 expected, four standard deviations of counting
