"""Rows of the verification: liquids, viscosity, free air and air that dissolves."""

import numpy as np
from verify_rows import APART, BY_HAND, CHART, FORM, THIRTY, Oracle, Row, along, check

from jaxlines.physics import air, liquids, solubility, viscosity
from jaxlines.physics.fields import ATMOSPHERE
from jaxlines.physics.fluids import Oil

PSI = 6894.757293168
GENERIC_OIL = Oracle(APART.kind, "parameters of the open library OpenHydraulics (GenericOil); computed apart")
LEE = Oracle(CHART, "The Lee Company, chart of bulk moduli, MIL-H-83282")

MEGAPASCALS = (0.101325, 0.2, 0.5, 1, 2, 5, 10, 20, 35)
PRESSURES = np.array(MEGAPASCALS) * 1e6
# Modulus slope, polytropic index, air fraction: modulus of the mixture [MPa], liquid 1.5 GPa
MODULI = {
    (0, 1.0, 0.001): "94.9196 312.4150 932.6073 1301.9546 1445.0444 1490.9277 1497.7216 1499.4298 1499.8138",
    (0, 1.0, 0.005): "19.9962 74.8349 370.2140 850.6702 1259.5756 1455.5407 1488.6321 1497.1419 1499.0657",
    (0, 1.0, 0.01): "10.0652 38.2822 210.4393 592.0540 1084.1409 1413.2385 1477.3241 1494.2661 1498.1232",
    (0, 1.0, 0.05): "2.0239 7.6618 45.9313 167.4790 500.9394 1136.7010 1388.9618 1470.6029 1490.2733",
    (0, 1.0, 0.10): "1.0126 3.7438 22.3688 84.7541 288.5767 896.0958 1283.5118 1439.2796 1479.6162",
    (0, 1.4, 0.005): "27.8469 85.6650 338.0694 732.4428 1136.8803 1406.6506 1470.3012 1490.8477 1496.4953",
    (0, 1.4, 0.01): "14.0539 44.0091 189.9346 483.1872 913.7208 1323.5051 1441.4837 1481.7177 1492.9723",
    (10, 1.0, 0.01): "10.0652 38.2829 210.5175 593.4482 1094.0219 1456.6356 1573.2397 1691.6287 1846.1297",
    (10, 1.4, 0.01): "14.0539 44.0099 189.9982 484.1146 920.7257 1361.4803 1532.6394 1675.5373 1838.2776",
}
RELATIVE_DENSITY = "1 1.00502399 1.00830500 1.00967236 1.01086243 1.01319710 1.01668408 1.02353699 1.03384637"
SHARE_OF_LIQUID = "0.39 0.72 0.942 0.985 0.996"  # K/K0 at 1, 2, 5, 10, 20 MPa with 1 % air, isothermal
# Gauge pressure [psi], factors of the chart for pressure, temperature and air, its modulus; K/K_l for n = 1 and 1.4
LEE_POINTS = {
    500: (0.91, 1.10, "0.80", "240000", "0.747", "0.600"),
    2000: (0.98, 0.86, "0.98", "248000", "0.982", "0.949"),
}
LEE_REFERENCE, LEE_AIR = 300e3 * PSI, 0.02

TAIT_PRESSURES = (0, 10, 20, 35)
TAIT_DENSITY = "856.80520 862.21813 867.31642 874.45518"
TAIT_MODULUS = "1534.127 1642.749 1750.650 1911.256"
DOWSON_PRESSURES = (10, 20, 100)
DOWSON_DENSITY, DOWSON_MODULUS = "1.00589971 1.01160542 1.05128205", "1733.985 1802.607 2398.5"
WALTHER_TEMPERATURES = (273.15, 293.15, 313.15, 333.15, 373.15)
WALTHER = "471.1904 115.7018 41.3428 19.0371 6.4829"

EQUILIBRIUM_PRESSURES = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 2.9, 3.1)
EQUILIBRIUM = "37.0146 204.2403 579.5946 879.1312 1073.3613 1195.6566 1261.2809 1500.0"
FROZEN_PRESSURES, FROZEN = (0.5, 1.0, 2.0), "238.6 728.7 1324.6"
POLYNOMIAL_PLACES = (0, 0.1, 0.25, 0.5, 0.75, 0.9, 1)
POLYNOMIAL = "1 0.99910908 0.9510726929 0.5 0.04892730713 0.00089092 0"
HENRY_AIR, HENRY = (0.001, 0.01, 0.05, 0.10), "1.011 1.112 1.585 2.235"


