"""Rows of the verification: the article's equations, walls and containers."""

import numpy as np
from verify_rows import APART, BY_HAND, FORM, THIRTY, Oracle, Row, check

from jaxlines.physics import article, containers, walls
from jaxlines.physics.fluids import Oil

INCH, PSI, ATMOSPHERE = 0.0254, 6894.757293168361, 101325.0
FLUID = Oil(1.379e9, 850.0, 27.7e-6)
ARTICLE = Oracle(APART.kind, "numbers of the article on the DSN 70-metre antennas, recomputed apart")

YOUNG, POISSON = 2.0684e11, 0.25
# Schedule 160 pipes: inner, outer diameter [in]; wall modulus [Pa] with expansion joints, anchored upstream,
# throughout, thin wall; effective modulus [Pa], wave speed [m/s], area [m^2]; the first and the fifth in psi
PIPES = {
    "1": (
        *(0.815, 1.315, "4.14116e10", "4.41692e10", "4.27460e10", "6.3448e10"),
        *("1.334559e9", "1253.02", "3.365678e-4", "6.0062e6", "193555"),
    ),
    "1.5": (
        *(1.338, 1.900, "3.21423e10", "3.48026e10", "3.34196e10", "4.3439e10"),
        *("1.322271e9", "1247.24", "9.071300e-4", "4.6619e6", "191773"),
    ),
    "2": (
        *(1.687, 2.375, "3.14660e10", "3.41080e10", "3.27338e10", "4.2177e10"),
        *("1.321103e9", "1246.69", "1.442074e-3", "4.5638e6", "191603"),
    ),
}


def article_rows() -> list[Row]:
    """Equations (1) to (12)."""
    by_hand = {
        "pressure_change": ("eq. (1)", 1.4e6, article.pressure_change(1.4e9, 0.85, 850.0), "Pa"),
        "series_modulus": ("eq. (2), 4 and 1 GPa", 0.8e9, article.series_modulus(4e9, 1e9), "Pa"),
        "ideal_gas_modulus": (
            "eq. (3)",
            1.4 * 1.2 * 287.05 * 293.0,
            article.ideal_gas_modulus(1.4, 1.2, 287.05, 293.0),
            "Pa",
        ),
        "combined_modulus": ("eq. (5)", 1.6e9, article.combined_modulus([1.0, 3.0], [1e9, 2e9]), "Pa"),
        "pressure_rate_from_density": ("eq. (6)", 1.4e7, article.pressure_rate_from_density(1.4e9, 850.0, 8.5), "Pa/s"),
        "density_rate": ("eq. (7)", 63.75, article.density_rate(850.0, 2e-3, 3e-4, 1e-4, 5e-5), "kg/(m^3 s)"),
        "pressure_rate": ("eqs. (8), (12)", 1.4e8, article.pressure_rate(1.4e9, 2e-3, 3e-4, 1e-4), "Pa/s"),
        "lumped_model_is_valid": ("eq. (11), 20 Hz", 1.0, article.lumped_model_is_valid(20.83, 1231.7, 20.0), ""),
    }
    rows = []
    for name, (case, expected, ours, unit) in by_hand.items():
        rows += check(f"article.{name}", BY_HAND, [(case, expected, ours)], unit=unit)
    rows += check(
        "article.lumped_model_is_valid",
        BY_HAND,
        [("eq. (11), 30 Hz", 0.0, article.lumped_model_is_valid(20.83, 1231.7, 30.0))],
    )
    return rows + article_number_rows()


