"""The peer that Python users write by hand: Dormand-Prince 5(4) in Numba, one lane a time, lanes over all cores.

Adaptive, error per step, with a step that ends on every sample: the samples are the knots of the command as well, and
at these tolerances there are some three steps in between, so that dense output would save none.

Reference: Dormand and Prince, J. Comput. Appl. Math. 6, 1980; step control of Hairer, Norsett and Wanner, 1993.
"""

import functools
import math
import time
from collections.abc import Callable

import numpy as np
import servo_axis as axis
from ensemble_peers import Missing, Run, best_seconds

MAX_STEPS = 100_000


def _numba():
    try:
        import numba
    except ImportError as problem:
        raise Missing('numba is not installed: pip install "jaxlines[bench]"') from problem
    return numba


def jitted(function: Callable) -> Callable:
    """The function compiled by Numba. Raises: Missing."""
    return _numba().njit(fastmath=True, error_model="numpy")(function)


@functools.cache
def scalar_field(precision: str = "float64", fastmath: bool = True) -> Callable:
    """f(p_A, p_B, speed, spool, rate, u, numbers) -> five rates, compiled by Numba for one lane."""
    jit = _numba().njit(fastmath=fastmath, inline="always", error_model="numpy")
    real = np.dtype(precision).type
    one, zero, floor, atmosphere = real(1.0), real(0.0), real(axis.FLOOR), real(axis.ATMOSPHERE)
    supply, tank, small = real(axis.SUPPLY), real(axis.RETURN), real(axis.TRANSITION**2)
    displacement, viscous, damping = real(axis.DISPLACEMENT), real(axis.VISCOUS), real(2.0 * axis.DAMPING)

    @jit
    def modulus(p, liquid, air, index):
        p = max(p, floor)
        ratio = air * math.exp(math.log(atmosphere / p) / index)
        return liquid * (one + ratio) / (one + ratio * liquid / (index * p))

    @jit
    def land(drop):
        return drop / math.sqrt(math.sqrt(drop * drop + small))

    @jit
    def field(p_a, p_b, speed, spool, rate, u, n):
        opening = n[6] * spool
        if spool > zero:
            flow_a, flow_b = opening * land(supply - p_a), -opening * land(p_b - tank)
        else:
            flow_a, flow_b = opening * land(p_a - tank), -opening * land(supply - p_b)
        through = displacement * speed + n[5] * (p_a - p_b)
        return (
            modulus(p_a, n[2], n[3], n[4]) / n[0] * (flow_a - through),
            modulus(p_b, n[2], n[3], n[4]) / n[1] * (flow_b + through),
            (displacement * (p_a - p_b) - viscous * speed) / n[7],
            rate,
            n[8] * n[8] * (u - spool) - damping * n[8] * rate,
        )

    return field


