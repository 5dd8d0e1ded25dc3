"""Covariance against closed forms, the whiteness test against its definition, and the words for what is open."""

import numpy as np
import pytest

from jaxlines.inference.parameters import Free
from jaxlines.inference.search import relative_offset
from jaxlines.inference.uncertainty import (
    UNINFORMED,
    covariance,
    describe_open_directions,
    is_open,
    ljung_box,
    make_estimate,
)

RNG = np.random.default_rng(3)


def test_covariance_of_a_straight_line_is_that_of_linear_regression():
    t, sigma = np.linspace(0.0, 10.0, 200), 0.3
    design = np.stack([np.ones_like(t), t], axis=1)
    found = covariance(design / sigma, np.zeros((200, 0)), np.array([100.0, 100.0]), ())
    sxx = np.sum((t - t.mean()) ** 2)
    assert found.joint[1, 1] == pytest.approx(sigma**2 / sxx, rel=1e-10)
    assert found.joint[0, 0] == pytest.approx(sigma**2 * (1 / 200 + t.mean() ** 2 / sxx), rel=1e-10)
    assert np.all(found.open_share < 1e-6)


def test_a_known_number_adds_its_share_as_the_gum_says():
    """y = a * g with g known to sd: u(a)^2 = (sigma/(g sqrt N))^2 + (a u_g/g)^2."""
    count, sigma, a, g, u_g = 400, 0.2, 3.0, 2.0, 0.01
    found = covariance(
        np.full((count, 1), g) / sigma, np.full((count, 1), a) / sigma, np.array([100.0]), np.array([u_g])
    )
    assert found.joint[0, 0] == pytest.approx((sigma / g) ** 2 / count + (a * u_g / g) ** 2, rel=1e-6)
    assert found.joint[0, 1] == pytest.approx(-a / g * u_g**2, rel=1e-6)


def test_only_the_ratio_is_known_and_that_is_said():
    column = RNG.standard_normal(300)
    jacobian = np.stack([column, -column, RNG.standard_normal(300)], axis=1) * 50.0
    found = covariance(jacobian, np.zeros((300, 0)), np.ones(3), ())
    assert found.open_directions.shape[0] == 1
    assert describe_open_directions(["K", "V", "leak"], found, np.ones(3)) in (
        ("the recording fixes K and V only together",),
        ("the recording fixes V and K only together",),
    )
    assert found.open_share[0] > 0.9
    assert found.open_share[2] < 0.1
    assert np.sqrt(found.joint[0, 0]) == pytest.approx(UNINFORMED / np.sqrt(2), rel=0.01)


def test_a_parameter_without_effect_is_said_to_be_open():
    jacobian = np.stack([RNG.standard_normal(100), np.zeros(100)], axis=1)
    found = covariance(jacobian * 10, np.zeros((100, 0)), np.ones(2), ())
    assert describe_open_directions(["K", "n"], found, np.ones(2)) == (
        "the recording says nothing about n within its bounds",
    )


def test_intervals_are_formed_in_the_coordinate_and_mapped():
    free = Free("fluid.air_fraction", (1e-5, 0.1), transform="log")
    estimate = make_estimate(free, 0.01, 0.2, "1", "interval")
    assert estimate.ci95 == pytest.approx((0.01 * np.exp(-1.96 * 0.2), 0.01 * np.exp(1.96 * 0.2)), rel=1e-3)
    assert estimate.sd == pytest.approx(0.002)
    limit = make_estimate(free, 1e-4, 1e-4, "1", "upper_limit")
    assert limit.ci95 == pytest.approx((0.0, 1e-4 + 1.645e-4), rel=1e-3)
    assert make_estimate(free, 0.01, 3.0, "1", "unidentified").ci95 is None


def test_open_means_both_by_share_and_by_size():
    assert is_open(0.9, 0.5, 1.0)
    assert not is_open(0.9, 0.05, 1.0)
    assert not is_open(0.1, 0.5, 1.0)


def test_ljung_box_equals_its_definition_and_has_its_level():
    x = RNG.standard_normal(500)
    from scipy.stats import chi2

    centred = x - x.mean()
    r = np.array([np.sum(centred[k:] * centred[:-k]) for k in range(1, 21)]) / np.sum(centred**2)
    q = 500 * 502 * np.sum(r**2 / (500 - np.arange(1, 21)))
    # The sums over pairs are divided by the number of pairs, which changes the statistic by terms of order lag/N.
    assert ljung_box(x, np.ones(500, bool)) == pytest.approx(chi2.sf(q, 20), abs=0.03)
    rejected = np.mean([ljung_box(RNG.standard_normal(400), np.ones(400, bool)) < 0.05 for _ in range(400)])
    assert 0.02 < rejected < 0.09


def test_ljung_box_finds_correlation_and_bears_gaps():
    x = np.convolve(RNG.standard_normal(600), [1.0, 0.5], mode="valid")
    used = RNG.random(x.size) > 0.2
    assert ljung_box(x, used) < 1e-6
    assert ljung_box(np.where(used, RNG.standard_normal(x.size), np.nan), used) > 1e-3


def test_relative_offset_sees_a_plateau_but_not_a_dead_direction():
    """A weak direction along which the misfit would fall counts; one that changes nothing does not."""
    count, noise = 50, RNG.standard_normal(50)
    firm, weak = np.linalg.qr(RNG.standard_normal((count, 2)))[0].T
    rest = noise - firm * (firm @ noise) - weak * (weak @ noise)
    jacobian = np.stack([100.0 * firm, 2.0 * weak], axis=1)
    assert relative_offset(jacobian, rest, np.ones(2)) < 1e-12
    assert relative_offset(jacobian, rest + 5.0 * weak, np.ones(2)) > 1.0
    assert relative_offset(jacobian * [1.0, 1e-6], rest + 5.0 * weak, np.ones(2)) < 1e-12
    assert relative_offset(jacobian, rest + 0.1 * firm, np.ones(2)) == pytest.approx(0.1, rel=0.3)
