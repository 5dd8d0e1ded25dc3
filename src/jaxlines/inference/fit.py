"""Fit a circuit to recordings: estimates, uncertainty, and what the recordings cannot tell."""

import functools
import time
from collections.abc import Callable, Sequence

import numpy as np

from jaxlines.inference.analysis import ChannelFit, analyse, channel_fits
from jaxlines.inference.checkpoint import Memory, open_memory, problem_key
from jaxlines.inference.curves import check_derived, derived_estimate, line_curves
from jaxlines.inference.fit_result import Fit, FittedRun
from jaxlines.inference.fit_setup import (
    Numerics,
    Setup,
    estimated_levels,
    make_setup,
    named_recordings,
    with_measured_noise,
)
from jaxlines.inference.influences import conditional_range, influences
from jaxlines.inference.input_noise import InputNoise, as_input_noise
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.loss import Loss
from jaxlines.inference.noise import Noise
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.recording import Recording
from jaxlines.inference.recording_faults import find_faults
from jaxlines.inference.scatter import scatter_of
from jaxlines.inference.search import Failed, Found, search
from jaxlines.inference.shooting import search_in_windows
from jaxlines.inference.shooting_windows import cut_recordings
from jaxlines.inference.starts import Start, best_of, start_points
from jaxlines.inference.uncertainty import WHITE_LIMIT, p_value_text
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import make_method
from jaxlines.simulation.result import MESSAGES, Simulation
from jaxlines.simulation.simulate import simulate

Progress = Callable[[str, float], None]

_ROUNDS = 12
"""At most this many times are noise levels and parameters estimated in turn."""


def _settle_noise(
    problem: JointProblem,
    best: Found,
    noise: dict[str, Noise],
    memory: Memory,
    say: Progress,
    find: Callable[..., Found],
) -> tuple[JointProblem, Found, dict[str, Noise], int]:
    """Estimate unknown noise levels, take relative ones of what is simulated, and search again until both settle.

    Without priors, given levels or a robust loss only their ratios matter, so that one channel is done at once.
    """
    evaluations, levels = 0, dict(noise)
    given = any(not (of.absolute is None and of.uniform) for of in noise.values())
    given |= any(trial.recording.noise for trial in problem.trials)
    scaled = given or problem.loss.kind != "gauss" or problem.prior_residuals(best.values).size > 0
    if all(not of.estimated and of.uniform for of in noise.values()):
        return problem, best, levels, 0
    for turn in range(_ROUNDS):
        levels, fresh = estimated_levels(problem, noise, best.simulated)
        parts = zip(fresh, problem.sigma, problem.trials, strict=True)
        ratio = np.concatenate([(f / s)[trial.used] for f, s, trial in parts])
        change = np.max(np.abs(ratio / (1.0 if scaled else ratio[0]) - 1.0))
        problem = problem.with_sigma(fresh)
        settled = change < (1e-3 if scaled else 0.02)
        if settled or (not scaled and len(noise) == 1):
            break

        def report(count, cost):
            say(f"noise levels, evaluation {count}, cost {cost:.5g}", 0.9)

        again = search if best.followed else find
        best = again(problem, best.coordinates, report, stage=f"noise {turn}", memory=memory)
        evaluations += best.num_evaluations
    return problem, best, levels, evaluations


def _faults(problem: JointProblem) -> list[str]:
    """What looks wrong with the recordings, beside a simulation at the start. Raises ValueError for a grave fault."""
    warnings = []
    for trial, simulated in zip(problem.trials, problem.predict(problem.to_values(problem.start)), strict=True):
        shown = {name: simulated[:, i] for i, name in enumerate(trial.wanted)}
        for fault in find_faults(trial.recording, shown, dict(zip(trial.wanted, trial.units, strict=True))):
            if fault.grave:
                raise ValueError(f"{fault.text} (fit(..., check=False) goes on all the same)")
            if fault.kind == "gap" and any("gap of" in said for said in trial.recording.warnings):
                continue  # said where the file was read
            warnings.append(fault.text)
    return warnings


