"""What can be said of a study before any fit: units, guesses, validity, identifiability, gradients, run time."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxlines.edge.display import readable, readable_unit
from jaxlines.edge.study import Study
from jaxlines.inference.fit_setup import Numerics, make_setup, named_recordings
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.loss import Loss
from jaxlines.inference.parameter_checks import number_metadata
from jaxlines.inference.parameters import Free
from jaxlines.inference.recording import Recording
from jaxlines.inference.recording_faults import find_faults
from jaxlines.inference.uncertainty import covariance, describe_correlations, describe_open_directions
from jaxlines.simulation.integration import make_method

GOOD, NOTE, DOUBT, STOP = "good", "note", "doubt", "stop"
RANK_LIMIT = 1e-8
"""Scaled singular value below which a direction is not identifiable at all, whatever the noise."""

GRADIENT_LIMIT = 0.02
EVALUATIONS = (8, 40)
"""Evaluations that a search usually takes from one start: a quick one and a slow one."""

Say = Callable[[str, float], None]


class Finding(NamedTuple):
    """One thing that a check found. Fields: topic; level: "good", "note", "doubt" or "stop"; text."""

    topic: str
    level: str
    text: str


@dataclasses.dataclass(frozen=True)
class _Local:
    """What a fit of a study would minimise, without the rows of priors. Fields: problem; rows: those of recordings."""

    problem: JointProblem
    rows: np.ndarray

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters, local ones once a recording."""
        return self.problem.free

    @property
    def widths(self) -> np.ndarray:
        """Widths of the bounds in search coordinates."""
        return self.problem.upper - self.problem.lower

    def predictions(self, coordinates) -> np.ndarray:
        """Simulated minus measured samples over their noise, shape (rows,)."""
        return self.problem.residuals(coordinates)[self.rows]

    def jacobian(self, coordinates) -> np.ndarray:
        """Their slopes by search coordinates, shape (rows, parameters); exact."""
        return self.problem.jacobian(coordinates)[self.rows]


def _recordings(study: Study) -> list[Recording]:
    """The recordings of a study."""
    return list(study.recordings) or ([study.recording] if study.recording is not None else [])


def _local(study: Study) -> _Local:
    """What a fit of a study would minimise, its noise that of the study or 1 % of the range of a channel."""
    options = dict(study.numerics)
    method = make_method(options.get("solver"), "forward", options["max_steps"])
    numerics = Numerics(method, options["tolerance"], options["precision"], "linear")
    given = (study.free, study.known, dict(study.noise), "steady" if study.steady else study.initial)
    setup = make_setup(study.circuit, named_recordings(_recordings(study)), *given, Loss("gauss", None), {}, numerics)
    return _Local(setup.problem, setup.problem.recording >= 0)


def _check_text(study: Study) -> list[Finding]:
    """Guesses that are still marked in the file."""
    path = Path(study.source)
    if not path.is_file():
        return []
    marked = [i for i, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1) if "# CHECK" in line]
    if not marked:
        return []
    lines = ", ".join(map(str, marked[:12])) + (", ..." if len(marked) > 12 else "")
    return [
        Finding("guesses", DOUBT, f"{len(marked)} lines are marked CHECK ({lines}): replace the guesses, then the mark")
    ]


def _check_units(study: Study) -> list[Finding]:
    """The ranges of the channels as they were understood, and what looks odd about them."""
    known, found = {**study.names.outputs, **study.names.inputs}, []
    for recording in _recordings(study):
        for name, values in recording.channels.items():
            unit, used = known.get(name, {"unit": ""})["unit"], values[recording.mask[name]]
            level = " absolute" if unit == "Pa" else ""
            found.append(Finding("units", GOOD, f"{name}: {readable(unit, used.min(), used.max())}{level}"))
        found += [Finding("units", DOUBT, warning) for warning in recording.warnings]
    return found


def _worth_of(local: _Local, jacobian: np.ndarray) -> list[str]:
    """How well each parameter would be known at a point, in words, by the noise assumed."""
    widths = local.widths
    found = covariance(jacobian, np.zeros((jacobian.shape[0], 0)), widths, np.zeros(0))
    sds = np.sqrt(np.diag(found.joint))
    sentences = []
    for parameter, sd, share in zip(local.free, sds, sds / widths, strict=True):
        if share > 0.25:
            sentences.append(f"{parameter.label}: hardly better than its bounds")
        elif parameter.transform == "log":
            sentences.append(f"{parameter.label}: to about {100 * sd:.2g} %")
        else:
            label, factor = readable_unit(_unit(local, parameter), float(np.max(np.abs(parameter.bounds))))
            slope = float(parameter.slope(parameter.to_value(parameter.start_coordinate())))
            sentences.append(f"{parameter.label}: to about {sd * slope * factor:.2g} {label}".rstrip())
    return sentences


