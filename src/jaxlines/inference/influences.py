"""What a result rests on: numbers that were held fixed, and how far they would move the estimates."""

import dataclasses

import jax
import numpy as np

from jaxlines.inference.analysis import Analysis, slopes_by_values
from jaxlines.inference.checkpoint import Memory
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.problem import Problem, number_metadata, set_on_host
from jaxlines.inference.search import Failed, Found, search
from jaxlines.inference.uncertainty import Estimate
from jaxlines.physics.fields import driven_of
from jaxlines.simulation.assembly import number_locations

POLYTROPIC_RANGE = (1.0, 1.4)
"""Isothermal to adiabatic: where the polytropic index of entrained air can lie."""

MOST_RECORDINGS = 12
"""With more recordings the influence of fixed numbers, a simulation each a recording, is not computed."""


def influences(problem: JointProblem, found: Found, analysis: Analysis, limit: float = 0.2) -> tuple[str, ...]:
    """What the result rests on: fixed numbers, and how far 1 % in each would move the estimates, in words.

    From d free / d fixed = -J^+ J_fixed, with J_fixed by a 1 % difference. Pressure alone fixes only ratios of
    modulus, volume and flow, so that at least one volume or flow must be among these numbers, or a measured flow.
    """
    first = problem.trials[0]
    sentences = [_measured_flow_sentence(first)]
    if not found.followed:
        return (sentences[0], "numbers taken as exact were not varied: no single trajectory follows the recording")
    if len(problem.trials) > MOST_RECORDINGS:
        return (sentences[0], f"numbers taken as exact were not varied: more than {MOST_RECORDINGS} recordings")
    jacobian = slopes_by_values(problem, found)[0] * analysis.steps
    widths = np.sqrt(np.maximum(np.diag(analysis.covariance.free_part), 1e-300))
    inverse = np.linalg.pinv(jacobian * widths, rcond=1e-6) * widths[:, None]
    firm = np.array([e.kind == "interval" and e.value != 0.0 for e in analysis.estimates.values()])
    labels, taken = list(analysis.estimates), {p for f in problem.free for p in f.paths}
    sds = {k.path: k.sd for k in problem.known}
    for path, difference in _one_percent_differences(problem, found).items():
        parts = zip(difference, problem.sigma, problem.trials, strict=True)
        change = np.concatenate([(d / sigma)[trial.used] for d, sigma, trial in parts])
        if path in taken or not np.all(np.isfinite(change)):
            continue
        moved = inverse[:, : change.size] @ change
        percent = -moved * analysis.steps / np.where(found.values == 0.0, 1.0, found.values) * 100.0
        affected = [f"{labels[i]} by {percent[i]:+.2g} %" for i in np.flatnonzero(firm & (np.abs(percent) > limit))]
        if affected:
            known = path in sds
            how = f"known with standard uncertainty {_with_unit(first, path, sds[path])}" if known else "taken as exact"
            sentences.append(f"{path} is {how}: 1 % more in it moves {', '.join(affected)}")
    return tuple(sentences)


def _with_unit(trial: Problem, path: str, value: float) -> str:
    """A number of the circuit with its unit."""
    unit = number_metadata(trial.circuit, path).get("unit", "1")
    return f"{value:.2g}" if unit == "1" else f"{value:.2g} {unit}"


def _one_percent_differences(problem: JointProblem, found: Found) -> dict[str, list[np.ndarray]]:
    """Path -> change of the simulated channels of each recording for 1 % more in each fixed, non-zero number."""
    differences: dict[str, list[np.ndarray]] = {}
    for i in range(len(problem.trials)):
        zero = [np.zeros_like(simulated) for simulated in found.simulated]
        for path, difference in _of_recording(problem, found, i).items():
            differences.setdefault(path, list(zero))[i] = difference
    return differences


