"""Pipes, vessels, lines and the equations of the article against printed and tabulated numbers."""

import math

import jax
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxlines import Line, Oil, Pipe, Vessel
from jaxlines.catalogue import dsn70m
from jaxlines.physics import article
from jaxlines.physics.containers import Hose, ViscoelasticHose, capacity, delayed_strain_rate, volume_at
from jaxlines.physics.validity import (
    frequency_of_error,
    lumped_impedance_error,
    lumped_impedance_ratio,
    quarter_wave_frequency,
)

INCH, PSI = 0.0254, 6894.757293168361
ATMOSPHERE = 101325.0
OIL = Oil(bulk_modulus=1.379e9, density=850.0, kinematic_viscosity=27.7e-6)

# Schedule 160 pipes: inner, outer diameter [in]; K_c of eq. (4), K_eff [Pa]; c [m/s]; area [m^2]; K_c, K_eff [psi]
PIPES = {
    "1": (0.815, 1.315, 4.14116e10, 1.334559e9, 1253.02, 3.365678e-4, 6.0062e6, 193555),
    "1.5": (1.338, 1.900, 3.21423e10, 1.322271e9, 1247.24, 9.071300e-4, 4.6619e6, 191773),
    "2": (1.687, 2.375, 3.14660e10, 1.321103e9, 1246.69, 1.442074e-3, 4.5638e6, 191603),
}


@pytest.mark.parametrize("size", PIPES)
def test_pipe_moduli(size):
    inner, outer, wall, effective, speed, area, wall_psi, effective_psi = PIPES[size]
    pipe = Pipe(1.0, inner * INCH, outer * INCH, 2.0684e11, 0.25)
    line = Line("A", pipe, path_length=1.0)
    assert pipe.container_modulus() == pytest.approx(wall, rel=2e-6)
    assert line.effective_bulk_modulus(OIL, ATMOSPHERE) == pytest.approx(effective, rel=5e-7)
    assert line.wave_speed(OIL, ATMOSPHERE) == pytest.approx(speed, abs=6e-3)
    assert pipe.reference_volume() == pytest.approx(area, rel=2e-7)
    printed = dsn70m.pipe(size, 1.0)
    assert pipe.container_modulus() / PSI == pytest.approx(wall_psi, rel=2e-5)
    assert article.series_modulus(printed.container_modulus(), 2e5 * PSI) / PSI == pytest.approx(effective_psi, abs=0.5)


def test_hose_modulus():
    assert article.series_modulus(4.32e9, 1.379e9) == pytest.approx(1.04532e9, rel=5e-6)
    hose = article.series_modulus(dsn70m.hose().container_modulus(), 2e5 * PSI)
    assert hose / PSI == pytest.approx(151574, abs=0.5)
    assert article.wave_speed(hose, 850.0) == pytest.approx(1109, abs=0.5)


def test_conduit_modulus_is_lames_solution_with_hoop_strain_only():
    inner, outer, young, nu = 0.0214249, 0.0301625, 2.0684e11, 0.29
    hoop = ((outer**2 + inner**2) / (outer**2 - inner**2) + nu) / young
    assert 1 / article.conduit_modulus(inner, outer - inner, young, nu) == pytest.approx(2 * hoop, rel=1e-13)


def test_equations_of_the_article():
    assert article.pressure_change(1.4e9, 0.85, 850.0) == pytest.approx(1.4e6)  # (1)
    assert article.series_modulus(4e9, 1e9) == pytest.approx(0.8e9)  # (2)
    assert article.series_modulus(np.inf, 1e9) == pytest.approx(1e9, rel=1e-15)
    assert article.ideal_gas_modulus(1.4, 1.204, 287.05, 293.15) == pytest.approx(1.419e5, rel=1e-3)  # (3)
    assert article.combined_modulus([1.0, 3.0], [1e9, 2e9]) == pytest.approx(1.6e9)  # (5)
    assert article.pressure_rate_from_density(1.4e9, 850.0, 8.5) == pytest.approx(1.4e7)  # (6)
    assert article.density_rate(850.0, 2e-3, 3e-4, 1e-4, 5e-5) == pytest.approx(63.75)  # (7)
    assert article.pressure_rate(1.4e9, 2e-3, 3e-4, 1e-4) == pytest.approx(1.4e8)  # (8), (12)
    assert article.wave_speed(1.2895e9, 850.0) == pytest.approx(1231.69, abs=5e-3)  # (9)
    assert article.round_trip_time(20.83, 1231.7) == pytest.approx(0.033823, abs=5e-7)  # (10)
    assert article.lumped_model_is_valid(20.83, 1231.7, 20.0)  # (11)
    assert not article.lumped_model_is_valid(20.83, 1231.7, 30.0)


def test_equations_6_to_8_agree():
    rate = article.pressure_rate_from_density(1.4e9, 850.0, article.density_rate(850.0, 2e-3, 3e-4, 1e-4))
    assert rate == pytest.approx(article.pressure_rate(1.4e9, 2e-3, 3e-4, 1e-4), rel=1e-14)