def oil(**changes) -> Oil:
    """A liquid of 1.5 GPa and 850 kg/m^3."""
    given: dict = {"bulk_modulus": 1.5e9, "density": 850.0}
    return Oil(**given | changes)


def liquid_rows() -> list[Row]:
    """Equations of state without air."""
    p, places = ATMOSPHERE + np.array([1e6, 2e7, 1e8]), (1, 20, 100)
    volume = "0.9993357664290 0.9875616889893 0.9502002165057"
    secant = 2e7 / (1.0 - liquids.murnaghan_volume(ATMOSPHERE + 2e7, 1.5e9, 10.0))
    rows = check(
        "liquids.murnaghan_volume",
        THIRTY,
        along("K0 1.5 GPa, m 10, {} MPa gauge", places, volume, liquids.murnaghan_volume(p, 1.5e9, 10.0)),
    )
    rows += check(
        "liquids.murnaghan_volume",
        THIRTY,
        [("secant modulus to 20 MPa gauge, m 10", "1607935352.55", secant)],
        unit="Pa",
    )
    special = ((0.0, float(np.exp(-1.0 / 75.0))), (1.0, 75.0 / 76.0))
    cases = [(f"m {m:g}, 20 MPa gauge", v, liquids.murnaghan_volume(ATMOSPHERE + 2e7, 1.5e9, m)) for m, v in special]
    rows += check("liquids.murnaghan_volume", FORM, cases)
    modulus = "1.51e9 1.7e9 2.5e9"
    cases = along("K0 1.5 GPa, m 10, {} MPa gauge", places, modulus, liquids.murnaghan_modulus(p, 1.5e9, 10.0))
    rows += check("liquids.murnaghan_modulus", BY_HAND, cases, unit="Pa", relative=1e-11)
    law = liquids.Murnaghan()
    product = law.volume(p, 1.5e9, 10.0) ** -10.0 * 1.5e9
    rows += check(
        "liquids.Murnaghan",
        FORM,
        along("K = K0 v^-m, {} MPa gauge", places, modulus, product),
        unit="Pa",
        relative=1e-11,
    )
    return rows + tait_rows() + dowson_rows()


def tait_rows() -> list[Row]:
    """Tait's equation at 293.15 K, by itself and as the law of an oil."""
    p, modulus = np.array(TAIT_PRESSURES) * 1e6, 8.4e9 * np.exp(-0.0058 * 293.15)
    density, case = 870.0 / (1.0 + 7.7e-4 * 20.0), "293.15 K, {} MPa"
    warm = Oil(
        bulk_modulus=8.4e9 * np.exp(-0.0058 * 273.15),
        density=870.0,
        modulus_slope=10.9,
        liquid=liquids.Tait(reference_pressure=0.0),
        temperature=293.15,
        reference_temperature=273.15,
        thermal_expansion=7.7e-4,
        modulus_temperature_coefficient=0.0058,
    )
    ours = {
        "liquids.tait_volume": (density / liquids.tait_volume(p, modulus, 10.9), TAIT_DENSITY, "kg/m^3"),
        "liquids.tait_modulus": (liquids.tait_modulus(p, modulus, 10.9) / 1e6, TAIT_MODULUS, "MPa"),
        "liquids.Tait.volume": (warm.density_at(p), TAIT_DENSITY, "kg/m^3"),
        "liquids.Tait.modulus": (warm.mixture_modulus(p) / 1e6, TAIT_MODULUS, "MPa"),
    }
    rows = []
    for formula, (values, printed, unit) in ours.items():
        rows += check(formula, GENERIC_OIL, along(case, TAIT_PRESSURES, printed, values), unit=unit)
    return rows


