"""The hydraulic drive of one axis of a DSN 70-metre antenna as a circuit, around its two control lines.

The lines and the oil are the article's. It gives no numbers for valve, motors, brake, supercharge and shaft:
those in `ASSUMED` are typical ones of the right order, assumed, not in the article. Node names are the
pressures of its glossary: P_S supply, P_R return, P_SC supercharge, P_B brake, P_D case drain.
"""

from jaxlines.catalogue.dsn70m import OIL, control_line
from jaxlines.physics.fluids import Oil
from jaxlines.physics.motors import Brake, Inertia, LoadTorque, Motor, Supercharge
from jaxlines.physics.servovalve import Servovalve
from jaxlines.physics.sources import PressureSource, Tank
from jaxlines.simulation.circuit import Circuit

AXES = ("azimuth", "elevation")

ASSUMED = {
    "supply.pressure": 20.7e6,
    "return_line.pressure": 0.35e6,
    "supercharge.pressure": 1.0e6,
    "brake_release.pressure": 4.0e6,
    "servovalve.rated_flow": 1.0e-3,
    "servovalve.rated_pressure_drop": 7.0e6,
    "servovalve.natural_frequency": 250.0,
    "servovalve.damping_ratio": 0.7,
    "motor.displacement": 1.0e-4,
    "motor.internal_leakage": 5.0e-12,
    "motor.external_leakage": 2.0e-12,
    "motor.viscous_friction": 2.0,
    "motor.coulomb_friction": 5.0,
    "inertia.moment_of_inertia": 40.0,
    "brake.holding_torque": 500.0,
}
"""Assumed, not in the article: typical values in SI by path. The four drive motors of an axis are one motor here."""

START = {"A.pressure": 10e6, "B.pressure": 10e6}
"""Pressures of the control lines from which to start: about half the supply on both sides [Pa]."""


def axis_drive(axis: str, fluid: Oil = OIL) -> Circuit:
    """The drive of the "azimuth" or the "elevation" axis, with the external input "spool" (-1..1).

    Supply and return, servovalve with a spool of second order, control lines no. 1 (node A) and no. 2 (node B),
    motor with internal leakage and case drain, supercharge of both lines, brake, inertia and load torque.

    Args: axis; fluid: the article's oil unless another is given, such as one with air.
    Raises: ValueError for another axis.
    """
    if axis not in AXES:
        raise ValueError(f'axis must be "azimuth" or "elevation", got {axis!r}')
    given = {part: {} for part in (path.split(".")[0] for path in ASSUMED)}
    for path, value in ASSUMED.items():
        part, field = path.split(".")
        given[part][field] = value
    components = {
        "supply": PressureSource("P_S", **given["supply"]),
        "return_line": Tank("P_R", **given["return_line"]),
        "supercharge": PressureSource("P_SC", **given["supercharge"]),
        "brake_release": PressureSource("P_B", **given["brake_release"]),
        "drain": Tank("P_D"),
        "servovalve": Servovalve("P_S", "P_R", "A", "B", command="spool", **given["servovalve"]),
        "control_1": control_line(f"{axis}_1", "A"),
        "control_2": control_line(f"{axis}_2", "B"),
        "check_1": Supercharge("P_SC", "A"),
        "check_2": Supercharge("P_SC", "B"),
        "motor": Motor("A", "B", "P_D", "shaft", **given["motor"]),
        "brake": Brake("shaft", "P_B", **given["brake"]),
        "inertia": Inertia("shaft", **given["inertia"]),
        "load": LoadTorque("shaft", torque=0.0),
    }
    return Circuit(fluid, components)
