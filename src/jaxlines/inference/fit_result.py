"""What a fit returns, and how it reads."""

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxlines.inference.analysis import Analysis, ChannelFit
from jaxlines.inference.curves import Curve
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.noise import Noise
from jaxlines.inference.scatter import Between
from jaxlines.inference.starts import Start
from jaxlines.inference.uncertainty import Estimate, whiteness_text
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.validity import Validity

if TYPE_CHECKING:
    from jaxlines.inference.budget import Budget
    from jaxlines.inference.identifiability import Identifiability
    from jaxlines.inference.posterior import Posterior


class FittedRun(NamedTuple):
    """A recording after a fit: the circuit, start values (or "steady") and inputs with the fitted numbers, to simulate
    on; status of the second simulation, and validity of the lumped model in it (None where it failed)."""

    name: str
    circuit: Circuit
    initial: dict | str
    inputs: dict
    status: str
    validity: Validity | None


@dataclasses.dataclass(frozen=True)
class Fit:
    """A fitted circuit.

    Fields:
        status: "converged", "at_bound", "near_failure" (simulations fail within a few standard errors), "stalled" or
            "failed", judged from the gradient at the end point and a second simulation there; message: in words.
        parameters: name -> Estimate; derived: the same for derived numbers.
        correlations: of the free parameters in the order of `parameters`, shape (free, free).
        channels: name -> ChannelFit, with several recordings "A.pressure [run 3]"; curves: line -> Curve.
        identifiability: what cannot be told apart; scale: what the result rests on; warnings, in words.
        singular_values: of the Jacobian scaled by the bounds, largest first (below 3.5: left open).
        validity: of the lumped model in the fitted circuit (of the first recording in which it is not valid, else of
            the first); None when it could not be simulated.
        circuit, initial: with the fitted numbers of the first recording, to simulate on; num_evaluations; seconds.
        runs: one a recording, see `FittedRun`; starts: where each search ended, best first.
        noise: channel -> Noise as given or estimated; log_likelihood: at the optimum, without priors.
        problem, coordinates: the least-squares problem and the optimum in its coordinates, for profiles and the like.
        analysis: covariance in the coordinates, degrees of freedom, and the noise that the residuals show.
        scatter: parameter -> how much recordings differ in it, with several recordings.

    What costs more simulations is a method: `assess`, `posterior`; `budgets` costs none.
    """

    status: str
    message: str
    parameters: dict[str, Estimate]
    derived: dict[str, Estimate]
    correlations: np.ndarray
    channels: dict[str, ChannelFit]
    curves: dict[str, Curve]
    identifiability: tuple[str, ...]
    scale: tuple[str, ...]
    singular_values: np.ndarray
    warnings: tuple[str, ...]
    validity: Validity | None
    circuit: Circuit
    initial: dict[str, float]
    num_evaluations: int
    seconds: float
    runs: tuple[FittedRun, ...] = ()
    starts: tuple[Start, ...] = ()
    noise: dict[str, Noise] = dataclasses.field(default_factory=dict)
    log_likelihood: float | None = None
    problem: JointProblem | None = dataclasses.field(default=None, repr=False)
    coordinates: np.ndarray | None = dataclasses.field(default=None, repr=False)
    analysis: Analysis | None = dataclasses.field(default=None, repr=False)
    scatter: dict[str, Between] = dataclasses.field(default_factory=dict)

    @property
    def intervals(self) -> str:
        """Which noise the intervals assume, and why, in words."""
        return self.analysis.noise.sentence if self.analysis is not None else ""

    def budgets(self) -> "dict[str, Budget]":
        """The uncertainty budget of each parameter that has an interval, in the sense of the GUM. Simulates nothing.

        Raises: ValueError for a failed fit.
        """
        from jaxlines.inference.fit_tools import budgets

        return budgets(self)

    def assess(self, seed: int = 0) -> "dict[str, Identifiability]":
        """Class of each parameter: structurally not, practically not, or identifiable, from its likelihood profile.

        Costs some tens of simulations with slopes a parameter. seed: of the random points of the structural test.
        Raises: ValueError for a failed fit.
        """
        from jaxlines.inference.fit_tools import assessment

        return assessment(self, seed)

    def posterior(self, *, warmup: int = 400, draws: int = 500, chains: int = 4, seed: int = 0) -> "Posterior":
        """The posterior of the parameters by the no-U-turn sampler, priors of the fit included, noise inferred.

        Raises: ImportError without the extra `posterior`; ValueError for a failed fit, a robust loss, or start values
        that are steady. See `sample_posterior`.
        """
        from jaxlines.inference.fit_tools import posterior

        return posterior(self, warmup=warmup, draws=draws, chains=chains, seed=seed)

    @staticmethod
    def failure(circuit: Circuit, message: str, seconds: float) -> "Fit":
        """A fit that found nothing."""
        none = np.zeros((0, 0))
        return Fit("failed", message, {}, {}, none, {}, {}, (), (), np.zeros(0), (), None, circuit, {}, 0, seconds)

    def __str__(self) -> str:
        lines = [f"{self.status}: {self.message} ({self.num_evaluations} evaluations, {self.seconds:.1f} s)", ""]
        for name, estimate in (self.parameters | self.derived).items():
            lines.append(f"  {name:<34} {describe(estimate)}")
        lines.append("")
        for name, channel in self.channels.items():
            white = whiteness_text(channel.whiteness_p)
            lines.append(f"  {name}: rmse {channel.rmse:.4g} {channel.unit}, residuals {white}")
        groups = {
            "intervals": (self.intervals,) if self.intervals else (),
            "scatter between recordings": tuple(between.sentence(name) for name, between in self.scatter.items()),
            "cannot be told apart": self.identifiability,
            "rests on": self.scale,
            "validity of the lumped model": self.validity.sentences() if self.validity else (),
            "warnings": self.warnings,
        }
        for title, sentences in groups.items():
            if sentences:
                lines += ["", f"{title}:", *(f"  - {sentence}" for sentence in sentences)]
        return "\n".join(lines)


def describe(estimate: Estimate) -> str:
    """An estimate in one line."""
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    note = f"  ({estimate.note})" if estimate.note else ""
    if estimate.kind == "unidentified" or estimate.ci95 is None:
        return f"{estimate.value:.5g}{unit}, not identified{note}"
    if estimate.kind == "upper_limit":
        return f"< {estimate.ci95[1]:.3g}{unit}{note}"
    low, high = estimate.ci95
    return f"{estimate.value:.5g}{unit}  sd {estimate.sd:.2g}  95 % {low:.5g} .. {high:.5g}{note}"
