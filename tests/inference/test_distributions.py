"""Distributions and their dependence: against closed forms and scipy's own numbers, and refused when wrong."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxlines.inference.distributions import (
    Discrete,
    LogNormal,
    LogUniform,
    Normal,
    Triangular,
    Truncated,
    Uniform,
)
from jaxlines.inference.samplers import Sobol
from jaxlines.inference.uncertain import Draws, JointNormal, Uncertain, from_fit
from jaxlines.inference.uncertainty import Estimate

PAIR = {"a": Normal(0, 1), "b": Normal(0, 1)}
U = Sobol(3).uniforms(0, 1 << 14, 3)

CLOSED = {  # distribution: mean, standard deviation, median
    Normal(2.0, 0.5): (2.0, 0.5, 2.0),
    LogNormal(3.0, 0.4): (3 * np.exp(0.08), 3 * np.exp(0.08) * np.sqrt(np.exp(0.16) - 1), 3.0),
    Uniform(1.0, 5.0): (3.0, 4 / np.sqrt(12), 3.0),
    LogUniform(1.0, np.e**2): ((np.e**2 - 1) / 2, np.sqrt((np.e**4 - 1) / 4 - ((np.e**2 - 1) / 2) ** 2), np.e),
    Triangular(0.0, 1.0, 4.0): (5 / 3, np.sqrt(13 / 18), 4 - np.sqrt(6)),
    Truncated(Normal(0.0, 1.0), low=0.0): (np.sqrt(2 / np.pi), np.sqrt(1 - 2 / np.pi), 0.6744897501960817),
    Discrete((1.0, 2.0, 10.0), (1, 2, 1)): (3.75, np.sqrt((1 + 8 + 100) / 4 - 3.75**2), 2.0),
}


@pytest.mark.parametrize("distribution", CLOSED, ids=lambda d: type(d).__name__)
def test_moments_and_median_are_those_of_the_books(distribution):
    mean, sd, median = CLOSED[distribution]
    x = distribution.quantile(U[:, 0])
    assert x.mean() == pytest.approx(mean, rel=2e-3, abs=2e-3)
    assert x.std() == pytest.approx(sd, rel=5e-3)
    assert float(distribution.quantile(np.asarray(0.5))) == pytest.approx(median, rel=1e-9)


@pytest.mark.parametrize(
    "distribution", [d for d in CLOSED if not isinstance(d, Discrete)], ids=lambda d: type(d).__name__
)
def test_probability_undoes_quantile(distribution):
    u = np.linspace(0.01, 0.99, 21)
    assert np.allclose(distribution.probability(distribution.quantile(u)), u, atol=1e-12)


def test_log_normal_between_holds_the_share():
    distribution = LogNormal.between(1e-4, 1e-2, 0.9)
    assert np.allclose(distribution.quantile(np.array([0.05, 0.95])), [1e-4, 1e-2])


def test_discrete_probability_counts_weights():
    assert np.allclose(
        Discrete((1.0, 2.0, 10.0), (1, 2, 1)).probability(np.array([0.0, 1.0, 5.0, 10.0])), [0, 0.25, 0.75, 1]
    )


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Normal(1.0, -0.1), "sd positive.*got 1, -0.1"),
        (lambda: LogNormal(-1.0, 0.1), "must be positive, got -1, 0.1"),
        (lambda: Uniform(3.0, 2.0), "increasing, got 3 .. 2"),
        (lambda: LogUniform(0.0, 2.0), "ends must be positive"),
        (lambda: Triangular(0.0, 5.0, 4.0), "increasing, got 0 .. 5 .. 4"),
        (lambda: Truncated(Uniform(0.0, 1.0), low=2.0), "some probability"),
        (lambda: Discrete((1.0, 2.0), (1.0,)), "as many weights"),
        (lambda: Uncertain({}), "nothing is uncertain"),
        (lambda: Uncertain({"x": Normal(0, 1)}, joint=(Draws(("x",), np.ones((2, 1))),)), "x is uncertain twice"),
        (lambda: Uncertain(PAIR, correlation={("a", "b"): 1.5}), "between -1 and 1, got 1.5"),
        (lambda: JointNormal(("a", "b"), np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]])), "contradict"),
        (lambda: Draws(("a",), np.array([[np.nan]])), "must be finite, got nan in row 0"),
    ],
)  # fmt: skip
def test_wrong_distributions_are_refused(make, text):
    with pytest.raises(ValueError, match=text):
        make()


def test_correlations_that_contradict_each_other_are_refused():
    numbers = {name: Normal(0, 1) for name in "abc"}
    pairs = {("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9}
    with pytest.raises(ValueError, match="contradict each other"):
        Uncertain(numbers, correlation=pairs)
    with pytest.raises(KeyError, match="'d' is none of"):
        Uncertain(numbers, correlation={("a", "d"): 0.1})


def test_copula_keeps_marginals_and_gives_the_rank_correlation_of_a_normal_pair():
    """Spearman's rho of a Gaussian copula is 6/pi asin(r/2) (Pearson, 1907)."""
    from scipy.stats import spearmanr

    uncertain = Uncertain(
        {"a": Uniform(0, 1), "b": LogNormal(1.0, 0.5), "c": Normal(0, 1)}, correlation={("a", "b"): 0.8}
    )
    values = uncertain.values(U)
    rank = np.asarray(spearmanr(values)[0])
    assert rank[0, 1] == pytest.approx(6 / np.pi * np.arcsin(0.4), abs=5e-3)
    assert abs(rank[0, 2]) < 5e-3
    assert np.quantile(values[:, 0], [0.1, 0.9]) == pytest.approx([0.1, 0.9], abs=2e-3)


