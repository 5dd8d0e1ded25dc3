"""The control lines of the servo hydraulics of the DSN 70-metre antennas, and the drive of one axis.

Every number of Tables 1 and 2 and of eqs. (13)-(17) of the article stands here as printed, in both of its
systems of units. The inch-pound printing is primary: the article computed in it, and it agrees with itself
to five digits; the density and the path length, of which the metric printing is the finer one, are metric.
Reference: "Dynamic Modeling of Fluid Transmission Lines of the DSN 70-Meter Antennas by Using a Lumped
Parameter Model", The Telecommunications and Data Acquisition Progress Report, NASA Jet Propulsion Laboratory.
"""

from decimal import Decimal
from typing import NamedTuple

from jaxlines.physics.containers import Pipe, Vessel
from jaxlines.physics.fluids import Oil
from jaxlines.physics.lines import Line

INCH = 0.0254
PSI = 4.4482216152605 / INCH**2
FACTORS = {
    "in": INCH,
    "in^2/s": INCH**2,
    "in^3": INCH**3,
    "in/s": INCH,
    "psi": PSI,
    "lbf/in^5": PSI / INCH**3,
    "lbf*s^2/in^4": PSI / INCH**2,
    "s": 1.0,
    "1": 1.0,
}
"""SI value of each unit of the inch-pound printing."""


class Rounded(NamedTuple):
    """A number as it was printed, which stands for all numbers that round to it."""

    text: str
    unit: str

    @property
    def value(self) -> float:
        """The number, in its unit."""
        return float(self.text)

    def interval(self) -> tuple[float, float]:
        """The smallest and the largest number that round to it."""
        number = Decimal(self.text)
        half = Decimal(5).scaleb(int(number.as_tuple().exponent) - 1)
        return float(number - half), float(number + half)


class Printed(NamedTuple):
    """A number of the article in its two printings."""

    si: Rounded
    inch_pound: Rounded

    @property
    def value(self) -> float:
        """The inch-pound number in SI."""
        return self.inch_pound.value * FACTORS[self.inch_pound.unit]

    def interval(self) -> tuple[float, float]:
        """The inch-pound interval in SI."""
        low, high = self.inch_pound.interval()
        return low * FACTORS[self.inch_pound.unit], high * FACTORS[self.inch_pound.unit]


def _printed(si: str, si_unit: str, inch_pound: str, inch_pound_unit: str) -> Printed:
    return Printed(Rounded(si, si_unit), Rounded(inch_pound, inch_pound_unit))


VOLUMES = {
    "azimuth_1": _printed("0.02710", "m^3", "1653.6", "in^3"),
    "azimuth_2": _printed("0.02770", "m^3", "1690.4", "in^3"),
    "elevation_1": _printed("0.02455", "m^3", "1498.1", "in^3"),
    "elevation_2": _printed("0.02457", "m^3", "1499.6", "in^3"),
}
"""Table 1: total volume V_0 of each control line."""

EFFECTIVE_MODULI = {
    "azimuth_1": _printed("1.2888e9", "Pa", "1.8693e5", "psi"),
    "azimuth_2": _printed("1.2895e9", "Pa", "1.8703e5", "psi"),
    "elevation_1": _printed("1.2815e9", "Pa", "1.8587e5", "psi"),
    "elevation_2": _printed("1.2816e9", "Pa", "1.8588e5", "psi"),
}
"""Table 1: effective bulk modulus beta of each control line."""

LINE_CONSTANTS = {
    "azimuth_1": _printed("4.756e10", "N/m^5", "113.0", "lbf/in^5"),
    "azimuth_2": _printed("4.655e10", "N/m^5", "110.6", "lbf/in^5"),
    "elevation_1": _printed("5.220e10", "N/m^5", "124.1", "lbf/in^5"),
    "elevation_2": _printed("5.216e10", "N/m^5", "124.0", "lbf/in^5"),
}
"""Eqs. (13)-(16): K = beta/V_0 of each control line."""

PROPERTIES = {
    "fluid_bulk_modulus": _printed("1.379e9", "Pa", "2e5", "psi"),
    "fluid_density": _printed("850", "kg/m^3", "7.95e-5", "lbf*s^2/in^4"),
    "fluid_kinematic_viscosity": _printed("27.7", "m^2/s", "1.09e3", "in^2/s"),
    "inner_diameter_1_in_pipe": _printed("2.070e-2", "m", "0.815", "in"),
    "outer_diameter_1_in_pipe": _printed("3.340e-2", "m", "1.315", "in"),
    "inner_diameter_1.5_in_pipe": _printed("3.399e-2", "m", "1.338", "in"),
    "outer_diameter_1.5_in_pipe": _printed("4.826e-2", "m", "1.900", "in"),
    "inner_diameter_2_in_pipe": _printed("4.285e-2", "m", "1.687", "in"),
    "outer_diameter_2_in_pipe": _printed("6.032e-2", "m", "2.375", "in"),
    "pipe_youngs_modulus": _printed("2.0684e11", "Pa", "30e6", "psi"),
    "pipe_poissons_ratio": _printed("0.25", "1", "0.25", "1"),
    "volume_1.5_in_tee": _printed("2.147e-4", "m^3", "13.1", "in^3"),
    "volume_2_in_tee": _printed("4.015e-4", "m^3", "24.5", "in^3"),
    "volume_1_in_hose": _printed("8.495e-4", "m^3", "51.8", "in^3"),
    "hose_wall_modulus": _printed("4.32e9", "Pa", "6.26e5", "psi"),
}
"""Table 2. The viscosity is misprinted in both systems of units, see `KINEMATIC_VISCOSITY`."""

