"""Named hydraulic fluids, and for every number how sure it is.

    from jaxlines.catalogue.oils import OILS
    oil = dataclasses.replace(OILS["HLP 46"].oil, air_fraction=0.01, temperature=333.15)
    print(OILS["HLP 46"].sources["bulk_modulus"])

Most of these numbers are typical ones QUOTED FROM MEMORY of handbooks and data sheets; `sources` says so for
each. They are starting points for a fit, not data of a product. Air is 0: it depends on the machine.
"""

from typing import NamedTuple

from jaxlines.catalogue import dsn70m
from jaxlines.physics.fluids import Oil
from jaxlines.physics.viscosity import Vogel, Walther

PSI = 6894.757293168
"""Pound-force per square inch [Pa]."""


class NamedOil(NamedTuple):
    """A fluid, and where each of its numbers comes from.

    Args: oil: free of air, at its reference temperature; sources: field of `Oil` -> text. Numbers of fields
        that are not listed are the defaults of `Oil`, which are nothing particular to this fluid.
    """

    oil: Oil
    sources: dict[str, str]


_MEMORY = "unverified: typical value, quoted from memory"
_LEE = "The Lee Company, engineering data on bulk modulus"
_HAYWARD = (
    "isentropic tangent modulus by Hayward's estimate for mineral oils, (1.57 + 0.15 lg(nu at 20 C in mm^2/s)) 1e9 Pa "
    "at 20 C, times 10^(-0.0024 (t - 20)), +-5 % (unverified: the estimate is quoted from memory)"
)
_FAHRENHEIT = 1.8
_LEE_PRESSURE_FACTOR = 0.91 - 500.0 * (0.98 - 0.91) / 1500.0
"""Lee's chart has factors 0.91 at 500 psi and 0.98 at 2000 psi; the line through them at 0."""


def _mineral(density: float, viscosity: float, viscosity_100: float, bulk_modulus: float) -> NamedOil:
    """A mineral oil of quality HLP (DIN 51524-2) at 40 C; viscosities at 40 C and 100 C [m^2/s]."""
    oil = Oil(
        bulk_modulus=bulk_modulus,
        density=density,
        kinematic_viscosity=viscosity,
        modulus_slope=10.2,
        vapour_pressure=10.0,
        viscosity=Walther.from_two_viscosities(313.15, viscosity, 373.15, viscosity_100),
        thermal_expansion=7e-4,
        modulus_temperature_coefficient=0.0055,
        viscosity_pressure_coefficient=2e-8,
    )
    sources = {
        "bulk_modulus": _HAYWARD,
        "modulus_slope": "twice Hayward's slope of the secant modulus, 5.6, less 1 (unverified: quoted from memory)",
        "modulus_temperature_coefficient": "0.0024 ln 10, from Hayward's estimate (unverified: quoted from memory)",
        "density": f"{_MEMORY}; some 875 kg/m^3 at 15 C",
        "kinematic_viscosity": "by definition of the ISO viscosity grade (ISO 3448), +-10 %",
        "viscosity": f"{viscosity_100 * 1e6:g} mm^2/s at 100 C, viscosity index about 100; {_MEMORY}",
        "vapour_pressure": f"{_MEMORY}; 1..100 Pa",
        "thermal_expansion": _MEMORY,
        "viscosity_pressure_coefficient": _MEMORY,
    }
    return NamedOil(oil, sources)


def _military(reference_psi: float, density: float, viscosities: tuple[float, float], about: dict) -> NamedOil:
    """A military fluid at 40 C: Lee's reference modulus [psi]; viscosities at 40 C and 100 C [m^2/s]."""
    oil = Oil(
        bulk_modulus=reference_psi * PSI * _LEE_PRESSURE_FACTOR * 0.99,
        density=density,
        kinematic_viscosity=viscosities[0],
        modulus_slope=reference_psi * (0.98 - 0.91) / 1500.0,
        vapour_pressure=100.0,
        viscosity=Walther.from_two_viscosities(313.15, viscosities[0], 373.15, viscosities[1]),
        thermal_expansion=0.00046 * _FAHRENHEIT,
        modulus_temperature_coefficient=0.0044,
        viscosity_pressure_coefficient=1.5e-8,
    )
    sources = {
        "bulk_modulus": f"{_LEE}: {reference_psi:,.0f} psi, times the chart's factor for pressure continued to 0 "
        "(0.887) and 0.99 from 100 F to 40 C; two digits. Isothermal or isentropic is not said",
        "modulus_slope": f"{_LEE}: factors for pressure 0.91 at 500 psi, 0.98 at 2000 psi; one digit",
        "modulus_temperature_coefficient": f"{_LEE}: factors for temperature 1.10 at 60 F, 0.86 at 160 F",
        "thermal_expansion": f"{_LEE}: 0.00046 1/F",
        "vapour_pressure": f"{_MEMORY}; of the order",
        "viscosity_pressure_coefficient": _MEMORY,
    }
    return NamedOil(oil, sources | about)


