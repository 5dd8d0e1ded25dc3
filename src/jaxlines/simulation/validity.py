"""Whether the lumped lines of a simulated circuit may be trusted, and how far off they are."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxlines.physics.article import lumped_model_is_valid
from jaxlines.physics.containers import AbstractConduit
from jaxlines.physics.lines import Line
from jaxlines.physics.validity import frequency_of_error, lumped_impedance_error, quarter_wave_frequency
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.wave_validity import LAMINAR_LIMIT, WaveLineValidity, check_wave_line, wave_lines

ERROR_LIMIT = 0.10
"""Largest error of the input impedance, and largest drop relative to the pressure, that counts as valid."""

_FLAT = 1e-6
_FINEST = 65536
# A record that moves by less than _FLAT of its size is constant: the rest is the solver's tolerance.


class LineValidity(NamedTuple):
    """One line: speeds, times, errors and drops in SI; drops are None where the line has no pipes.

    `wave_speed` and what follows from it are taken at the lowest pressure visited, where air makes it slowest.
    """

    name: str
    path_length: float
    lowest_pressure: float
    median_pressure: float
    wave_speed: float
    median_wave_speed: float
    round_trip_time: float
    highest_frequency: float
    article_condition: bool
    impedance_error: float
    frequency_1_percent: float
    frequency_10_percent: float
    first_resonance: float
    reynolds_number: float | None
    friction_drop: float | None
    relative_friction_drop: float | None
    inertia_drop: float | None
    relative_inertia_drop: float | None

    @property
    def ok(self) -> bool:
        """Eq. (11) of the article holds, and no error or relative drop exceeds 10 %."""
        drops = (self.relative_friction_drop or 0.0, self.relative_inertia_drop or 0.0)
        return self.article_condition and max(self.impedance_error, *drops) <= ERROR_LIMIT

    def sentence(self) -> str:
        """What there is to say about this line, in plain words."""
        return f"{self.name}: {_waves(self)}; {_drops(self)}"


@dataclasses.dataclass(frozen=True)
class Validity:
    """Validity of each lumped line with a path length and of each line in segments (`waves`).

    highest_frequency [Hz] that was taken, and frequency_source: what it was read from.
    """

    lines: tuple[LineValidity, ...]
    waves: tuple[WaveLineValidity, ...]
    highest_frequency: float
    frequency_source: str

    @property
    def ok(self) -> bool:
        """Whether every line is within the limits; true when there is no line to check."""
        return all(line.ok for line in (*self.lines, *self.waves))

    def sentences(self) -> list[str]:
        """One sentence a line, with numbers and units."""
        if not self.lines and not self.waves:
            return ["no line has a path_length, so that the validity of the lumped model was not checked"]
        return [line.sentence() for line in (*self.lines, *self.waves)]

    def to_dict(self) -> dict:
        """Plain numbers and texts, fit for JSON."""
        return {
            "ok": self.ok,
            "highest_frequency": self.highest_frequency,
            "frequency_source": self.frequency_source,
            "lines": [{**line._asdict(), "ok": line.ok} for line in self.lines],
            "waves": [{**line._asdict(), "ok": line.ok} for line in self.waves],
            "sentences": self.sentences(),
        }


def _waves(line: LineValidity) -> str:
    """Eq. (11) and the error of the impedance, in words."""
    f, trip = line.highest_frequency, f"2L/c0 = {1e3 * line.round_trip_time:.3g} ms"
    limits = f"1 % up to {line.frequency_1_percent:.2g} Hz, 10 % up to {line.frequency_10_percent:.2g} Hz"
    limits += f", first resonance at {line.first_resonance:.3g} Hz"
    if f == 0.0:
        return f"{trip}, nothing oscillates; the input impedance of the lumped line is off by {limits}"
    holds = f"{trip} < 1/f = {1e3 / f:.4g} ms holds" if line.article_condition else f"{trip} >= 1/f = {1e3 / f:.4g} ms"
    joint = "but" if line.article_condition and line.impedance_error > ERROR_LIMIT else "and"
    error = f"the input impedance of the lumped line is off by {100 * line.impedance_error:.3g} % at {f:.3g} Hz"
    return f"{holds}, {joint} {error}; {limits}"


def _drops(line: LineValidity) -> str:
    """Friction and inertia drop, in words."""
    friction, inertia, reynolds = line.friction_drop, line.inertia_drop, line.reynolds_number
    if friction is None or inertia is None or reynolds is None:
        return "it has no pipes, so that friction and inertia drops are unknown"
    pressure = abs(line.median_pressure)
    text = (
        f"friction drop {1e-3 * friction:.3g} kPa ({100 * friction / pressure:.2g} %), inertia drop "
        f"{1e-3 * inertia:.3g} kPa ({100 * inertia / pressure:.2g} %) of {1e-6 * pressure:.3g} MPa"
    )
    turbulent = f"; the flow is turbulent (Re = {reynolds:.0f}), so that the friction drop is larger"
    return text + turbulent * (reynolds > LAMINAR_LIMIT)


def spectral_edge(times, values, fraction: float = 0.99) -> float:
    """The frequency [Hz] below which a share of the power of a record lies; 0 for a constant one.

    Args: times [s], increasing; values, the same shape; fraction of the power of the record, detrended by a
        straight line and windowed by Hann's window. Records at unequal times are interpolated first.
    """
    times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    keep = np.isfinite(values)
    times, values = times[keep], values[keep]
    if times.size < 4:
        return 0.0
    count = int(np.clip(np.ceil((times[-1] - times[0]) / np.min(np.diff(times)) - 1e-6) + 1, times.size, _FINEST))
    even = np.linspace(times[0], times[-1], count)
    record = np.interp(even, times, values)
    x = np.linspace(-1.0, 1.0, count)
    rest = record - np.mean(record) - x * np.mean(x * record) / np.mean(x * x)
    if np.ptp(rest) <= _FLAT * np.max(np.abs(record)):
        return 0.0
    power = np.abs(np.fft.rfft(rest * np.hanning(count))) ** 2
    share = np.cumsum(power) / np.sum(power)
    return float(np.fft.rfftfreq(count, even[1] - even[0])[np.searchsorted(share, fraction)])


def _pipe_numbers(line: Line, fluid, flow, times) -> tuple[float, float, float] | tuple[None, None, None]:
    """Largest Reynolds number, friction drop and inertia drop [Pa]; nothing without pipes."""
    pipes = [part for part in line.parts if isinstance(part, AbstractConduit)]
    if not pipes:
        return None, None, None
    largest, fastest = np.max(np.abs(flow)), np.max(np.abs(np.gradient(flow, times)))
    viscosity = fluid.dynamic_viscosity() / fluid.liquid_density()
    reynolds = max(4.0 * largest / (np.pi * p.inner_diameter * viscosity) for p in pipes)
    friction, inertia = line.laminar_resistance(fluid) * largest, line.inertance(fluid) * fastest
    return float(reynolds), float(friction), float(inertia)


def _check_line(name: str, line: Line, fluid, times, pressure, flow, frequency: float) -> LineValidity:
    """One line against its pressure and flow."""
    seen = np.asarray(pressure)[np.isfinite(pressure)]
    if not seen.size:
        raise ValueError(f"the pressure of {line.node!r} has no finite value: the validity of {name!r} is unknown")
    low, median, length = float(np.min(seen)), float(np.median(seen)), float(line.path_length)
    speed = float(line.wave_speed(fluid, low))
    reynolds, friction, inertia = _pipe_numbers(line, fluid, flow, times)
    return LineValidity(
        name=name,
        path_length=length,
        lowest_pressure=low,
        median_pressure=median,
        wave_speed=speed,
        median_wave_speed=float(line.wave_speed(fluid, median)),
        round_trip_time=float(line.round_trip_time(fluid, low)),
        highest_frequency=frequency,
        article_condition=bool(lumped_model_is_valid(length, speed, frequency)),
        impedance_error=float(lumped_impedance_error(length, speed, frequency)),
        frequency_1_percent=float(frequency_of_error(length, speed, 0.01)),
        frequency_10_percent=float(frequency_of_error(length, speed, 0.10)),
        first_resonance=float(quarter_wave_frequency(length, speed)),
        reynolds_number=reynolds,
        friction_drop=friction,
        relative_friction_drop=None if friction is None else friction / abs(median),
        inertia_drop=inertia,
        relative_inertia_drop=None if inertia is None else inertia / abs(median),
    )


def lines_to_check(circuit: Circuit) -> dict[str, Line]:
    """The lumped lines whose path length is known, by name."""
    lines = {name: part for name, part in circuit.parts().items() if isinstance(part, Line) and part.to is None}
    return {name: line for name, line in lines.items() if float(line.path_length) > 0.0}


def nodes_to_check(circuit: Circuit) -> set[str]:
    """The nodes whose pressures the check needs."""
    ends = {node for line in wave_lines(circuit).values() for node in (line.node, line.to) if node is not None}
    return ends | {line.node for line in lines_to_check(circuit).values()}


def check_validity(circuit: Circuit, times, pressures, flows, signals, highest_frequency=None) -> Validity:
    """Check the lines of a circuit, lumped and segmented, against what happened in it.

    Args:
        circuit: its lines with a path_length are checked, on concrete numbers.
        times: of pressures and flows [s], shape (times,).
        pressures: node -> absolute pressure [Pa], at least for the lines' nodes.
        flows: name of the line -> volume flow into it [m^3/s], used for the drops only; of a segmented line the
            flows along it, shape (columns, times).
        signals: name -> (times, values) of the inputs.
        highest_frequency: f of eq. (11) [Hz]; by default the highest spectral edge of signals and pressures.
    """
    times = np.asarray(times, dtype=float)
    edges = {name: spectral_edge(*record) for name, record in signals.items()}
    edges |= {f"{node}.pressure": spectral_edge(times, pressures[node]) for node in sorted(nodes_to_check(circuit))}
    source = max(edges, key=edges.__getitem__, default="none")
    frequency = float(edges.get(source, 0.0) if highest_frequency is None else highest_frequency)
    source = source if highest_frequency is None else "given"
    checked = tuple(
        _check_line(name, line, circuit.fluid, times, pressures[line.node], flows[name], frequency)
        for name, line in lines_to_check(circuit).items()
    )
    waves = []
    for name, line in wave_lines(circuit).items():
        ends = np.stack([np.asarray(pressures[node]) for node in (line.node, line.to)])
        waves.append(check_wave_line(name, line, circuit.fluid, ends, flows[name], frequency, source))
    return Validity(checked, tuple(waves), frequency, source)
