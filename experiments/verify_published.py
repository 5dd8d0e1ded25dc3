"""Rows of the verification: bulk moduli of other programs and papers, and where these differ from the reference law."""

from typing import NamedTuple

import numpy as np
from verify_fluids import MEGAPASCALS, MODULI, PRESSURES, PSI, RELATIVE_DENSITY, oil
from verify_rows import APART, BY_HAND, FORM, THIRTY, Oracle, Row, along, check

from jaxlines.physics import published_moduli as published
from jaxlines.physics.air import LegacySimscapeAir
from jaxlines.physics.article import series_modulus
from jaxlines.physics.fields import ATMOSPHERE

MATHWORKS = Oracle(APART.kind, "MathWorks documentation, block Hydraulic Fluid; the printed formula computed apart")
TEXTBOOK = Oracle(APART.kind, "textbook example (Merritt's eq. 2-13), computed apart")

PER_LIQUID = 0.005 / 1.005  # alpha of the mixture, where air per liquid is 0.005
SIMHYDRAULICS = "27.9836 86.0749 339.4514 734.5441 1138.6044 1407.3725 1470.6373 1491.0124 1496.5928"
YU = "27.8469 85.8260 339.0320 734.1790 1138.4414 1407.3456 1470.6318 1491.0114 1496.5925"
GAUGE = (0, 0.1, 0.5, 1, 5, 10, 20)
MATHWORKS_LAW = "2.79381e7 8.65577e7 4.19038e8 7.61107e8 1.302871e9 1.354585e9 1.371479e9"
TABLES = {
    "published_moduli.simhydraulics_modulus": ("SimHydraulics", PER_LIQUID, 1.4, SIMHYDRAULICS),
    "published_moduli.maplesim_modulus": ("MapleSim", PER_LIQUID, 1.4, SIMHYDRAULICS),
    "published_moduli.yu_modulus": ("Yu 1994 (c1 = 0)", PER_LIQUID, 1.4, YU),
    "published_moduli.cho_modulus": ("Cho 2002", 0.01, 1.4, MODULI[0, 1.4, 0.01]),
    "published_moduli.yudell_modulus": ("Yudell 2017", 0.01, 1.4, MODULI[0, 1.4, 0.01]),
    "published_moduli.wood_modulus": ("Wood", 0.01, 1.4, MODULI[0, 1.4, 0.01]),
    "published_moduli.simscape_isothermal_liquid_modulus": (
        *("Simscape isothermal liquid", 0.01, 1.4),
        MODULI[0, 1.4, 0.01],
    ),
    "published_moduli.wylie_modulus": ("Wylie 1984 (isothermal)", 0.01, 1.0, MODULI[0, 1.0, 0.01]),
}


def published_rows() -> list[Row]:
    """Each published modulus against its own table."""
    rows, case = [], "air {:.5g}, n {:g}, {{}} MPa"
    for formula, (name, fraction, index, printed) in TABLES.items():
        ours = published.PUBLISHED[name](PRESSURES, 1.5e9, fraction, index) / 1e6
        rows += check(formula, APART, along(case.format(fraction, index), MEGAPASCALS, printed, ours), unit="MPa")
    legacy = oil(air_fraction=PER_LIQUID, polytropic_index=1.4, air=LegacySimscapeAir(), mass="article")
    cases = along(case.format(PER_LIQUID, 1.4), MEGAPASCALS, SIMHYDRAULICS, legacy.mixture_modulus(PRESSURES) / 1e6)
    rows += check("air.LegacySimscapeAir", APART, cases, unit="MPa")
    p = ATMOSPHERE + np.array(GAUGE) * 1e6
    ours = published.simhydraulics_modulus(p, 1.379e9, PER_LIQUID, 1.4)
    cases = along("E_l 1.379 GPa, air per liquid 0.005, n 1.4, {} MPa gauge", GAUGE, MATHWORKS_LAW, ours)
    rows += check("published_moduli.simhydraulics_modulus", MATHWORKS, cases, unit="Pa")
    densities = (850.0, 1.225)
    density = published.simscape_isothermal_liquid_density(PRESSURES, 1.5e9, 0.01, 1.0, densities)
    cases = along("rho/rho(p0), air 0.01, n 1, {} MPa", MEGAPASCALS, RELATIVE_DENSITY, density / density[0])
    rows += check("published_moduli.simscape_isothermal_liquid_density", APART, cases)
    cases = [("rho(p0), air 0.01: 0.99 rho_l0 + 0.01 rho_g0", 0.99 * 850.0 + 0.01 * 1.225, density[0])]
    rows += check("published_moduli.simscape_isothermal_liquid_density", FORM, cases, unit="kg/m^3")
    return rows + mixing_rows()


