"""Whether the segments of a wave line are fine enough, and its friction law fits, for what happened in it."""

from typing import NamedTuple

import numpy as np

from jaxlines.physics.friction import LaminarFriction
from jaxlines.physics.lines import Line
from jaxlines.physics.validity import ladder_delay_error, quarter_wave_frequency
from jaxlines.simulation.circuit import Circuit

DELAY_LIMIT = 0.02
"""Largest share by which waves of the highest frequency may run too slow (9 segments per wavelength)."""

LAMINAR_LIMIT = 2000.0
"""Reynolds number up to which laminar friction holds."""


class WaveLineValidity(NamedTuple):
    """One segmented line: wave speeds at the lowest and the median pressure, segments against the wavelength, flow.

    `segments_per_wavelength` and `delay_error` are taken at the lowest pressure visited, where air makes waves
    slowest, and are infinite and zero when nothing oscillates.
    """

    name: str
    length: float
    segments: int
    lowest_pressure: float
    wave_speed: float
    median_wave_speed: float
    highest_frequency: float
    frequency_source: str
    segments_per_wavelength: float
    delay_error: float
    first_resonance: float
    reynolds_number: float
    friction: str

    @property
    def friction_fits(self) -> bool:
        """Whether the friction law holds at the largest Reynolds number seen."""
        return self.friction != LaminarFriction.__name__ or self.reynolds_number <= LAMINAR_LIMIT

    @property
    def ok(self) -> bool:
        """Waves of the highest frequency are less than 2 % slow, and the friction law holds."""
        return self.delay_error <= DELAY_LIMIT and self.friction_fits

    def sentence(self) -> str:
        """What there is to say about this line, in plain words."""
        count = f"{self.name}: {self.segments} segments"
        if self.highest_frequency > 0.0:
            count += (
                f", {self.segments_per_wavelength:.3g} per wavelength at {self.highest_frequency:.3g} Hz "
                f"({self.frequency_source}) and {self.wave_speed:.4g} m/s, so that its waves run "
                f"{100 * self.delay_error:.2g} % slow"
            )
        count += f"; first resonance of the closed line {self.first_resonance:.3g} Hz"
        law = f"{self.friction} at a Reynolds number of up to {self.reynolds_number:.0f}"
        if self.friction_fits:
            return f"{count}; {law}"
        return f"{count}; {law}, where the flow is turbulent: use HaalandFriction or ChurchillFriction"


def wave_lines(circuit: Circuit) -> dict[str, Line]:
    """The lines that run between two nodes in segments, by name."""
    lines = {name: part for name, part in circuit.parts().items() if isinstance(part, Line)}
    return {name: line for name, line in lines.items() if line.to is not None}


def check_wave_line(name: str, line: Line, fluid, pressures, flows, frequency: float, source: str) -> WaveLineValidity:
    """One segmented line against the pressures at its ends and the flows along it.

    Args: pressures at both ends [Pa], shape (ends, times); flows [m^3/s], shape (columns, times); frequency [Hz]
    and what it was read from.
    """
    conduit, seen = line.ladder().conduit, np.asarray(pressures)[np.isfinite(pressures)]
    lowest, median, length = float(np.min(seen)), float(np.median(seen)), float(conduit.length)
    speed, segments = float(line.wave_speed(fluid, lowest)), line.ladder().cut.columns.size - (line.model == "T")
    per_wavelength = segments * speed / (frequency * length) if frequency > 0.0 else np.inf
    fastest = 4.0 * np.max(np.abs(flows)) / (np.pi * float(conduit.inner_diameter))
    return WaveLineValidity(
        name=name,
        length=length,
        segments=segments,
        lowest_pressure=lowest,
        wave_speed=speed,
        median_wave_speed=float(line.wave_speed(fluid, median)),
        highest_frequency=frequency,
        frequency_source=source,
        segments_per_wavelength=per_wavelength,
        delay_error=float(ladder_delay_error(per_wavelength)),
        first_resonance=float(quarter_wave_frequency(length, speed)),
        reynolds_number=float(fastest * fluid.density_at(median) / fluid.dynamic_viscosity(median)),
        friction=type(line.friction).__name__,
    )
