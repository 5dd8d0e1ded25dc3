"""From the end of a search to statements: estimates, what is open, what channels leave over."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxlines.inference.input_noise import InputNoise, white_noise_covariance
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.problem import Problem, number_metadata
from jaxlines.inference.search import Found
from jaxlines.inference.stated_noise import StatedNoise, state_noise
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
    make_estimate,
    student_factor,
    whiteness_p,
)


class ChannelFit(NamedTuple):
    """Measured and simulated values of a channel and the test of their difference, SI.

    sigma: root mean square of the noise levels of its used samples.
    """

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
    """Uncertainty of a fit.

    Fields: estimates; covariance, in analysis coordinates; noise: what the residuals say of it; freedom: degrees of
    freedom of the standard deviation of each free parameter, known numbers included; steps: d value / d coordinate of
    each free parameter; widths: of their bounds; correlations; identifiability, warnings, in words.
    """

    estimates: dict[str, Estimate]
    covariance: Covariance
    noise: StatedNoise
    freedom: np.ndarray
    steps: np.ndarray
    widths: np.ndarray
    correlations: np.ndarray
    identifiability: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def reach(self) -> float:
        """Standard deviations in half a 95 % interval of a number that follows from all of them (never too few)."""
        return float(student_factor(np.min(self.freedom, initial=np.inf)))


def trial_of(problem: JointProblem, parameter: int) -> Problem:
    """The first recording that a parameter concerns."""
    return problem.trials[next(i for i, own in enumerate(problem.columns) if parameter in own)]


def unit_of(problem: JointProblem, parameter: int) -> str:
    """The SI unit of a parameter's value."""
    circuit = trial_of(problem, parameter).circuit
    return number_metadata(circuit, problem.free[parameter].paths[0]).get("unit", "1")