@functools.cache
def _program(precision: str, fastmath: bool = True) -> Callable:  # noqa: PLR0915 - scalars stay in registers
    """p_A (lanes, samples) of all lanes; compiled at the first call."""
    numba, real = _numba(), np.dtype(precision).type
    field, tableau = scalar_field(precision, fastmath), _tableau(precision)
    samples, commands, widths = axis.SAMPLES, axis.command.astype(precision), np.diff(axis.times).astype(precision)
    slopes, start = (np.diff(axis.command) / np.diff(axis.times)).astype(precision), axis.INITIAL.astype(precision)
    g1, g2, g3, g4, g5 = axis.SIZES.astype(precision)
    one, zero, safety, least, most = real(1.0), real(0.0), real(0.9), real(0.2), real(5.0)
    power, fifth, first, tiny = real(-0.2), real(0.2), real(1e-3), real(1e-4)
    (a21, a31, a32, a41, a42, a43, a51, a52, a53, a54, a61, a62, a63, a64, a65, b1, b3, b4, b5, b6,
     e1, e3, e4, e5, e6, e7, c2, c3, c4, c5) = tableau  # fmt: skip
    jit = numba.njit(fastmath=fastmath, error_model="numpy")

    @jit
    def square(error, old, new, size):
        share = error / (size + max(abs(old), abs(new)))
        return share * share

    @jit
    def lane(n, tolerance, out):
        y1, y2, y3, y4, y5 = start
        p1, p2, p3, p4, p5 = field(y1, y2, y3, y4, y5, commands[0], n)
        h, steps = first, 0
        out[0] = y1
        for k in range(samples - 1):
            at, width, base, slope = zero, widths[k], commands[k], slopes[k]
            while at < width:
                steps += 1
                if steps > MAX_STEPS or not (h > zero):
                    out[k + 1 :] = np.nan
                    return
                left = width - at
                last = h >= left * (one - tiny)
                s = left if last else h
                q1, q2, q3, q4, q5 = field(
                    y1 + s * a21 * p1, y2 + s * a21 * p2, y3 + s * a21 * p3, y4 + s * a21 * p4, y5 + s * a21 * p5,
                    base + slope * (at + c2 * s), n)  # fmt: skip
                r1, r2, r3, r4, r5 = field(
                    y1 + s * (a31 * p1 + a32 * q1), y2 + s * (a31 * p2 + a32 * q2), y3 + s * (a31 * p3 + a32 * q3),
                    y4 + s * (a31 * p4 + a32 * q4), y5 + s * (a31 * p5 + a32 * q5),
                    base + slope * (at + c3 * s), n)  # fmt: skip
                t1, t2, t3, t4, t5 = field(
                    y1 + s * (a41 * p1 + a42 * q1 + a43 * r1), y2 + s * (a41 * p2 + a42 * q2 + a43 * r2),
                    y3 + s * (a41 * p3 + a42 * q3 + a43 * r3), y4 + s * (a41 * p4 + a42 * q4 + a43 * r4),
                    y5 + s * (a41 * p5 + a42 * q5 + a43 * r5), base + slope * (at + c4 * s), n)  # fmt: skip
                v1, v2, v3, v4, v5 = field(
                    y1 + s * (a51 * p1 + a52 * q1 + a53 * r1 + a54 * t1),
                    y2 + s * (a51 * p2 + a52 * q2 + a53 * r2 + a54 * t2),
                    y3 + s * (a51 * p3 + a52 * q3 + a53 * r3 + a54 * t3),
                    y4 + s * (a51 * p4 + a52 * q4 + a53 * r4 + a54 * t4),
                    y5 + s * (a51 * p5 + a52 * q5 + a53 * r5 + a54 * t5), base + slope * (at + c5 * s), n)  # fmt: skip
                end = base + slope * (at + s)
                w1, w2, w3, w4, w5 = field(
                    y1 + s * (a61 * p1 + a62 * q1 + a63 * r1 + a64 * t1 + a65 * v1),
                    y2 + s * (a61 * p2 + a62 * q2 + a63 * r2 + a64 * t2 + a65 * v2),
                    y3 + s * (a61 * p3 + a62 * q3 + a63 * r3 + a64 * t3 + a65 * v3),
                    y4 + s * (a61 * p4 + a62 * q4 + a63 * r4 + a64 * t4 + a65 * v4),
                    y5 + s * (a61 * p5 + a62 * q5 + a63 * r5 + a64 * t5 + a65 * v5), end, n)  # fmt: skip
                z1 = y1 + s * (b1 * p1 + b3 * r1 + b4 * t1 + b5 * v1 + b6 * w1)
                z2 = y2 + s * (b1 * p2 + b3 * r2 + b4 * t2 + b5 * v2 + b6 * w2)
                z3 = y3 + s * (b1 * p3 + b3 * r3 + b4 * t3 + b5 * v3 + b6 * w3)
                z4 = y4 + s * (b1 * p4 + b3 * r4 + b4 * t4 + b5 * v4 + b6 * w4)
                z5 = y5 + s * (b1 * p5 + b3 * r5 + b4 * t5 + b5 * v5 + b6 * w5)
                x1, x2, x3, x4, x5 = field(z1, z2, z3, z4, z5, end, n)
                total = square(s * (e1 * p1 + e3 * r1 + e4 * t1 + e5 * v1 + e6 * w1 + e7 * x1), y1, z1, g1)
                total += square(s * (e1 * p2 + e3 * r2 + e4 * t2 + e5 * v2 + e6 * w2 + e7 * x2), y2, z2, g2)
                total += square(s * (e1 * p3 + e3 * r3 + e4 * t3 + e5 * v3 + e6 * w3 + e7 * x3), y3, z3, g3)
                total += square(s * (e1 * p4 + e3 * r4 + e4 * t4 + e5 * v4 + e6 * w4 + e7 * x4), y4, z4, g4)
                total += square(s * (e1 * p5 + e3 * r5 + e4 * t5 + e5 * v5 + e6 * w5 + e7 * x5), y5, z5, g5)
                error = math.sqrt(total * fifth) / tolerance
                factor = most if error == zero else min(most, max(least, safety * error**power))
                if error <= one:
                    at = width if last else at + s
                    y1, y2, y3, y4, y5 = z1, z2, z3, z4, z5
                    p1, p2, p3, p4, p5 = x1, x2, x3, x4, x5
                    h = max(h, s * factor) if last else s * factor
                else:
                    h = s * factor
            out[k + 1] = y1

    @numba.njit(parallel=True, fastmath=fastmath, error_model="numpy")
    def all_lanes(numbers, tolerance, out):
        for i in numba.prange(numbers.shape[0]):
            lane(numbers[i], tolerance, out[i])

    return all_lanes


def _tableau(precision: str) -> tuple:
    """Coefficients of Dormand and Prince: a, b, error weights b - b_hat, c."""
    a = (1 / 5, 3 / 40, 9 / 40, 44 / 45, -56 / 15, 32 / 9, 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729)
    a += (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656)
    b = (35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
    e = (71 / 57600, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
    real = np.dtype(precision).type
    return tuple(real(x) for x in (*a, *b, *e, 1 / 5, 3 / 10, 4 / 5, 8 / 9))


def dopri5(columns, tolerance: float, precision: str = "float64", repeats: int = 3) -> Run:
    """All lanes by Dormand-Prince 5(4), relative tolerance, absolute of the states over SIZES.

    Args: columns; tolerance, 1e-3..1e-7; precision; repeats, of which the fastest counts. Raises: Missing.
    """
    program = _program(precision)
    numbers, real = axis.matrix(columns).astype(precision), np.dtype(precision).type
    began = time.perf_counter()
    program(numbers[:1], real(tolerance), np.empty((1, axis.SAMPLES), precision))
    compiling = time.perf_counter() - began
    out = np.empty((len(numbers), axis.SAMPLES), precision)
    seconds = best_seconds(lambda: program(numbers, real(tolerance), out), repeats)
    return Run(out, seconds, compiling)
