"""What a test is designed for: parameters, a combination of them, or a prediction."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxlines.inference.design_before import Before
from jaxlines.inference.design_criteria import CRITERIA, Criterion
from jaxlines.inference.design_model import DesignModel, make_model, message_of
from jaxlines.inference.parameter_checks import number_metadata

OPEN = 1e-8
"""Scaled singular values below this part of the largest count as zero."""

PREDICTED = ("peak", "trough", "final")


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """A number that the circuit will show in another situation, which a test is to make sure of.

    Args: output: its name, such as "A.pressure"; times [s] and inputs of that situation, as for `simulate`; of: "peak"
        (largest value), "trough" (smallest) or "final"; initial: its start values (those of the test by default).
    """

    output: str
    times: Any
    inputs: dict
    of: str = "peak"
    initial: dict | str | None = None

    def __post_init__(self):
        if self.of not in PREDICTED:
            raise ValueError(f"a prediction is one of {', '.join(PREDICTED)}, got {self.of!r}")

    def slopes(self, model: DesignModel, values) -> np.ndarray:
        """d prediction / d scaled coordinate of the free parameters, shape (free,), at values in SI."""
        other = make_model(
            model.circuit,
            model.free,
            times=self.times,
            sensors=(self.output,),
            noise={self.output: 1.0},
            inputs=self.inputs,
            initial=model.initial if self.initial is None else self.initial,
            method=model.static.method,
            tolerance=model.tolerance,
            precision=model.precision,
        )
        outcome = other.evaluate(values)
        if not outcome.ok:
            raise ValueError(f"the prediction of {self.output} cannot be simulated: {message_of(outcome.status)}")
        shown = outcome.outputs[:, 0]
        at = {"peak": np.argmax(shown), "trough": np.argmin(shown), "final": shown.size - 1}[self.of]
        return outcome.rows[int(at), 0]

    def __str__(self) -> str:
        return f"{self.of} of {self.output}"


@dataclasses.dataclass(frozen=True, eq=False)
class Target:
    """What is asked: labels of parameters, or weights of a combination in SI, or a prediction; and the criterion."""

    labels: tuple[str, ...]
    weights: dict[str, float] | None
    prediction: Prediction | None
    kind: str

    def __str__(self) -> str:
        if self.prediction is not None:
            return str(self.prediction)
        if self.weights is not None:
            return " + ".join(f"{w:g} {name}" for name, w in self.weights.items())
        return ", ".join(self.labels)

    def unit(self, model: DesignModel) -> str:
        """The unit of one number; "" where a combination has several."""
        if self.prediction is not None:
            return model.units[self.prediction.output]
        units = {
            number_metadata(model.circuit, f.paths[0]).get("unit", "") for f in model.free if f.label in self.labels
        }
        return units.pop() if len(units) == 1 else ""

    def directions(self, model: DesignModel, values, sizes) -> np.ndarray:
        """L, shape (free, asked): in SI for one number, else in standard deviations before the test."""
        names, step = [f.label for f in model.free], model.slopes(values) * model.scale
        if self.prediction is not None:
            return self.prediction.slopes(model, values)[:, None]
        if self.weights is not None:
            return (np.array([self.weights.get(name, 0.0) for name in names]) * step)[:, None]
        chosen = np.eye(len(names))[:, [names.index(label) for label in self.labels]]
        return chosen * (step if len(self.labels) == 1 else 1.0 / sizes)[:, None]

    def criterion(self, model: DesignModel, values, before: Before) -> Criterion:
        """The criterion at parameter values in SI."""
        return Criterion(self.kind, self.directions(model, values, before.sizes), before.information)


def as_target(given, criterion: str | None, labels: Sequence[str]) -> Target:
    """A checked target.

    Args: given: None (all parameters), a label, several, a mapping label -> weight, or a `Prediction`; criterion: one
    of D, A, E, c, or None: c for one number, else D.
    """
    if criterion is not None and criterion not in CRITERIA:
        raise ValueError(f"criterion must be one of {', '.join(CRITERIA)}, got {criterion!r}")
    weights = prediction = None
    if isinstance(given, Prediction):
        chosen, prediction = tuple(labels), given
    elif isinstance(given, Mapping):
        chosen, weights = tuple(given), {name: float(w) for name, w in given.items()}
    else:
        chosen = tuple(labels) if given is None else (given,) if isinstance(given, str) else tuple(given)
    for name in chosen:
        if name not in labels:
            raise ValueError(f"{name!r} is not free, so that no test can be designed for it; free: {', '.join(labels)}")
    if not chosen or len(set(chosen)) < len(chosen):
        raise ValueError(f"the target must be one or more different parameters, got {given!r}")
    one = prediction is not None or weights is not None or len(chosen) == 1
    kind = criterion or ("c" if one else "D")
    if kind == "c" and not one:
        raise ValueError(
            f"criterion c is for one number, got {len(chosen)} parameters: name one, give weights of a combination, or "
            "use D, A or E"
        )
    return Target(chosen, weights, prediction, kind)


def untold(rows, num_free: int, prior_rows, directions) -> tuple[bool, tuple[int, ...]]:
    """Whether what is asked has a part of which rows say nothing, and the parameters that take part in that.

    Columns are scaled to length one; singular values below 1e-8 of the largest count as zero.
    """
    every = np.concatenate([rows[:, :num_free], prior_rows[:, :num_free]])
    size = np.linalg.norm(every, axis=0)
    dead = size <= 1e-12 * max(size.max(), 1e-300)
    scaled = np.where(dead, 0.0, every / np.where(dead, 1.0, size))
    _, singular, right = np.linalg.svd(scaled, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(max(num_free - singular.size, 0))])
    null = right[singular <= OPEN * max(singular[0], 1e-300)]
    asked = directions / np.where(dead, 1.0, size)[:, None]
    asked = asked / np.linalg.norm(asked, axis=0)
    if not null.size or not np.any(np.abs(null @ asked) > 1e-4):
        return False, ()
    return True, tuple(int(i) for i in np.flatnonzero(np.max(np.abs(null), axis=0) > 1e-3))