def slopes_by_values(problem: JointProblem, found: Found) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the weighted residuals, then of the priors' rows, by free and by known values in SI.

    With a robust loss they are scaled so that J'J is the information that an M-estimate has (`Loss.information`).
    """
    free, known = problem.by_values(found.slopes)
    tells = np.sqrt(problem.loss.information(problem.misfit(found.simulated)))
    priors = problem.prior_slopes(found.values)
    known = np.concatenate([tells * known, np.zeros((priors.shape[0], known.shape[1]))])
    return np.concatenate([tells * free, priors]), known


def _stated(problem: JointProblem, found: Found, free, known_levels: bool) -> StatedNoise:
    """The noise that the rows show; those of a robust loss are taken for white, as its information has it."""
    rows, plain = problem.rows(found.values, found.simulated), problem.loss.kind == "gauss"
    if plain:
        return state_noise(problem, rows, free, known=known_levels)
    word = "the loss is robust, which takes residuals to be uncorrelated"
    return StatedNoise("white", word, np.nan, None, problem, rows, 1.0, len(problem.free), known_levels)


def _undetected(problem: JointProblem, found: Found, free, known, known_sd, noise: StatedNoise) -> np.ndarray:
    """Which parameters cannot be told from their physical zero, judged in linear coordinates."""
    widths = np.array([f.bounds[1] - f.bounds[0] for f in problem.free])
    linear = _under(covariance(free, known, widths, known_sd), noise)
    sd = np.sqrt(np.diag(linear.joint)[: len(problem.free)])
    numbers = [(f, trial_of(problem, i).circuit) for i, f in enumerate(problem.free)]
    zero = np.array([number_metadata(circuit, f.paths[0]).get("low") == 0.0 for f, circuit in numbers])
    inside = found.values + NORMAL_ONE_SIDED_95 * sd < np.array([f.bounds[1] for f in problem.free])
    return zero & (found.values <= NORMAL_95 * sd) & inside


def _under(found: Covariance, noise: StatedNoise) -> Covariance:
    """The covariance under the noise that the rows show."""
    return found if noise.method == "white" else found.under(noise.spread(found.gain))


def _freedom(result: Covariance, noise: StatedNoise, count: int) -> np.ndarray:
    """Degrees of freedom of each standard deviation: those of the noise, and infinite ones of all else.

    Reference: Welch and Satterthwaite, as in the GUM, annex G.4.
    """
    own = noise.freedom(result.gain)
    told = np.maximum(np.diag(result.gain @ result.gain.T if noise.method == "white" else noise.spread(result.gain)), 0)
    whole = np.diag(result.joint)[:count]
    return own * (whole / np.maximum(told, 1e-300)) ** 2


def _with_inputs(problem: JointProblem, found: Found, result: Covariance, input_noise) -> Covariance:
    """The covariance with white noise of the inputs carried through."""
    if not any(of.white for of in input_noise.values()):
        return result
    gain = result.gain  # what least squares makes of a change in the residuals
    gain = gain[:, : gain.shape[1] - problem.prior_residuals(found.values).size]
    joint = result.joint.copy()
    count = len(problem.free)
    joint[:count, :count] += white_noise_covariance(problem, found.values, gain, input_noise)
    return dataclasses.replace(result, joint=joint)


def analyse(
    problem: JointProblem, found: Found, input_noise: dict[str, InputNoise], known_levels: bool = False
) -> Analysis:
    """Covariance afresh at the optimum, in the transformed coordinates, mapped to estimates in SI.

    It is that of white noise only where the residuals are white, see `state_noise`. known_levels: whether all noise
    levels were given.
    A parameter that cannot be told from its physical zero is treated in a linear coordinate, where the model
    is close to linear in it, so that an upper limit can be given.
    """
    count, labels = len(problem.free), list(problem.labels)
    known_sd = np.array([k.sd for k in problem.known])
    free, known = slopes_by_values(problem, found)
    noise = _stated(problem, found, free, known_levels)
    undetected = _undetected(problem, found, free, known, known_sd, noise)
    pairs = list(zip(problem.free, found.values, undetected, strict=True))
    steps = np.array([1.0 if linear else float(f.slope(v)) for f, v, linear in pairs])
    ranges = [f.bounds if linear else f.coordinate_bounds() for f, _, linear in pairs]
    widths = np.array([high - low for low, high in ranges])
    result = _under(covariance(free * steps, known, widths, known_sd), noise)
    result = _with_inputs(problem, found, result, input_noise)
    freedom = _freedom(result, noise, count)
    sd = np.sqrt(np.diag(result.joint)[:count])
    estimates = {}
    for i, (parameter, value, linear) in enumerate(pairs):
        kind = "unidentified" if is_open(result.open_share[i], sd[i], UNINFORMED * widths[i]) else "interval"
        kind = "upper_limit" if linear else kind
        estimate = make_estimate(parameter, float(value), float(sd[i]), unit_of(problem, i), kind, freedom[i])
        edge = np.abs(parameter.to_coordinate(value) - np.array(parameter.coordinate_bounds()))
        if np.min(edge) < 1e-6 * np.ptp(parameter.coordinate_bounds()) and kind == "interval":
            estimate = estimate._replace(note="on a bound, so that the interval, from the curvature there, is no guide")
        if parameter.prior is not None:
            estimate = estimate._replace(note="; ".join(filter(None, [estimate.note, f"prior: {parameter.prior}"])))
        estimates[parameter.label] = estimate
    correlations = result.joint[:count, :count] / np.outer(sd, sd)
    return Analysis(
        estimates=estimates,
        covariance=result,
        noise=noise,
        freedom=freedom,
        steps=steps,
        widths=widths,
        correlations=correlations,
        identifiability=describe_open_directions(labels, result, widths),
        warnings=describe_correlations(labels, correlations),
    )


def channel_fits(problem: JointProblem, found: Found) -> dict[str, ChannelFit]:
    """Each fitted channel with its residual statistics; with several recordings named "A.pressure [run 3]"."""
    channels, several = {}, len(problem.trials) > 1
    for trial, simulated_channels, sigma in zip(problem.trials, found.simulated, problem.sigma, strict=True):
        for i, name in enumerate(trial.wanted):
            measured, simulated, used = trial.measured[:, i], simulated_channels[:, i], trial.used[:, i]
            if not used.any():
                continue
            residual = measured - simulated
            p = whiteness_p(residual / sigma[:, i], used)
            rmse = float(np.sqrt(np.mean(residual[used] ** 2)))
            level = float(np.sqrt(np.mean(sigma[used, i] ** 2)))
            values = (trial.recording.times, measured, simulated, used)
            label = f"{name} [{trial.recording.name}]" if several else name
            channels[label] = ChannelFit(*values, level, rmse, trial.units[i], p, p > WHITE_LIMIT)
    return channels
