"""The circuit behind the crane's record, how the record is mapped to it, and what of it is free.

    pump -> meter-in edge -> port (gauge) -> hose (inertance, losses) -> cylinder with the hose's volume -> arm
                              port -> meter-out edge -> return                       arm - sling - load

The record has no units. One sample stands for 0.1 s, one unit of pressure for 1 MPa about the pressure that carries
the arm at rest, one unit of position for 1 m, one unit of the valve signal for 1, and the piston has 10 cm^2; each of
these choices scales numbers and cancels in what is predicted. Raising needs a negative valve signal.
"""

import numpy as np
import pandas as pd

import jaxlines as jl
from jaxlines.physics.component import AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import ATMOSPHERE, Number, driven, port, quantity
from jaxlines.physics.resistances import orifice_flow, passed, soft_clip

SAMPLE, PASCAL, METRE = 0.1, 1e6, 1.0  # what one sample, one unit of pressure and one unit of position stand for
AREA, VOLUME = 1e-3, 0.05  # of the piston [m^2], of the hose [m^3]; with the modulus it only makes up the capacitance
INERTANCE = 1e8  # of the fluid in the hose, held: a fiftieth of the arm when seen through the piston [Pa s^2/m^3]
PORT_VOLUME = 0.04 * VOLUME  # between valve and hose, where the gauge sits [m^3]
CARRYING = 20e6  # pressure that carries the arm at rest, absolute [Pa]; only differences from it matter
HOME = 5.0  # where the piston stands when the record says 0: far from the end stops, which the record does not show [m]
CHANNELS = ("gauge", "position")
NOISE = {"gauge": 0.2 * PASCAL, "position": 0.07 * METRE}  # how the channels are weighted


class MeteringEdge(AbstractComponent):
    """One edge of a spool with overlap and a full opening: Q = C_d A o sqrt(2 dp/rho), o = clip((s - l)/(f - l), 0, 1).

    Args: a, b: nodes; command u (signal or input) [-]; sense: +1 or -1, the sign of the command that opens it, s =
        sense u; area A when fully open [m^2]; lap l: stroke at which it starts to open [-]; full f: beyond l, so that
        it is fully open at l + f [-]; discharge_coefficient [-]; width of the rounded ends of the opening [-];
        transition [Pa], see `Orifice`.
    Validity: the spool follows at once (a delay belongs to the command), no leakage, no flow forces.
    """

    a: str = port()
    b: str = port()
    command: Number = driven("1", low=-10.0, high=10.0)
    sense: Number = quantity("1", low=-1.0, high=1.0)
    area: Number = quantity("m^2", low=0.0, high=1.0)
    lap: Number = quantity("1", low=-1.0, high=5.0)
    full: Number = quantity("1", low=1e-3, high=10.0)
    discharge_coefficient: Number = quantity("1", low=0.01, high=2.0, default=0.62)
    width: Number = quantity("1", low=1e-6, high=0.49, default=0.2)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e5)

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density = at.fluid.density_at(0.5 * (p_a + p_b))
        area = self.area * soft_clip((self.sense * at.given["command"] - self.lap) / self.full, self.width)
        return passed(at, orifice_flow(area, self.discharge_coefficient, density, p_a, p_b, self.transition))


# Where the searches start: the best of thousands of random sets and ten local searches each of a SciPy prototype with
# the same structure, on the fitted part alone.
START = {
    "valve.delay": 0.31,
    "meter_in.lap": 0.03,
    "meter_in.full": 0.48,
    "meter_in.area": 5.8e-6,
    "meter_out.lap": 0.03,
    "meter_out.full": 0.75,
    "meter_out.area": 5.7e-6,
    "pump.pressure": 21.5e6,
    "return.pressure": 13.9e6,
    "fluid.bulk_modulus": 1.75e9,
    "arm.mass": 4400.0,
    "cylinder.viscous_friction": 1000.0,
    "hose.resistance": 4e9,
    "hose.quadratic_resistance": 7e12,
    "cylinder.coulomb_friction": 40.0,
    "fluid.air_fraction": 0.01,
    "load.mass": 185.0,
    "sling.stiffness": 700.0,
}


def _free(path: str, low: float, high: float, transform: str = "log") -> jl.Free:
    """A free number that starts where `START` says."""
    return jl.Free(path, (low, high), start=START[path], transform=transform)


