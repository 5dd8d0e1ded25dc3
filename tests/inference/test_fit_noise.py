"""What a fit says of its uncertainty: the noise it assumes, scatter between recordings, budgets, classes, a posterior.

All on a line without air or leak under constant flow, p = p0 + (K/V) Q t, where K is the slope of a regression.
"""

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference.identifiability import IDENTIFIABLE, STRUCTURALLY

from .cases import TIMES, linear_line
from .test_noise_models import coloured, stationary

FLOW, VOLUME, MODULUS, NOISE = 1e-5, 0.03, 1.4e9, 1e4
DESIGN = np.stack([np.ones_like(TIMES), TIMES], axis=1)
FREE = [jl.Free("fluid.bulk_modulus", (5e8, 4e9), start=2.5e9), jl.Free("initial.A.pressure", (1e5, 1e6))]
SCALE = VOLUME / FLOW
"""K over the slope of the pressure."""


def record(noise, modulus: float = MODULUS, name: str = "run") -> jl.Recording:
    """A recording of the line with this noise [Pa]."""
    pressure = 3e5 + modulus / SCALE * TIMES + noise
    return jl.Recording(TIMES, {"A.pressure": pressure, "flow": np.full(TIMES.size, FLOW)}, name=name)


@pytest.fixture(scope="module")
def correlated():
    noise = NOISE * coloured(np.random.default_rng(1), TIMES.size, [0.6], 0.8)
    return jl.fit(linear_line(), record(noise), free=FREE, known=[jl.Known("line.volume", 3e-4)])


def test_intervals_bear_autoregressive_noise_by_default_and_say_so(correlated):
    """Standard deviation of the regression slope under the known covariance of the noise: twice that of white noise."""
    gain = np.linalg.pinv(DESIGN)
    exact = NOISE * SCALE * np.sqrt((gain @ stationary([0.6], 0.8, TIMES.size) @ gain.T)[1, 1])
    white = NOISE * SCALE * np.sqrt((gain @ gain.T)[1, 1])
    own = correlated.budgets()["fluid.bulk_modulus"].sources[0]
    assert exact > 1.8 * white
    assert own.sd == pytest.approx(exact, rel=0.3) and own.kind == "A" and own.freedom < 100
    assert "autoregressive of order 1" in correlated.intervals
    assert "intervals:\n  - residuals are not white" in str(correlated)
    assert any("not a wrong model" in warning for warning in correlated.warnings)
    estimate = correlated.parameters["fluid.bulk_modulus"]
    assert estimate.value == pytest.approx(np.polyfit(TIMES, _pressure(correlated), 1)[0] * SCALE, rel=1e-5)


def _pressure(fit) -> np.ndarray:
    return fit.channels["A.pressure"].measured


def test_the_budget_parts_noise_from_the_volume_and_adds_up(correlated):
    budget = correlated.budgets()["fluid.bulk_modulus"]
    estimate = correlated.parameters["fluid.bulk_modulus"]
    volume = next(source for source in budget.sources if source.quantity.endswith("volume"))
    assert volume.kind == "B" and volume.value == VOLUME
    assert volume.contribution == pytest.approx(0.01 * estimate.value, rel=1e-3)  # K is proportional to V
    assert budget.sd == pytest.approx(estimate.sd, rel=1e-9)
    reach = estimate.ci95[1] - estimate.value
    assert reach == pytest.approx(1.96 * estimate.sd, rel=0.02)  # the volume has no lack of degrees of freedom


def test_residuals_with_a_known_level_and_no_correlation_are_white():
    noise = NOISE * np.random.default_rng(2).standard_normal(TIMES.size)
    fit = jl.fit(linear_line(), record(noise), free=FREE, noise={"A.pressure": NOISE})
    estimate = fit.parameters["fluid.bulk_modulus"]
    assert fit.analysis is not None and fit.analysis.noise.method == "white"
    assert np.all(np.isinf(fit.analysis.freedom))
    assert estimate.ci95 is not None and estimate.sd is not None
    assert estimate.ci95[1] - estimate.ci95[0] == pytest.approx(2 * 1.959964 * estimate.sd, rel=1e-6)