@pytest.mark.parametrize("name", dsn70m.VOLUMES)
def test_control_lines_have_the_numbers_of_table_1(name):
    line = dsn70m.control_line(name, "A")
    modulus = line.effective_bulk_modulus(dsn70m.OIL, ATMOSPHERE)
    assert modulus / PSI == pytest.approx(dsn70m.EFFECTIVE_MODULI[name].inch_pound.value, rel=1e-10)
    assert line.volume() / INCH**3 == pytest.approx(dsn70m.VOLUMES[name].inch_pound.value, rel=1e-10)
    assert line.line_constant(dsn70m.OIL, ATMOSPHERE) == pytest.approx(dsn70m.LINE_CONSTANTS[name].si.value, rel=2e-4)
    rebuilt = dsn70m.reconstructed_line(name, "A")
    assert rebuilt.volume() == pytest.approx(line.volume(), rel=1e-12)
    assert rebuilt.effective_bulk_modulus(dsn70m.OIL, ATMOSPHERE) == pytest.approx(modulus, rel=5e-6)


def test_adding_capacities_is_equation_5():
    parts = [Pipe(12.8, 0.04285, 0.06032), Vessel(3.4e-3, 4.32e9), Vessel(3e-3)]
    line = Line("A", parts)
    moduli = [Line("A", part).effective_bulk_modulus(OIL, ATMOSPHERE) for part in parts]
    expected = article.combined_modulus([part.reference_volume() for part in parts], moduli)
    assert line.effective_bulk_modulus(OIL, ATMOSPHERE) == pytest.approx(expected, rel=1e-13)
    halves = Line("A", [Pipe(6.4, 0.04285, 0.06032)] * 2 + parts[1:])
    assert halves.capacity(OIL, 5e6) == pytest.approx(line.capacity(OIL, 5e6), rel=1e-14)


def test_capacity_is_the_derivative_of_mass():
    vessel, fluid = Vessel(2e-3, 5e8), Oil(1.4e9, 850.0, air_fraction=0.02)
    for p in (2e5, 2e6, 2e7):
        step = 1e-4 * p
        mass = [fluid.density_at(q) * volume_at(vessel, fluid, q) for q in (p - step, p + step)]
        assert capacity(vessel, fluid, p) == pytest.approx((mass[1] - mass[0]) / (2 * step), rel=1e-7)


def test_article_capacity_does_not_depend_on_pressure():
    fluid = Oil(1.379e9, 850.0, mass="article")
    line = dsn70m.control_line("azimuth_1", "A")
    assert line.capacity(fluid, 2e7) == line.capacity(fluid, 1e5)


def test_resistance_and_inertance():
    line = Line("A", [Pipe(20.83, 0.0428498, 0.060325), Vessel(1e-3)])
    assert 1e-3 * line.laminar_resistance(OIL) == pytest.approx(5.93e3, rel=1e-3)
    assert line.inertance(OIL) == pytest.approx(850 * 20.83 / 1.442074e-3, rel=1e-5)


HOSE = ViscoelasticHose(2.0, 0.02, static_modulus=4e8, dynamic_modulus=1e9, relaxation_time=0.3)


def test_capacity_at_constant_strain_is_the_derivative_of_mass():
    fluid = Oil(1.4e9, 850.0, air_fraction=0.02)
    for p in (2e5, 2e6, 2e7):
        step = 1e-4 * p
        mass = [fluid.density_at(q) * volume_at(HOSE, fluid, q, 0.01) for q in (p - step, p + step)]
        assert capacity(HOSE, fluid, p, 0.01) == pytest.approx((mass[1] - mass[0]) / (2 * step), rel=1e-7)
        given = [fluid.density_at(q, 0.3) * volume_at(HOSE, fluid, q, 0.01) for q in (p - step, p + step)]
        assert capacity(HOSE, fluid, p, 0.01, 0.3) == pytest.approx((given[1] - given[0]) / (2 * step), rel=1e-7)


