"""The fits whose speed is compared: recordings of the servo axis with noise, four numbers free in each.

One channel, p_A of the axis in `servo_axis.py` (201 samples, noise of 1 bar), is computed by Dormand-Prince in Numba at
a tolerance of 1e-7, by no engine of jaxlines. Free are the modulus of the liquid, the air ratio R = f/(1 - f), the
leakage and the gain of the valve; the rest is known. Every engine searches in the same coordinate, the place of the
logarithm between its bounds, 0 to 1, from the same start, and minimises sum ((p - p_A)/sigma)^2 within the bounds.
"""

from typing import NamedTuple

import numpy as np
import servo_axis as axis
from ensemble_peers_numba import dopri5

import jaxlines as jl

NOISE = 1e5
"""Standard deviation of p_A [Pa], and the weight of all fits."""
FREE = ("bulk_modulus", "air_ratio", "leakage", "valve_gain")
LOWEST = np.array([0.3e9, 3e-4, 1e-13, 1e-7])
HIGHEST = np.array([3e9, 0.15, 1e-10, 1.2e-6])
KNOWN = {"polytropic_index": 1.2, "inertia": 40.0, "spool_frequency": 250.0, "volume_a": 0.0271, "volume_b": 0.0277}
PLACES = [axis.COLUMNS.index(name) for name in FREE]


class Task(NamedTuple):
    """Fits to be done: p_A, shape (fits, samples) [Pa]; starts and truth, shape (fits, 4), in the units of FREE."""

    pressure: np.ndarray
    starts: np.ndarray
    truth: np.ndarray

    def part(self, count: int) -> "Task":
        """The first few."""
        return Task(self.pressure[:count], self.starts[:count], self.truth[:count])


def to_value(coordinate):
    """Numbers from coordinates."""
    return LOWEST * np.exp(np.asarray(coordinate) * np.log(HIGHEST / LOWEST))


def to_coordinate(value):
    """Coordinates of numbers."""
    return np.log(np.asarray(value) / LOWEST) / np.log(HIGHEST / LOWEST)


def numbers_of(values: np.ndarray) -> np.ndarray:
    """The nine numbers of the axis for some values of the free ones, shape (..., 9)."""
    numbers = np.empty((*np.shape(values)[:-1], len(axis.COLUMNS)))
    for name, value in KNOWN.items():
        numbers[..., axis.COLUMNS.index(name)] = value
    numbers[..., PLACES] = values
    return numbers


def make_task(count: int, seed: int = 0) -> Task:
    """Recordings with noise, and starts 30 to 60 % away from the truth, up or down, in every number."""
    random = np.random.default_rng(seed)
    truth = np.stack(
        [
            1.29e9 * random.uniform(0.8, 1.1, count),
            10.0 ** random.uniform(-2.5, -1.5, count),
            random.uniform(1e-12, 1e-11, count),
            random.uniform(0.8, 1.2, count) * 1e-3 / np.sqrt(7e6),
        ],
        axis=-1,
    )
    columns = dict(zip(axis.COLUMNS, numbers_of(truth).T, strict=True))
    clean = dopri5(columns, 1e-7, repeats=1).pressure
    away = random.uniform(0.3, 0.6, truth.shape)
    starts = truth * np.where(random.random(truth.shape) < 0.5, 1.0 + away, 1.0 - away)
    return Task(clean + NOISE * random.standard_normal(clean.shape), starts, truth)


def circuit() -> jl.Circuit:
    """The axis with the known numbers."""
    return axis.circuit().replace(
        {
            "fluid.polytropic_index": KNOWN["polytropic_index"],
            "inertia.moment_of_inertia": KNOWN["inertia"],
            "valve.natural_frequency": KNOWN["spool_frequency"],
            "line_a.parts.0.volume": KNOWN["volume_a"],
            "line_b.parts.0.volume": KNOWN["volume_b"],
        }
    )


def _paths(values: np.ndarray) -> np.ndarray:
    """Numbers of the circuit, in the order of `free`, from those of FREE."""
    modulus, ratio, leakage, gain = np.moveaxis(np.asarray(values), -1, 0)
    return np.stack([modulus, ratio / (1.0 + ratio), leakage, gain * np.sqrt(7e6)], axis=-1)


def from_paths(values: np.ndarray) -> np.ndarray:
    """The numbers of FREE from those of the circuit."""
    modulus, air, leakage, flow = np.moveaxis(np.asarray(values), -1, 0)
    return np.stack([modulus, air / (1.0 - air), leakage, flow / np.sqrt(7e6)], axis=-1)


def free() -> list[jl.Free]:
    """The free parameters of the circuit."""
    names = ("fluid.bulk_modulus", "fluid.air_fraction", "motor.internal_leakage", "valve.rated_flow")
    bounds = zip(names, _paths(LOWEST), _paths(HIGHEST), strict=True)
    return [jl.Free(name, (float(low), float(high)), transform="log") for name, low, high in bounds]


def starts_of(task: Task) -> np.ndarray:
    """Start values in the circuit."""
    return _paths(task.starts)


def recordings(task: Task) -> list[jl.Recording]:
    """The recordings of jaxlines."""
    return [
        jl.Recording(axis.times, {"A.pressure": pressure, "spool": axis.command}, name=f"run {i}")
        for i, pressure in enumerate(task.pressure)
    ]


def local(task: Task) -> list[dict[str, float]]:
    """Start values of the states."""
    return [{f"initial.{name}": value for name, value in axis.initial().items()}] * len(task.pressure)