def fit(
    circuit: Circuit,
    recording: Recording | Sequence[Recording],
    *,
    free: Sequence[Free],
    known: Sequence[Known] = (),
    noise: dict | None = None,
    initial: dict | str | None = None,
    derived: Sequence[str] = (),
    loss: str = "gauss",
    loss_scale: float | None = None,
    input_noise: dict | None = None,
    starts: int = 1,
    windows: int = 1,
    sampling: str = "sobol",
    seed: int = 0,
    checkpoint=None,
    check: bool = True,
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 100_000,
    precision: str = "float64",
    interpolation: str = "linear",
    progress: Progress | None = None,
) -> Fit:
    """Fit a circuit to one or several recordings by bounded nonlinear least squares with an exact Jacobian.

    Main arguments:
        circuit: the model; its external inputs are driven by channels of the same names.
        recording: measured channels; those that are outputs of the circuit are fitted. A list of them is fitted
            together: each has its own inputs, length, start values and `conditions`; parameters are shared unless
            they are `Free(..., local=True)`.
        free: what to estimate: numbers of the circuit, start values ("initial.A.pressure"), gain, offset, lag and delay
            of sensors, and "spool.delay", "spool.gain", "spool.offset" of a recorded input `spool`.
        known: numbers held fixed whose standard uncertainty is carried into the result.

    Other arguments:
        noise: channel -> standard deviation in SI, or a `Noise` (absolute, relative); estimated where not given.
        initial: potential or state -> start value in SI, or "measured" (the first usable sample, with the noise
            of its channel as uncertainty; the default for a node whose pressure is a channel and not free); "steady":
            every recording starts in the steady state of its first inputs, which moves with the parameters.
        derived: numbers to report with uncertainty, such as "line.effective_bulk_modulus" (at the median pressure).
        loss, loss_scale: "gauss", "huber" or "student", see `Loss`; the last two bear outliers.
        input_noise: input -> standard deviation of its samples, or an `InputNoise` (white, gain, offset), carried into
            the result.
        starts, sampling, seed: number of searches: the given start, then points of a "sobol" sequence or a "latin"
            hypercube within the bounds; `Fit.starts` says where each ended.
        windows: in how many parts each recording is cut for the search (multiple shooting), for oscillating, long or
            chaotic recordings that a trajectory from the start soon has nothing in common with: each part shorter
            than half a period, or than the time in which chaos doubles errors a few times. Not with sampled
            controllers or delays of sensors. See `shooting.search_in_windows`.
        checkpoint: a file that is written at every accepted iterate; if it is there, the fit goes on from it.
        check: look for faults of the recordings first (see `find_faults`); a grave one is an error.
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
    say("compiling the model", 0.0)
    numerics = Numerics(make_method(solver, "forward", max_steps), tolerance, precision, interpolation)
    inputs, recordings = as_input_noise(input_noise), named_recordings(recording)
    shape = Loss(loss, loss_scale)
    setup = make_setup(circuit, recordings, free, known, dict(noise or {}), initial, shape, inputs, numerics)
    find = search
    if windows != 1:
        cut_recordings(setup.problem, windows)
        find = functools.partial(search_in_windows, windows=windows)
    points = start_points(setup.problem, starts, seed, sampling)
    memory = open_memory(checkpoint, problem_key(setup.problem, setup.noise, inputs, points.tolist(), windows))
    faults = _faults(setup.problem) if check else []
    try:
        best, table, remarks = best_of(setup.problem, points, memory, say, find)
        problem, best, levels, more = _settle_noise(setup.problem, best, setup.noise, memory, say, find)
    except Failed as failure:
        return Fit.failure(circuit, str(failure), time.perf_counter() - began)
    memory.write()
    say("uncertainty", 0.92)
    problem = with_measured_noise(setup, problem)
    count = sum(start.num_evaluations for start in table) + more
    said = [*faults, *remarks]
    return _result(problem, best, setup, levels, inputs, derived, said, table, memory, count, began)


def _simulations(problem: JointProblem, best: Found) -> list[tuple[FittedRun, Simulation]]:
    """Every recording simulated anew with the fitted numbers, by the public way."""
    runs = []
    for i, trial in enumerate(problem.trials):
        fitted, initial, inputs = trial.with_numbers(problem.own(i, best.values))
        simulation = simulate(
            fitted,
            trial.recording.times,
            inputs,
            initial=initial,
            solver=trial.method.solver,
            tolerance=trial.tolerance,
            max_steps=trial.method.max_steps,
            precision=trial.precision,
            throw=False,
        )
        usable = simulation.status in ("ok", "tension")
        validity = simulation.validity() if usable else None
        runs.append((FittedRun(trial.recording.name, fitted, initial, inputs, simulation.status, validity), simulation))
    return runs


def _warnings(channels: dict[str, ChannelFit], noise: dict[str, Noise], loss: Loss) -> list[str]:
    """What the residuals say against the model or the noise that was given."""
    warnings = []
    bear = "the intervals bear correlated noise, not a wrong model"
    bear = bear if loss.kind == "gauss" else "the loss takes them to be, and the intervals are too narrow"
    for name, channel in channels.items():
        if channel.whiteness_p <= WHITE_LIMIT:
            warnings.append(
                f"residuals of {name} are not white (Ljung-Box {p_value_text(channel.whiteness_p)}): the model misses "
                f"something that the recording shows; {bear}"
            )
        of = noise[name.partition(" [")[0]]
        if loss.kind == "gauss" and not of.estimated and not 0.5 < channel.rmse / channel.sigma < 2.0:
            ratio = channel.rmse / channel.sigma
            warnings.append(f"residuals of {name} are {ratio:.2g} times the noise that was given")
    return warnings


def _status(problem: JointProblem, best: Found, runs) -> tuple[str, str, list[str]]:
    """Status and message after the second simulation, and what it says."""
    warnings = []
    parts = zip(runs, problem.trials, best.simulated, problem.sigma, strict=True)
    for (run, simulation), trial, shown, sigma in parts:
        where = f"{run.name}: " if len(runs) > 1 else ""
        if run.validity is None:
            return "failed", f"{where}simulation at the optimum: {MESSAGES[run.status]}", warnings
        if run.status == "tension":
            warnings.append(f"{where}at the optimum {MESSAGES['tension']}")
        again = np.stack([np.asarray(simulation[name]) for name in trial.wanted], axis=1)
        apart = float(np.max(np.abs(again - shown)[trial.used] / sigma[trial.used], initial=0.0))
        if apart > 1.0:
            so = "lower the tolerance" if best.followed else "what is simulated with the fitted numbers is no guide"
            warnings.append(
                f"{where}a second simulation at the optimum differs by up to {apart:.2g} noise levels: {so}"
            )
    return best.status, best.message, warnings


def _result(
    problem: JointProblem,
    best: Found,
    setup: Setup,
    noise: dict[str, Noise],
    input_noise: dict[str, InputNoise],
    derived: Sequence[str],
    remarks: list[str],
    table: list[Start],
    memory: Memory,
    count: int,
    began: float,
) -> Fit:
    """Put the result together."""
    analysis = analyse(problem, best, input_noise, known_levels=not any(of.estimated for of in setup.noise.values()))
    channels = channel_fits(problem, best)
    runs = _simulations(problem, best)
    status, message, seen = _status(problem, best, runs)
    simulations = [simulation for _, simulation in runs if simulation.status in ("ok", "tension")]
    parameters, conditional = conditional_range(problem, best, analysis.estimates, memory)
    warnings = [w for trial in problem.trials for w in trial.recording.warnings]
    warnings += [*remarks, *conditional, *analysis.warnings, *_warnings(channels, setup.noise, problem.loss), *seen]
    first = runs[0][0]
    return Fit(
        status=status,
        message=message,
        parameters=parameters,
        derived={name: derived_estimate(problem, best, analysis, simulations, name) for name in derived if simulations},
        correlations=analysis.correlations,
        channels=channels,
        curves=line_curves(problem, best, analysis, simulations),
        identifiability=analysis.identifiability,
        scale=influences(problem, best, analysis),
        singular_values=analysis.covariance.singular_values,
        warnings=tuple(dict.fromkeys(warnings)),
        validity=next((run.validity for run, _ in runs if run.validity and not run.validity.ok), first.validity),
        circuit=first.circuit,
        initial=first.initial if isinstance(first.initial, dict) else {},
        num_evaluations=count,
        seconds=time.perf_counter() - began,
        runs=tuple(run for run, _ in runs),
        starts=tuple(table),
        noise=noise,
        log_likelihood=problem.log_likelihood(best.simulated),
        analysis=analysis,
        scatter=scatter_of(problem, best),
        problem=problem,
        coordinates=best.coordinates,
    )
