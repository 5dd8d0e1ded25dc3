"""Models with known answers that the tests of sweeps share, behind the interface of an ensemble."""

import dataclasses
import time
from typing import Any

import numpy as np

from jaxlines.inference.distributions import Uniform
from jaxlines.inference.sweep_plan import AbstractModel
from jaxlines.inference.uncertain import Uncertain

FAILED = 3


@dataclasses.dataclass
class Lanes:
    """What a program returns."""

    outputs: dict[str, np.ndarray]
    reductions: dict[str, np.ndarray]
    status: np.ndarray
    error: np.ndarray


@dataclasses.dataclass(frozen=True)
class Analytic(AbstractModel):
    """y = f(x) and the series y sin(t); lanes whose first number is below `fails_below` fail."""

    function: str
    paths: tuple[str, ...]
    times: np.ndarray = dataclasses.field(default_factory=lambda: np.linspace(0.1, 1.0, 5))
    outputs: tuple[str, ...] = ()
    reductions: dict[str, Any] = dataclasses.field(default_factory=lambda: {"y": "value"})
    units: dict[str, str] = dataclasses.field(default_factory=lambda: {"y": "Pa", "wave": "Pa"})
    fails_below: float = -np.inf
    pause: float = 0.0
    low: float = -np.inf

    def full_paths(self, uncertain: Uncertain) -> dict[str, tuple[str, ...]]:
        found = {name: uncertain.paths(name) for name in uncertain.names}
        for path in (p for paths in found.values() for p in paths):
            if path not in self.paths:
                raise KeyError(f"no number is called {path!r}; did you mean {', '.join(self.paths)}?")
        return found

    def limits(self, path: str) -> tuple[float, float, str]:
        return self.low, np.inf, "1"

    def prepare(self, pilot: dict[str, np.ndarray], fixed: dict | None = None) -> "Program":
        return Program(self)


class Program:
    """Runs an analytic model."""

    def __init__(self, model: Analytic):
        self.model = model
        self.description = {"engine": "analytic", "steps": 1, "precision": "float64"}

    def run(self, varied: dict[str, np.ndarray]) -> Lanes:
        x = np.stack([varied[path] for path in self.model.paths], axis=1)
        time.sleep(self.model.pause)
        y = FUNCTIONS[self.model.function](x)
        failed = x[:, 0] < self.model.fails_below
        y = np.where(failed, np.nan, y)
        outputs = {name: y[:, None] * np.sin(self.model.times) for name in self.model.outputs}
        return Lanes(outputs, {n: y for n in self.model.reductions}, np.where(failed, FAILED, 0), np.zeros(len(y)))


def ishigami(x):
    """Ishigami and Homma (1990) with a = 7, b = 0.1."""
    return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


ISHIGAMI_VARIANCE = 7.0**2 / 8 + 0.1 * np.pi**4 / 5 + 0.1**2 * np.pi**8 / 18 + 0.5
ISHIGAMI_FIRST = np.array([0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 7.0**2 / 8, 0.0]) / ISHIGAMI_VARIANCE
_PAIR = 0.1**2 * np.pi**8 * (1 / 18 - 1 / 50) / ISHIGAMI_VARIANCE
ISHIGAMI_TOTAL = ISHIGAMI_FIRST + np.array([_PAIR, 0.0, _PAIR])
ISHIGAMI_PAIR = _PAIR

G_COEFFICIENTS = np.array([0.0, 1.0, 4.5, 9.0])


def g_function(x):
    """Sobol's g-function."""
    return np.prod((np.abs(4 * x - 2) + G_COEFFICIENTS) / (1 + G_COEFFICIENTS), axis=1)


_PARTS = 1 / (3 * (1 + G_COEFFICIENTS) ** 2)
G_VARIANCE = np.prod(1 + _PARTS) - 1
G_FIRST = _PARTS / G_VARIANCE
G_TOTAL = _PARTS * np.prod(1 + _PARTS) / (1 + _PARTS) / G_VARIANCE


def linear(x):
    """1 + x0 + 2 x1 + 3 x2 + ..."""
    return 1.0 + x @ (1.0 + np.arange(x.shape[1]))


FUNCTIONS = {"ishigami": ishigami, "g": g_function, "linear": linear}
ANGLES = Uncertain({name: Uniform(-np.pi, np.pi) for name in ("a", "b", "c")})
UNITS = Uncertain({name: Uniform(0.0, 1.0) for name in ("a", "b", "c", "d")})