def mixing_rows() -> list[Row]:
    """The laws of mixing behind them, and the variants without a table."""
    rows = []
    for gas, bubbles, expected in (("isothermal", 500.0, "41096"), ("adiabatic", 700.0, "53708")):
        fluid = published.merritt_series_modulus(250e3 * PSI, bubbles * PSI, 0.01)
        ours = series_modulus(30e6 * PSI / 10.0, fluid) / PSI
        case = f"D/t 10, steel, 1 % bubbles at the pressure, {gas}"
        rows += check("published_moduli.merritt_series_modulus", TEXTBOOK, [(case, expected, ours)], unit="psi")
    place = (1e6, 1.5e9, 0.01, 1.4)
    case = "K_l 1.5 GPa, air 0.01, n 1.4, 1 MPa"
    cases = [(case, "0.00196592952933281", published.gas_fraction_at(*place))]
    rows += check("published_moduli.gas_fraction_at", THIRTY, cases)
    cases = [("at p0 the air fraction", 0.01, published.gas_fraction_at(ATMOSPHERE, *place[1:]))]
    rows += check("published_moduli.gas_fraction_at", FORM, cases)
    rows += check(
        "published_moduli.merritt_modulus",
        THIRTY,
        [(case, "482881362.0275", published.merritt_modulus(*place))],
        unit="Pa",
    )
    reuss = published.reuss_modulus(1.5e9, 1.4e6, 0.00196592952933281)
    rows += check("published_moduli.reuss_modulus", THIRTY, [(case, "483187158.5299", reuss)], unit="Pa")
    rows += check(
        "published_moduli.reuss_modulus",
        BY_HAND,
        [("1 and 3 GPa, half each", 1.5e9, published.reuss_modulus(1e9, 3e9, 0.5))],
        unit="Pa",
    )
    simplified = published.simplified_isothermal_modulus(1e6, 1.5e9, 0.01)
    case = "K_l 1.5 GPa, air 0.01, 1 MPa"
    return rows + check(
        "published_moduli.simplified_isothermal_modulus", THIRTY, [(case, "591662931.4209", simplified)], unit="Pa"
    )


class Difference(NamedTuple):
    """A published modulus over the reference law, less 1, at several pressures with one air content and index."""

    name: str
    polytropic_index: float
    air_fraction: float
    differences: tuple[float, ...]


COMPARED_PRESSURES = (0.101325, 0.2, 0.5, 1.0, 2.0, 5.0, 20.0)
COMPARED_AIR = (0.001, 0.01, 0.05)
COMPARED_INDICES = (1.4, 1.0)
EQUAL = 1e-11
"""Differences below are rounding."""
REASONS = {
    "Cho 2002": "it is the reference law",
    "Yudell 2017": "the reference law, rearranged",
    "Wood": "the reference law, written with the gas fraction at the pressure",
    "Simscape isothermal liquid": "the reference law, written as a density",
    "Merritt 1967": "counts the liquid as if it filled the whole volume",
    "Wylie 1984 (isothermal)": "the reference law with index 1, whatever index is given",
    "SimHydraulics": "holds the volume of the liquid at that at p0",
    "MapleSim": "equal to SimHydraulics",
    "Yu 1994 (c1 = 0)": "of first order in the air, and holds the volume of the liquid at that at p0",
    "novaTehnika (simplified isothermal)": "index 1, and neglects the volume of the gas",
}


def differences() -> list[Difference]:
    """Every published modulus against that of `fluids.Oil` with free air and a constant modulus of 1.5 GPa."""
    p, found = np.array(COMPARED_PRESSURES) * 1e6, []
    for index in COMPARED_INDICES:
        for name, modulus in published.PUBLISHED.items():
            for fraction in COMPARED_AIR:
                reference = oil(air_fraction=fraction, polytropic_index=index).mixture_modulus(p)
                found.append(
                    Difference(name, index, fraction, tuple(modulus(p, 1.5e9, fraction, index) / reference - 1.0))
                )
    return found


TOPICS = {"Bulk moduli of other programs and papers": published_rows}
