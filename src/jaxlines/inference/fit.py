"""Fit a circuit to a recording: estimates, uncertainty, and what the recording cannot tell."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jaxlines.inference.analysis import Analysis, analyse, channel_fits, conditional_range, influences
from jaxlines.inference.curves import check_derived, derived_estimate, line_curves
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.problem import Problem, make_problem
from jaxlines.inference.recording import Recording
from jaxlines.inference.search import Failed, Found, estimate_sigma, search, start_points
from jaxlines.inference.uncertainty import p_value_text
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import make_method
from jaxlines.simulation.result import MESSAGES
from jaxlines.simulation.simulate import simulate

Progress = Callable[[str, float], None]


class MeasuredStart(NamedTuple):
    """A start value taken from the first usable sample of a channel; gain: of the sensor that shows it."""

    name: str
    channel: str
    value: float
    gain: float


def _measured_start(circuit: Circuit, recording: Recording, name: str) -> MeasuredStart | None:
    """The start value of a quantity from the channel that shows it, or from a sensor that reads it."""
    shown = {name: (0.0, 1.0)}
    for sensor_name, sensor in circuit.sensors().items():
        if sensor.quantity_read() == name and sensor.quantity_subtracted() is None:
            zero, slope = float(sensor.read(0.0, circuit.fluid)), float(sensor.slope(circuit.fluid))
            shown[sensor_name] = (zero, slope)
    for channel, (zero, slope) in shown.items():
        if channel in recording.channels and recording.mask[channel].any() and slope != 0.0:
            first = float(recording.channels[channel][np.argmax(recording.mask[channel])])
            return MeasuredStart(name, channel, (first - zero) / slope, slope)
    return None


def _measured_starts(circuit: Circuit, recording: Recording, free, initial: dict) -> tuple[dict, list[MeasuredStart]]:
    """Start pressures taken from the recording, where they are neither free nor given."""
    initial, starts = dict(initial), []
    taken = {path for parameter in free for path in parameter.paths}
    for node, domain in circuit.nodes().items():
        name = f"{node}.pressure"
        wanted = initial.get(name) == "measured"
        implied = name not in initial and f"initial.{name}" not in taken
        if domain != "hydraulic" or node in circuit.fixed_nodes() or not (wanted or implied):
            continue
        start = _measured_start(circuit, recording, name)
        if start is not None:
            initial[name] = start.value
            starts.append(start)
        elif wanted:
            raise ValueError(f'initial {name} cannot be "measured": the recording has no usable channel that shows it')
    return initial, starts


def _first_sigma(problem: Problem, noise: dict[str, float]) -> np.ndarray:
    """Given noise levels, else one per cent of the channel's range to begin with."""
    measured = np.where(problem.used, problem.measured, np.nan)
    spread = np.nanmax(measured, axis=0) - np.nanmin(measured, axis=0)
    guess = np.where(spread > 0, 0.01 * spread, 1.0)
    return np.array([noise.get(name, guess[i]) for i, name in enumerate(problem.wanted)])


def _check_noise(problem: Problem, noise: dict[str, float]) -> None:
    """Raise for noise of an unknown channel or a level that is not positive."""
    for name, level in noise.items():
        if name not in problem.wanted:
            raise ValueError(f"noise is given for {name!r}, which is not fitted; fitted: {', '.join(problem.wanted)}")
        if not (np.isfinite(level) and level > 0):
            raise ValueError(f"noise of {name} must be positive, got {level:g}")


def _best_of(problem: Problem, sigma, starts: np.ndarray, say: Progress) -> tuple[Found, int, list[str]]:
    """The best end point of several searches, the number of evaluations, and what went wrong on the way."""
    found: list[Found] = []
    trouble, evaluations = [], 0
    for number, start in enumerate(starts):

        def report(count, cost, number=number):
            share = (number + 1.0 - np.exp(-count / 15.0)) / len(starts)
            say(f"start {number + 1} of {len(starts)}, evaluation {count}, cost {cost:.5g}", 0.9 * share)

        try:
            found.append(search(problem, start, sigma, report))
            evaluations += found[-1].num_evaluations
        except Failed as failure:
            trouble.append(f"start {number + 1}: {failure}")
    if not found:
        raise Failed("; ".join(trouble))
    best = min(found, key=lambda f: f.cost)
    agree = sum(f.cost < best.cost * (1 + 1e-3) + 1e-9 for f in found)
    if len(starts) > 1:
        trouble.append(f"{agree} of {len(starts)} starts reached the best optimum")
    return best, evaluations, trouble


def _settle_noise(problem: Problem, best: Found, noise: dict, say: Progress) -> tuple[Found, np.ndarray, int]:
    """Estimate unknown noise levels and repeat the search until their ratios settle (one channel: at once)."""
    evaluations = 0
    sigma = _first_sigma(problem, noise)
    for _ in range(6):
        fresh = estimate_sigma(problem, best.simulated)
        fresh = np.array([noise.get(name, fresh[i]) for i, name in enumerate(problem.wanted)])
        ratio = (fresh / sigma) / (fresh / sigma)[0]
        settled = bool(np.all(np.abs(ratio - 1.0) < 0.02)) and not noise
        sigma = fresh
        if settled or len(problem.wanted) == 1:
            break
        best = search(
            problem, best.coordinates, sigma, lambda n, c: say(f"noise levels, evaluation {n}, cost {c:.5g}", 0.9)
        )
        evaluations += best.num_evaluations
    return best, sigma, evaluations