def dowson_rows() -> list[Row]:
    """Dowson and Higginson's equation, by itself and as the law of an oil."""
    p, case = ATMOSPHERE + np.array(DOWSON_PRESSURES) * 1e6, "{} MPa gauge"
    a, b = 0.6e-9, 1.7e-9
    fluid = oil(bulk_modulus=1.0 / a, modulus_slope=1.0 + 2.0 * b / a, liquid=liquids.DowsonHigginson())
    start = [("at p0", "1.6667", liquids.dowson_higginson_modulus(ATMOSPHERE, a, b) / 1e9)]
    rows = check("liquids.dowson_higginson_modulus", APART, start, unit="GPa")
    ours = {
        "liquids.dowson_higginson_volume": (1.0 / liquids.dowson_higginson_volume(p, a, b), DOWSON_DENSITY, ""),
        "liquids.dowson_higginson_modulus": (liquids.dowson_higginson_modulus(p, a, b) / 1e6, DOWSON_MODULUS, "MPa"),
        "liquids.DowsonHigginson.volume": (fluid.density_at(p) / 850.0, DOWSON_DENSITY, ""),
        "liquids.DowsonHigginson.modulus": (fluid.mixture_modulus(p) / 1e6, DOWSON_MODULUS, "MPa"),
    }
    for formula, (values, printed, unit) in ours.items():
        rows += check(formula, APART, along(case, DOWSON_PRESSURES, printed, values), unit=unit)
    found = liquids.dowson_higginson_parameters(1.0 / a, 1.0 + 2.0 * b / a)
    cases = [("a from modulus and slope", a, found[0]), ("b from modulus and slope", b, found[1])]
    return rows + check("liquids.dowson_higginson_parameters", FORM, cases, unit="1/Pa")


def viscosity_rows() -> list[Row]:
    """Viscosity over temperature and pressure."""
    t, case, source = np.array(WALTHER_TEMPERATURES), "A 9.32, B 3.65, {} K", GENERIC_OIL
    law = viscosity.Walther.from_two_viscosities(313.15, 41.3428e-6, 373.15, 6.4829e-6)
    rows = check(
        "viscosity.walther_viscosity",
        source,
        along(case, WALTHER_TEMPERATURES, WALTHER, viscosity.walther_viscosity(t, 9.32, 3.65) * 1e6),
        unit="mm^2/s",
    )
    A, B = viscosity.walther_parameters(313.15, 41.3428e-6, 373.15, 6.4829e-6)
    cases = [("A from two printed viscosities", "9.32", A), ("B from two printed viscosities", "3.65", B)]
    rows += check("viscosity.walther_parameters", source, cases, relative=3e-5)
    cases = along(
        "through 40 and 100 C, {} K", WALTHER_TEMPERATURES, WALTHER, law.kinematic(t, 41.3428e-6, 313.15) * 1e6
    )
    rows += check("viscosity.Walther", source, cases, unit="mm^2/s", relative=2e-5)
    vogel = viscosity.vogel_viscosity(333.15, 5e-5, 810.0, 178.0)
    case = "a 5e-5 Pa s, b 810 K, c 178 K, 333.15 K"
    rows += check("viscosity.vogel_viscosity", THIRTY, [(case, "0.00925368485936", vogel)], unit="Pa s")
    ours = viscosity.Vogel(810.0, 178.0).kinematic(333.15, 46e-6, 313.15)
    ratio = float(46e-6 * np.exp(810.0 / 155.15 - 810.0 / 135.15))
    rows += check("viscosity.Vogel", FORM, [("46 mm^2/s at 313.15 K, at 333.15 K", ratio, ours)], unit="m^2/s")
    barus = viscosity.barus_factor(ATMOSPHERE + 20e6, 2e-8)
    rows += check("viscosity.barus_factor", APART, [("20 MPa gauge at 2e-8 1/Pa", "1.49", barus)])
    rows += check("viscosity.barus_factor", THIRTY, [("20 MPa gauge at 2e-8 1/Pa", "1.49182469764", barus)])
    same = viscosity.ConstantViscosity().kinematic(400.0, 46e-6, 313.15)
    rows += check("viscosity.ConstantViscosity", FORM, [("400 K", 46e-6, same)], unit="m^2/s")
    thick = oil(density=870.0, kinematic_viscosity=41.3428e-6, viscosity_pressure_coefficient=2e-8)
    expected = float(870.0 * 41.3428e-6 * np.exp(0.4))
    cases = [("Barus, 20 MPa gauge", expected, thick.dynamic_viscosity(ATMOSPHERE + 20e6))]
    return rows + check("fluids.Oil.dynamic_viscosity", FORM, cases, unit="Pa s")


