"""What `design` returns: the test to run, what it will tell, against the test that it began with."""

import dataclasses
from typing import Any

import numpy as np

from jaxlines.inference.design_search import OutputLimit, Start
from jaxlines.inference.design_selection import Selection


@dataclasses.dataclass(frozen=True, eq=False)
class Profile:
    """A designed input: times [s], values and base_values (of the starting test), shape (samples,), joined by straight
    lines; low, high: limits; rate: steepest slope allowed, or None; energy, base_energy: integral of u^2 dt; unit;
    amplitudes and frequencies [Hz] of a multisine, else None.
    """

    times: np.ndarray
    values: np.ndarray
    base_values: np.ndarray
    low: float
    high: float
    rate: float | None
    energy: float
    base_energy: float
    unit: str = ""
    frequencies: np.ndarray | None = None
    amplitudes: np.ndarray | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """A designed test.

    Fields:
        names, units, values: of the free parameters, values in SI for which the test was designed.
        sd_before, sd_base, sd: standard deviations that are known before, and that a fit will state after the starting
            test and after the designed one, SI, shape (free,); infinite where nothing is told.
        target, criterion: what it was designed for; target_sd_base, target_sd: of a single number in SI, else None;
        target_unit: of that number, "" for a combination of different units.
        improvement: how many times smaller the designed test makes the standard deviation that the criterion is.
        profiles: input -> `Profile`; inputs, base_inputs: all inputs as signals, to be used in `simulate`.
        sensors, times: what to measure and when [s]; candidate_sensors, candidate_times; measured: times of each sensor
            that are measured, shape (candidate times, candidate sensors), number of measurements.
        outputs, base_outputs: output -> simulated values at the candidate times; output_units; limits of outputs.
        base_keeps_limits: whether the starting test keeps the limits of outputs.
        selections: "sensors" and "samples" -> `Selection` where they were chosen (evenly spaced ones have none).
        active: limits that hold the design back; unidentified: what the designed test still does not tell; warnings.
        scenarios: parameter values that were considered, SI, shape (scenarios, free), nominal first; robust: how.
        starts: where each search ended, best first; num_simulations; seconds.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    sd_before: np.ndarray
    sd_base: np.ndarray
    sd: np.ndarray
    target: str
    criterion: str
    target_sd_base: float | None
    target_sd: float | None
    target_unit: str
    improvement: float
    profiles: dict[str, Profile]
    inputs: dict[str, Any]
    base_inputs: dict[str, Any]
    sensors: tuple[str, ...]
    times: np.ndarray
    candidate_sensors: tuple[str, ...]
    candidate_times: np.ndarray
    measured: np.ndarray
    outputs: dict[str, np.ndarray]
    base_outputs: dict[str, np.ndarray]
    output_units: dict[str, str]
    limits: tuple[OutputLimit, ...]
    base_keeps_limits: bool
    selections: dict[str, Selection]
    active: tuple[str, ...]
    unidentified: tuple[str, ...]
    warnings: tuple[str, ...]
    scenarios: np.ndarray
    robust: str
    starts: tuple[Start, ...]
    num_simulations: int
    seconds: float

    def table(self) -> list[dict[str, Any]]:
        """One row a parameter: name, unit, value, sd_before, sd_base, sd (SI), and ratio sd_base/sd."""
        rows = zip(self.names, self.units, self.values, self.sd_before, self.sd_base, self.sd, strict=True)
        keys = ("name", "unit", "value", "sd_before", "sd_base", "sd")
        found: list[dict[str, Any]] = [dict(zip(keys, row, strict=True)) for row in rows]
        for row in found:
            row["ratio"] = float(row["sd_base"] / row["sd"]) if np.isfinite([row["sd_base"], row["sd"]]).all() else None
        return found

    def finding(self) -> str:
        """The result in one line."""
        what, gain = f"{self.target} (criterion {self.criterion})", self.improvement
        keeps = "" if self.base_keeps_limits else ", which does not keep the limits"
        word = f"{gain:.3g} times smaller" if gain >= 1.0 else f"{1.0 / gain:.3g} times larger"
        word += {"average": " on average over the samples", "worst": " at the worst sample"}.get(self.robust, "")
        if self.target_sd is None or self.target_sd_base is None:
            return f"{what}: standard deviation {word} than by the starting test{keeps}"
        sd, base = (
            f"{number:.4g} {self.target_unit}".removesuffix(" 1").rstrip()
            for number in (self.target_sd, self.target_sd_base)
        )
        if not np.isfinite(self.target_sd_base):
            return f"{what}: standard deviation {sd}; the starting test does not tell it{keeps}"
        return f"{what}: standard deviation {sd} instead of {base} by the starting test{keeps}: {word}"

    def __str__(self) -> str:
        lines = [self.finding(), ""]
        width = max(len("parameter"), *(len(name) for name in self.names))
        heads = ("value", "sd before", "starting test", "designed test", "ratio")
        lines.append(f"{'parameter':<{width}}  " + "  ".join(f"{head:>13}" for head in heads) + "  unit")
        for row in self.table():
            cells = [_cell(row[key]) for key in ("value", "sd_before", "sd_base", "sd")]
            cells.append("" if row["ratio"] is None else f"{row['ratio']:.3g}")
            lines.append(f"{row['name']:<{width}}  " + "  ".join(f"{c:>13}" for c in cells) + f"  {row['unit']}")
        lines += ["", *self._choices()]
        for head, texts in (("at its limits", self.active), ("not told", self.unidentified), ("note", self.warnings)):
            lines += [f"{head}: {text}" for text in texts]
        return "\n".join(lines)

    def _choices(self) -> list[str]:
        """What was chosen, in words."""
        lines = []
        for name, profile in self.profiles.items():
            low, high = float(profile.values.min()), float(profile.values.max())
            lines.append(f"{name}: {profile.times.size} points, {low:.4g} .. {high:.4g} {profile.unit}".rstrip())
        lines.append(f"measure {', '.join(self.sensors)} at {self.times.size} of {self.candidate_times.size} instants")
        for what, found in self.selections.items():
            lines.append(f"{what}: {found.method}, efficiency {found.efficiency:.4g} against fractions of measurements")
        return lines


def _cell(value: float) -> str:
    """A number of the table."""
    return f"{value:.4g}" if np.isfinite(value) else "unknown"
