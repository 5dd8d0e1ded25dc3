"""Elementary functions of many lanes that a processor computes without its divider and without leaving its vectors.

XLA calls a scalar routine for some (log in float64), and the square roots and divisions in others wait for one slow
unit while the multipliers idle. Here are polynomials, and Newton's iteration where a
good start is known: a float's bits, read as a whole number, are nearly its logarithm (Blinn, "Floating-point tricks",
IEEE Computer Graphics and Applications 17(4), 1997). Powers and logarithms are those of 2, which need no reduction of
their argument by multiples of log 2. Numbers below the smallest normal one count as zero.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np


class Operation(NamedTuple):
    """An operation of an expression that JAX has no primitive for."""

    name: str
    bind: Callable


class Format(NamedTuple):
    """What depends on the floating-point format.

    Fields: number, whole: types; mantissa [bits]; bias of the exponent; roots: n -> start of the iteration for
    x^(-1/n); terms: of the series, that each iteration takes; exp2, log2: coefficients.
    """

    number: Any
    whole: Any
    mantissa: int
    bias: int
    roots: dict[int, int]
    terms: tuple[int, int]
    exp2: tuple[float, ...]
    log2: tuple[float, ...]


# The starts of the roots are those with the smallest largest error, 3.4 % (n = 2) and 3.1 % (n = 4), found by trying.
# exp2: q in 2^r = 1 + r q(r), |r| < 1/2; log2: q in log2(m) = s q(s^2), s = (m - 1)/(m + 1), m in sqrt(1/2)..sqrt(2).
# Both are interpolated at Chebyshev's nodes; relative errors 2.0e-17 and 1.4e-17 (float64), 5.0e-9 and 7.0e-10.
FORMATS = {
    np.dtype(np.float64): Format(
        np.float64,
        np.int64,
        52,
        1023,
        {2: 0x5FE6E8DB8BAC7000, 4: 0x4FEB03126E978C00},
        (3, 3),
        (
            0.6931471805599453,
            0.24022650695910097,
            0.0555041086648216,
            0.009618129107606871,
            0.0013333558146416927,
            0.00015403530441765088,
            1.5252733829851596e-05,
            1.321544257022465e-06,
            1.0178062436412765e-07,
            7.072589488396345e-09,
            4.4549624846332125e-10,
        ),
        (
            2.8853900817779268,
            0.9617966939259898,
            0.577078016345514,
            0.4121985858422942,
            0.3205985347650481,
            0.26233436060329546,
            0.22091286734180157,
            0.21366122502798326,
        ),
    ),
    np.dtype(np.float32): Format(
        np.float32,
        np.int32,
        23,
        127,
        {2: 0x5F3746DC, 4: 0x4F581893},
        (3, 1),
        (
            0.6931471880307134,
            0.24022650760606956,
            0.0555035709268903,
            0.009618082538636961,
            0.0013390874847810528,
            0.00015453172887040158,
        ),
        (2.8853900798025367, 0.9617988394560251, 0.5767151118408125, 0.4317197157256091),
    ),
}

SERIES = {2: (1 / 2, 3 / 8, 5 / 16), 4: (1 / 4, 5 / 32, 15 / 128)}
"""(1 - e)^(-1/n) = 1 + e (c0 + c1 e + c2 e^2 + ...)"""


def _bits(x, form: Format):
    return jax.lax.bitcast_convert_type(x, form.whole)


def _number(bits, form: Format):
    return jax.lax.bitcast_convert_type(bits, form.number)


def _polynomial(x, coefficients: tuple[float, ...]):
    """c0 + c1 x + c2 x^2 + ..."""
    total = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = c + x * total
    return total


def _inverse_root(x, root: int):
    """x^(-1/n), n = 2 or 4: y <- y (1 - e)^(-1/n), e = 1 - x y^n, with a few terms of the series in e."""
    form = FORMATS[np.dtype(x.dtype)]
    limits = np.finfo(form.number)
    largest = jnp.where(x > limits.max, limits.max, x)
    y = _number(form.roots[root] - jax.lax.shift_right_logical(_bits(largest, form), form.whole(root // 2)), form)
    for terms in form.terms:
        square = y * y if root == 4 else y
        e = 1.0 - (largest * square) * square
        y = y + y * (e * _polynomial(e, SERIES[root][:terms]))
    return jnp.where(x < limits.tiny, jnp.where(x < 0.0, jnp.nan, jnp.inf), y)


def inverse_root(x):
    """1/sqrt(x), float32 or float64, right to one unit in the last place.

    inf at zero, NaN for negative numbers; infinity counts as the largest number.
    """
    return _inverse_root(x, 2)


def inverse_fourth_root(x):
    """x^(-1/4); as `inverse_root`."""
    return _inverse_root(x, 4)


def exp2(x):
    """2^x, float32 or float64, right to one unit in the last place; 0 where it would hardly be a normal number.

    2^x = 2^n 2^r, n = round(x): twice the polynomial for 2^r times 2^(n - 1), which is a number for every n.
    """
    form = FORMATS[np.dtype(x.dtype)]
    least, most = 1.0 - form.bias, 1.0 + form.bias
    x = jnp.where(x < least, least, x)
    x = jnp.where(x > most, most, x)
    n = jnp.floor(x + 0.5)
    r = x - n
    twice = 2.0 + r * _polynomial(r, tuple(2.0 * c for c in form.exp2))
    # A conversion to whole numbers is not vectorised; here they are the last bits of a number with no room for others.
    last = _bits(n + 1.5 * 2.0**form.mantissa, form)
    return twice * _number(jax.lax.shift_left(last + (form.bias - 1), form.whole(form.mantissa)), form)


def log2(x):
    """The logarithm to base 2, float32 or float64, right to two units in the last place of max(1, |log2 x|).

    -inf at zero, NaN for negative numbers. log2 x = n + log2 m, x = m 2^n with m in sqrt(1/2)..sqrt(2).
    """
    form = FORMATS[np.dtype(x.dtype)]
    one, half = (int(form.number(c).view(form.whole)) for c in (1.0, np.sqrt(0.5)))
    shifted = _bits(x, form) + (one - half)
    # As in `exp2`: the exponent becomes the last bits of a number, without a conversion.
    magic = int(form.number(2.0**form.mantissa).view(form.whole))
    n = _number(jax.lax.shift_right_logical(shifted, form.whole(form.mantissa)) + magic, form)
    n = n - (2.0**form.mantissa + form.bias)
    m = _number((shifted & (2**form.mantissa - 1)) + half, form)
    s = (m - 1.0) / (m + 1.0)
    value = n + s * _polynomial(s * s, form.log2)
    limits = np.finfo(form.number)
    value = jnp.where(x < limits.tiny, jnp.where(x < 0.0, jnp.nan, -jnp.inf), value)
    return jnp.where(x <= limits.max, value, x + x)


INVERSE_ROOT = Operation("inverse_root", inverse_root)
INVERSE_FOURTH_ROOT = Operation("inverse_fourth_root", inverse_fourth_root)
EXP2, LOG2 = Operation("exp2", exp2), Operation("log2", log2)