def free_air_rows() -> list[Row]:
    """Oil with air that is compressed only."""
    rows = []
    for (slope, index, fraction), printed in MODULI.items():
        fluid = oil(modulus_slope=slope, polytropic_index=index, air_fraction=fraction)
        case = f"m {slope}, n {index:g}, air {fraction:g}, {{}} MPa"
        cases = along(case, MEGAPASCALS, printed, fluid.mixture_modulus(PRESSURES) / 1e6)
        rows += check("fluids.Oil.mixture_modulus", APART, cases, unit="MPa")
    fluid = oil(polytropic_index=1.0, air_fraction=0.01)
    share = fluid.mixture_modulus(np.array([1, 2, 5, 10, 20]) * 1e6) / 1.5e9
    cases = along("K/K0, n 1, air 0.01, {} MPa", (1, 2, 5, 10, 20), SHARE_OF_LIQUID, share)
    rows += check("fluids.Oil.mixture_modulus", APART, cases)
    ratio = fluid.density_at(PRESSURES) / fluid.density_at(ATMOSPHERE)
    cases = along("rho/rho(p0), m 0, n 1, air 0.01, {} MPa", MEGAPASCALS, RELATIVE_DENSITY, ratio)
    rows += check("fluids.Oil.density_at", APART, cases)
    warm = oil(temperature=330.0, thermal_expansion=7e-4, modulus_temperature_coefficient=0.0058)
    cases = [("330 K, 0.0058 1/K from 313.15 K", float(1.5e9 * np.exp(-0.0058 * 16.85)), warm.liquid_modulus(1e7))]
    rows += check("fluids.Oil.liquid_modulus", FORM, cases, unit="Pa")
    cases = [("330 K, 7e-4 1/K from 313.15 K", 850.0 / (1.0 + 7e-4 * 16.85), warm.liquid_density(ATMOSPHERE))]
    rows += check("fluids.Oil.liquid_density", FORM, cases, unit="kg/m^3")
    cases = [("n 1.4, twice p0", float(0.5 ** (1 / 1.4)), air.gas_volume(2 * ATMOSPHERE, 1.4))]
    cases += [("n 1, vapour 2339 Pa, at 2349 Pa", 9898.6, air.gas_volume(2349.0, 1.0, 2339.0))]
    rows += check("air.gas_volume", FORM, cases)
    cases = [("n 1.4, 0.2 MPa", 2.8e5, air.gas_modulus(2e5, 1.4))]
    cases += [("n 1, vapour 2339 Pa, at 2349 Pa", 10.0, air.gas_modulus(2349.0, 1.0, 2339.0))]
    rows += check("air.gas_modulus", FORM, cases, unit="Pa")
    wet = oil(air_fraction=0.01, polytropic_index=1.0, vapour_pressure=2339.0, air=air.FreeAir(vapour="in_bubbles"))
    bubbles = wet.specific_volume(2349.0) - np.exp((ATMOSPHERE - 2349.0) / 1.5e9)
    cases = [("bubbles, air 0.01, vapour 2339 Pa, at 2349 Pa", 9898.6 / 99.0, bubbles)]
    return rows + check("air.FreeAir", FORM, cases) + lee_rows()


def lee_rows() -> list[Row]:
    """Two points of a chart with 2 % air, which is isothermal."""
    published, shares = [], []
    for gauge, (by_pressure, by_temperature, by_air, modulus, *known) in LEE_POINTS.items():
        p, liquid = ATMOSPHERE + gauge * PSI, LEE_REFERENCE * by_pressure * by_temperature
        found = {
            n: oil(bulk_modulus=liquid, air_fraction=LEE_AIR, polytropic_index=n).mixture_modulus(p) for n in (1.0, 1.4)
        }
        published += [(f"modulus [psi], {gauge} psi gauge, 2 % air, n 1", modulus, found[1.0] / PSI)]
        published += [(f"factor for air, {gauge} psi gauge, 2 % air, n 1", by_air, found[1.0] / liquid)]
        shares += [
            (f"K/K_l, {gauge} psi gauge, 2 % air, n {n:g}", k, found[n] / liquid)
            for n, k in zip(found, known, strict=True)
        ]
    rows = check("fluids.Oil.mixture_modulus", LEE, published, relative=0.1)
    return rows + check("fluids.Oil.mixture_modulus", APART, shares, absolute=1e-3)


