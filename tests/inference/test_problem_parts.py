"""Priors, losses, noise levels and faults of recordings, against SciPy's densities and hand-made data."""

import numpy as np
import pytest
from scipy import stats

import jaxlines as jl
from jaxlines.inference.distributions import LogNormal, LogUniform, Normal, Triangular, Truncated, Uniform
from jaxlines.inference.input_noise import InputNoise
from jaxlines.inference.loss import Loss
from jaxlines.inference.noise import Noise, as_noise, estimate_noise
from jaxlines.inference.priors import Prior
from jaxlines.inference.recording_faults import find_faults

PRIORS = [
    (Normal(3.0, 0.5), stats.norm(3.0, 0.5)),
    (LogNormal(2.0, 0.3), stats.lognorm(0.3, scale=2.0)),
    (Uniform(1.0, 4.0), stats.uniform(1.0, 3.0)),
    (LogUniform(1.0, 4.0), stats.loguniform(1.0, 4.0)),
    (Truncated(Normal(3.0, 0.5), 2.5, 3.2), stats.truncnorm(-1.0, 0.4, 3.0, 0.5)),
]


@pytest.mark.parametrize(("distribution", "known"), PRIORS)
def test_density_and_samples_are_those_of_the_distribution(distribution, known):
    prior = Prior(distribution)
    for value in (2.6, 3.0, 3.15, 5.0, 0.5):
        assert prior.log_density(value) == pytest.approx(known.logpdf(value), rel=1e-9)
    drawn = prior.sample(np.random.default_rng(1), 2000)
    assert stats.kstest(drawn, known.cdf).pvalue > 1e-3
    assert prior.support[0] <= prior.sample(np.random.default_rng(2)) <= prior.support[1]


def test_rows_of_priors_and_their_slopes():
    """Half the square of a row is minus the log density in the coordinate in which it is normal, up to a constant."""
    normal, log_normal = Prior(Normal(3.0, 0.5)), Prior(LogNormal(2.0, 0.3))
    assert normal.residual(4.0) == pytest.approx(2.0)
    assert normal.slope(4.0) == pytest.approx(2.0)
    assert log_normal.residual(2.0 * np.exp(0.6)) == pytest.approx(2.0)
    step = (log_normal.residual(2.5 + 1e-6) - log_normal.residual(2.5 - 1e-6)) / 2e-6
    assert log_normal.slope(2.5) == pytest.approx(step, rel=1e-6)
    assert Prior(Uniform(0.0, 1.0)).flat and Prior(Uniform(0.0, 1.0)).residual(0.7) == 0.0
    with pytest.raises(TypeError, match=r"a prior must be Normal, LogNormal, Uniform or LogUniform"):
        Prior(Triangular(0.0, 0.5, 1.0))


def test_ends_of_a_prior_narrow_the_bounds():
    free = jl.Free("a", (0.0, 10.0), prior=Truncated(Normal(3.0, 1.0), 2.0, 20.0))
    assert free.bounds == (2.0, 10.0)
    with pytest.raises(ValueError, match=r"leaves nothing of the bounds 0\.\.1: other units"):
        jl.Free("a", (0.0, 1.0), prior=Uniform(5.0, 6.0))
    with pytest.raises(ValueError, match=r"ratios must be one finite number other than 0 for each of the 2 paths"):
        jl.Free(("a", "b"), (0.0, 1.0), ratios=(1.0,))


@pytest.mark.parametrize("kind", ["gauss", "huber", "student"])
def test_losses_are_half_squares_of_their_rows(kind):
    loss, z = Loss(kind), np.array([-8.0, -1.5, -0.3, 1e-9, 0.7, 1.3451, 20.0])
    np.testing.assert_allclose(0.5 * loss.rows(z) ** 2, loss.cost(z), rtol=1e-9, atol=1e-20)
    step = 1e-5
    influence = (loss.cost(z + step) - loss.cost(z - step)) / (2 * step)
    np.testing.assert_allclose(loss.influence(z), influence, atol=1e-8)
    np.testing.assert_allclose(loss.row_slopes(z) * loss.rows(z), loss.influence(z), atol=1e-8)
    density = np.exp(-loss.cost(np.linspace(-400.0, 400.0, 800_001)) - loss.log_normaliser())
    assert density.sum() * 1e-3 == pytest.approx(1.0, rel=1e-3)


def test_losses_agree_with_published_definitions():
    from scipy.special import huber

    z = np.linspace(-6.0, 6.0, 25)
    np.testing.assert_allclose(Loss("huber", 1.5).cost(z), huber(1.5, z), rtol=1e-12)
    loss = Loss("student", 3.0)
    np.testing.assert_allclose(-loss.cost(z) - loss.log_normaliser(), stats.t.logpdf(z, 3.0), rtol=1e-10)
    noise = np.random.default_rng(0).standard_normal(200_000)
    assert Loss("huber").information(noise) == pytest.approx(0.95, abs=0.01)  # efficiency at 1.345 (Huber)
    assert np.mean(Loss("huber").influence(noise) ** 2) == pytest.approx(Loss("huber").consistency, abs=0.01)
    with pytest.raises(ValueError, match="loss must be one of gauss, huber, student, got 'tukey'"):
        Loss("tukey")
    with pytest.raises(ValueError, match="scale of the loss must be positive"):
        Loss("huber", -1.0)


