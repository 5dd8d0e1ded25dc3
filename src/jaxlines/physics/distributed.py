"""Small oscillations of a uniform line in the frequency domain: the exact distributed line and its ladders.

Pressure and volume flow at the two ends, p1, Q1 where the flow enters and p2, Q2 where it leaves:

    [p1; Q1] = [[cosh G, Zc sinh G], [sinh G/Zc, cosh G]] [p2; Q2],  G^2 = Z Y,  Zc^2 = Z/Y

with the series impedance Z of the whole line (inertia and friction) and its shunt admittance Y (capacitance).
They are written with G^2 throughout, so that every entry is finite and smooth at s = 0. `friction` is

    "none"          Z = s I
    "steady"        Z = s I + R,  R = 8 rho nu L/(A R_i^2)    (Hagen and Poiseuille, quasi-steady)
    "distributed"   Z = s I I0(z)/I2(z),  z = R_i sqrt(s/nu)  (exact for laminar flow)
    a weighting     Z = s I (1 + 8/z^2 + 4 sum m_i/(z^2 + n_i)), see `weighting`

Validity: small oscillations about rest or laminar flow, wave length much larger than the diameter, fluid and
wall linear. Functions work element by element on complex s [1/s]; s = 2 pi j f for the response at f [Hz].
Reference: Goodson and Leonard, "A survey of modeling techniques for fluid line transients", J. Basic
Engineering 94, 1972; Stecki and Davis, "Fluid transmission lines - distributed parameter models", Proc.
IMechE 200, 1986.
"""

from typing import Literal

import numpy as np

from jaxlines.physics.fields import array_module
from jaxlines.physics.weighting import AbstractWeighting

Friction = Literal["none", "steady", "distributed"] | AbstractWeighting
"""How the friction of a line is described in the frequency domain."""

_FRACTION_TERMS, _SERIES_TERMS, _SWITCH = 32, 16, 25.0
# Continued fraction for |z| <= 25, asymptotic series beyond: both exact to rounding for Re s >= 0.


def dissipation_number(length, inner_diameter, speed, kinematic_viscosity):
    """Dn = nu L/(c R_i^2) [-]: how strongly friction damps one passage of a wave.

    Args: length L, inner_diameter 2 R_i [m]; speed c of the waves [m/s]; kinematic_viscosity nu [m^2/s].
    Typical values: 1e-4 (thin oil, wide pipe) to 0.1 (long thin line).
    """
    return 4.0 * kinematic_viscosity * length / (speed * inner_diameter * inner_diameter)


def _asymptotic_coefficients(order):
    """(-1)^k a_k of I_order(z) ~ exp(z)/sqrt(2 pi z) sum (-1)^k a_k/z^k (Abramowitz and Stegun, eq. 9.7.1)."""
    k = np.arange(1, _SERIES_TERMS)
    return np.concatenate([[1.0], np.cumprod(((2 * k - 1) ** 2 - 4.0 * order**2) / (8.0 * k))])


_SERIES_1, _SERIES_2 = _asymptotic_coefficients(1), _asymptotic_coefficients(2)


def _polynomial(coefficients, x):
    """Horner's scheme, coefficients from the constant on."""
    total = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = coefficient + x * total
    return total


def womersley_impedance(w):
    """Series impedance of oscillating laminar flow, in units of rho nu/R_i^2: w I0(z)/I2(z), w = z^2 [-].

    Args: w = s R_i^2/nu [-], complex.
    It is analytic, 8 + 4 w/3 for slow flow (friction of Hagen and Poiseuille, inertia 4/3 of the fluid's) and
    w + 2 sqrt(w) for fast flow.
    Validity: to rounding for Re w >= 0, within 1e-7 for |arg w| < 0.8 pi; zeros and poles on the negative axis.
    Reference: Zielke 1968 (see `weighting`); the ratio is w + 2 q with the continued fraction
    q = z I1/I2 = 4 + w/(6 + w/(8 + ...)) (Abramowitz and Stegun, eq. 9.1.73), or Hankel's expansion.
    """
    xp = array_module(w)
    w = xp.asarray(w) + 0j
    slow = xp.abs(w) <= _SWITCH**2
    inner = xp.where(slow, w, 1.0)
    ratio = _FRACTION_TERMS + xp.sqrt(_FRACTION_TERMS**2 + inner)
    for n in range(_FRACTION_TERMS - 1, 1, -1):
        ratio = 2.0 * n + inner / ratio
    z = xp.sqrt(xp.where(slow, _SWITCH**2, w))
    return w + 2.0 * xp.where(slow, ratio, z * _polynomial(_SERIES_1, 1.0 / z) / _polynomial(_SERIES_2, 1.0 / z))


