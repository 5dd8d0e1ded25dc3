"""Hoses: as conduits, from data sheets, and with walls that creep, against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from jaxlines import Line, Oil, Pipe
from jaxlines.physics.containers import Hose, ViscoelasticHose, area, capacity, delayed_strain_rate, volume_at

ATMOSPHERE = 101325.0
OIL = Oil(bulk_modulus=1.379e9, density=850.0, kinematic_viscosity=27.7e-6)


def test_hoses_are_conduits():
    hose, pipe = Hose(20.83, 0.0428498, 4.32e9, 1e-5), Pipe(20.83, 0.0428498, 0.060325)
    assert area(hose) == pytest.approx(1.442074e-3, rel=2e-7)
    assert hose.reference_volume() == pytest.approx(20.83 * 1.442074e-3, rel=2e-7)
    assert 1e-3 * hose.laminar_resistance(OIL) == pytest.approx(5.93e3, rel=1e-3)
    assert hose.inertance(OIL) == pipe.inertance(OIL) == pytest.approx(850 * 20.83 / 1.442074e-3, rel=1e-5)
    assert Line("A", hose).effective_bulk_modulus(OIL, ATMOSPHERE) == pytest.approx(1.04532e9, rel=5e-6)


def test_hoses_expand_as_their_data_sheets_say():
    p, bore = 7e6, np.pi / 4 * 0.0127**2
    hose = Hose.from_expansion(3.0, 0.0127, 1.6e-6, p)
    growth = volume_at(hose, OIL, OIL.atmospheric_pressure + p) - 3.0 * bore
    assert growth == pytest.approx(3.0 * 1.6e-6, rel=1e-10)
    slow = ViscoelasticHose.from_expansion(3.0, 0.0127, 1.6e-6, 0.9e-6, p, relaxation_time=0.2)
    at = OIL.atmospheric_pressure + p
    settled = slow.relaxation_time * delayed_strain_rate(slow, OIL, at, 0.0)
    assert volume_at(slow, OIL, at) - 3.0 * bore == pytest.approx(3.0 * 0.9e-6, rel=1e-10)
    assert volume_at(slow, OIL, at, settled) - 3.0 * bore == pytest.approx(3.0 * 1.6e-6, rel=1e-10)


HOSE = ViscoelasticHose(2.0, 0.02, static_modulus=4e8, dynamic_modulus=1e9, relaxation_time=0.3)


def test_creep_at_constant_pressure():
    """eps = dp (1/K_s - 1/K_d)(1 - exp(-t/tau)), also for the Kelvin-Voigt wall."""
    times = np.linspace(0, 1, 11)
    for hose in (HOSE, ViscoelasticHose(2.0, 0.02, 4e8, np.inf, 0.3)):
        done = solve_ivp(
            lambda t, y: delayed_strain_rate(hose, OIL, ATMOSPHERE + 1e7, y),  # noqa: B023
            (0, 1),
            [0.0],
            t_eval=times,
            rtol=1e-10,
            atol=1e-14,
        )
        compliance = 1 / 4e8 - 1 / hose.dynamic_modulus
        np.testing.assert_allclose(done.y[0], 1e7 * compliance * (1 - np.exp(-times / 0.3)), rtol=1e-7, atol=1e-12)
        settled = volume_at(hose, OIL, ATMOSPHERE + 1e7, 1e7 * compliance)
        assert settled == pytest.approx(hose.reference_volume() * np.exp(1e7 / 4e8), rel=1e-14)


def test_pressure_of_a_closed_hose_relaxes():
    """Oil shut in: p falls by C_d/C_s, C = 1/K + 1/K_wall, with the time constant tau C_d/C_s."""
    fluid = Oil(1.379e9, 850.0, mass="article")

    def rates(t, y):
        strain_rate = delayed_strain_rate(HOSE, fluid, y[0], y[1])
        mass = fluid.density_at(y[0]) * volume_at(HOSE, fluid, y[0])
        return [-mass * strain_rate / capacity(HOSE, fluid, y[0], y[1]), strain_rate]

    fast, slow = 1 / 1.379e9 + 1 / 1e9, 1 / 1.379e9 + 1 / 4e8
    times = np.linspace(0, 1, 11)
    done = solve_ivp(rates, (0, 1), [ATMOSPHERE + 1e7, 0.0], t_eval=times, rtol=1e-10, atol=1e-12)
    share = fast / slow + (1 - fast / slow) * np.exp(-times * slow / (0.3 * fast))
    np.testing.assert_allclose(done.y[0], ATMOSPHERE + 1e7 * share, rtol=1e-8)


@settings(max_examples=10, deadline=None)
@given(
    st.floats(10.0, 100.0),
    st.lists(st.tuples(st.floats(1e4, 1e6), st.floats(0, 6.3)), min_size=1, max_size=3),
    st.floats(1.1, 100.0),
)
def test_a_cycle_of_pressure_costs_energy(frequency, harmonics, ratio):
    """The loop integral of p dV is positive, and pi V sum_k k P_k^2 J k w tau/(1 + (k w tau)^2) for small strains."""
    hose, compliance = ViscoelasticHose(1.0, 0.02, 1e9, ratio * 1e9, 0.02), (1 - 1 / ratio) / 1e9
    orders = np.arange(1, len(harmonics) + 1)
    phasors = np.array([size * np.exp(1j * phase) for size, phase in harmonics])
    response = compliance / (1 + 2j * np.pi * frequency * 0.02 * orders)
    turns = np.linspace(0, 1, 129)
    pressure, strain = (
        np.sum(a[:, None] * np.exp(2j * np.pi * np.outer(orders, turns)), axis=0).real
        for a in (phasors, phasors * response)
    )
    rate = delayed_strain_rate(hose, OIL, ATMOSPHERE + pressure, strain)
    waves = np.sum(
        (phasors * response * 2j * np.pi * frequency * orders)[:, None] * np.exp(2j * np.pi * np.outer(orders, turns)),
        axis=0,
    ).real
    np.testing.assert_allclose(rate, waves, atol=1e-9 * np.max(np.abs(waves)))
    volume = volume_at(hose, OIL, ATMOSPHERE + pressure, strain)
    loss = np.sum(0.5 * (pressure[1:] + pressure[:-1]) * np.diff(volume))
    expected = np.pi * hose.reference_volume() * np.sum(orders * np.abs(phasors) ** 2 * np.abs(response.imag))
    assert loss > 0
    assert loss == pytest.approx(expected, rel=1e-2)