PLAIN = [
    _free("valve.delay", 0.0, 0.6, "identity"),
    _free("meter_in.lap", -0.5, 0.3, "identity"),
    _free("meter_in.full", 0.02, 3.0),
    _free("meter_in.area", 1e-6, 1e-3),
    _free("meter_out.lap", -0.5, 0.3, "identity"),
    _free("meter_out.full", 0.02, 3.0),
    _free("meter_out.area", 5e-7, 1e-3),
    _free("pump.pressure", 20.2e6, 60e6, "identity"),
    _free("return.pressure", 1e5, 19e6, "identity"),
    _free("fluid.bulk_modulus", 1.2e8, 3e10),
    _free("arm.mass", 1e2, 1e5),
    _free("cylinder.viscous_friction", 1.0, 1e5),
]
LOSSES = [_free("hose.resistance", 1e7, 1e11), _free("hose.quadratic_resistance", 1e9, 1e15)]
COULOMB = _free("cylinder.coulomb_friction", 1e-2, 1e3)
AIR = _free("fluid.air_fraction", 1e-5, 0.3)
# A load that swings by small angles below the tip; a damper beside the sling went to zero in every search.
SWING = [_free("load.mass", 1.0, 1e4), _free("sling.stiffness", 10.0, 1e5)]
STRUCTURES = {
    "no loss in the hose": PLAIN,
    "losses in the hose": [*PLAIN, *LOSSES],
    "losses and dry friction": [*PLAIN, *LOSSES, COULOMB],
    "losses and swinging load": [*PLAIN, *LOSSES, *SWING],
    "losses, swinging load and air": [*PLAIN, *LOSSES, *SWING, AIR],
}
EDGE = ("area", "lap", "full")


def circuit(free) -> jl.Circuit:
    """The circuit of a structure: terms that are not free in it are absent or as good as absent."""
    paths = {path for f in free for path in f.paths}

    def start(path: str, absent: float) -> float:
        return START[path] if path in paths else absent

    oil = jl.Oil(
        bulk_modulus=START["fluid.bulk_modulus"],
        density=850.0,
        air_fraction=start("fluid.air_fraction", 0.0),
        polytropic_index=1.3,
        mass="article",
    )
    components = {
        "pump": jl.PressureSource("supply", START["pump.pressure"]),
        "return": jl.Tank("drain", START["return.pressure"]),
        "surroundings": jl.Tank("outside"),
        "meter_in": MeteringEdge("supply", "port", "valve", -1.0, *(START[f"meter_in.{n}"] for n in EDGE)),
        "meter_out": MeteringEdge("port", "drain", "valve", 1.0, *(START[f"meter_out.{n}"] for n in EDGE)),
        "port_volume": jl.Line("port", jl.Vessel(volume=PORT_VOLUME)),
        "hose": jl.FluidInertia(
            "port",
            "chamber",
            INERTANCE,
            start("hose.resistance", 3e8),
            start("hose.quadratic_resistance", 0.0),
        ),
        "hose_volume": jl.Line("chamber", jl.Vessel(volume=VOLUME)),
        "cylinder": jl.SingleRodCylinder(
            *("chamber", "outside", "rod", AREA, AREA, 12.0),
            viscous_friction=START["cylinder.viscous_friction"],
            coulomb_friction=start("cylinder.coulomb_friction", 0.0),
            stribeck_speed=0.1,
            friction_speed=0.01,
        ),
        "arm": jl.Mass("rod", START["arm.mass"]),
        "weight": jl.Force("rod", -(CARRYING - ATMOSPHERE) * AREA),
        "gauge": jl.PressureSensor("port", offset=-CARRYING),
        "position": jl.PositionSensor("cylinder.position", offset=-HOME),
    }
    if "load.mass" in paths:
        components |= {
            "load": jl.Mass("hook", START["load.mass"]),
            "sling": jl.Spring("rod", START["sling.stiffness"], to="hook"),
        }
    return jl.Circuit(oil, components)


def initial(first_position: float) -> dict:
    """Start values: the arm at rest where the record begins, pressures as they carry it."""
    nodes = {f"{node}.pressure": CARRYING for node in ("port", "chamber")}
    return nodes | {"cylinder.position": HOME + first_position * METRE}


def recording(rows: pd.DataFrame, fitted: np.ndarray) -> jl.Recording:
    """The record in SI; only samples that are `fitted` count, the valve signal is used throughout."""
    channels = {
        "valve": rows["u_valve"].to_numpy(),
        "gauge": rows["p_oil"].to_numpy() * PASCAL,
        "position": rows["x_crane"].to_numpy() * METRE,
    }
    mask = {name: np.asarray(fitted, dtype=bool) for name in CHANNELS}
    return jl.Recording(np.arange(len(rows)) * SAMPLE, channels, mask=mask, name="crane")