def bessel_ratio(z):
    """I0(z)/I2(z) [-] for Re z > 0: by how much friction raises the inertia of oscillating laminar flow.

    Args: z = R_i sqrt(s/nu) [-], complex. Equal to 1 + 8/z^2 + 4 sum_k 1/(z^2 + j_k^2), J_2(j_k) = 0.
    Validity: see `womersley_impedance`. Infinite at z = 0.
    """
    return womersley_impedance(z * z) / (z * z)


def _friction_impedance(w, friction: Friction):
    """Series impedance in units of rho nu/R_i^2 as a function of w = s R_i^2/nu."""
    if isinstance(friction, AbstractWeighting):
        if not friction.laminar:
            raise ValueError(f"{type(friction).__name__} is for turbulent mean flow, the matrices for laminar")
        return w + 8.0 + 4.0 * w * friction.transform(w)
    laws = {"none": lambda w: w, "steady": lambda w: w + 8.0, "distributed": womersley_impedance}
    if friction not in laws:
        raise ValueError(f"friction must be one of {sorted(laws)} or a weighting function, got {friction!r}")
    return laws[friction](w)


def series_impedance(s, length, inner_diameter, density, kinematic_viscosity, friction: Friction = "distributed"):
    """Z: pressure drop over a short line per flow through it [Pa s/m^3], from inertia and friction.

    Args: s [1/s]; length L, inner_diameter [m]; density rho [kg/m^3]; kinematic_viscosity nu > 0 [m^2/s];
        friction: see the module.
    """
    area, square = np.pi / 4.0 * inner_diameter * inner_diameter, inner_diameter * inner_diameter / 4.0
    w = (array_module(s).asarray(s) + 0j) * (square / kinematic_viscosity)
    return density * kinematic_viscosity * length / (area * square) * _friction_impedance(w, friction)


def shunt_admittance(s, length, inner_diameter, effective_modulus):
    """Y = s A L/K_eff: flow that a short line takes up per pressure [m^3/(s Pa)].

    Args: s [1/s]; length L, inner_diameter [m]; effective_modulus K_eff of fluid and wall [Pa].
    """
    capacitance = np.pi / 4.0 * inner_diameter * inner_diameter * length / effective_modulus
    return (array_module(s).asarray(s) + 0j) * capacitance


def propagation_number(
    s, length, inner_diameter, density, kinematic_viscosity, effective_modulus, friction: Friction = "distributed"
):
    """G = (s L/c) sqrt(I0(z)/I2(z)) [-]: attenuation (real part) and phase (imaginary part) of the line.

    Args: as of `transmission_matrix`. Validity: Re s >= 0; its slope is infinite at s = 0.
    Typical values: real part 0.01..0.1, imaginary part 2 pi f L/c.
    """
    impedance = series_impedance(s, length, inner_diameter, density, kinematic_viscosity, friction)
    xp = array_module(s, impedance, effective_modulus)
    return xp.sqrt(impedance) * xp.sqrt(shunt_admittance(s, length, inner_diameter, effective_modulus))