def dissolving_air_rows() -> list[Row]:
    """Air that dissolves: at equilibrium, frozen, with rates."""
    linear = solubility.LinearSolubility(3e6)

    def modulus(law, pressures):
        fluid = oil(air_fraction=0.01, polytropic_index=1.0, air=law)
        return fluid.mixture_modulus(np.array(pressures) * 1e6) / 1e6

    case = "modulus, linear to 3 MPa, air 0.01, n 1, {}, {{}} MPa"
    ours = modulus(air.DissolvingAir(linear), EQUILIBRIUM_PRESSURES)
    cases = along(case.format("equilibrium"), EQUILIBRIUM_PRESSURES, EQUILIBRIUM, ours)
    rows = check("air.DissolvingAir", APART, cases, unit="MPa")
    for formula, law in {
        "air.DissolvingAir": air.DissolvingAir(linear, "frozen"),
        "air.KineticAir": air.KineticAir(linear),
    }.items():
        cases = along(case.format("frozen"), FROZEN_PRESSURES, FROZEN, modulus(law, FROZEN_PRESSURES))
        rows += check(formula, APART, cases, unit="MPa")
    kinetic = oil(air=air.KineticAir(linear, release_time=0.5, absorption_time=40.0))
    cases = [("release, theta 0.4 at 0.1 MPa, 0.5 s", 1.2, kinetic.undissolved_rate(1e5, 0.4))]
    cases += [("absorption, theta 0.4 at 5 MPa, 40 s", -0.01, kinetic.undissolved_rate(5e6, 0.4))]
    rows += check("air.KineticAir", FORM, cases, unit="1/s")
    return rows + solubility_rows(linear)


def solubility_rows(linear: solubility.LinearSolubility) -> list[Row]:
    """The undissolved fraction at equilibrium, by every law."""
    place = 500.0 + np.array(POLYNOMIAL_PLACES) * (3e6 - 500.0)
    cases = along("x {}", POLYNOMIAL_PLACES, POLYNOMIAL, solubility.polynomial_undissolved(place, 3e6, 500.0))
    rows = check("solubility.polynomial_undissolved", APART, cases, absolute=5.1e-9)
    bell = solubility.PolynomialSolubility(3e6, 500.0).dissolving(0.5 * (3e6 + 500.0), 0.01)
    cases = [("-d theta/dp in the middle: 630/4^4 of 1/(p_sat - p_vh)", 630.0 / 256.0 / (3e6 - 500.0), bell)]
    rows += check("solubility.PolynomialSolubility", FORM, cases, unit="1/Pa")
    middle = 0.5 * (ATMOSPHERE + 3e6)
    places = [("at p0", 1.0, ATMOSPHERE), ("half way to 3 MPa", 0.5, middle), ("at 3 MPa", 0.0, 3e6)]
    cases = [(name, theta, solubility.linear_undissolved(p, 3e6)) for name, theta, p in places]
    rows += check("solubility.linear_undissolved", FORM, cases)
    slope = linear.dissolving(middle, 0.01)
    rows += check("solubility.LinearSolubility", FORM, [("-d theta/dp", 1 / (3e6 - ATMOSPHERE), slope)], unit="1/Pa")
    content = np.array(HENRY_AIR)
    ratio = solubility.henry_saturation_pressure(content / (1.0 - content), 0.09) / ATMOSPHERE
    rows += check(
        "solubility.henry_saturation_pressure", APART, along("p_c/p0, a_B 0.09, air {}", HENRY_AIR, HENRY, ratio)
    )
    law = solubility.HenrySolubility(0.09)
    cases = [("theta at p0 is R/(R + a_B), R 0.01", 0.1, law.undissolved(ATMOSPHERE, 0.01))]
    return rows + check("solubility.HenrySolubility", FORM, cases)


TOPICS = {
    "Liquids without air": liquid_rows,
    "Viscosity": viscosity_rows,
    "Oil with free air": free_air_rows,
    "Air that dissolves": dissolving_air_rows,
}
