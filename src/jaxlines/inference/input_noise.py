"""The uncertainty of recorded inputs, carried into the result by linearisation."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlines.inference.joint import JointProblem
from jaxlines.inference.parameters import Known
from jaxlines.inference.programs import pulled_program
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.precision import cast, computing_in


@dataclasses.dataclass(frozen=True)
class InputNoise:
    """Standard uncertainties of a recorded input u: true value = gain * (u + noise) + offset.

    white: of each sample, independent of the others, in the unit of the input; gain: of the calibration [-];
    offset: of the zero, in the unit of the input. Gain and offset are common to all recordings.

    Validity: to first order. Gain and offset go through exact sensitivities, white noise through the exact slopes of
    the estimates by every sample (the adjoint of the solver), held at the optimum. White noise also blurs the model
    (errors in variables): the bias it causes is of second order in the noise and is not corrected. What white input
    noise adds to the residuals is part of their level already, as if it were white itself.
    Typical values: gain 0.002..0.01 of a flow meter or transducer; offset 0.1..0.5 % of full scale.
    Reference: JCGM 100 (GUM), 2008, sec. 5; Fuller, "Measurement Error Models", 1987, ch. 1.
    """

    white: float = 0.0
    gain: float = 0.0
    offset: float = 0.0

    def __post_init__(self):
        levels = (self.white, self.gain, self.offset)
        if not all(np.isfinite(level) and level >= 0.0 for level in levels) or not any(levels):
            raise ValueError(f"noise of an input must be positive in white, gain or offset, got {levels}")


def as_input_noise(given: dict | None) -> dict[str, InputNoise]:
    """Input noises from a table of numbers (white) or `InputNoise`."""
    return {
        name: value if isinstance(value, InputNoise) else InputNoise(white=float(value))
        for name, value in (given or {}).items()
    }


def known_of_inputs(circuit: Circuit, noise: dict[str, InputNoise]) -> list[Known]:
    """Gains and offsets of inputs as known numbers. Raises ValueError for a name that is no input."""
    inputs, known = circuit.external_inputs(), []
    for name, of in noise.items():
        if name not in inputs:
            there = ", ".join(inputs) or "none"
            raise ValueError(f"input_noise is given for {name!r}, which is no input; inputs: {there}")
        known += [Known(f"{name}.{part}", getattr(of, part)) for part in ("gain", "offset") if getattr(of, part)]
    return known


def white_noise_covariance(problem: JointProblem, values, gain: np.ndarray, noise: dict[str, InputNoise]) -> np.ndarray:
    """Covariance that white noise of the inputs gives the estimates, shape (free, free), in the units of `gain`.

    An estimate moves by d theta = -gain d misfit, with gain = J^+ of shape (free, samples), so that with the slopes
    of the misfit by input samples u_k: C = sum_k sd^2 g_k g_k', g_k = gain (d misfit / d u_k), over all recordings.
    """
    white = {name: of.white for name, of in noise.items() if of.white}
    total, at = np.zeros((gain.shape[0], gain.shape[0])), 0
    for i, trial in enumerate(problem.trials if white else ()):
        rows = int(trial.used.sum())
        weights = np.zeros((gain.shape[0], trial.padded_times().size, len(trial.wanted)))
        weights[:, : trial.used.shape[0]][:, trial.used] = gain[:, at : at + rows] / problem.sigma[i][trial.used]
        at += rows
        for name, slopes in _slopes_by_samples(trial, problem.own(i, values), tuple(white), weights).items():
            total += white[name] ** 2 * (slopes @ slopes.T)
    return total


def _slopes_by_samples(trial, values, names: Sequence[str], weights) -> dict[str, np.ndarray]:
    """Slopes of weighted sums of the outputs by every sample of some inputs, shape (weightings, samples)."""
    method = trial.method._replace(gradient="reverse")
    with computing_in(trial.precision):
        arguments, weights = trial.arguments(values), cast(weights, trial.precision)
        static = (trial.plan, trial.wanted, method, trial.locations)
        found = pulled_program(*static, *arguments, trial.steady, tuple(names), weights)
        return {name: np.asarray(slopes, dtype=float) for name, slopes in zip(names, found, strict=True)}
