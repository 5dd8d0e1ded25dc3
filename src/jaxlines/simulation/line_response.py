"""A line of a circuit as it is simulated, beside the exact distributed line: input impedance over frequency."""

from typing import Any, NamedTuple

import numpy as np

from jaxlines.physics.containers import AbstractConduit
from jaxlines.physics.fields import array_module, check_range
from jaxlines.physics.fluids import Oil
from jaxlines.physics.lines import Line
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.frequency import (
    chain,
    closed_end,
    constant_pressure_end,
    impedance_end,
    input_impedance,
    line_matrix,
    vessel_capacitance,
    volume_matrix,
)

ENDS = {"closed": closed_end, "open": constant_pressure_end}


class LineResponse(NamedTuple):
    """Input impedance of a line, exact and as simulated [Pa s/m^3], complex, shape (frequencies,)."""

    name: str
    frequencies: Any
    exact: Any
    simulated: Any
    pressure: float
    end: str

    @property
    def error(self):
        """abs(simulated/exact - 1) [-], shape (frequencies,)."""
        return array_module(self.exact).abs(self.simulated / self.exact - 1.0)

    def highest_frequency(self, error: float = 0.1) -> float:
        """The frequency [Hz] up to which the error stays below a limit; 0 when it never does."""
        beyond = np.flatnonzero(~(np.asarray(self.error) <= error))
        count = beyond[0] if beyond.size else len(self.frequencies)
        return float(self.frequencies[count - 1]) if count else 0.0


def line_response(circuit: Circuit, name: str, frequencies, *, pressure, end: Any = "closed") -> LineResponse:
    """Input impedance of a line, as the circuit simulates it and as the distributed line has it.

    Args:
        circuit, name: a `Line` of it, lumped or in segments (a number of them, not "auto").
        frequencies: above 0 [Hz], shape (frequencies,).
        pressure: mean absolute pressure [Pa].
        end: what is at the far end: "closed", "open" (constant pressure), or an impedance [Pa s/m^3], one number
            or one a frequency.
    Returns: a `LineResponse`; JAX arrays in traced code, so that a measured impedance can be fitted.
    Raises: KeyError and TypeError when there is no such line; ValueError for frequencies that are not positive.
    Validity: small oscillations about rest, laminar flow. The parts of a lumped line stand in series in their order;
    its impedance as simulated is that of its capacitance alone, whatever the end.
    """
    line = circuit.components.get(name)
    if line is None:
        raise KeyError(f"the circuit has no component {name!r}; it has {', '.join(circuit.components)}")
    if not isinstance(line, Line):
        raise TypeError(f"{name!r} is a {type(line).__name__}, and only a Line has a response")
    check_range("frequencies", frequencies, {"unit": "Hz", "low": 1e-9, "high": 1e9, "slip": ""})
    far = ENDS[end]() if isinstance(end, str) and end in ENDS else impedance_end(end)
    exact = input_impedance(_exact_matrix(line, circuit.fluid, pressure, frequencies), far)
    simulated = _simulated(line, circuit.fluid, pressure, frequencies, far)
    return LineResponse(name, frequencies, exact, simulated, pressure, end if isinstance(end, str) else "impedance")


def _exact_matrix(line: Line, fluid: Oil, pressure, frequencies):
    """The distributed line: conduits with their exact friction, vessels as volumes, in series."""
    parts = [
        line_matrix(part, fluid, pressure, frequencies)
        if isinstance(part, AbstractConduit)
        else volume_matrix(vessel_capacitance(part, fluid, pressure), frequencies)
        for part in line.parts
    ]
    return chain(*parts)


def _simulated(line: Line, fluid: Oil, pressure, frequencies, far):
    """The input impedance of the line's own equations."""
    if line.to is None:
        capacitance = line.capacity(fluid, pressure) / fluid.density_at(pressure)
        return input_impedance(volume_matrix(capacitance, frequencies), closed_end())
    ladder = line.ladder()
    matrix = line_matrix(
        ladder.conduit,
        fluid,
        pressure,
        frequencies,
        friction=ladder.weights or "steady",
        segments=ladder.cut.volumes.size - (1 if line.model == "pi" else 2),
        model=line.model,  # pyright: ignore[reportArgumentType]
    )
    return input_impedance(matrix, far)
