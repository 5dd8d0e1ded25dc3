"""What an ensemble returns: series and reductions by name, and a status and an error for every lane."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxlines.simulation.paths import resolve
from jaxlines.simulation.result import MESSAGES, STATUS

LANE_MESSAGES = {
    **MESSAGES,
    "out_of_range": "a varied number is outside the range that its component declares, or not finite",
    "inaccurate": "the error estimate stayed above the tolerance, also with 16 times as many steps",
}
LANE_STATUS = {name: code for code, name in enumerate(LANE_MESSAGES)}
"""Status of a lane -> its code. The first ones are those of a single simulation."""

USABLE = (LANE_STATUS["ok"],)
"""Codes of lanes whose numbers can be trusted."""


class Audit(NamedTuple):
    """Lanes that were computed again by the adaptive solver at a tighter tolerance.

    Fields: lanes: which; tolerance: that was asked for; worst: largest observed error of any output at any saved
    time, as a share of that output's largest magnitude; rms: by output, in its unit; factor: by which the error
    estimates of all lanes are multiplied, so that the largest agrees with the largest error observed.
    """

    lanes: np.ndarray
    tolerance: float
    worst: float
    rms: dict[str, float]
    factor: float


@dataclasses.dataclass(frozen=True)
class Ensemble:
    """Results of many lanes.

    Fields: times [s], shape (samples,); outputs: name -> (lanes, samples), SI; reductions: name -> (lanes,);
    status_code (lanes,), see `statuses`; error (lanes,): of the outputs, as a share of their largest magnitude: the
    estimate of the scheme, calibrated by the audit; audit: None when there was none; units of the outputs;
    description: engine, steps, precision and what else the numbers depend on; seconds: compile, audit, run.
    Lanes that are out of range or not finite have NaN in place of numbers.
    """

    times: np.ndarray
    outputs: dict[str, np.ndarray]
    reductions: dict[str, np.ndarray]
    status_code: np.ndarray
    error: np.ndarray
    audit: Audit | None
    units: dict[str, str]
    description: dict[str, Any]
    seconds: dict[str, float]

    def __getitem__(self, name: str) -> np.ndarray:
        """A reduction or an output by its name."""
        if name in self.reductions:
            return self.reductions[name]
        return self.outputs[resolve(name, [*self.outputs, *self.reductions], "output")]

    def __len__(self) -> int:
        """How many lanes there are."""
        return len(self.status_code)

    @property
    def status(self) -> np.ndarray:
        """Status codes of the lanes, as `status_code`."""
        return self.status_code

    @property
    def usable(self) -> np.ndarray:
        """Which lanes can be trusted, shape (lanes,)."""
        return np.isin(self.status_code, USABLE)

    @property
    def statuses(self) -> dict[str, int]:
        """Status -> how many lanes have it, without those that none has."""
        names = list(LANE_MESSAGES)
        codes, counts = np.unique(self.status_code, return_counts=True)
        return {names[int(code)]: int(count) for code, count in zip(codes, counts, strict=True)}

    def __str__(self) -> str:
        """A few lines: how many lanes, what became of them, how exact they are."""
        engine, steps = self.description["engine"], self.description["steps"]
        how = engine if engine == "adaptive" else f"{engine}, {steps} steps between samples"
        lines = [f"{len(self)} lanes ({how}, {self.description['precision']})"]
        for name, count in self.statuses.items():
            lines.append(f"  {name}: {count}" + ("" if name == "ok" else f" ({LANE_MESSAGES[name]})"))
        if self.audit is not None:
            lines.append(
                f"  error: at most {self.audit.worst:.2g} of an output's largest magnitude in {len(self.audit.lanes)} "
                f"lanes that were computed again (asked for: {self.audit.tolerance:.2g})"
            )
        return "\n".join(lines)

    def to_xarray(self):
        """Outputs (lane, time), reductions, status and error (lane,) as an xarray.Dataset."""
        import xarray

        data: dict[str, Any] = {
            name: (("lane", "time"), values, {"units": self.units.get(name, "")})
            for name, values in self.outputs.items()
        }
        data |= {name: ("lane", values) for name, values in self.reductions.items()}
        data |= {"status": ("lane", self.status_code), "error": ("lane", self.error)}
        coordinates = {"time": ("time", self.times, {"units": "s"})}
        attributes = {"statuses": str(STATUS | LANE_STATUS), **{k: str(v) for k, v in self.description.items()}}
        return xarray.Dataset(data, coords=coordinates, attrs=attributes)