def fit(
    circuit: Circuit,
    recording: Recording,
    *,
    free: Sequence[Free],
    known: Sequence[Known] = (),
    noise: dict[str, float] | None = None,
    initial: dict | None = None,
    derived: Sequence[str] = (),
    starts: int = 1,
    seed: int = 0,
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 100_000,
    precision: str = "float64",
    interpolation: str = "linear",
    progress: Progress | None = None,
) -> Fit:
    """Fit a circuit to a recording by bounded nonlinear least squares with an exact Jacobian.

    Main arguments:
        circuit: the model; its external inputs are driven by channels of the same names.
        recording: measured channels; those that are outputs of the circuit are fitted.
        free: what to estimate.
        known: numbers held fixed whose standard uncertainty is carried into the result.

    Other arguments:
        noise: channel -> standard deviation in SI; estimated from the residuals where it is not given.
        initial: potential or state -> start value in SI, or "measured" (the first usable sample, with the noise
            of its channel as uncertainty; the default for a node whose pressure is a channel and not free).
        derived: numbers to report with uncertainty, such as "line.effective_bulk_modulus" (at the median pressure).
        starts: number of searches: the given start, then points of a Sobol sequence (`seed`) within the bounds.
        solver, tolerance, max_steps, precision: as in `simulate`.
        interpolation: between samples of the input channels: "linear", "cubic" or "hold".
        progress: called with a text and a fraction done while the fit works.

    Returns: a `Fit`; print it. Failure to fit is a status, not an exception.
    Raises: ValueError, KeyError or TypeError for a wrong call, before any work is done.
    """
    began = time.perf_counter()
    say = progress or (lambda text, fraction: None)
    if starts < 1:
        raise ValueError(f"starts must be at least 1, got {starts}")
    for name in derived:
        check_derived(circuit, name)
    initial, measured = _measured_starts(circuit, recording, free, initial or {})
    method = make_method(solver, "forward", max_steps)
    say("compiling the model", 0.0)
    starting = [Known(f"initial.{s.name}", 1.0) for s in measured]  # their noise is written in once it is known
    problem = make_problem(
        circuit, recording, free, [*known, *starting], initial, method, tolerance, precision, interpolation
    )
    noise = dict(noise or {})
    _check_noise(problem, noise)
    try:
        best, count, remarks = _best_of(problem, _first_sigma(problem, noise), start_points(problem, starts, seed), say)
        best, sigma, more = _settle_noise(problem, best, noise, say)
    except Failed as failure:
        return Fit.failure(circuit, str(failure), time.perf_counter() - began)
    say("uncertainty", 0.92)
    problem = _with_measured_noise(problem, measured, sigma)
    analysis = analyse(problem, best, sigma)
    return _result(problem, best, sigma, analysis, derived, remarks, count + more, began, noise)


def _with_measured_noise(problem: Problem, starts: list[MeasuredStart], sigma: np.ndarray) -> Problem:
    """The problem with the noise of the channels as uncertainty of the start values taken from them."""
    level = dict(zip(problem.wanted, sigma, strict=True))
    noise = {f"initial.{s.name}": float(level[s.channel] / abs(s.gain)) for s in starts}
    known = tuple(dataclasses.replace(k, sd=noise.get(k.path, k.sd)) for k in problem.known)
    return dataclasses.replace(problem, known=known)


def _result(problem: Problem, best: Found, sigma, analysis: Analysis, derived, remarks, count, began, noise) -> Fit:
    """Put the result together."""
    fitted, initial, inputs = problem.with_numbers(best.values)
    channels = channel_fits(problem, best, sigma)
    simulation = simulate(
        fitted,
        problem.recording.times,
        inputs,
        initial=initial,
        solver=problem.method.solver,
        tolerance=problem.tolerance,
        max_steps=problem.method.max_steps,
        precision=problem.precision,
        throw=False,
    )
    curves = line_curves(problem, best, analysis, simulation)
    parameters, conditional = conditional_range(problem, best, sigma, analysis.estimates)
    warnings = [*problem.recording.warnings, *remarks, *conditional, *analysis.warnings]
    for name, channel in channels.items():
        if not channel.white:
            warnings.append(
                f"residuals of {name} are not white (Ljung-Box {p_value_text(channel.whiteness_p)}): the model misses "
                "something that the recording shows, and the intervals are too narrow"
            )
        if name in noise and not 0.5 < channel.rmse / noise[name] < 2.0:
            warnings.append(f"residuals of {name} are {channel.rmse / noise[name]:.2g} times the noise that was given")
    usable = simulation.status in ("ok", "tension")
    if simulation.status == "tension":
        warnings.append(f"at the optimum {MESSAGES['tension']}")
    validity = simulation.validity() if usable else None
    return Fit(
        status=best.status if usable else "failed",
        message=best.message if usable else f"simulation at the optimum: {MESSAGES[simulation.status]}",
        parameters=parameters,
        derived={name: derived_estimate(problem, best, analysis, simulation, name) for name in derived},
        correlations=analysis.correlations,
        channels=channels,
        curves=curves,
        identifiability=analysis.identifiability,
        scale=influences(problem, best, sigma, analysis),
        singular_values=analysis.covariance.singular_values,
        warnings=tuple(warnings),
        validity=validity,
        circuit=fitted,
        initial=initial,
        num_evaluations=count,
        seconds=time.perf_counter() - began,
    )
