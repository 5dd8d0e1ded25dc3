"""The source of the bound in C: 2N-storage Runge-Kutta of the servo axis, lanes innermost.

One loop over the lanes of a block per stage, whose arrays stay in the first-level cache; reciprocals made once. Two
choices: the vector exp and log of the C library (libmvec), or polynomials for 2^x and log2(x) in the loop, right to
some 1e-15 (float64) or 1e-7 (float32); and all four lands of the valve as the problem states them, or only the open
ones, since one of the two lands of a line is always closed.

Reference: Carpenter and Kennedy, "Fourth-order 2N-storage Runge-Kutta schemes", NASA TM-109112, 1994: RK4(3)5.
"""

import math

import numpy as np
from servo_axis import ATMOSPHERE, DAMPING, DISPLACEMENT, FLOOR, INITIAL, RETURN, SUPPLY, TRANSITION, VISCOUS

DECAY = (0.0, -567301805773 / 1357537059087, -2404267990393 / 2016746695238)
DECAY = (*DECAY, -3550918686646 / 2091501179385, -1275806237668 / 842570457699)
ADVANCE = (1432997174477 / 9575080441755, 5161836677717 / 13612068292357, 1720146321549 / 2090206949498)
ADVANCE = (*ADVANCE, 3134564353537 / 4481467310338, 2277821191437 / 14882151754819)
WHEN = (0.0, 1432997174477 / 9575080441755, 2526269341429 / 6820363962896)
WHEN = (*WHEN, 2006345519317 / 3224310063776, 2802321613138 / 2924317926251)

SOURCE = """
#include <math.h>
#include <string.h>
#define W @WIDTH@
typedef @REAL@ real;
typedef @INTEGER@ integer;

static const real decay[5] = {@DECAY@}, advance[5] = {@ADVANCE@}, when[5] = {@WHEN@}, start[5] = {@START@};

@MATHEMATICS@
@LANDS@

/* dp/dt without the flow: K(p)/V */
static inline real stiffness(real p, real liquid, real air, real index, real inverse_index, real liquid_over_volume) {
    p = p > (real)@FLOOR@ ? p : (real)@FLOOR@;
    real ratio = air * power_of_ratio(p, inverse_index), n_p = index * p;
    return liquid_over_volume * ((real)1 + ratio) * n_p / (n_p + ratio * liquid);
}

static inline real root(real drop) {
    return drop / SQRT(SQRT(drop * drop + (real)@SMALL@));
}

/* One block of W lanes. numbers: [9][W], u: [samples], out: [W][samples] */
static void block(const real *numbers, const real *u, real width, int samples, int steps, real *out) {
    real y[5][W] __attribute__((aligned(64))), d[5][W] __attribute__((aligned(64)));
    real liquid_a[W] __attribute__((aligned(64))), liquid_b[W] __attribute__((aligned(64)));
    real liquid[W] __attribute__((aligned(64))), air[W] __attribute__((aligned(64)));
    real index[W] __attribute__((aligned(64))), inverse_index[W] __attribute__((aligned(64)));
    real leakage[W] __attribute__((aligned(64))), gain[W] __attribute__((aligned(64)));
    real inverse_inertia[W] __attribute__((aligned(64))), frequency[W] __attribute__((aligned(64)));
    for (int i = 0; i < W; i++) {
        for (int j = 0; j < 5; j++) { y[j][i] = start[j]; d[j][i] = 0; }
        liquid[i] = numbers[2 * W + i]; air[i] = numbers[3 * W + i]; index[i] = numbers[4 * W + i];
        liquid_a[i] = liquid[i] / numbers[i]; liquid_b[i] = liquid[i] / numbers[W + i];
        inverse_index[i] = (real)1 / index[i]; leakage[i] = numbers[5 * W + i]; gain[i] = numbers[6 * W + i];
        inverse_inertia[i] = (real)1 / numbers[7 * W + i]; frequency[i] = numbers[8 * W + i];
        out[(long)i * samples] = start[0];
    }
    const real h = width / steps;
    for (int k = 0; k < samples - 1; k++) {
        const real slope = (u[k + 1] - u[k]) / steps;
        for (int step = 0; step < steps; step++)
            for (int s = 0; s < 5; s++) {
                const real now = u[k] + slope * ((real)step + when[s]), a = decay[s], b = advance[s];
                #pragma omp simd
                for (int i = 0; i < W; i++) {
                    real p_a = y[0][i], p_b = y[1][i], speed = y[2][i], spool = y[3][i], rate = y[4][i];
                    real w = frequency[i], flow_a, flow_b;
                    LANDS;
                    real difference = p_a - p_b;
                    real through = (real)@DISPLACEMENT@ * speed + leakage[i] * difference;
                    flow_a -= through; flow_b += through;
                    real k_a = stiffness(p_a, liquid[i], air[i], index[i], inverse_index[i], liquid_a[i]);
                    real k_b = stiffness(p_b, liquid[i], air[i], index[i], inverse_index[i], liquid_b[i]);
                    real torque = (real)@DISPLACEMENT@ * difference - (real)@VISCOUS@ * speed;
                    real d0 = a * d[0][i] + h * k_a * flow_a, d1 = a * d[1][i] + h * k_b * flow_b;
                    real d2 = a * d[2][i] + h * inverse_inertia[i] * torque, d3 = a * d[3][i] + h * rate;
                    real d4 = a * d[4][i] + h * w * (w * (now - spool) - (real)@DAMPING@ * rate);
                    d[0][i] = d0; d[1][i] = d1; d[2][i] = d2; d[3][i] = d3; d[4][i] = d4;
                    y[0][i] = p_a + b * d0; y[1][i] = p_b + b * d1; y[2][i] = speed + b * d2;
                    y[3][i] = spool + b * d3; y[4][i] = rate + b * d4;
                }
            }
        for (int i = 0; i < W; i++) out[(long)i * samples + k + 1] = y[0][i];
    }
}

void simulate(const real *numbers, const real *u, real width, int samples, int steps, long blocks, real *out) {
    for (long j = 0; j < blocks; j++)
        block(numbers + j * 9 * W, u, width, samples, steps, out + j * W * samples);
}
"""

