"""What a simulation returns: outputs by name, and whether they can be trusted."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.line_records import line_flows, signal_records
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.validity import Validity, check_validity, nodes_to_check

MESSAGES = {
    "ok": "the trajectory was computed to the tolerance",
    "max_steps": "the step limit was reached: the circuit may be stiff (try solver=jaxlines.implicit()), "
    "or raise max_steps",
    "solver_failed": "the solver could not find a step: the circuit may be stiff (try solver=jaxlines.implicit())",
    "non_finite": "an output is not finite: look for an extreme parameter",
    "tension": "a pressure fell below the vapour pressure of an air-free liquid, which would cavitate: "
    "give the fluid an air_fraction",
}
STATUS = {name: code for code, name in enumerate(MESSAGES)}


class Simulation(eqx.Module):
    """Outputs of a simulated circuit, by name: `simulation["A.pressure"]`, shape (times,), SI.

    Fields: times [s]; outputs; status_code (see `status`); num_steps, num_rejected; lowest_pressure [Pa] of all
    free nodes at the saved times; circuit, inputs; units of the outputs.
    """

    times: Any
    outputs: dict[str, Any]
    status_code: Any
    num_steps: Any
    num_rejected: Any
    lowest_pressure: Any
    circuit: Circuit
    inputs: dict[str, Any]
    units: dict[str, str] = eqx.field(static=True)

    def __getitem__(self, name: str):
        """An output by its name."""
        return self.outputs[resolve(name, self.outputs, "output")]

    @property
    def status(self) -> str:
        """ "ok", or the kind of failure: "max_steps", "solver_failed", "non_finite", "tension"."""
        return list(MESSAGES)[int(self.status_code)]

    def raise_if_failed(self) -> None:
        """Raise RuntimeError unless the status is ok, naming the output that went wrong first."""
        if self.status == "ok":
            return
        bad = [name for name, values in self.outputs.items() if not np.all(np.isfinite(values))]
        where = f" First affected: {bad[0]}." if bad else ""
        raise RuntimeError(
            f"simulation failed ({self.status}): {MESSAGES[self.status]}. {int(self.num_steps)} steps were made, "
            f"lowest pressure {float(self.lowest_pressure):.4g} Pa.{where} Pass throw=False to get what there is."
        )

    def validity(self, highest_frequency: float | None = None) -> Validity:
        """Whether the lumped lines may be trusted for what happened here; see `Validity`.

        Args: highest_frequency [Hz] of any oscillation; by default it is read from the inputs and the pressures.
        Raises: ValueError when an output that the check needs was not saved.
        """
        with computing_in("float64"):
            flows = line_flows(self.circuit, self.times, self.outputs, self.inputs)
            records = signal_records(self.circuit, self.times, self.inputs)
        pressures = {node: self.outputs[f"{node}.pressure"] for node in nodes_to_check(self.circuit)}
        return check_validity(self.circuit, self.times, pressures, flows, records, highest_frequency)

    def to_xarray(self):
        """The outputs as an xarray.Dataset over `time`, with units and status as attributes."""
        import xarray

        data = {n: ("time", np.asarray(v), {"units": self.units[n]}) for n, v in self.outputs.items()}
        attributes = {"status": self.status, "num_steps": int(self.num_steps), "num_rejected": int(self.num_rejected)}
        return xarray.Dataset(data, coords={"time": ("time", np.asarray(self.times), {"units": "s"})}, attrs=attributes)
