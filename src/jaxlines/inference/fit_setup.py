"""From the arguments of a fit to one problem over all recordings."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxlines.inference.input_noise import InputNoise, known_of_inputs
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.loss import Loss
from jaxlines.inference.noise import Noise, as_noise, estimate_noise
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.problem import Problem, conditioned, make_problem, settled
from jaxlines.inference.recording import Recording
from jaxlines.inference.start_values import MeasuredStart, measured_starts
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import Method
from jaxlines.simulation.segments import undecided_lines, with_segments


class Numerics(NamedTuple):
    """How trajectories are computed: as the arguments of `fit` of these names."""

    method: Method
    tolerance: float
    precision: str
    interpolation: str


class Setup(NamedTuple):
    """A problem with first noise levels, the noise of its channels, and the start values that were measured.

    starts: (position among the known numbers, recording, start).
    """

    problem: JointProblem
    noise: dict[str, Noise]
    starts: tuple[tuple[int, int, MeasuredStart], ...]


def named_recordings(recording: Recording | Sequence[Recording]) -> tuple[Recording, ...]:
    """One or several recordings with names that differ. Raises TypeError or ValueError for anything else."""
    recordings = (recording,) if isinstance(recording, Recording) else tuple(recording)
    if not recordings or not all(isinstance(r, Recording) for r in recordings):
        raise TypeError(f"fit needs a Recording or a list of them, got {recording!r}")
    names = [r.name for r in recordings]
    if len(set(names)) == len(names):
        return recordings
    if len(set(names)) == 1:  # nobody named them
        names = [f"run {i + 1}" for i in range(len(names))]
        return tuple(dataclasses.replace(r, name=name) for r, name in zip(recordings, names, strict=True))
    twice = next(name for name in names if names.count(name) > 1)
    raise ValueError(f"two recordings are called {twice!r}: give each its own name")


def _segmented(circuit: Circuit, recordings, free, initial, interpolation: str) -> Circuit:
    """The circuit with numbers of segments that are enough for every recording, so that all share a program."""
    lines = undecided_lines(circuit)
    if not lines or len(recordings) == 1:
        return circuit
    chosen = dict.fromkeys(lines, 0)
    for recording in recordings:
        own, start = conditioned(circuit, recording, initial)
        done = settled(own, recording, start if isinstance(start, dict) else {}, free, interpolation)
        for name in chosen:
            chosen[name] = max(chosen[name], int(getattr(done.components[name], "segments")))  # noqa: B009
    return with_segments(circuit, chosen)


def make_setup(
    circuit: Circuit,
    recordings: tuple[Recording, ...],
    free: Sequence[Free],
    known: Sequence[Known],
    noise: dict,
    initial: dict | str | None,
    loss: Loss,
    input_noise: dict[str, InputNoise],
    numerics: Numerics,
) -> Setup:
    """Check the arguments of a fit and compile them. Raises as `fit` documents."""
    circuit = _segmented(circuit, recordings, free, initial, numerics.interpolation)
    known = [*known, *known_of_inputs(circuit, input_noise)]
    trials, measured = [], []
    for recording in recordings:
        own, start = conditioned(circuit, recording, initial)
        found: list[MeasuredStart] = []
        if isinstance(start, dict):
            start, found = measured_starts(own, recording, free, start)
        starting = [Known(f"initial.{s.name}", 1.0) for s in found]  # their noise is written in once it is known
        told = dataclasses.replace(recording, conditions=_without_initial(recording), initial=start)
        arguments = (numerics.method, numerics.tolerance, numerics.precision, numerics.interpolation)
        trials.append(make_problem(circuit, told, free, [*known, *starting], None, *arguments))
        measured.append(found)
    return _joined(trials, measured, len(known), noise, loss)


def _without_initial(recording: Recording) -> dict[str, float]:
    """The conditions that are no start values, which are in the table of those by now."""
    return {path: value for path, value in recording.conditions.items() if not path.startswith("initial.")}


def _joined(trials: list[Problem], measured, shared_known: int, noise: dict, loss: Loss) -> Setup:
    """Number the parameters of all recordings."""
    several, free, columns = len(trials) > 1, [], [[] for _ in trials]
    for k, parameter in enumerate(trials[0].free):
        owners = [[i] for i in range(len(trials))] if parameter.local else [list(range(len(trials)))]
        for owned in owners:
            name = parameter.label
            if parameter.local and several:
                name = f"{name} [{trials[owned[0]].recording.name}]"
            for i in owned:
                columns[i].append(len(free))
            free.append(dataclasses.replace(trials[owned[0]].free[k], name=name))
    known, known_columns, starts = list(trials[0].known[:shared_known]), [], []
    for i, trial in enumerate(trials):
        own = list(range(shared_known))
        for number, start in zip(trial.known[shared_known:], measured[i], strict=True):
            own.append(len(known))
            starts.append((len(known), i, start))
            known.append(number)
        known_columns.append(tuple(own))
    problem = JointProblem(
        trials=tuple(trials),
        free=tuple(free),
        columns=tuple(tuple(own) for own in columns),
        known=tuple(known),
        known_columns=tuple(known_columns),
        sigma=tuple(np.ones_like(trial.measured) for trial in trials),
        loss=loss,
    )
    for name in noise:
        if name not in problem.channels:
            raise ValueError(f"noise is given for {name!r}, which is not fitted; fitted: {', '.join(problem.channels)}")
    levels = {name: as_noise(noise.get(name), name) for name in problem.channels}
    return Setup(problem.with_sigma(first_levels(problem, levels)), levels, tuple(starts))


def _filled(levels: list[np.ndarray], problem: JointProblem) -> list[np.ndarray]:
    """Noise levels with those that a recording itself gives put in."""
    filled = []
    for level, trial in zip(levels, problem.trials, strict=True):
        for c, name in enumerate(trial.wanted):
            own = trial.recording.noise.get(name)
            if own is not None:
                level[:, c] = np.where(np.isfinite(own), own, level[:, c])
        filled.append(level)
    return filled


def first_levels(problem: JointProblem, noise: dict[str, Noise]) -> list[np.ndarray]:
    """Noise levels to begin with: what is given, else one per cent of the channel's range over all recordings."""
    levels = [np.empty_like(trial.measured) for trial in problem.trials]
    for name, of in noise.items():
        places = [(i, t.wanted.index(name)) for i, t in enumerate(problem.trials) if name in t.wanted]
        readings = [problem.trials[i].measured[problem.trials[i].used[:, c], c] for i, c in places]
        every = np.concatenate(readings)
        spread = float(np.ptp(every)) if every.size else 0.0
        guess = 0.01 * spread if spread > 0.0 else 1.0
        for i, c in places:
            if of.estimated:
                levels[i][:, c] = guess if of.absolute in (None, 0.0) else max(of.absolute, guess)
            else:
                readable = np.where(problem.trials[i].used[:, c], problem.trials[i].measured[:, c], 0.0)
                levels[i][:, c] = np.maximum(of.level(readable), 1e-3 * guess)
    return _filled(levels, problem)


