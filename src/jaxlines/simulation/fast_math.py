"""Elementary functions that XLA's CPU compiler can vectorise in float64 (its own call a scalar routine)."""

import jax
import jax.numpy as jnp
import numpy as np

_LOG_2_HIGH, _LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""log(2) in two parts, so that exponent times the first is exact."""

_ONE, _MANTISSA = 0x3FF0000000000000, 0x000FFFFFFFFFFFFF
_SQRT_HALF = 0x3FE6A09E667F3BCD
_MAGIC = 0x4330000000000000


_LOG_SERIES = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
"""Minimax coefficients of (log((1 + s)/(1 - s)) - 2 s)/s in s^2 for |s| < 0.1716 (error below 2^-58)."""


def log(x):
    """Natural logarithm of float64 numbers.

    log x = e log 2 + log(1 + f), x = (1 + f) 2^e with 1 + f in sqrt(1/2)..sqrt(2), and log(1 + f) = f - f^2/2 +
    s (f^2/2 + R(s^2)), s = f/(2 + f). Accuracy 3e-16 relative to max(1, |log x|); -inf at 0 (and below 2.3e-308), NaN
    for negative numbers. Reference: Ng, "log(x)", fdlibm, Sun Microsystems, 1993 (form and coefficients).
    """
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    shifted = bits + (_ONE - _SQRT_HALF)
    # The exponent without a conversion of integers, which is not vectorised: its bits as the mantissa of 2^52 + e.
    exponent = jax.lax.bitcast_convert_type(jax.lax.shift_right_logical(shifted, np.int64(52)) + _MAGIC, jnp.float64)
    exponent = exponent - (2.0**52 + 1023.0)
    f = jax.lax.bitcast_convert_type((shifted & _MANTISSA) + _SQRT_HALF, jnp.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    c = _LOG_SERIES
    odd = z * (c[0] + w * (c[2] + w * (c[4] + w * c[6])))
    even = w * (c[1] + w * (c[3] + w * c[5]))
    half_square = 0.5 * f * f
    rest = s * (half_square + (odd + even)) + exponent * _LOG_2_LOW
    value = exponent * _LOG_2_HIGH - ((half_square - rest) - f)
    value = jnp.where(x < 2.2250738585072014e-308, jnp.where(x < 0.0, jnp.nan, -jnp.inf), value)
    return jnp.where(x <= 1.7976931348623157e308, value, x + x)


FAST = {"log": log}
"""Name of a primitive -> the function that takes its place in float64."""
