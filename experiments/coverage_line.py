"""The control line of the coverage studies: circuit, truth, made data, and fast rows for many data sets.

The circuit, its bounds and its true numbers are those of the bundled example `control-line`; recordings are made by the
same one-lump model, at two fifths of the bundled rate of samples or less, so that a miss is a miss of the statistics.
"""

import dataclasses
import json
import os
from pathlib import Path

import make_control_line_recording as generator
import numpy as np
from scipy import signal

import jaxlines as jl
from jaxlines.inference.problem import Problem, make_problem
from jaxlines.simulation.integration import make_method

SAMPLES, SHORT, DURATION = 601, 121, 30.0  # of a data set, of a short one; s
NOISE_SD = 0.4e5  # Pa, of the bundled recording
CORRELATION = 0.6  # of neighbouring samples in the studies with AR(1) noise
LABELS = ("fluid.bulk_modulus", "fluid.air_fraction", "leak.conductance", "initial.A.pressure")


@dataclasses.dataclass(frozen=True)
class Line:
    """The circuit with times [s], the measured flow [m^3/s], true values in SI, and compiled problem."""

    circuit: jl.Circuit
    free: tuple[jl.Free, ...]
    times: np.ndarray
    flow: np.ndarray
    truth: np.ndarray
    problem: Problem

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates."""
        return np.array([f.coordinate_bounds()[0] for f in self.free])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates."""
        return np.array([f.coordinate_bounds()[1] for f in self.free])

    def to_coordinates(self, values) -> np.ndarray:
        """Coordinates of values in SI, on the last axis."""
        values = np.asarray(values, dtype=float)
        return np.stack([f.to_coordinate(values[..., i]) for i, f in enumerate(self.free)], axis=-1)

    def to_values(self, x) -> np.ndarray:
        """Values in SI of coordinates, on the last axis."""
        x = np.asarray(x, dtype=float)
        return np.stack([f.to_value(x[..., i]) for i, f in enumerate(self.free)], axis=-1)

    def recording(self, pressure) -> jl.Recording:
        """A recording with this pressure [Pa]."""
        return jl.Recording(self.times, {"A.pressure": pressure, "flow": self.flow})


def make_line(samples: int = SAMPLES) -> Line:
    """The example's circuit under the example's flow, sampled."""
    study, truth = jl.load_study("example:control-line"), generator.Truth()
    times = np.linspace(0.0, DURATION, samples)
    flow = np.asarray(generator.valve_flow(times))
    free = tuple(study.free)
    assert tuple(f.label for f in free) == LABELS
    values = (truth.liquid_modulus_Pa, truth.air_fraction, truth.leak_m3_per_s_Pa, truth.initial_pressure_Pa_abs)
    recording = jl.Recording(times, {"A.pressure": np.full(samples, 1e6), "flow": flow})
    method = make_method(None, "forward", 4096)
    problem = make_problem(study.circuit, recording, free, (), {}, method, 1e-7, "float64")
    return Line(study.circuit, free, times, flow, np.array(values), problem)


def noise(rng: np.random.Generator, count: int, samples: int, correlation: float) -> np.ndarray:
    """Noise of the pressure [Pa], shape (count, samples), of one standard deviation whatever its correlation."""
    drive = rng.standard_normal((count, samples)) * np.sqrt(1.0 - correlation**2)
    drive[:, 0] = rng.standard_normal(count)
    return NOISE_SD * np.asarray(signal.lfilter([1.0], [1.0, -correlation], drive, axis=1))


class Rows:
    """Where the rows of one data set come from: one recording, one channel, evenly sampled."""

    labels = LABELS

    def __init__(self, samples: int):
        self.recording = self.channel = np.zeros(samples, dtype=int)
        self.time = np.arange(samples)
        self.lower = self.upper = np.zeros(len(LABELS))

    def residuals(self, x) -> np.ndarray:
        """Rows are computed for many data sets at once elsewhere."""
        raise NotImplementedError

    jacobian = residuals


def save(folder: Path, content: dict) -> None:
    """Write results.json in one step, so that a reader never sees half of it."""
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / "results.json.part"
    part.write_text(json.dumps(content, indent=2, default=float) + "\n", encoding="utf-8")
    os.replace(part, folder / "results.json")


def band(count: int, rate: float = 0.95, level: float = 0.999) -> tuple[int, int]:
    """Hits that a right 95 % interval makes of `count` data sets: 926..971 of 1000, 179..198 of 200 at 99.9 %."""
    from scipy.stats import binom

    tail = 0.5 * (1.0 - level)
    return int(binom.ppf(tail, count, rate)), int(binom.ppf(1.0 - tail, count, rate))