def test_joint_normal_has_its_covariance():
    covariance = np.array([[4.0, 1.0], [1.0, 0.5]])
    group = JointNormal(("x", "y"), np.array([10.0, -3.0]), covariance)
    values = Uncertain({"a": Uniform(0, 1)}, joint=(group,)).values(U)
    assert values[:, 1:].mean(axis=0) == pytest.approx([10.0, -3.0], abs=2e-3)
    assert np.cov(values[:, 1:].T) == pytest.approx(covariance, rel=5e-3)


def test_draws_stay_together():
    rows = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]])
    values = Uncertain({}, joint=(Draws.from_table({"x": rows[:, 0], "y": rows[:, 1]}),)).values(U[:, :1])
    assert np.array_equal(values[:, 1], 10 * values[:, 0])
    assert np.allclose(np.unique(values[:, 0], return_counts=True)[1] / len(U), 1 / 3, atol=1e-3)


def test_a_row_does_not_depend_on_the_others():
    group = JointNormal(("x", "y"), np.zeros(2), np.array([[1.0, 0.3], [0.3, 1.0]]))
    uncertain = Uncertain({"a": Normal(0, 1)}, joint=(group,))
    assert np.array_equal(uncertain.values(U)[1000:1017], uncertain.values(U[1000:1017]))


def test_a_fit_gives_its_laplace_approximation():
    """An interval that is symmetric in the logarithm gives a log-normal marginal."""
    log = Estimate(0.01, 0.002, (0.01 * np.exp(-0.392), 0.01 * np.exp(0.392)), "1", "interval")
    plain = Estimate(1.4e9, 1e7, (1.4e9 - 1.96e7, 1.4e9 + 1.96e7), "Pa", "interval")
    lost = Estimate(1.0, None, None, "1", "unidentified")
    correlations = np.array([[1.0, -0.7, 0.0], [-0.7, 1.0, 0.0], [0.0, 0.0, 1.0]])
    fit = SimpleNamespace(parameters={"air": log, "modulus": plain, "lost": lost}, correlations=correlations)
    uncertain = from_fit(fit)
    assert uncertain.single == {"air": LogNormal(0.01, 0.2), "modulus": Normal(1.4e9, 1e7)}
    assert uncertain.correlation == {("modulus", "air"): -0.7}
    with pytest.raises(ValueError, match="lost: the fit left it open"):
        from_fit(fit, ["lost"])