def test_scatter_between_recordings_stands_beside_the_intervals():
    rng = np.random.default_rng(3)
    moduli = MODULUS + np.array([-1e8, -2e7, 3e7, 9e7])
    runs = [record(NOISE * rng.standard_normal(TIMES.size), k, f"run {i}") for i, k in enumerate(moduli)]
    fit = jl.fit(linear_line(), runs, free=[FREE[0]], initial={"A.pressure": 3e5})
    between = fit.scatter["fluid.bulk_modulus"]
    assert between.p < 1e-6 and between.recordings == 4
    assert between.sd == pytest.approx(np.std(moduli, ddof=1), rel=0.2)
    assert "differs by" in str(fit) and "scatter between recordings" in str(fit)
    sources = fit.budgets()["fluid.bulk_modulus"].sources
    assert sources[1].sd == pytest.approx(between.sd / 2.0) and sources[1].freedom == 3


def test_few_samples_are_not_called_white():
    few = slice(0, 24)
    pressure = 3e5 + MODULUS / SCALE * TIMES[few] + NOISE * np.random.default_rng(4).standard_normal(24)
    data = jl.Recording(TIMES[few], {"A.pressure": pressure, "flow": np.full(24, FLOW)})
    fit = jl.fit(linear_line(), data, free=FREE)
    assert not fit.channels["A.pressure"].white and np.isnan(fit.channels["A.pressure"].whiteness_p)
    assert "too few to tell whether white" in str(fit) and "too few" in fit.intervals
    assert not any("not white" in warning for warning in fit.warnings)


def test_classes_name_what_cannot_be_told_and_what_test_would():
    noise = NOISE * np.random.default_rng(5).standard_normal(TIMES.size)
    free = [*FREE, jl.Free("line.volume", (0.01, 0.1), start=0.05)]
    found = jl.fit(linear_line(), record(noise), free=free).assess()
    assert found["fluid.bulk_modulus"].kind == found["line.volume"].kind == STRUCTURALLY
    assert "fixes them together" in found["line.volume"].sentence and "ruler" in found["line.volume"].sentence
    assert found["initial.A.pressure"].kind == IDENTIFIABLE
    assert "Pa" in found["initial.A.pressure"].sentence


def test_classes_use_the_noise_that_residuals_show(correlated):
    """On a linear model the likelihood interval is the stated one, without the known volume."""
    found = correlated.assess()["fluid.bulk_modulus"]
    own = correlated.budgets()["fluid.bulk_modulus"].sources[0]
    from scipy import stats

    assert found.interval is not None
    half = 0.5 * (found.interval.ends[1] - found.interval.ends[0])
    assert half == pytest.approx(stats.t.ppf(0.975, own.freedom) * own.sd, rel=0.02)


def test_a_failed_fit_has_nothing_to_ask():
    fit = jl.Fit.failure(linear_line(), "no start could be simulated", 0.0)
    with pytest.raises(ValueError, match="no start could be simulated"):
        fit.budgets()


@pytest.mark.slow
def test_the_posterior_is_the_interval_on_a_linear_model():
    noise = NOISE * np.random.default_rng(6).standard_normal(TIMES.size)
    fit = jl.fit(linear_line(), record(noise), free=FREE, noise={"A.pressure": NOISE})
    drawn = fit.posterior(warmup=200, draws=400, chains=2)
    estimate = fit.parameters["fluid.bulk_modulus"]
    values = drawn.draws[..., 0]
    assert estimate.sd is not None
    assert np.mean(values) == pytest.approx(estimate.value, abs=0.2 * estimate.sd)
    assert np.std(values) == pytest.approx(estimate.sd, rel=0.15)