CONTAINERS = {
    "pipe": Pipe(12.8, 0.04285, 0.06032),
    "anchored": Pipe(12.8, 0.04285, 0.06032, restraint="upstream"),
    "thin": Pipe(12.8, 0.04285, 0.046, restraint="throughout", wall="thin"),
    "capped": Pipe(12.8, 0.04285, 0.06032, restraint="capped"),
    "hose": Hose(2.0, 0.02, 5e8),
    "rigid hose": Hose(2.0, 0.02, np.inf),
    "visco-elastic hose": HOSE,
    "Kelvin-Voigt hose": ViscoelasticHose(2.0, 0.02, 4e8, np.inf, 0.3),
    "vessel": Vessel(1e-3, 4e9),
    "rigid": Vessel(1e-3),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_gradients_of_containers(name):
    """Of volume, capacity and creep in every number of the container, pressure and strain, against differences."""
    fluid = Oil(1.4e9, 850.0, 30e-6, 0.01, 1.2, 6.0)

    def found(x):
        container, p, strain = restore(x)
        creep = [delayed_strain_rate(container, fluid, p, strain)] if container.delayed else []
        return jax.numpy.stack([volume_at(container, fluid, p, strain), capacity(container, fluid, p, strain), *creep])

    with jax.enable_x64(True):
        found, slopes = jax.jit(found), jax.jit(jax.jacfwd(found))
        for p in (2e4, 5e6, 2e7):
            x, restore = ravel_pytree((CONTAINERS[name], p, 0.01))
            exact, largest = np.asarray(slopes(x)), np.abs(found(x))
            assert np.all(np.isfinite(exact))
            for i, size in enumerate(np.asarray(x)):
                if np.isinf(size) or size == 0.0:  # the infinite modulus of a rigid wall, the roughness of a smooth one
                    assert np.all(exact[:, i] == 0.0)
                    continue
                h = 1e-3 * np.eye(len(x))[i] * size
                change = (8 * (found(x + h) - found(x - h)) - (found(x + 2 * h) - found(x - 2 * h))) / 12e-3
                np.testing.assert_allclose(exact[:, i] * size / largest, change / largest, rtol=1e-6, atol=1e-12)


def test_impedance_of_a_lumped_line():
    phases = {0.01: 0.17303, 0.05: 0.38537, 0.10: 0.54228, 0.20: 0.75931, 0.50: 1.16556}
    for error, phase in phases.items():
        assert 1 - lumped_impedance_ratio(phase) == pytest.approx(error, rel=1e-4)
        assert frequency_of_error(1.0, 2 * math.pi, error) == pytest.approx(phase, abs=1e-5)
    assert lumped_impedance_ratio(2 * math.pi * 20 * 20.83 / 1246.69) == pytest.approx(-1.227, abs=5e-4)
    assert lumped_impedance_error(20.83, 1246.69, 20.0) == pytest.approx(2.227, abs=5e-4)
    assert quarter_wave_frequency(20.83, 1246.69) == pytest.approx(14.96, abs=5e-3)
    assert lumped_impedance_ratio(0.0) == 1.0
    for phase in (1e-4, 0.0199, 0.0201):  # both sides of the change from series to cotangent
        assert lumped_impedance_ratio(phase) == pytest.approx(phase / math.tan(phase), rel=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Pipe(12.8, 42.85e-3, 30e-3),
            "outer_diameter must be larger than .* got 0.03 m and 0.04285",
        ),
        (lambda: Pipe(12.8, 42.85, 60.3), "inner_diameter must be .* m, got 42.85 m: was it given in mm"),
        (
            lambda: Pipe(1, 0.04, 0.06, youngs_modulus=207.0),
            "youngs_modulus must .* 207 Pa: was it given in GPa",
        ),
        (lambda: Vessel(-1.0), "volume must be .* got -1 m"),
        (lambda: Vessel(1e-3, wall_modulus=4.0), "wall_modulus must be .* got 4 Pa: was it given in MPa or bar"),
        (lambda: Pipe(12.8, 0.04, 0.06, roughness=15.0), "roughness must be .* got 15 m: was it given in mm or micro"),
        (lambda: Pipe(12.8, 0.04, 0.06, restraint="anchored"), "restraint must be one of .* got 'anchored'"),
        (lambda: Pipe(12.8, 0.04, 0.06, wall="steel"), 'wall must be "thick" or "thin", got \'steel\''),
        (lambda: Hose(2.0, 19.05, 4e8), "inner_diameter must be .* got 19.05 m: was it given in mm"),
        (lambda: Hose(2.0, 0.01905, 400.0), "wall_modulus must be .* got 400 Pa: was it given in MPa or bar"),
        (
            lambda: Hose.from_expansion(2.0, 0.01905, 2.0, 7e6),
            r"expansion must be .* got 2 m\^3/m: was it given in cm\^3/m",
        ),
        (
            lambda: ViscoelasticHose(2.0, 0.02, 1e9, 4e8, 0.3),
            "dynamic_modulus must not be below static_modulus, got 4e.08 Pa and 1e.09 Pa: were they swapped",
        ),
        (lambda: ViscoelasticHose(2.0, 0.02, 4e8, 1e9, 0.0), "relaxation_time must be .* got 0 s"),
        (lambda: Vessel.from_effective_modulus(1e-3, 1.4e9, 1.3e9), "effective_modulus must not exceed the fluid's"),
    ],
)
def test_wrong_containers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_lines_hold_containers():
    with pytest.raises(TypeError, match="parts of a Line are containers"):
        Line("A", [OIL])
    with pytest.raises(TypeError, match=r"parts of a Line are containers .* got 'none'"):
        Line("A", [])
