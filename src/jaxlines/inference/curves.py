"""What follows from fitted parameters: effective modulus and wave speed over pressure, with 95 % bands."""

import inspect
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxlines.inference.analysis import Analysis
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.parameters import Free
from jaxlines.inference.search import Found
from jaxlines.inference.uncertainty import UNINFORMED, Estimate, is_open
from jaxlines.physics.lines import Line
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.result import Simulation

CURVE_POINTS = 60
UNITS = {"effective_bulk_modulus": "Pa", "wave_speed": "m/s", "round_trip_time": "s", "line_constant": "N/m^5"}
UNITS |= {"volume": "m^3", "laminar_resistance": "Pa*s/m^3", "inertance": "Pa*s^2/m^3", "capacity": "kg/Pa"}


class Curve(NamedTuple):
    """Effective bulk modulus [Pa] and wave speed [m/s] of a line over pressure [Pa], with 95 % bands."""

    pressure: np.ndarray
    bulk_modulus: np.ndarray
    bulk_modulus_low: np.ndarray
    bulk_modulus_high: np.ndarray
    wave_speed: np.ndarray
    wave_speed_low: np.ndarray
    wave_speed_high: np.ndarray


def _with_sd(problem: JointProblem, found: Found, analysis: Analysis, function):
    """Value and standard deviation of function(circuit), by linear propagation, and whether the data leave it open.

    The circuit is that of the first recording. Slopes by central differences: the formulas are smooth, cheap and in
    float64 on the host, so that the error (about 1e-9 relative) does not matter and nothing has to be compiled.
    """
    trial, free, known = problem.trials[0], list(problem.columns[0]), list(problem.known_columns[0])
    places = [*free, *(len(problem.free) + k for k in known)]
    numbers = np.concatenate([found.values[free], trial.known_values])

    def evaluate(numbers) -> np.ndarray:
        changes = {}
        for number, parameter in zip(numbers, [*trial.free, *trial.known], strict=True):
            driven = parameter.path_ratios if isinstance(parameter, Free) else (1.0,)
            paths = parameter.paths if isinstance(parameter, Free) else (parameter.path,)
            for path, ratio in zip(paths, driven, strict=True):
                if path.partition(".")[0] in ("fluid", *trial.circuit.components):
                    changes[path] = number * ratio
        return np.asarray(function(trial.circuit.replace(changes, check=False)))

    value, steps = evaluate(numbers), np.concatenate([analysis.steps, np.ones(len(problem.known))])
    slopes = np.zeros((*value.shape, steps.size))
    for i, (number, place) in enumerate(zip(numbers, places, strict=True)):
        shift = np.zeros_like(numbers)
        shift[i] = 1e-5 * abs(number) if number else 1e-9
        slopes[..., place] = (evaluate(numbers + shift) - evaluate(numbers - shift)) / (2.0 * shift[i]) * steps[place]
    variance = np.einsum("...i,ij,...j->...", slopes, analysis.covariance.joint, slopes)
    open_parts = (slopes[..., : len(problem.free)] @ analysis.covariance.open_directions.T) ** 2 * UNINFORMED**2
    share = open_parts.sum(axis=-1) / np.maximum(variance, 1e-300)
    sd = np.sqrt(np.maximum(variance, 0.0))
    bounds_sd = UNINFORMED * np.linalg.norm(slopes[..., : len(problem.free)] * analysis.widths, axis=-1)
    return value, sd, np.vectorize(is_open)(share, sd, bounds_sd)


def _visited(simulations: Sequence[Simulation], line: Line) -> np.ndarray:
    """Pressures that the line's node visited in all recordings [Pa]."""
    return np.concatenate([np.asarray(simulation[f"{line.node}.pressure"]) for simulation in simulations])


def check_derived(circuit: Circuit, name: str) -> None:
    """Raise KeyError, with the names there are, when a derived number does not exist."""
    known = [f"{n}.{m}" for n, c in circuit.components.items() if isinstance(c, Line) for m in UNITS]
    if name not in known:
        raise KeyError(f"no derived number is called {name!r}; there are {', '.join(known)}")


def derived_estimate(
    problem: JointProblem, found: Found, analysis: Analysis, simulations: Sequence[Simulation], name: str
) -> Estimate:
    """A derived number such as "line.effective_bulk_modulus", at the median pressure of its node, with interval.

    Raises: KeyError when the component or the method does not exist.
    """
    circuit = problem.trials[0].circuit
    check_derived(circuit, name)
    owner, _, method = name.partition(".")
    component = circuit.components[owner]
    assert isinstance(component, Line)
    pressure = float(np.median(_visited(simulations, component)))
    needs = inspect.signature(getattr(component, method)).parameters

    def function(circuit):
        given = {"fluid": circuit.fluid, "p": pressure}
        return getattr(circuit.components[owner], method)(**{key: given[key] for key in needs})

    value, sd, left_open = _with_sd(problem, found, analysis, function)
    value, sd, unit = float(value), float(sd), UNITS.get(method, "1")
    note = f"at {pressure / 1e6:.4g} MPa" if "p" in needs else ""
    if any(parameter.local for parameter in problem.free) or any(t.recording.conditions for t in problem.trials):
        note = ", ".join(filter(None, [note, f"in {problem.trials[0].recording.name}"]))
    if left_open:
        return Estimate(value, None, None, unit, "unidentified", note)
    return Estimate(value, sd, (value - analysis.reach * sd, value + analysis.reach * sd), unit, "interval", note)


def line_curves(
    problem: JointProblem, found: Found, analysis: Analysis, simulations: Sequence[Simulation]
) -> dict[str, Curve]:
    """Curves of every line, as in the first recording, over the pressures it visited in all of them."""
    curves = {}
    for name, line in problem.trials[0].circuit.components.items():
        if (
            not isinstance(line, Line)
            or not simulations
            or any(simulation.status != "ok" for simulation in simulations)
        ):
            continue
        visited = _visited(simulations, line)
        pressure = np.geomspace(max(visited.min(), 1e3), max(visited.max(), 2e3), CURVE_POINTS)
        bands = []
        for method in ("effective_bulk_modulus", "wave_speed"):

            def function(circuit, method=method, name=name, pressure=pressure):
                return getattr(circuit.components[name], method)(circuit.fluid, pressure)

            value, sd, _ = _with_sd(problem, found, analysis, function)
            relative = analysis.reach * sd / value  # a band of a positive number is formed in its logarithm
            bands += [value, value * np.exp(-relative), value * np.exp(relative)]
        curves[name] = Curve(pressure, *bands)
    return curves
