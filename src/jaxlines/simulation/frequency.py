"""Lines in the frequency domain: matrices of lines in series, what stands at their far end, impedances.

Small oscillations about a mean pressure, with the exact distributed line or the ladder of N segments:

    oil, f = jl.Oil(1.4e9, 850.0, 30e-6), np.geomspace(1.0, 500.0, 400)
    pipes = chain(line_matrix(pipe, oil, 5e6, f), line_matrix(hose, oil, 5e6, f))
    z = input_impedance(pipes, closed_end())                    # Pa s/m^3, complex

Positions: 1 is the near end, where one drives and measures, 2 the far end; volume flow counts from 1 to 2.
Results are NumPy; in traced code (jit, grad, jacfwd) JAX arrays, so that measured impedances can be fitted.
Reference: Goodson and Leonard, "A survey of modeling techniques for fluid line transients", J. Basic
Engineering 94, 1972.
"""

import functools
from typing import Literal

import jax
import numpy as np

from jaxlines.physics.containers import AbstractConduit, AbstractContainer, ViscoelasticHose, capacity
from jaxlines.physics.distributed import Friction, ladder_matrix, transmission_matrix, two_port
from jaxlines.physics.fields import array_module, check_range
from jaxlines.physics.fluids import Oil
from jaxlines.simulation.precision import computing_in, is_traced

_FREQUENCY = {"unit": "Hz", "low": 0.0, "high": 1e9, "slip": ""}
_PRESSURE = {"unit": "Pa", "low": 1.0, "high": 1e10, "slip": "pressures are absolute"}


def _laplace(frequencies):
    """s = 2 pi j f [1/s]."""
    return 2j * np.pi * array_module(frequencies).asarray(frequencies)


def _numbers(conduit: AbstractConduit, fluid: Oil, pressure, s):
    """Length, bore, density, viscosity and modulus of a filled line; the modulus is complex when the wall creeps.

    The modulus is that which gives the line the capacity it has at the pressure.
    """
    check_range("pressure", pressure, _PRESSURE)
    density = fluid.density_at(pressure)
    modulus = density * conduit.reference_volume() / capacity(conduit, fluid, pressure)
    if isinstance(conduit, ViscoelasticHose):
        delayed = conduit.delayed_compliance() / (1.0 + s * conduit.relaxation_time)
        modulus = 1.0 / (1.0 / modulus + delayed)
    return conduit.length, conduit.inner_diameter, density, fluid.dynamic_viscosity(pressure) / density, modulus


def line_matrix(
    conduit: AbstractConduit,
    fluid: Oil,
    pressure,
    frequencies,
    *,
    friction: Friction | None = None,
    segments: int | None = None,
    model: Literal["pi", "T"] = "pi",
):
    """The matrix M of a pipe or hose, [p1; Q1] = M [p2; Q2], shape (frequencies, 2, 2).

    Args:
        conduit: `Pipe`, `Hose` or `ViscoelasticHose`; fluid: what fills it; frequencies: [Hz], any shape.
        pressure: mean absolute pressure [Pa], at which density, viscosity and moduli are taken.
        friction: "distributed" (exact laminar; the default of the exact line), "steady" (the default of a
            ladder), "none", or a weighting function such as `KagawaWeights()`.
        segments: None for the exact distributed line, or the number of segments of a ladder.
        model: of the segments, see `jaxlines.physics.distributed.ladder_matrix`.
    Raises: TypeError for a container without a length; RuntimeError in traced code while JAX is set to float32.
    Validity: small oscillations about rest or laminar mean flow; inertia and friction by the bore at
        atmospheric pressure, capacity by the volume at the mean pressure.
    """
    if not isinstance(conduit, AbstractConduit):
        raise TypeError(
            f"line_matrix needs a pipe or hose, got {type(conduit).__name__}: a vessel is "
            "volume_matrix(vessel_capacitance(vessel, fluid, pressure), frequencies)"
        )
    weights = None if isinstance(friction, str) else friction
    given = (conduit, fluid, pressure, frequencies, weights)
    with computing_in("float64", given):
        if not is_traced(given):
            given = jax.tree.map(lambda x: np.asarray(x, dtype=np.float64), given)
        conduit, fluid, pressure, frequencies, weights = given
        check_range("frequencies", frequencies, _FREQUENCY)
        s, law = _laplace(frequencies), friction if isinstance(friction, str) else weights
        numbers = _numbers(conduit, fluid, pressure, s)
        if segments is None:
            return transmission_matrix(s, *numbers, friction=law or "distributed")
        return ladder_matrix(s, segments, *numbers, friction=law or "steady", model=model)