def _unit(local: _Local, parameter: Free) -> str:
    """The SI unit of a parameter."""
    return number_metadata(local.problem.trials[0].circuit, parameter.paths[0]).get("unit", "1")


def _identifiability(local: _Local, jacobian: np.ndarray, points: int, seed: int) -> list[Finding]:
    """Scaled singular values at the start and at random points, and what they mean."""
    from scipy.stats import qmc

    labels, widths = [f.label for f in local.free], local.widths
    # Away from the very edges, where models degenerate (no air, no leak).
    samples = qmc.LatinHypercube(len(labels), rng=np.random.default_rng(seed)).random(points)
    jacobians = [jacobian]
    for sample in samples:
        found = local.jacobian(local.problem.lower + widths * (0.1 + 0.8 * sample))
        if np.all(np.isfinite(found)):
            jacobians.append(found)
    spectra = np.array([np.linalg.svd(j * widths, compute_uv=False) for j in jacobians])
    relative = spectra / spectra[:, :1]
    shown = ", ".join(f"{value:.2g}" for value in relative[0])
    findings = [
        Finding("identifiability", NOTE, f"scaled singular values at the start: {shown}, of {spectra[0, 0]:.3g}")
    ]
    lost = (relative < RANK_LIMIT).sum(axis=1)
    if np.all(lost > 0):
        text = (
            f"at all {len(jacobians)} points tried, {lost.min()} combination(s) of the free numbers change nothing: "
            "the model itself cannot tell them, whatever is recorded: hold one of them"
        )
        findings.append(Finding("identifiability", STOP, text))
    found = covariance(jacobian, np.zeros((jacobian.shape[0], 0)), widths, np.zeros(0))
    sd = np.sqrt(np.diag(found.joint))
    correlations = found.joint / np.outer(sd, sd)
    findings += [Finding("identifiability", DOUBT, text) for text in describe_open_directions(labels, found, widths)]
    findings += [Finding("identifiability", NOTE, text) for text in describe_correlations(labels, correlations, 0.98)]
    findings += [Finding("expected", NOTE, text) for text in _worth_of(local, jacobian)]
    if len(jacobians) <= points:
        text = f"{points + 1 - len(jacobians)} of {points} random points within the bounds cannot be simulated"
        findings.append(Finding("identifiability", DOUBT, text))
    return findings


def gradient_errors(local, start: np.ndarray, jacobian: np.ndarray, share: float = 1e-3) -> np.ndarray:
    """Largest difference of each column of an exact Jacobian from central differences, relative to that column.

    Args: local: with `predictions` and `widths`; start: coordinates; jacobian there; share of the widths as step.
    Two steps are combined (Richardson), so that the differences are of fourth order in the step.
    """
    errors = np.empty(len(start))
    for i, width in enumerate(local.widths):
        slopes = []
        for step in (share * width, 0.5 * share * width):
            shift = np.zeros(len(start))
            shift[i] = step
            slopes.append((local.predictions(start + shift) - local.predictions(start - shift)) / (2.0 * step))
        difference = (4.0 * slopes[1] - slopes[0]) / 3.0 - jacobian[:, i]
        errors[i] = np.linalg.norm(difference) / max(np.linalg.norm(jacobian[:, i]), 1e-300)
    return errors


def _gradients(local: _Local, start: np.ndarray, jacobian: np.ndarray) -> list[Finding]:
    """Whether the exact slopes agree with differences."""
    sensitive = np.linalg.norm(jacobian * local.widths, axis=0) > 1e-6
    errors = np.where(sensitive, gradient_errors(local, start, jacobian), 0.0)
    worst = int(np.argmax(errors))
    label = local.free[worst].label
    if errors[worst] < GRADIENT_LIMIT:
        return [Finding("gradients", GOOD, f"exact slopes agree with differences within {errors[worst]:.1g} ({label})")]
    text = (
        f"the slope of {label} differs from differences by {100 * errors[worst]:.2g} %: jumps in the model or a loose "
        "tolerance; try a tighter [numerics] tolerance or the implicit solver"
    )
    return [Finding("gradients", DOUBT, text)]


