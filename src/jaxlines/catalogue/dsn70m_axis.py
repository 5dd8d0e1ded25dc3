"""A whole axis of a DSN 70-metre antenna: servovalve, both control lines, four motors, gears, antenna, rate loop.

The lines, the oil and the 20 commands a second are the article's. Everything else in `ASSUMED` is of the right order
for such a drive and assumed, not in the article.
"""

from typing import Any

import numpy as np

from jaxlines.catalogue.dsn70m import COMMAND_RATE, OIL, PATH_LENGTH, VOLUMES, control_line
from jaxlines.catalogue.dsn70m_drive import AXES
from jaxlines.physics.containers import Hose
from jaxlines.physics.controllers import SampledController
from jaxlines.physics.fluids import Oil
from jaxlines.physics.friction import ChurchillFriction
from jaxlines.physics.lines import Line
from jaxlines.physics.motors import Inertia, LoadTorque, Motor, Supercharge
from jaxlines.physics.servovalve import Servovalve
from jaxlines.physics.sources import PressureSource, Tank
from jaxlines.physics.stops import Gear
from jaxlines.simulation.circuit import Circuit

MOTORS = 4
"""Drive motors of an axis (Bartos, TDA Progress Report 42-111, 1992)."""

ASSUMED = {
    "supply.pressure": 20.7e6,
    "return_line.pressure": 0.35e6,
    "supercharge.pressure": 1.0e6,
    "servovalve.rated_flow": 3.0e-3,
    "servovalve.rated_pressure_drop": 7.0e6,
    "servovalve.natural_frequency": 250.0,
    "servovalve.damping_ratio": 0.7,
    "motor.displacement": 5.0e-6,
    "motor.internal_leakage": 1.0e-11,
    "motor.external_leakage": 1.0e-12,
    "motor.viscous_friction": 0.02,
    "motor.coulomb_friction": 1.0,
    "motor.friction_speed": 0.5,
    "motor_inertia.moment_of_inertia": 0.02,
    "gear.ratio": 28_730.0,
    "gear.stiffness": 3.0e9,
    "gear.damping": 2.0e7,
    "gear.efficiency": 0.95,
    "antenna.moment_of_inertia": 3.0e8,
    "rate_loop.gain": 3e-4,
    "rate_loop.integral_gain": 2.5e-3,
}
"""Assumed, not in the article: numbers in SI by component (of its kind) and field."""

TRACKING_RATE = np.radians(360.0 / 86164.0)
"""Rate of the stars [rad/s of the axis]."""

SLEWING_RATE = np.radians(0.25)
"""Slewing rate [rad/s of the axis]; assumed."""


def equivalent_conduit(name: str) -> Hose:
    """One conduit with length, volume and effective modulus of a control line; its bore follows (41 mm).

    The article's longest path and total volume belong to a branched line of several bores; one bore that has both is
    the simplest line with the same travel time and capacity: AN EQUIVALENT, NOT FROM THE ARTICLE.
    """
    volume = VOLUMES[name].value
    wall = control_line(name, "A").parts[0].container_modulus()
    return Hose(PATH_LENGTH, np.sqrt(4.0 * volume / (np.pi * PATH_LENGTH)), wall)


def motor_speed(axis_rate):
    """Speed of the motors [rad/s] that belongs to a rate of the axis [rad/s]."""
    return ASSUMED["gear.ratio"] * axis_rate


def _given(kind: str) -> dict[str, Any]:
    """The assumed numbers of a component."""
    return {path.split(".")[1]: value for path, value in ASSUMED.items() if path.split(".")[0] == kind}


def _lines(axis: str, segments: int | None) -> dict[str, Line]:
    """Control lines no. 1 and no. 2: lumped, or between valve (A_valve, B_valve) and motors (A, B)."""
    names = {"control_1": (f"{axis}_1", "A"), "control_2": (f"{axis}_2", "B")}
    if segments is None:
        return {part: control_line(name, node) for part, (name, node) in names.items()}
    friction = ChurchillFriction()
    return {
        part: Line(f"{node}_valve", equivalent_conduit(name), to=node, segments=segments, friction=friction)
        for part, (name, node) in names.items()
    }


def antenna_axis(axis: str, segments: int | None = None, fluid: Oil = OIL) -> Circuit:
    """The whole "azimuth" or "elevation" axis, with the external input "rate": speed of the motors asked for [rad/s].

    Args: axis; segments: None for the article's lumped lines (nodes A and B), or the number of segments of lines with
        inertia and friction between valve (A_valve, B_valve) and motors (A, B); fluid.
    Raises: ValueError for another axis.
    """
    if axis not in AXES:
        raise ValueError(f'axis must be "azimuth" or "elevation", got {axis!r}')
    end = "" if segments is None else "_valve"
    components = {
        "supply": PressureSource("P_S", **_given("supply")),
        "return_line": Tank("P_R", **_given("return_line")),
        "supercharge": PressureSource("P_SC", **_given("supercharge")),
        "drain": Tank("P_D"),
        "rate_loop": SampledController(
            "shaft_1.speed", 1.0 / COMMAND_RATE, "rate", low=-1.0, high=1.0, **_given("rate_loop")
        ),
        "servovalve": Servovalve("P_S", "P_R", f"A{end}", f"B{end}", command="rate_loop", **_given("servovalve")),
        **_lines(axis, segments),
        "check_1": Supercharge("P_SC", "A"),
        "check_2": Supercharge("P_SC", "B"),
        "antenna": Inertia("axis", **_given("antenna")),
        "wind": LoadTorque("axis", torque=0.0),
    }
    for i in range(1, MOTORS + 1):
        components |= {
            f"motor_{i}": Motor("A", "B", "P_D", f"shaft_{i}", **_given("motor")),
            f"motor_inertia_{i}": Inertia(f"shaft_{i}", **_given("motor_inertia")),
            f"gear_{i}": Gear(f"shaft_{i}", "axis", **_given("gear")),
        }
    return Circuit(fluid, components)