def _mil_prf_5606() -> NamedOil:
    about = {
        "bulk_modulus": f"{_LEE}: 260,000 psi, times the chart's factor for pressure continued to 0 (0.887) and 0.99 "
        "from 100 F to 40 C, which were read for MIL-H-83282 and are assumed to hold here too",
        "modulus_slope": f"{_LEE}: factors read for MIL-H-83282, assumed to hold here too; one digit",
        "modulus_temperature_coefficient": f"{_LEE}: factors read for MIL-H-83282, assumed to hold here too",
        "density": f"{_MEMORY}; 0.85..0.86 g/cm^3 at 15 C",
        "kinematic_viscosity": f"{_MEMORY}; 13..14 mm^2/s at 40 C",
        "viscosity": f"5.1 mm^2/s at 100 C; {_MEMORY}",
    }
    return _military(260_000.0, 840.0, (13.5e-6, 5.1e-6), about)


def _mil_prf_83282() -> NamedOil:
    about = {
        "density": f"{_LEE}: specific gravity 0.82 at 120 F, carried to 40 C with the thermal expansion",
        "kinematic_viscosity": "the specification's least value, 14.0 mm^2/s at 40 C (unverified: quoted from memory)",
        "viscosity": "the specification's least value, 3.45 mm^2/s at 100 C (unverified: quoted from memory)",
    }
    return _military(300_000.0, 825.0, (14.0e-6, 3.45e-6), about)


def _water() -> NamedOil:
    oil = Oil(
        bulk_modulus=2.1791e9,
        density=998.21,
        kinematic_viscosity=1.0034e-6,
        modulus_slope=6.0,
        vapour_pressure=2339.0,
        viscosity=Vogel(b=570.6, c=140.0),
        temperature=293.15,
        reference_temperature=293.15,
        thermal_expansion=2.07e-4,
    )
    simscape = "default of Simscape's isothermal liquid, water"
    sources = {
        "bulk_modulus": f"{simscape}. Its change with temperature is left out: small, and not of one sign",
        "density": simscape,
        "kinematic_viscosity": simscape,
        "modulus_slope": simscape,
        "vapour_pressure": "at 20 C (unverified: quoted from memory)",
        "viscosity": "mu = 2.414e-5 * 10^(247.8/(T - 140)) Pa s, taken for nu too (unverified: quoted from memory)",
        "temperature": "20 C, where the other numbers hold",
        "reference_temperature": "20 C, where the other numbers hold",
        "thermal_expansion": "at 20 C, it grows to 3.9e-4 1/K at 40 C (unverified: quoted from memory)",
    }
    return NamedOil(oil, sources)


def _water_glycol() -> NamedOil:
    oil = Oil(
        bulk_modulus=3.4e9,
        density=1080.0,
        kinematic_viscosity=46e-6,
        modulus_slope=6.0,
        vapour_pressure=5e3,
        thermal_expansion=6e-4,
        viscosity_pressure_coefficient=0.4e-8,
    )
    fields = ("bulk_modulus", "density", "modulus_slope", "vapour_pressure", "thermal_expansion")
    sources = {field: f"{_MEMORY}; products differ by 10 % and more" for field in fields}
    sources |= {
        "kinematic_viscosity": "by definition of the ISO viscosity grade 46 (ISO 3448), +-10 %",
        "viscosity_pressure_coefficient": f"{_MEMORY}; of the order",
    }
    return NamedOil(oil, sources)


def _antennas() -> NamedOil:
    table = "Table 2 of the article on the fluid lines of the DSN 70-metre antennas"
    sources = {
        "bulk_modulus": f"{table}: 2.0e5 psi; constant, temperature not stated",
        "density": f"{table}; temperature not stated",
        "kinematic_viscosity": f"{table}, 27.7, of which the printed unit m^2/s is taken for mm^2/s",
    }
    return NamedOil(dsn70m.OIL, sources)


OILS: dict[str, NamedOil] = {
    "DSN 70-m antennas": _antennas(),
    "HLP 32": _mineral(856.0, 32e-6, 5.4e-6, 1.67e9),
    "HLP 46": _mineral(860.0, 46e-6, 6.8e-6, 1.69e9),
    "MIL-PRF-5606": _mil_prf_5606(),
    "MIL-PRF-83282": _mil_prf_83282(),
    "water": _water(),
    "water-glycol": _water_glycol(),
}
"""Name -> fluid with the sources of its numbers."""