def vessel_capacitance(container: AbstractContainer, fluid: Oil, pressure):
    """C = V/K_eff of a vessel at a mean absolute pressure [m^3/Pa]. Typical: 1 litre of oil 7e-13 m^3/Pa."""
    return capacity(container, fluid, pressure) / fluid.density_at(pressure)


def orifice_impedance(pressure_drop, flow):
    """Impedance of an orifice about its operating point, d(dp)/dQ = 2 dp/Q [Pa s/m^3].

    Args: pressure_drop dp [Pa] and flow Q > 0 [m^3/s] at the operating point. Valid for turbulent flow, where
    dp is proportional to Q^2, and oscillations small against Q.
    """
    return 2.0 * pressure_drop / flow


def volume_matrix(capacitance, frequencies):
    """The matrix of a volume between two lines, or at a branch: [[1, 0], [s C, 1]].

    Args: capacitance C [m^3/Pa], see `vessel_capacitance`; frequencies [Hz].
    """
    admittance = _laplace(frequencies) * capacitance
    return two_port(1.0 + 0.0 * admittance, 0.0 * admittance, admittance, 1.0 + 0.0 * admittance)


def impedance_matrix(impedance):
    """The matrix of an impedance z [Pa s/m^3] in the path, such as an orifice: [[1, z], [0, 1]]."""
    z = array_module(impedance).asarray(impedance) + 0j
    return two_port(1.0 + 0.0 * z, z, 0.0 * z, 1.0 + 0.0 * z)


def chain(*matrices):
    """The matrix of elements in series, in the order in which the flow meets them from end 1 on."""
    return functools.reduce(lambda a, b: a @ b, matrices)


def closed_end():
    """No flow at the far end: (p2, Q2) is a multiple of (1, 0)."""
    return np.array([1.0, 0.0])


def constant_pressure_end():
    """A reservoir, tank or accumulator without resistance: (p2, Q2) is a multiple of (0, 1)."""
    return np.array([0.0, 1.0])


def impedance_end(impedance):
    """Something with p2 = z Q2 [Pa s/m^3] at the far end, one number or one for each frequency."""
    xp = array_module(impedance)
    z = xp.asarray(impedance) + 0j
    return xp.stack([z, xp.ones_like(z)], axis=-1)


def volume_end(capacitance, frequencies):
    """A volume with capacitance C [m^3/Pa] at the far end: (p2, Q2) is a multiple of (1, s C); frequencies [Hz]."""
    admittance = _laplace(frequencies) * capacitance
    return array_module(admittance).stack([1.0 + 0.0 * admittance, admittance], axis=-1)


def _near_end(matrix, end):
    """(p1, Q1) that belong to (p2, Q2)."""
    xp = array_module(matrix, end)
    near = (matrix @ xp.asarray(end)[..., None])[..., 0]
    return near[..., 0], near[..., 1]


def input_impedance(matrix, end):
    """p1/Q1 [Pa s/m^3] seen at the near end, with one of the ends of this module at the other.

    Infinite where no flow is taken, as at zero frequency with a closed end.
    """
    pressure, flow = _near_end(matrix, end)
    return pressure / flow


def pressure_ratio(matrix, end):
    """p2/p1 [-]: pressure at the far end per pressure at the near end."""
    return end[..., 0] / _near_end(matrix, end)[0]


def transfer_impedance(matrix, end):
    """p2/Q1 [Pa s/m^3]: pressure at the far end per flow at the near end, as of a pump's ripple."""
    return end[..., 0] / _near_end(matrix, end)[1]