def test_relative_noise_is_estimated_without_bias():
    """40 data sets of readings 1..50 with 0.2 absolute and 3 % relative noise: means within 3 standard errors."""
    rng, reading = np.random.default_rng(5), np.linspace(1.0, 50.0, 400)
    sigma, found = np.hypot(0.2, 0.03 * reading), []
    for _ in range(40):
        errors = sigma * rng.standard_normal(reading.size)
        noise = estimate_noise(Noise(None, None), errors, reading, 1.0, Loss(), 1e-9)
        found.append((noise.absolute, noise.relative))
    mean, error = np.mean(found, axis=0), np.std(found, axis=0) / np.sqrt(40)
    assert np.all(np.abs(mean - [0.2, 0.03]) < 3.0 * error + [0.01, 0.0002])  # the second: bias of order 1/n of ML
    assert np.all(error < [0.02, 0.001])


@pytest.mark.parametrize("kind", ["huber", "student"])
def test_noise_level_bears_outliers(kind):
    rng = np.random.default_rng(6)
    errors = 2.0 * (stats.t(4.0).rvs(4000, random_state=rng) if kind == "student" else rng.standard_normal(4000))
    level = estimate_noise(Noise(), errors, np.ones(4000), 1.0, Loss(kind), 1e-9).absolute
    assert level == pytest.approx(2.0, rel=0.06)
    errors[:40] = 1e4
    bad = estimate_noise(Noise(), errors, np.ones(4000), 1.0, Loss(kind), 1e-9).absolute
    assert bad == pytest.approx(2.0, rel=0.15)


def test_wrong_noise_is_refused():
    with pytest.raises(ValueError, match=r"noise of p must be positive, got 0"):
        as_noise(0.0, "p")
    with pytest.raises(ValueError, match="both 0"):
        Noise(0.0, 0.0)
    with pytest.raises(ValueError, match="relative noise must be positive"):
        Noise(1.0, -0.1)
    with pytest.raises(ValueError, match="noise of an input must be positive in white, gain or offset"):
        InputNoise()


TIMES = np.arange(200) * 0.01
SHOWN = 5e6 + 2e6 * np.sin(8.0 * TIMES)


def faults_of(pressure, times=TIMES, unit="Pa"):
    """What is found in a recording of a pressure beside a flow, by (kind, grave), and the first text."""
    recording = jl.Recording(times, {"p": pressure, "flow": np.sin(times)}, name="run 7")
    found = find_faults(recording, {"p": SHOWN}, {"p": unit})
    return [(fault.kind, fault.grave) for fault in found], (found[0].text if found else "")


def noisy(scale: float) -> np.ndarray:
    """The pressure in another unit, on a scale 30 % off and with noise."""
    return scale * 1.3 * (SHOWN + 3e4 * np.random.default_rng(4).standard_normal(TIMES.size))


@pytest.mark.parametrize(
    ("factor", "grave", "words"),
    [
        (1e-5, True, "was it recorded in bar"),
        (1e-6, True, "was it recorded in MPa"),
        (1.0 / 6894.757, True, "was it recorded in psi"),
        (10.0, False, "bar was taken for MPa"),
        (0.1, False, "MPa was taken for bar"),
        (14.504, False, "psi was taken for bar"),
        (6894.757, True, "Pa was taken for psi"),
        (1e5, True, "Pa was taken for bar"),
    ],
)
def test_swapped_units_are_named(factor, grave, words):
    kinds, text = faults_of(noisy(factor / 1.15))
    assert kinds == [("unit", grave)]
    assert words in text and "'p'" in text and "run 7" in text


def test_a_good_recording_has_no_faults_even_from_a_start_far_off():
    for scale in (0.4, 1.0, 2.5):
        assert faults_of(noisy(scale))[0] == []


def test_dead_and_stuck_channels_are_named():
    kinds, text = faults_of(np.full(TIMES.size, 3.2e6))
    assert kinds == [("dead", True)] and "'p' is 3.2e+06 throughout" in text
    stuck = noisy(1.0)
    stuck[60:130] = stuck[60]
    kinds, text = faults_of(stuck)
    assert kinds == [("dead", False)] and "stuck" in text and "from 0.6 to 1.29 s" in text


def test_time_jumps_are_named():
    jump = np.where(np.arange(200) < 120, TIMES, TIMES + 3.0)
    kinds, text = faults_of(noisy(1.0), jump)
    assert kinds == [("gap", False)] and "time jumps by 3.01 s at 1.19 s" in text
    jitter = TIMES + 0.004 * np.random.default_rng(3).random(200)
    kinds, text = faults_of(noisy(1.0), jitter)
    assert kinds == [("uneven", False)] and "off the usual" in text
    backward = TIMES.copy()
    backward[100:] -= 0.5
    with pytest.raises(ValueError, match=r"at sample 100 it goes from 0.99 s to 0.5 s.*did the clock jump"):
        jl.Recording(backward, {"p": SHOWN})
