"""Elementary functions of lanes against those of the C library in twice the precision."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.simulation.fast_math import exp2, inverse_fourth_root, inverse_root, log2

FORMATS = (np.float64, np.float32)
ROOTS = ((inverse_root, 2), (inverse_fourth_root, 4))


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def all_sizes(kind) -> np.ndarray:
    """Numbers of all exponents, and many near one."""
    random, limits = np.random.default_rng(0), np.finfo(kind)
    wide = 10.0 ** random.uniform(np.log10(limits.tiny) + 0.01, np.log10(limits.max) - 0.01, 20_000)
    return np.concatenate([wide, random.uniform(0.5, 2.0, 20_000), [limits.tiny, limits.max, 1.0]]).astype(kind)


def ulps(found, exact, kind, least=0.0) -> float:
    """The largest error in units of the last place of the exact numbers, or of a least size."""
    size = np.maximum(np.abs(exact), least)
    return float(np.max(np.abs(np.asarray(found).astype(np.longdouble) - exact) / size) / np.finfo(kind).eps)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(("function", "root"), ROOTS)
def test_inverse_roots(function, root, kind):
    x = all_sizes(kind)
    assert ulps(jax.jit(function)(x), np.power(x.astype(np.longdouble), -np.longdouble(1) / root), kind) < 1.0


@pytest.mark.parametrize("kind", FORMATS)
def test_logarithm(kind):
    x = all_sizes(kind)
    found, exact = jax.jit(log2)(x), np.log2(x.astype(np.longdouble))
    assert ulps(found, exact, kind, least=1.0) < 1.0
    near = (x > 0.5) & (x < 2.0) & (x != 1.0)
    assert ulps(np.asarray(found)[near], exact[near], kind) < 2.0


@pytest.mark.parametrize("kind", FORMATS)
def test_power_of_two(kind):
    most = np.finfo(kind).maxexp
    x = np.random.default_rng(0).uniform(3.0 - most, most - 1e-3, 40_000).astype(kind)
    assert ulps(jax.jit(exp2)(x), np.exp2(x.astype(np.longdouble)), kind) < 1.0
    whole = np.arange(3 - most, most, dtype=kind)
    np.testing.assert_array_equal(jax.jit(exp2)(whole), np.ldexp(kind(1.0), whole.astype(int)))


@pytest.mark.parametrize("kind", FORMATS)
def test_special_numbers(kind):
    """Zero, negative numbers, infinities and what is no number; numbers below the normal ones count as zero."""
    limits = np.finfo(kind)
    x = np.array([0.0, -0.0, limits.tiny / 8, -1.0, -np.inf, np.nan, np.inf], kind)
    for function, root in ROOTS:
        found = np.asarray(jax.jit(function)(x))
        np.testing.assert_array_equal(found[:-1], [np.inf, np.inf, np.inf, np.nan, np.nan, np.nan])
        np.testing.assert_allclose(found[-1], float(limits.max) ** (-1.0 / root), rtol=1e-6)
    np.testing.assert_array_equal(jax.jit(log2)(x), [-np.inf] * 3 + [np.nan] * 3 + [np.inf])
    x = np.array([-np.inf, -2.0 * limits.maxexp, limits.maxexp, np.inf, np.nan, 0.0], kind)
    np.testing.assert_array_equal(jax.jit(exp2)(x), [0.0, 0.0, np.inf, np.inf, np.nan, 1.0])


def power(p, index):
    return exp2(-log2(p) / index)


@settings(deadline=None)
@given(st.floats(-250.0, 250.0), st.floats(1.0, 3.0))
def test_powers_as_circuits_have_them(exponent, index):
    """p^(-1/n) by 2^(-log2(p)/n): the error is that of the product in the exponent."""
    p = 10.0**exponent
    found = float(jax.jit(power)(p, index))
    exact = np.longdouble(p) ** (-np.longdouble(1.0) / np.longdouble(index))
    np.testing.assert_allclose(found, float(exact), rtol=4e-16 * (2.0 + abs(np.log(p)) / index))