def characteristic_impedance(
    s, inner_diameter, density, kinematic_viscosity, effective_modulus, friction: Friction = "distributed"
):
    """Zc = (rho c/A) sqrt(I0(z)/I2(z)): pressure per flow of a wave that travels one way [Pa s/m^3].

    Args: as of `transmission_matrix`. Validity: Re s >= 0, s not 0, where it is infinite with friction.
    Typical values: 7.5e8 Pa s/m^3 for a 2-in pipe, 1e10 for a bore of 10 mm.
    """
    impedance = series_impedance(s, 1.0, inner_diameter, density, kinematic_viscosity, friction)
    xp = array_module(s, impedance, effective_modulus)
    return xp.sqrt(impedance) / xp.sqrt(shunt_admittance(s, 1.0, inner_diameter, effective_modulus))


def _even_functions(square):
    """cosh(x) and sinh(x)/x as functions of x^2, smooth at 0."""
    xp = array_module(square)
    small = xp.abs(square) < 1e-2
    x2 = xp.where(small, square, 0.0)
    cosh = 1.0 + x2 / 2.0 * (1.0 + x2 / 12.0 * (1.0 + x2 / 30.0 * (1.0 + x2 / 56.0)))
    sinhc = 1.0 + x2 / 6.0 * (1.0 + x2 / 20.0 * (1.0 + x2 / 42.0 * (1.0 + x2 / 72.0)))
    x = xp.sqrt(xp.where(small, 1.0, square))
    return xp.where(small, cosh, xp.cosh(x)), xp.where(small, sinhc, xp.sinh(x) / x)


def two_port(a, b, c, d):
    """The matrix [[a, b], [c, d]] from arrays of its entries, shape (..., 2, 2)."""
    xp = array_module(a, b, c, d)
    a, b, c, d = xp.broadcast_arrays(a, b, c, d)
    return xp.stack([xp.stack([a, b], axis=-1), xp.stack([c, d], axis=-1)], axis=-2)


def transmission_matrix(
    s, length, inner_diameter, density, kinematic_viscosity, effective_modulus, friction: Friction = "distributed"
):
    """The matrix M of a uniform line, [p1; Q1] = M [p2; Q2], shape (..., 2, 2); see the module.

    Args: s [1/s]; length L, inner_diameter [m]; density rho [kg/m^3]; kinematic_viscosity nu > 0 [m^2/s];
        effective_modulus K_eff of fluid and wall in series [Pa]; friction: see the module.
    Validity: s = 0 included (M = [[1, R], [0, 1]]); attenuation Re G below 700. det M = 1.
    """
    impedance = series_impedance(s, length, inner_diameter, density, kinematic_viscosity, friction)
    admittance = shunt_admittance(s, length, inner_diameter, effective_modulus)
    cosh, sinhc = _even_functions(impedance * admittance)
    return two_port(cosh, impedance * sinhc, admittance * sinhc, cosh)


def ladder_matrix(
    s,
    segments: int,
    length,
    inner_diameter,
    density,
    kinematic_viscosity,
    effective_modulus,
    friction: Friction = "steady",
    model: Literal["pi", "T"] = "pi",
):
    """The matrix M of a line of N lumped segments, [p1; Q1] = M [p2; Q2], shape (..., 2, 2).

    "pi": half of a segment's capacity at each of its ends, inertia and friction between; "T": half of a
    segment's inertia and friction at each end, its capacity in the middle. Series impedance and shunt
    admittance of all segments together are the line's for every N.

    Args: segments N >= 1; model; the others as of `transmission_matrix`, whose friction laws all apply.
    Validity: converges to the distributed line with N^-2; about 13 segments per wave length for 1 %.
    """
    if segments < 1 or model not in ("pi", "T"):
        raise ValueError(f'segments must be at least 1 and model "pi" or "T", got {segments!r} and {model!r}')
    z = series_impedance(s, length, inner_diameter, density, kinematic_viscosity, friction) / segments
    y = shunt_admittance(s, length, inner_diameter, effective_modulus) / segments
    middle, end = 1.0 + 0.5 * z * y, 1.0 + 0.25 * z * y
    cell = two_port(middle, z, y * end, middle) if model == "pi" else two_port(middle, z * end, y, middle)
    return array_module(cell).linalg.matrix_power(cell, segments)