def _of_recording(problem: JointProblem, found: Found, i: int) -> dict[str, np.ndarray]:
    """The same for one recording; start values are held fixed only where they are known with an uncertainty."""
    trial, own = problem.trials[i], problem.own(i, found.values)
    count, differences = len(own), {}
    for k, number in enumerate(trial.known):
        differences[number.path] = found.slopes[i][..., count + k] * 0.01 * trial.known_values[k]
    for path, location in number_locations(trial.plan, trial.values).items():
        leaf = np.asarray(jax.tree.leaves(trial.values)[location[0]])
        number = leaf if location[1] is None else leaf[location[1]]
        skipped = path in differences or path.startswith("initial.") or number.ndim
        if skipped or not np.isfinite(number) or number == 0.0:
            continue
        moved = dataclasses.replace(trial, values=set_on_host(trial.values, location, factor=1.01))
        differences[path] = moved.predict(own) - found.simulated[i]
    return differences


def _measured_flow_sentence(trial: Problem) -> str:
    """Whether a measured flow fixes the scale of volumes."""
    flows = [
        name
        for name, places in trial.circuit.external_inputs().items()
        if any(driven_of(trial.circuit.components[c])[f]["unit"] == "m^3/s" for c, f in places)
    ]
    if flows:
        return f"the measured flow {', '.join(map(repr, flows))} and the numbers below fix the scale of volumes"
    return (
        "no flow was measured: pressure alone fixes only the ratio of modulus to volume times flow, so that the scale "
        "rests on the numbers below"
    )


def conditional_range(
    problem: JointProblem, found: Found, estimates: dict[str, Estimate], memory: Memory
) -> tuple[dict[str, Estimate], list[str]]:
    """Air fractions that were estimated at a fixed polytropic index, with their range over [1, 1.4] noted.

    The other parameters are fitted anew at both ends. Returns the estimates and warnings.
    """
    index_path = "fluid.polytropic_index"
    moving = {p for f in problem.free for p in f.paths} | {k.path for k in problem.known}
    moving |= {path for trial in problem.trials for path in trial.recording.conditions}
    airy = [i for i, f in enumerate(problem.free) if f.paths[0].endswith("air_fraction")]
    if not airy or index_path in moving or not found.followed:
        return estimates, []
    ends = []
    for index in POLYTROPIC_RANGE:
        trials = []
        for trial in problem.trials:
            location = number_locations(trial.plan, trial.values)[index_path]
            values = set_on_host(trial.values, location, value=index)
            trials.append(dataclasses.replace(trial, values=values))
        other, stage = dataclasses.replace(problem, trials=tuple(trials)), f"polytropic index {index:g}"
        try:
            end = search(
                other, found.coordinates, lambda count, cost: None, stage=stage, memory=memory, max_evaluations=30
            )
        except Failed:
            return estimates, [f"air is conditional on {index_path}; the fit fails at {index:g}"]
        ends.append(end.values)
    return _noted(problem, estimates, ends, airy)


def _noted(problem: JointProblem, estimates, ends, airy) -> tuple[dict[str, Estimate], list[str]]:
    """Estimates that depend on the polytropic index with its range in their notes."""
    estimates, warnings = dict(estimates), []
    held = float(problem.trials[0].circuit.fluid.polytropic_index)
    for i, parameter in enumerate(problem.free):
        low, high = sorted(float(end[i]) for end in ends)
        old = estimates[parameter.label]
        unit = "" if old.unit == "1" else f" {old.unit}"
        ends_text = f"{low:.4g} to {high:.4g}{unit} for an index of {POLYTROPIC_RANGE[0]:g} to {POLYTROPIC_RANGE[1]:g}"
        note = f"holds for polytropic index {held:g}; {ends_text}"
        if old.kind != "unidentified" and (i in airy or high - low > 2.0 * (old.sd or np.inf)):
            estimates[parameter.label] = old._replace(note="; ".join(filter(None, [old.note, note])))
        if i in airy:
            warnings.append(f"{parameter.label} is conditional on the polytropic index: {ends_text}")
    return estimates, warnings