def article_number_rows() -> list[Row]:
    """Numbers of the article's text and of eqs. (13) to (16)."""
    air = article.ideal_gas_modulus(1.4, ATMOSPHERE / (287.05 * 293.15), 287.05, 293.15)
    rows = check("article.ideal_gas_modulus", APART, [("eq. (3), air at 1 atm", "141.9", air / 1e3)], unit="kPa")
    hose = article.series_modulus(4.32e9, 1.379e9)
    rows += check("article.series_modulus", ARTICLE, [("eq. (2), hose, metric", "1.04532e9", hose)], unit="Pa")
    hose = article.series_modulus(6.26e5, 2e5)
    rows += check("article.series_modulus", ARTICLE, [("eq. (2), hose", "151574", hose)], unit="psi")
    speeds = [("eq. (9), 1.2895 GPa", "1231.69", article.wave_speed(1.2895e9, 850.0))]
    speeds += [("eq. (9), 1.3211 GPa", "1246.6897345", article.wave_speed(1.3211e9, 850.0))]
    speeds += [("eq. (9), hose", "1109", article.wave_speed(1.04532e9, 850.0))]
    rows += check("article.wave_speed", ARTICLE, speeds, unit="m/s")
    times = [("eq. (10), 20.83 m, 1231.7 m/s", "0.033823", article.round_trip_time(20.83, 1231.7))]
    times += [("2 L/c, 36.09 m, 1324.36 m/s", "0.05450180", article.round_trip_time(36.09, 1324.36))]
    rows += check("article.round_trip_time", APART, times, unit="s")
    metric = {13: (1.2888e9, 0.02710, "4.7557e10"), 14: (1.2895e9, 0.02770, "4.6552e10")}
    metric |= {15: (1.2815e9, 0.02455, "5.2200e10"), 16: (1.2816e9, 0.02457, "5.2161e10")}
    cases = [(f"eq. ({n})", k, article.line_constant(b, v)) for n, (b, v, k) in metric.items()]
    rows += check("article.line_constant", ARTICLE, cases, unit="N/m^5")
    inch = {13: (1.8693e5, 1653.6, "113.04"), 14: (1.8703e5, 1690.4, "110.64")}
    inch |= {15: (1.8587e5, 1498.1, "124.07"), 16: (1.8588e5, 1499.6, "123.95")}
    cases = [(f"eq. ({n})", k, article.line_constant(b, v)) for n, (b, v, k) in inch.items()]
    return rows + check("article.line_constant", ARTICLE, cases, unit="lbf/in^5")


def conduit_rows() -> list[Row]:
    """The table of the antennas' pipes, and one of stainless steel."""
    rows = [row for size in PIPES for row in pipe_rows(size)]
    steel = containers.Pipe(1.0, 1.687 * INCH, 2.375 * INCH, 193e9, 0.29)
    ours = article.series_modulus(steel.container_modulus(), 1.379e9)
    cases = [("2 in, stainless: E 193 GPa, nu 0.29; with oil of 1.379 GPa", "1.316418e9", ours)]
    return rows + check("containers.Pipe", APART, cases, unit="Pa")


def pipe_rows(size: str) -> list[Row]:
    """All columns of the table for one pipe."""
    inner, outer, *restrained, thin, k, c, a, wall_psi, k_psi = PIPES[size]
    bore, wall, case = inner * INCH, 0.5 * (outer - inner) * INCH, f"{size} in, schedule 160"
    names = (*walls.RESTRAINTS[:3], "capped")
    cases = [
        (f"{case}, {name}", printed, walls.thick_wall_modulus(0.5 * bore, wall, YOUNG, POISSON, name))
        for name, printed in zip(names, (*restrained, restrained[0]), strict=True)  # 1 - 4 nu = 0
    ]
    pipe = containers.Pipe(1.0, bore, outer * INCH, YOUNG, POISSON)
    effective = article.series_modulus(pipe.container_modulus(), 1.379e9)
    eq_4 = article.conduit_modulus(0.5 * bore, wall, YOUNG, POISSON)
    in_psi = article.conduit_modulus(0.5 * inner, 0.5 * (outer - inner), YOUNG / PSI, POISSON)
    numbers = (
        ("walls.thin_wall_modulus", case, thin, walls.thin_wall_modulus(bore, wall, YOUNG, POISSON), "Pa"),
        ("article.conduit_modulus", f"eq. (4), {case}", restrained[0], eq_4, "Pa"),
        ("article.conduit_modulus", f"eq. (4), {case}", wall_psi, in_psi, "psi"),
        ("containers.Pipe", f"with oil of 1.379 GPa, {case}", k, effective, "Pa"),
        ("article.series_modulus", f"with oil of 2e5 psi, {case}", k_psi, article.series_modulus(in_psi, 2e5), "psi"),
        ("article.wave_speed", f"with oil of 1.379 GPa, {case}", c, article.wave_speed(effective, 850.0), "m/s"),
        ("containers.area", case, a, containers.area(pipe), "m^2"),
    )
    rows = check("walls.thick_wall_modulus", APART, cases, unit="Pa")
    for formula, what, printed, ours, unit in numbers:
        rows += check(formula, APART, [(what, printed, ours)], unit=unit)
    return rows