def estimated_levels(problem: JointProblem, noise: dict[str, Noise], simulated) -> tuple[dict, list[np.ndarray]]:
    """The noise of every channel, and its levels, from what the simulated channels leave over.

    The parameters are shared out over the channels as degrees of freedom.
    """
    total = sum(int(trial.used.sum()) for trial in problem.trials)
    freedom = max(1.0 - len(problem.free) / total, 1.0 / total)
    levels, found = [np.empty_like(trial.measured) for trial in problem.trials], {}
    for name, of in noise.items():
        places = [(i, t.wanted.index(name)) for i, t in enumerate(problem.trials) if name in t.wanted]
        chosen = [_judged(problem.trials[i], c, name) for i, c in places]
        shown = np.concatenate([simulated[i][keep, c] for (i, c), keep in zip(places, chosen, strict=True)])
        measured = [problem.trials[i].measured[keep, c] for (i, c), keep in zip(places, chosen, strict=True)]
        errors = shown - np.concatenate(measured)
        floor = 1e-12 * max(float(np.max(np.abs(np.concatenate(measured)), initial=0.0)), 1e-300)
        found[name] = estimate_noise(of, errors, shown, freedom, problem.loss, floor)
        for i, c in places:
            known = dataclasses.replace(
                found[name], absolute=found[name].absolute or floor, relative=found[name].relative or 0.0
            )
            levels[i][:, c] = known.level(simulated[i][:, c])
    return found, _filled(levels, problem)


def _judged(trial: Problem, column: int, name: str) -> np.ndarray:
    """The used samples of a channel whose noise the recording does not give."""
    own = trial.recording.noise.get(name)
    return trial.used[:, column] if own is None else trial.used[:, column] & ~np.isfinite(own)


def with_measured_noise(setup: Setup, problem: JointProblem) -> JointProblem:
    """The problem with the noise of the channels as uncertainty of the start values taken from them."""
    known = list(problem.known)
    for position, recording, start in setup.starts:
        trial = problem.trials[recording]
        column = trial.wanted.index(start.channel)
        level = problem.sigma[recording][int(np.argmax(trial.used[:, column])), column]
        known[position] = dataclasses.replace(known[position], sd=float(level / abs(start.gain)))
    return dataclasses.replace(problem, known=tuple(known))
