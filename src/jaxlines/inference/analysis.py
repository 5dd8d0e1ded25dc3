"""From the end of a search to statements: estimates, what is open, what the result rests on."""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np

from jaxlines.inference.problem import Problem, number_metadata, set_on_host
from jaxlines.inference.search import Failed, Found, search
from jaxlines.inference.uncertainty import (
    NORMAL_95,
    NORMAL_ONE_SIDED_95,
    UNINFORMED,
    WHITE_LIMIT,
    Covariance,
    Estimate,
    covariance,
    describe_correlations,
    describe_open_directions,
    is_open,
    ljung_box,
    make_estimate,
)
from jaxlines.physics.fields import driven_of
from jaxlines.simulation.assembly import number_locations

POLYTROPIC_RANGE = (1.0, 1.4)
"""Isothermal to adiabatic: where the polytropic index of entrained air can lie."""


class ChannelFit(NamedTuple):
    """Measured and simulated values of a channel and the test of their difference, SI."""

    times: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    used: np.ndarray
    sigma: float
    rmse: float
    unit: str
    whiteness_p: float
    white: bool


@dataclasses.dataclass(frozen=True)
class Analysis:
    """Uncertainty of a fit. `steps`: d value / d coordinate of each free parameter; `widths`: of their bounds."""

    estimates: dict[str, Estimate]
    covariance: Covariance
    steps: np.ndarray
    widths: np.ndarray
    correlations: np.ndarray
    identifiability: tuple[str, ...]
    warnings: tuple[str, ...]


def _weighted(problem: Problem, slopes, sigma) -> np.ndarray:
    """Slopes of the used samples over their noise, by value in SI, shape (samples, parameters)."""
    return (slopes / sigma[:, None])[problem.used]


def _undetected(problem: Problem, found: Found, weighted, known_sd) -> np.ndarray:
    """Which parameters cannot be told from their physical zero, judged in linear coordinates."""
    count = len(problem.free)
    widths = np.array([f.bounds[1] - f.bounds[0] for f in problem.free])
    linear = covariance(weighted[:, :count], weighted[:, count:], widths, known_sd)
    sd = np.sqrt(np.diag(linear.joint)[:count])
    zero = np.array([number_metadata(problem.circuit, f.paths[0]).get("low") == 0.0 for f in problem.free])
    inside = found.values + NORMAL_ONE_SIDED_95 * sd < np.array([f.bounds[1] for f in problem.free])
    return zero & (found.values <= NORMAL_95 * sd) & inside


def analyse(problem: Problem, found: Found, sigma: np.ndarray) -> Analysis:
    """Covariance afresh at the optimum, in the transformed coordinates, mapped to estimates in SI.

    A parameter that cannot be told from its physical zero is treated in a linear coordinate, where the model
    is close to linear in it, so that an upper limit can be given.
    """
    count, labels = len(problem.free), [f.label for f in problem.free]
    known_sd = np.array([k.sd for k in problem.known])
    weighted = _weighted(problem, found.slopes, sigma)
    undetected = _undetected(problem, found, weighted, known_sd)
    pairs = list(zip(problem.free, found.values, undetected, strict=True))
    steps = np.array([1.0 if linear else float(f.slope(v)) for f, v, linear in pairs])
    ranges = [f.bounds if linear else f.coordinate_bounds() for f, _, linear in pairs]
    widths = np.array([high - low for low, high in ranges])
    result = covariance(weighted[:, :count] * steps, weighted[:, count:], widths, known_sd)
    sd = np.sqrt(np.diag(result.joint)[:count])
    estimates = {}
    for i, (parameter, value, linear) in enumerate(pairs):
        unit = number_metadata(problem.circuit, parameter.paths[0]).get("unit", "1")
        kind = "unidentified" if is_open(result.open_share[i], sd[i], UNINFORMED * widths[i]) else "interval"
        kind = "upper_limit" if linear else kind
        estimate = make_estimate(parameter, float(value), float(sd[i]), unit, kind)
        edge = np.abs(parameter.to_coordinate(value) - np.array(parameter.coordinate_bounds()))
        if np.min(edge) < 1e-6 * np.ptp(parameter.coordinate_bounds()) and kind == "interval":
            estimate = estimate._replace(note="on a bound, so that the interval, from the curvature there, is no guide")
        estimates[parameter.label] = estimate
    correlations = result.joint[:count, :count] / np.outer(sd, sd)
    return Analysis(
        estimates=estimates,
        covariance=result,
        steps=steps,
        widths=widths,
        correlations=correlations,
        identifiability=describe_open_directions(labels, result, widths),
        warnings=describe_correlations(labels, correlations),
    )


def channel_fits(problem: Problem, found: Found, sigma: np.ndarray) -> dict[str, ChannelFit]:
    """Each fitted channel with its residual statistics."""
    channels = {}
    for i, name in enumerate(problem.wanted):
        measured, simulated, used = problem.measured[:, i], found.simulated[:, i], problem.used[:, i]
        residual = measured - simulated
        p = ljung_box(residual, used)
        rmse = float(np.sqrt(np.mean(residual[used] ** 2)))
        values = (problem.recording.times, measured, simulated, used)
        channels[name] = ChannelFit(*values, float(sigma[i]), rmse, problem.units[i], p, p > WHITE_LIMIT)
    return channels