TEXT = {
    "path_length": _printed("20.83", "m", "820", "in"),
    "wave_speed": _printed("1.23e3", "m/s", "4.85e4", "in/s"),
    "viscous_drop_limit": _printed("6.9e4", "Pa", "10", "psi"),
    "round_trip_time": _printed("0.034", "s", "0.034", "s"),
    "command_period": _printed("0.05", "s", "0.05", "s"),
}
"""Section III and eq. (17): longest path, wave speed, viscous pressure drop, 2 L/c_0 and 1/f."""

KINEMATIC_VISCOSITY = 27.7e-6
"""[m^2/s] = 0.0429 in^2/s. Table 2 prints 27.7 m^2/s and 1090 in^2/s: the metric number is in mm^2/s (cSt), and the
inch number is 27.7 times 39.37, the factor of a length where that of an area was due."""

PATH_LENGTH = TEXT["path_length"].si.value
"""The largest distance between the servovalve and a hydraulic motor [m]."""

COMMAND_RATE = 20.0
"""Commands sent to the servovalve per second, which the article takes for the frequency f of eq. (11) [Hz]."""

OIL = Oil(
    bulk_modulus=PROPERTIES["fluid_bulk_modulus"].value,
    density=PROPERTIES["fluid_density"].si.value,
    kinematic_viscosity=KINEMATIC_VISCOSITY,
)
"""The oil of Table 2, free of air, of constant modulus."""


def pipe(size: str, length) -> Pipe:
    """A length [m] of the antennas' stainless steel pipe of nominal size "1", "1.5" or "2" (in, schedule 160)."""
    return Pipe(
        length=length,
        inner_diameter=PROPERTIES[f"inner_diameter_{size}_in_pipe"].value,
        outer_diameter=PROPERTIES[f"outer_diameter_{size}_in_pipe"].value,
        youngs_modulus=PROPERTIES["pipe_youngs_modulus"].value,
        poissons_ratio=PROPERTIES["pipe_poissons_ratio"].value,
    )


def tee(size: str) -> Vessel:
    """A tee of nominal size "1.5" or "2" (in), rigid: Table 2 gives it no wall."""
    return Vessel(volume=PROPERTIES[f"volume_{size}_in_tee"].value)


def hose() -> Vessel:
    """The hose of 1 in bore and 66 in length."""
    return Vessel(volume=PROPERTIES["volume_1_in_hose"].value, wall_modulus=PROPERTIES["hose_wall_modulus"].value)


def control_line(name: str, node: str) -> Line:
    """A control line of Table 1 ("azimuth_1", "azimuth_2", "elevation_1", "elevation_2") attached to a node.

    Its wall is what eq. (2) leaves of the effective modulus beside the oil's; the path is the longest of all lines.
    """
    volume, modulus = VOLUMES[name].value, EFFECTIVE_MODULI[name].value
    return Line.from_effective_modulus(node, volume, modulus, OIL.bulk_modulus, PATH_LENGTH)


class Composition(NamedTuple):
    """Volumes of hose, rigid parts (tees, fittings, ports) and 2-in pipe of a line [m^3]."""

    hose: float
    rigid: float
    pipe: float


RECONSTRUCTED_HOSES = 4
"""Hoses of a line in the reconstruction: one for each drive motor of an axis. Not in the article."""

RECONSTRUCTED_RIGID = {"azimuth_1": 319.6, "azimuth_2": 319.7, "elevation_1": 203.6, "elevation_2": 204.5}
"""Rigid volume of each line in the reconstruction [in^3]. Not in the article."""


def reconstruction(name: str) -> Composition:
    """A composition that gives the volume and the modulus of a line in Table 1: A RECONSTRUCTION, NOT FROM THE ARTICLE.

    The article shows the layout in figures only. Four hoses (66 in of 1 in bore), rigid parts and 2-in pipe
    are the simplest mixture that fits; the rigid volumes were chosen to meet the modulus, and other
    mixtures (five or six hoses, some 1.5-in pipe) fit as well.
    """
    whole, bore = VOLUMES[name].value, 3.141592653589793 / 4.0 * 66.0 * INCH**3
    hoses, rigid = RECONSTRUCTED_HOSES * bore, RECONSTRUCTED_RIGID[name] * INCH**3
    return Composition(hoses, rigid, whole - hoses - rigid)


def reconstructed_line(name: str, node: str) -> Line:
    """A control line from the parts of its `reconstruction`, which is not from the article."""
    volumes, two_inch = reconstruction(name), pipe("2", 1.0)
    length = volumes.pipe / two_inch.reference_volume()
    parts = (Vessel(volumes.hose, hose().wall_modulus), Vessel(volumes.rigid), pipe("2", length))
    return Line(node, parts, PATH_LENGTH)