def _faults(local: _Local, start: np.ndarray) -> list[Finding]:
    """What looks wrong with the recordings beside a simulation at the start: swapped units, dead channels."""
    found, problem = [], local.problem
    for trial, simulated in zip(problem.trials, problem.predict(problem.to_values(start)), strict=True):
        shown = {name: simulated[:, i] for i, name in enumerate(trial.wanted)}
        for fault in find_faults(trial.recording, shown, dict(zip(trial.wanted, trial.units, strict=True))):
            if fault.kind != "gap" or not any("gap of" in said for said in trial.recording.warnings):
                found.append(Finding("recordings", STOP if fault.grave else DOUBT, fault.text))
    return found


def _run_time(study: Study, compiling: float, evaluation: float) -> Finding:
    """What a fit will take here, from one timed evaluation."""
    starts = int(study.fit_options.get("starts", 1))
    low, high = (compiling + evaluation * count * starts for count in EVALUATIONS)
    text = (
        f"about {low:.2g} to {high:.2g} s on this machine ({compiling:.2g} s to compile once, {1e3 * evaluation:.3g} "
        f"ms an evaluation, {starts} start{'s' * (starts > 1)})"
    )
    return Finding("run time", NOTE, text)


def _check_fit(study: Study, points: int, seed: int, say: Say) -> list[Finding]:
    """Identifiability, gradients and run time at the start of the search."""
    local = _local(study)
    inner = 1e-3 * local.widths
    start = np.array([np.clip(f.start_coordinate(), *f.coordinate_bounds()) for f in local.free])
    lows, highs = local.problem.bounds
    start = np.clip(start, lows + 2.0 * inner, highs - 2.0 * inner)  # room for differences
    say("compiling the sensitivities", 0.4)
    began = time.perf_counter()
    jacobian = local.jacobian(start)
    compiling = time.perf_counter() - began
    if not np.all(np.isfinite(jacobian)):
        reason = local.problem.why_it_fails(local.problem.to_values(start))
        return [Finding("start", STOP, f"the simulation fails where the search would start: {reason}")]
    began = time.perf_counter()
    local.jacobian(start)
    evaluation = time.perf_counter() - began
    say("identifiability", 0.6)
    found = [*_faults(local, start), *_identifiability(local, jacobian, points, seed)]
    say("gradients", 0.8)
    found += _gradients(local, start, jacobian)
    return [*found, _run_time(study, max(compiling - evaluation, 0.0), evaluation)]


def check_study(study: Study, *, points: int = 5, seed: int = 0, say: Say | None = None) -> list[Finding]:
    """What can be said of a study before any fit.

    Args: study; points: random points within the bounds at which identifiability is looked at; seed; say: progress.
    Returns: findings on guesses left in the file, units, the validity of the lumped model, identifiability (singular
        values of the Jacobian, each parameter scaled by the width of its bounds, each channel by its noise or 1 % of
        its range), precision to expect, exact slopes against central differences, and the run time of a fit.
    Raises: as `simulate`.
    Validity: local: a nonlinear model may tell two numbers apart elsewhere; hence the random points.
    """
    say = say or (lambda text, fraction: None)
    found = [*_check_text(study), *_check_units(study)]
    say("simulating", 0.1)
    simulation = study.simulate(on_recording=True)
    level = GOOD if simulation.status == "ok" else DOUBT
    found += [Finding("validity", level, text) for text in simulation.validity().sentences()]
    if study.free and _recordings(study):
        found += _check_fit(study, points, seed, say)
    return found


def show_findings(findings: list[Finding]) -> None:
    """Print findings by topic, doubts marked."""
    import sys

    from rich.console import Console
    from rich.markup import escape

    from jaxlines.edge.display import readable_text

    console = Console(highlight=False, width=None if sys.stdout.isatty() else 160)
    marks = {GOOD: "[green]ok[/green]", NOTE: "  ", DOUBT: "[yellow]?[/yellow] ", STOP: "[red]![/red] "}
    topic = None
    for finding in findings:
        if finding.topic != topic:
            console.print(f"\n[bold]{escape(finding.topic)}[/bold]")
            topic = finding.topic
        console.print(
            f" {marks[finding.level]} {escape(readable_text(finding.text))}", soft_wrap=not console.is_terminal
        )