def influences(
    problem: Problem, found: Found, sigma: np.ndarray, analysis: Analysis, limit: float = 0.2
) -> tuple[str, ...]:
    """What the result rests on: fixed numbers, and how far 1 % in each would move the estimates, in words.

    From d free / d fixed = -J^+ J_fixed, with J_fixed by a 1 % difference. Pressure alone fixes only ratios of
    modulus, volume and flow, so that at least one volume or flow must be among these numbers, or a measured flow.
    """
    sentences = [_measured_flow_sentence(problem)]
    jacobian = _weighted(problem, found.slopes, sigma)[:, : len(problem.free)] * analysis.steps
    widths = np.sqrt(np.maximum(np.diag(analysis.covariance.free_part), 1e-300))
    inverse = np.linalg.pinv(jacobian * widths, rcond=1e-6) * widths[:, None]
    firm = np.array([e.kind == "interval" and e.value != 0.0 for e in analysis.estimates.values()])
    labels, taken = list(analysis.estimates), {p for f in problem.free for p in f.paths}
    sds = {k.path: k.sd for k in problem.known}
    for path, difference in _one_percent_differences(problem, found).items():
        change = (difference / sigma)[problem.used]
        if path in taken or not np.all(np.isfinite(change)):
            continue
        percent = -(inverse @ change) * analysis.steps / np.where(found.values == 0.0, 1.0, found.values) * 100.0
        affected = [f"{labels[i]} by {percent[i]:+.2g} %" for i in np.flatnonzero(firm & (np.abs(percent) > limit))]
        if affected:
            known = path in sds
            how = (
                f"known with standard uncertainty {_with_unit(problem, path, sds[path])}" if known else "taken as exact"
            )
            sentences.append(f"{path} is {how}: 1 % more in it moves {', '.join(affected)}")
    return tuple(sentences)


def _with_unit(problem: Problem, path: str, value: float) -> str:
    """A number of the circuit with its unit."""
    unit = number_metadata(problem.circuit, path).get("unit", "1")
    return f"{value:.2g}" if unit == "1" else f"{value:.2g} {unit}"


def _one_percent_differences(problem: Problem, found: Found) -> dict[str, np.ndarray]:
    """Path -> change of the simulated channels for 1 % more in each fixed, non-zero number of the circuit."""
    count, differences = len(problem.free), {}
    for i, number in enumerate(problem.known):
        differences[number.path] = found.slopes[..., count + i] * 0.01 * problem.known_values[i]
    for path, location in number_locations(problem.plan, problem.values).items():
        leaf = np.asarray(jax.tree.leaves(problem.values)[location[0]])
        number = leaf if location[1] is None else leaf[location[1]]
        if (
            path in differences
            or path.startswith("initial.")
            or number.ndim
            or not np.isfinite(number)
            or number == 0.0
        ):
            continue
        moved = dataclasses.replace(problem, values=set_on_host(problem.values, location, factor=1.01))
        differences[path] = moved.predict(found.values) - found.simulated
    return differences


def _measured_flow_sentence(problem: Problem) -> str:
    """Whether a measured flow fixes the scale of volumes."""
    flows = [
        name
        for name, places in problem.circuit.external_inputs().items()
        if any(driven_of(problem.circuit.components[c])[f]["unit"] == "m^3/s" for c, f in places)
    ]
    if flows:
        return f"the measured flow {', '.join(map(repr, flows))} and the numbers below fix the scale of volumes"
    return (
        "no flow was measured: pressure alone fixes only the ratio of modulus to volume times flow, so that the scale "
        "rests on the numbers below"
    )


def conditional_range(problem: Problem, found: Found, sigma, estimates) -> tuple[dict[str, Estimate], list[str]]:
    """Air fractions that were estimated at a fixed polytropic index, with their range over [1, 1.4] noted.

    The other parameters are fitted anew at both ends. Returns the estimates and warnings.
    """
    index_path = "fluid.polytropic_index"
    moving = {p for f in problem.free for p in f.paths} | {k.path for k in problem.known}
    airy = [i for i, f in enumerate(problem.free) if f.paths[0].endswith("air_fraction")]
    if not airy or index_path in moving:
        return estimates, []
    location = number_locations(problem.plan, problem.values)[index_path]
    ends = []
    for index in POLYTROPIC_RANGE:
        other = dataclasses.replace(problem, values=set_on_host(problem.values, location, value=index))
        try:
            ends.append(search(other, found.coordinates, sigma, lambda count, cost: None, max_evaluations=30).values)
        except Failed:
            return estimates, [f"air is conditional on {index_path}; the fit fails at {index:g}"]
    estimates, warnings = dict(estimates), []
    held = float(problem.circuit.fluid.polytropic_index)
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