def container_rows() -> list[Row]:
    """Thin walls, hoses and vessels."""
    zeta = {"expansion_joints": 1.0, "upstream": 0.85, "throughout": 0.91, "capped": 0.95}  # nu 0.3
    cases = [
        (f"zeta, nu 0.3, {name}", z, 2e11 * 1e-3 / walls.thin_wall_modulus(0.1, 1e-3, 2e11, 0.3, name) / 0.1)
        for name, z in zeta.items()
    ]
    rows = check("walls.thin_wall_modulus", FORM, cases)
    cases = [
        (f"wall of 1e-6 radii, zeta {z:g}, {name}", 1e5 / z, walls.thick_wall_modulus(1.0, 1e-6, 2e11, 0.3, name))
        for name, z in zeta.items()
    ]
    rows += check("walls.thick_wall_modulus", FORM, cases, unit="Pa", relative=5e-6)
    bore = np.pi / 4 * 0.0127**2
    case, wall = "1.6 cm^3/m at 7 MPa, bore 12.7 mm", walls.modulus_from_expansion(bore, 1.6e-6, 7e6)
    rows += check("walls.modulus_from_expansion", THIRTY, [(case, "557703983.596", wall)], unit="Pa")
    hose, at = containers.Hose.from_expansion(3.0, 0.0127, 1.6e-6, 7e6), ATMOSPHERE + 7e6
    growth = containers.volume_at(hose, FLUID, at) - hose.reference_volume()
    rows += check("containers.Hose", FORM, [(f"3 m, {case}: growth", 4.8e-6, growth)], unit="m^3")
    slow = containers.ViscoelasticHose(2.0, 0.02, 4e8, 1e9, 0.3)
    rate = containers.delayed_strain_rate(slow, FLUID, ATMOSPHERE + 1e7, 0.005)
    case = "K_s 0.4, K_d 1 GPa, 0.3 s, 10 MPa above atmosphere, strain 0.005"
    rows += check("containers.delayed_strain_rate", BY_HAND, [(case, 0.01 / 0.3, rate)], unit="1/s")
    cases = [("K_s 0.4, K_d 1 GPa: 1/K_s - 1/K_d", 1.5e-9, slow.delayed_compliance())]
    rows += check("containers.ViscoelasticHose", BY_HAND, cases, unit="1/Pa")
    stretched = containers.volume_at(slow, FLUID, ATMOSPHERE + 1e7, 0.015) / slow.reference_volume()
    rows += check(
        "containers.volume_at",
        FORM,
        [("settled, 10 MPa above atmosphere: exp(p/K_s)", float(np.exp(0.025)), stretched)],
    )
    vessel = containers.Vessel(2e-3, 5e8)
    mass = containers.capacity(vessel, Oil(1e9, 800.0), ATMOSPHERE)
    rows += check(
        "containers.capacity", BY_HAND, [("rho V (1/K + 1/K_c) at p0, 2 l, 1 and 0.5 GPa", 4.8e-9, mass)], unit="kg/Pa"
    )
    known = containers.Vessel.from_effective_modulus(1e-3, 151574.0, 2e5).container_modulus()
    return rows + check(
        "containers.Vessel", ARTICLE, [("hose from its effective modulus", "6.26e5", known)], unit="psi"
    )


TOPICS = {
    "Equations of the article": article_rows,
    "Walls of pipes": conduit_rows,
    "Thin walls, hoses, vessels": container_rows,
}
