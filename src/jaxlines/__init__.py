"""Differentiable simulation of lumped hydraulic lines, and physical parameters from recorded pressure."""

from jaxlines.inference.fit import fit as fit
from jaxlines.inference.parameters import Free as Free, Known as Known
from jaxlines.inference.recording import Recording as Recording
from jaxlines.physics.containers import Pipe as Pipe, Vessel as Vessel
from jaxlines.physics.fluids import Oil as Oil
from jaxlines.physics.lines import FluidInertia as FluidInertia, Line as Line
from jaxlines.physics.motors import (
    Brake as Brake,
    Inertia as Inertia,
    LoadTorque as LoadTorque,
    Motor as Motor,
    Supercharge as Supercharge,
)
from jaxlines.physics.resistances import LaminarLeak as LaminarLeak, Orifice as Orifice
from jaxlines.physics.sensors import FlowSensor as FlowSensor, PressureSensor as PressureSensor
from jaxlines.physics.servovalve import Servovalve as Servovalve
from jaxlines.physics.sources import FlowSource as FlowSource, PressureSource as PressureSource, Tank as Tank
from jaxlines.simulation.circuit import Circuit as Circuit
from jaxlines.simulation.signals import Constant as Constant, Sampled as Sampled, Sine as Sine, Step as Step
from jaxlines.simulation.simulate import implicit as implicit, simulate as simulate
