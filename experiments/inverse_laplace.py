"""Water hammer of the exact line in time: reservoir, line with laminar flow, valve that closes.

Times are in units of L/c, pressures at the valve relative to that before closure, in units of rho c V0. Then

    p(s) = xi tanh(s xi) a(s),  xi^2 = I0(z)/I2(z), z^2 = s/Dn,  Dn = nu L/(c R^2)

with a(s) the transform of -dV/dt/V0, and everything depends on Dn alone. tanh = 1 - 2 e^(-2 s xi) + 2 e^(-4 s xi)
- ... separates the passages of the wave: each is a smooth function behind its front at t = 2k, which a numerical
inverse transform gives to many digits, where that of the whole would ring at the fronts.

Reference: Holmboe and Rouleau, "The effect of viscous shear on transients in liquid lines", J. Basic Engineering
89, 1967, for the problem; Abate and Whitt, "A unified framework for numerically inverting Laplace transforms",
INFORMS J. on Computing 18, 2006, sec. 5 (Euler), for the inverse transform.
"""

from math import comb

import numpy as np

from jaxlines.physics.distributed import bessel_ratio


def invert(transform, times, order=12):
    """Inverse Laplace transform at times > 0 by Euler summation, about 0.6 `order` digits (order 8..15).

    Args: transform: a function of complex s, element by element, whose original is real and smooth for t > 0.
    """
    times = np.asarray(times, dtype=float)
    weights = np.ones(2 * order + 1)
    weights[0] = 0.5
    tail = np.cumsum([comb(order, k) for k in range(order + 1)]) / 2.0**order
    weights[order + 1 :] = tail[order - 1 :: -1]
    k = np.arange(2 * order + 1)
    nodes = order * np.log(10.0) / 3.0 + 1j * np.pi * k
    values = transform(nodes / times[..., None]).real
    return 10.0 ** (order / 3.0) / times * np.sum((-1.0) ** k * weights * values, axis=-1)


def exact_friction(w):
    """xi^2 of laminar flow as a function of w = s R^2/nu."""
    return bessel_ratio(np.sqrt(w))


def passage(times, dissipation_number, k, order=12, friction=exact_friction):
    """Response to a step behind the front of passage k, at times > 0 since that front; friction gives xi^2(w)."""

    def transform(s):
        ratio = np.sqrt(friction(s / dissipation_number))
        return (-1.0) ** k * (2.0 if k else 1.0) * ratio * np.exp(-2.0 * k * s * (ratio - 1.0)) / s

    return invert(transform, times, order)


def instantaneous_closure(times, dissipation_number, order=12):
    """Pressure at the valve after it closes at once at t = 0; times [L/c], not at the fronts t = 0, 2, 4, ..."""
    times = np.asarray(times, dtype=float)
    total = np.zeros(times.shape)
    for k in range(int(np.max(times) // 2) + 1):
        behind = times > 2.0 * k
        total[behind] += passage(times[behind] - 2.0 * k, dissipation_number, k, order)
    return total


def raised_cosine(share):
    """Rate of V(t) = V0 (1 + cos(pi x))/2 over the closure, x = t/T_c from 0 to 1; its slope jumps at both ends."""
    return 0.5 * np.pi * np.sin(np.pi * share)


def smooth_step(share):
    """Rate of V(t) = V0 (1 - x^3 (10 - 15 x + 6 x^2)); value and slope vanish at both ends."""
    return 30.0 * share**2 * (1.0 - share) ** 2


def gradual_closure(times, dissipation_number, closure_time, rate, order=12, points=80, friction=exact_friction):
    """Pressure at the valve while it closes over T_c, and after; times, T_c [L/c]; rate(x) = -dV/dx/V0, x = t/T_c.

    The response to a step is folded with the rate by Gauss' rule with `points`, in the square root of the time since
    each front, in which the response is smooth. With a weighting function in place of the exact friction,
    xi^2 = 1 + 8/w + 4 W(w), W its transform in w = s R^2/nu.
    """
    x, weight = np.polynomial.legendre.leggauss(points)
    total = np.zeros(np.shape(times))
    for i, time in np.ndenumerate(np.asarray(times, dtype=float)):
        for k in range(int(time // 2) + 1):
            since = time - 2.0 * k
            if since <= 0.0:
                continue
            low, high = np.sqrt(max(since - closure_time, 0.0)), np.sqrt(since)
            root = 0.5 * (low + high) + 0.5 * (high - low) * x
            acceleration = rate((since - root * root) / closure_time) / closure_time
            step = passage(root * root, dissipation_number, k, order, friction)
            total[i] += np.sum(0.5 * (high - low) * weight * 2.0 * root * acceleration * step)
    return total


def raised_cosine_closure(times, dissipation_number, closure_time, order=12, points=80):
    """Pressure at the valve while V(t) = V0 (1 + cos(pi t/T_c))/2 until T_c, and after; see `gradual_closure`."""
    return gradual_closure(times, dissipation_number, closure_time, raised_cosine, order, points)
