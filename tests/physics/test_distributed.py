"""The exact line and its ladders against 30-digit numbers, closed forms, and a state space written by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import brentq
from scipy.special import ive, jn_zeros

from jaxlines.physics.distributed import (
    Friction,
    bessel_ratio,
    characteristic_impedance,
    dissipation_number,
    ladder_matrix,
    propagation_number,
    series_impedance,
    transmission_matrix,
    womersley_impedance,
)
from jaxlines.physics.weighting import KagawaWeights, TrikhaWeights, VitkovskyTurbulentWeights

# 20.83 m of the antennas' 2-in pipe: length, inner diameter, density, viscosity, effective modulus.
PIPE = (20.83, 2 * 0.0214249, 850.0, 27.7e-6, 1.3211e9)
FRICTIONS: dict[str, Friction] = {
    "none": "none",
    "steady": "steady",
    "distributed": "distributed",
    "kagawa": KagawaWeights(),
}

# f [Hz] -> G, Zc, cosh G, Zc sinh G, sinh G/Zc; computed with mpmath, 30 digits.
EXACT = {
    0.1: (
        *(0.003650675512 + 0.01256434334j, 879465626.7 - 255536126.4j, 0.9999277329 + 4.586723561e-5j),
        *(6420977.889 + 10116883.07j, -2.184270508e-16 + 1.428599401e-11j),
    ),
    1.0: (
        *(0.008344711562 + 0.1121900945j, 785296366.7 - 58410430.11j, 0.993747888 + 9.342421372e-4j),
        *(13051511.15 + 87436472.66j, -4.452683328e-14 + 1.425655274e-10j),
    ),
    5.0: (
        *(0.01730279549 + 0.5411439354j, 757568426.0 - 24222855.86j, 0.8572482903 + 0.008913405708j),
        *(23715201.83 + 389935397.9j, -2.16491209e-12 + 6.799933469e-10j),
    ),
    10.0: (
        *(0.02403285001 + 1.072795557j, 750924096.2 - 16822260.37j, 0.477808045 + 0.0211158355j),
        *(23404553.42 + 659713715.3j, -1.0922269e-11 + 1.170037399e-9j),
    ),
    14.96: (
        *(0.02916203811 + 1.598637779j, 747993033.3 - 13644742.81j, -0.02784969316 + 0.02915486834j),
        *(13037941.64 + 748032183.5j, -2.546557735e-11 + 1.336496483e-9j),
    ),
    20.0: (
        *(0.03355626706 + 2.132140662j, 746216643.9 - 11744180.59j, -0.5326244455 + 0.02841206223j),
        *(-3384523.357 + 632267939.5j, -4.17962571e-11 + 1.134423969e-9j),
    ),
    50.0: (
        *(0.05245820434 + 5.300483153j, 742035236.2 - 7343827.897j, 0.5555398935 - 0.04366522j),
        *(15486570.34 - 618436423.7j, 5.034503282e-11 - 1.122284722e-9j),
    ),
    100.0: (
        *(0.07376335424 + 10.57084402j, 739926767.9 - 5163209.316j, -0.4131965998 - 0.06727043861j),
        *(-27228504.43 - 675862088.4j, -3.249933544e-11 - 1.234983889e-9j),
    ),
}


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("frequency", EXACT)
def test_exact_line(frequency):
    s = 2j * np.pi * frequency
    matrix = transmission_matrix(s, *PIPE)
    ours = [propagation_number(s, *PIPE), characteristic_impedance(s, *PIPE[1:])]
    ours += [matrix[0, 0], matrix[0, 1], matrix[1, 0]]
    for mine, exact in zip(ours, EXACT[frequency], strict=True):
        assert abs(mine - exact) < 1e-9 * abs(exact)
        assert mine.real == pytest.approx(exact.real, rel=1e-8)
        assert mine.imag == pytest.approx(exact.imag, rel=1e-8)
    assert matrix[1, 1] == matrix[0, 0]


def test_resonance_and_numbers_of_the_line():
    assert abs(1 / transmission_matrix(2j * np.pi * 14.96, *PIPE)[0, 0]) == pytest.approx(24.802279, rel=1e-7)
    speed = np.sqrt(PIPE[4] / PIPE[2])
    assert speed == pytest.approx(1246.6897345, rel=1e-10)
    assert dissipation_number(20.83, PIPE[1], speed, 27.7e-6) == pytest.approx(1.00826118e-3, rel=1e-8)
    lossless = characteristic_impedance(1j, *PIPE[1:], friction="none")
    assert lossless == pytest.approx(734834993.05, rel=1e-10)


@pytest.mark.parametrize(("share", "tolerance"), [(0, 1e-13), (0.25, 1e-13), (-0.25, 1e-13), (0.3, 1e-12), (0.4, 1e-7)])
def test_bessel_ratio_for_all_sizes(share, tolerance):
    z = np.geomspace(1e-4, 1e5, 1000) * np.exp(1j * np.pi * share)
    np.testing.assert_allclose(bessel_ratio(z) * ive(2, z) / ive(0, z), 1.0, rtol=tolerance)
    np.testing.assert_allclose(bessel_ratio(jnp.asarray(z)), bessel_ratio(z), rtol=1e-13)


def test_bessel_ratio_is_a_sum_of_poles():
    """I0/I2 = 1 + 8/z^2 + 4 sum 1/(z^2 + j_k^2), the tail of the sum by its integral."""
    z = np.array([0.3, 2.0 + 1.0j, 10.0 * np.exp(0.25j * np.pi), 30.0])
    exponents = jn_zeros(2, 1000) ** 2
    tail = 1.0 / (np.pi**2 * (1000 + 0.75 + 0.5))
    poles = 1.0 + 8.0 / z**2 + 4.0 * (np.sum(1.0 / (z[:, None] ** 2 + exponents), axis=1) + tail)
    np.testing.assert_allclose(bessel_ratio(z), poles, rtol=1e-6)


def test_slow_and_fast_flow():
    """8 + 4 w/3 for w -> 0: Hagen-Poiseuille and an inertia of 4/3; w + 2 sqrt(w) for w -> infinity."""
    assert womersley_impedance(0.0) == 8.0
    assert (womersley_impedance(1e-4j) - 8.0) / 1e-4j == pytest.approx(4 / 3, rel=1e-5)
    assert abs(womersley_impedance(1e10j) / (1e10j + 2 * np.sqrt(1e10j)) - 1) < 1e-9
    slope = jax.grad(womersley_impedance, holomorphic=True)
    assert slope(jnp.asarray(0j)) == pytest.approx(4 / 3, rel=1e-14)


def test_at_zero_frequency_the_line_is_its_resistance():
    resistance = 128 * 850 * 27.7e-6 * 20.83 / (np.pi * PIPE[1] ** 4)
    for name in ("steady", "distributed", "kagawa"):
        friction = FRICTIONS[name]
        for matrix in (transmission_matrix(0.0, *PIPE, friction), ladder_matrix(0.0, 5, *PIPE, friction)):
            np.testing.assert_allclose(matrix, [[1, resistance], [0, 1]], rtol=1e-13)
    np.testing.assert_allclose(transmission_matrix(0.0, *PIPE, "none"), np.eye(2), rtol=1e-14)


@pytest.mark.parametrize("model", ["pi", "T"])
@pytest.mark.parametrize("segments", [1, 2, 3, 7, 40])
def test_segments_add_up_to_the_line(segments, model):
    s = 1e-4j
    matrix = ladder_matrix(s, segments, *PIPE, "none", model)
    area = np.pi / 4 * PIPE[1] ** 2
    assert matrix[0, 1] / s == pytest.approx(850 * 20.83 / area, rel=1e-9)
    assert matrix[1, 0] / s == pytest.approx(area * 20.83 / 1.3211e9, rel=1e-9)


def quarter_wave(segments, model):
    """First frequency of a ladder closed at one end and open at the other, times L/c."""
    length, speed = PIPE[0], np.sqrt(PIPE[4] / PIPE[2])

    def cosh(phase):
        return ladder_matrix(1j * phase * speed / length, segments, *PIPE, "none", model)[0, 0].real

    return float(brentq(cosh, 0.9, 1.7, xtol=1e-13))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("segments", "printed", "percent"),
    [(1, 1.414214, -9.97), (2, 1.530734, -2.55), (4, 1.560723, -0.641), (8, 1.568274, -0.161), (16, None, -0.0402)],
)
def test_frequencies_of_the_ladder(segments, printed, percent):
    for model in ("pi", "T"):
        phase = quarter_wave(segments, model)
        assert phase == pytest.approx(2 * segments * np.sin(np.pi / (4 * segments)), rel=1e-10)
        assert printed is None or phase == pytest.approx(printed, abs=5e-7)
        assert 100 * (phase / (np.pi / 2) - 1) == pytest.approx(percent, rel=4e-3)


@pytest.mark.parametrize("friction", FRICTIONS.values(), ids=FRICTIONS)
@pytest.mark.parametrize("model", ["pi", "T"])
def test_the_ladder_converges_with_the_square_of_the_segments(model, friction):
    counts = np.array([16, 23, 32, 45, 64, 90])
    for frequency in (3.0, 12.0, 35.0):  # up to 0.6 wave lengths in the line
        s = 2j * np.pi * frequency
        exact = transmission_matrix(s, *PIPE, friction)
        scale = np.array([[1.0, 7.3e8], [1 / 7.3e8, 1.0]])
        errors = [np.max(np.abs(ladder_matrix(s, int(n), *PIPE, friction, model) - exact) / scale) for n in counts]
        order, _ = np.polyfit(np.log(counts), np.log(errors), 1)
        assert order == pytest.approx(-2.0, abs=0.02)


def test_weights_are_states_of_the_line():
    """dy_k/dt = -n_k nu/R^2 y_k + m_k dV/dt, rho L dV/dt = dp - 8 mu L/R^2 V - (4 mu L/R^2) sum y_k, by hand."""
    length, diameter, density, viscosity, _ = PIPE
    m, n = TrikhaWeights().coefficients()
    mu, r2 = density * viscosity, diameter**2 / 4
    rate = np.zeros((4, 4))  # V, y_1, y_2, y_3
    rate[0, 0], rate[0, 1:] = -8 * mu / (r2 * density), -4 * mu / (r2 * density)
    for k in range(3):
        rate[k + 1] = m[k] * rate[0]
        rate[k + 1, k + 1] -= n[k] * viscosity / r2
    drive = np.concatenate([[1.0], m]) / (density * length)
    for s in (0.5j, 20j, 3.0 + 400j):
        velocity = np.linalg.solve(s * np.eye(4) - rate, drive)[0]
        impedance = 1.0 / (velocity * np.pi * r2)
        assert series_impedance(s, *PIPE[:4], TrikhaWeights()) == pytest.approx(impedance, rel=1e-12)


def test_weights_approximate_the_exact_impedance():
    """Error of the part of the impedance that friction makes, at w R^2/nu = 1, 10, 100, 1e3, 1e4."""
    s = 1j * np.array([1.0, 10.0, 100.0, 1e3, 1e4]) * 27.7e-6 / (PIPE[1] / 2) ** 2
    exact, inertia = series_impedance(s, *PIPE[:4]), series_impedance(s, *PIPE[:4], "none")
    cases = [("steady", (0.042, 0.348, 0.753, 0.914, 0.972)), ("kagawa", (2e-4, 0.0015, 0.0072, 0.025, 0.080))]
    for name, known in cases:
        error = np.abs(series_impedance(s, *PIPE[:4], FRICTIONS[name]) - exact) / np.abs(exact - inertia)
        np.testing.assert_allclose(error, known, rtol=0.02, atol=5e-5)


RANGES = ((0.1, 100.0), (2e-3, 0.1), (700.0, 1200.0), (1e-6, 3e-4), (2e8, 3e9))
lines = st.tuples(*(st.floats(low, high) for low, high in RANGES))


@settings(max_examples=60, deadline=None)
@given(lines, st.floats(-2, 3), st.floats(0, 2), st.sampled_from(list(FRICTIONS)), st.integers(1, 40))
def test_determinant_is_one(pipe, log_omega, damping, friction, segments):
    s = 10.0**log_omega * (damping + 1j)
    exact = transmission_matrix(s, *pipe, friction=FRICTIONS[friction])
    if abs(exact[0, 0]) < 1e3:  # beyond, the entries are so large that their difference has no digits
        tolerance = 1e-12 * (1 + abs(exact[0, 0]) ** 2)
        assert abs(exact[0, 0] * exact[1, 1] - exact[0, 1] * exact[1, 0] - 1) < tolerance
    ladder = ladder_matrix(s, segments, *pipe, friction=FRICTIONS[friction])
    size = abs(ladder[0, 0]) ** 2 + abs(ladder[0, 1] * ladder[1, 0])
    assert abs(ladder[0, 0] * ladder[1, 1] - ladder[0, 1] * ladder[1, 0] - 1) < 1e-11 * (1 + size)


@pytest.mark.parametrize("friction", FRICTIONS.values(), ids=FRICTIONS)
@pytest.mark.parametrize("segments", [None, 6])
def test_derivatives(friction, segments):
    """Exact derivatives in all numbers of the line against differences of fourth order, s = 0 included."""
    omega = np.array([0.0, 1e-3, 1.0, 60.0, 625.0 / 16.57134801, 20.0, 500.0])
    s = 1j * omega

    def matrix(x):
        if segments is None:
            entries = transmission_matrix(s, *x, friction=friction)
        else:
            entries = ladder_matrix(s, segments, *x, friction=friction)
        return entries[..., 0, :]

    x = np.array(PIPE)
    exact = np.asarray(jax.jit(jax.jacfwd(lambda x: matrix(tuple(x))))(jnp.asarray(x)))
    assert np.all(np.isfinite(exact))
    for i in range(5):
        h = 1e-4 * x[i] * np.eye(5)[i]
        near, far = (matrix(tuple(x + k * h)) - matrix(tuple(x - k * h)) for k in (1, 2))
        difference = (8 * near - far) / (12 * h[i])
        error = np.abs(exact[..., i] - difference) * x[i]
        assert np.all(error <= 1e-6 * np.abs(exact[..., i]) * x[i] + 1e-10 * np.array([1.0, 7.3e8]))


def test_unknown_words_are_refused():
    with pytest.raises(ValueError, match=r"friction must be one of .*'distributed'.* got 'laminar'"):
        transmission_matrix(1j, *PIPE, "laminar")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="VitkovskyTurbulentWeights is for turbulent mean flow"):
        transmission_matrix(1j, *PIPE, VitkovskyTurbulentWeights(1e4))
    with pytest.raises(ValueError, match='model "pi" or "T", got 4 and \'L\''):
        ladder_matrix(1j, 4, *PIPE, model="L")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="segments must be at least 1"):
        ladder_matrix(1j, 0, *PIPE)