LIBMVEC = """
static inline real power_of_ratio(real p, real inverse_index) {
    return EXP((@LOG_ATMOSPHERE@ - LOG(p)) * inverse_index);
}
"""

# Of the two lands of a line one is closed, so that only the drop over the open one needs a root.
OPEN_LANDS = """
#define LANDS                                                                                \\
    int forward = spool > (real)0;                                                           \\
    flow_a = gain[i] * spool * root(forward ? (real)@SUPPLY@ - p_a : p_a - (real)@TANK@);    \\
    flow_b = -gain[i] * spool * root(forward ? p_b - (real)@TANK@ : (real)@SUPPLY@ - p_b)
"""

ALL_LANDS = """
#define LANDS                                                                                \\
    real open = spool > (real)0 ? gain[i] * spool : (real)0, closed = gain[i] * spool - open; \\
    flow_a = open * root((real)@SUPPLY@ - p_a) + closed * root(p_a - (real)@TANK@);          \\
    flow_b = -closed * root((real)@SUPPLY@ - p_b) - open * root(p_b - (real)@TANK@)
"""

INLINE = """
/* log2 from exponent and mantissa in [sqrt(1/2), sqrt(2)): 2/ln(2) atanh((m - 1)/(m + 1)); 2^x from Taylor's series. */
static inline real power_of_ratio(real p, real inverse_index) {
    integer bits, shifted;
    memcpy(&bits, &p, sizeof bits);
    shifted = (bits - (integer)@ROOT_HALF@) >> @MANTISSA@;
    bits -= shifted << @MANTISSA@;
    real m;
    memcpy(&m, &bits, sizeof m);
    real s = (m - (real)1) / (m + (real)1), z = s * s;
    real x = ((real)@LOG_ATMOSPHERE@ - (real)shifted - s * (@ATANH@)) * inverse_index;
    real whole = RINT(x), f = x - whole;
    integer scale = ((integer)whole + (integer)@BIAS@) << @MANTISSA@;
    real factor;
    memcpy(&factor, &scale, sizeof factor);
    return factor * (@EXP2@);
}
"""


def _horner(coefficients, variable: str) -> str:
    """A polynomial as C, lowest power first."""
    text = f"(real){coefficients[-1]!r}"
    for number in reversed(coefficients[:-1]):
        text = f"((real){number!r} + {variable} * {text})"
    return text


def c_source(precision: str, mathematics: str, lands: str, width: int) -> str:
    """The program in C.

    Args: precision; mathematics: "libmvec" or "inline"; lands: "open" or "all"; width: lanes in a block.
    """
    double = precision == "float64"
    inline = mathematics == "inline"
    root_half = np.float64(math.sqrt(0.5)).view(np.int64) if double else np.float32(math.sqrt(0.5)).view(np.int32)
    terms, degree = (10, 13) if double else (5, 7)
    log_two = math.log(2.0)
    fill = {
        "WIDTH": width,
        "REAL": "double" if double else "float",
        "INTEGER": "long long" if double else "int",
        "DECAY": ", ".join(map(repr, DECAY)),
        "ADVANCE": ", ".join(map(repr, ADVANCE)),
        "WHEN": ", ".join(map(repr, WHEN)),
        "START": ", ".join(map(repr, INITIAL.tolist())),
        "LOG_ATMOSPHERE": f"(real){math.log2(ATMOSPHERE) if inline else math.log(ATMOSPHERE)!r}",
        "ROOT_HALF": int(root_half),
        "MANTISSA": 52 if double else 23,
        "BIAS": 1023 if double else 127,
        "ATANH": _horner([2.0 / log_two / (2 * k + 1) for k in range(terms)], "z"),
        "EXP2": _horner([log_two**k / math.factorial(k) for k in range(degree + 1)], "f"),
        "FLOOR": FLOOR,
        "SMALL": TRANSITION**2,
        "SUPPLY": SUPPLY,
        "TANK": RETURN,
        "DISPLACEMENT": DISPLACEMENT,
        "VISCOUS": VISCOUS,
        "DAMPING": 2.0 * DAMPING,
    }
    text = SOURCE.replace("@MATHEMATICS@", INLINE if inline else LIBMVEC)
    text = text.replace("@LANDS@", OPEN_LANDS if lands == "open" else ALL_LANDS)
    for name, value in fill.items():
        text = text.replace(f"@{name}@", str(value))
    for name in ("SQRT", "EXP", "LOG", "RINT"):
        text = text.replace(f"{name}(", f"{name.lower()}{'' if double else 'f'}(")
    return text
