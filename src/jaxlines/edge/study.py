"""Study files: a circuit, a recording, what is free and what to simulate, in TOML with units."""

import contextlib
import dataclasses
import importlib.resources
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.building import Builder, StudyError, build_circuit
from jaxlines.edge.fit_tables import (
    check_fit,
    study_fit_options,
    study_noise,
    study_parameters,
    study_recordings,
)
from jaxlines.edge.naming import Names, at, look_up, names_of
from jaxlines.edge.study_positions import with_positions
from jaxlines.edge.tables import NumericsTable, SimulateTable, StudyTable, check_layout
from jaxlines.inference.fit import fit
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.recording import Recording
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import implicit
from jaxlines.simulation.result import Simulation
from jaxlines.simulation.signals import Sampled
from jaxlines.simulation.simulate import simulate

EXAMPLE = "example:"
MEASURED = "measured"
NOTHING_TO_SIMULATE = 'there is nothing to simulate: add a table [simulate] with stop = "1 s"'


@dataclasses.dataclass(frozen=True)
class Study:
    """A study, read and checked; all numbers in SI.

    Fields: title; source: where it was read from; circuit; initial: name -> value, or "measured"; recording: the
    first one, or None; recordings: all of them; free and known parameters; noise: of channels, as `fit` takes it;
    steady: whether a fit starts in the steady state; fit_options, numerics: further arguments of `fit` and `simulate`;
    times, inputs and outputs of [simulate]; names of the circuit.
    """

    title: str
    source: str
    circuit: Circuit
    names: Names
    initial: dict[str, Any] = dataclasses.field(default_factory=dict)
    recording: Recording | None = None
    free: tuple[Free, ...] = ()
    known: tuple[Known, ...] = ()
    noise: dict[str, Any] = dataclasses.field(default_factory=dict)
    fit_options: dict[str, Any] = dataclasses.field(default_factory=dict)
    numerics: dict[str, Any] = dataclasses.field(default_factory=dict)
    times: np.ndarray | None = None
    inputs: dict[str, Any] = dataclasses.field(default_factory=dict)
    outputs: tuple[str, ...] = ()
    recordings: tuple[Recording, ...] = ()
    steady: bool = False

    def fit(self, progress=None, checkpoint=None) -> Fit:
        """Fit the free parameters to the recordings. Raises: StudyError without [recording] or [fit]; as `fit`."""
        if self.recording is None:
            raise StudyError(f"{self.source}: there is nothing to fit to: add a table [recording]")
        if not self.free:
            raise StudyError(f"{self.source}: nothing is free: add [[fit.free]] with path and bounds")
        return fit(
            self.circuit,
            self.recordings if len(self.recordings) > 1 else self.recording,
            free=list(self.free),
            known=list(self.known),
            noise=self.noise or None,
            initial="steady" if self.steady else self.initial,
            progress=progress,
            checkpoint=checkpoint,
            **self.fit_options,
            **self.numerics,
        )

    def simulate(self, *, on_recording: bool = False) -> Simulation:
        """Simulate with the numbers of the file, over the times of [simulate] or else of the recording.

        Args: on_recording: prefer times, inputs and start pressures of the recording, as a fit does.
        Inputs that [simulate.inputs] does not give come from the recording. Raises: StudyError when there are no
        times; as `simulate`.
        """
        times = self.simulated_times(on_recording)
        if times is None:
            raise StudyError(f"{self.source}: {NOTHING_TO_SIMULATE}")
        measured = self._recorded_inputs()
        inputs = self.inputs | measured if on_recording else measured | self.inputs
        channels = self.recording.channels if self.recording is not None else {}
        seen = [name for name in channels if name in self.names.outputs]
        wanted = dict.fromkeys([*self.names.observed, *self.outputs, *seen])
        start = self._start(on_recording)
        return simulate(self.circuit, times, inputs, initial=start, outputs=list(wanted), **self.numerics)

    def simulated_times(self, on_recording: bool = False) -> np.ndarray | None:
        """The times of [simulate] or else of the recording, which `on_recording` prefers; None without either."""
        recorded = None if self.recording is None else self.recording.times
        return recorded if recorded is not None and (on_recording or self.times is None) else self.times

    def _start(self, on_recording: bool) -> dict[str, float]:
        """Initial values, with the first usable sample where they are "measured" (or not given, on a recording)."""
        start, recording = dict(self.initial), self.recording
        if recording is None:
            return start
        for name in self.names.initial:
            implied = on_recording and name not in start and name in recording.channels
            if implied or start.get(name) == MEASURED:
                start[name] = float(recording.channels[name][np.argmax(recording.mask[name])])
        return start

    def _recorded_inputs(self) -> dict[str, Any]:
        """The channels of the recording that drive the circuit, without their missing samples."""
        recording, signals = self.recording, {}
        for name in self.names.inputs:
            if recording is not None and name in recording.channels:
                good = recording.mask[name]
                signals[name] = Sampled(recording.times[good], recording.channels[name][good])
        return signals


def _simulation(table: SimulateTable, names: Names, builder: Builder) -> dict:
    """Times, inputs and outputs of [simulate]."""
    start, stop = (builder.number(getattr(table, end), {"unit": "s"}, f"simulate.{end}") for end in ("start", "stop"))
    if not start < stop:
        raise StudyError(f"simulate: stop must be after start, got {start:g} s and {stop:g} s")
    inputs = {}
    for name, value in table.inputs.items():
        metadata = look_up(name, names.inputs, "simulate.inputs", "input")
        if isinstance(value, dict) and "input" in value:
            raise StudyError(f"simulate.inputs.{name}: an input cannot be another input: give a number or a signal")
        inputs[name] = builder.driven(value, metadata, f"simulate.inputs.{name}")
    for name in table.outputs:
        look_up(name, names.outputs, "simulate.outputs", "output")
    return {"times": np.linspace(start, stop, table.samples), "inputs": inputs, "outputs": tuple(table.outputs)}


def _initial(given: dict, names: Names, recording: Recording | None, builder: Builder) -> dict:
    """Initial values in SI, or "measured" where a channel of that name gives them."""
    initial = {}
    for name, value in given.items():
        metadata = look_up(name, names.initial, "initial", "state")
        if value != MEASURED:
            initial[name] = builder.number(value, metadata, f"initial.{name}")
        elif recording is not None and name in recording.channels:
            initial[name] = MEASURED
        else:
            raise StudyError(f'initial.{name}: cannot be "measured": the recording has no channel {name!r}')
    return initial


def _numerics(table: NumericsTable) -> dict:
    """The arguments of `fit` and `simulate` that say how to compute."""
    solver = implicit() if table.solver == "implicit" else None
    return {**table.model_dump(exclude={"solver"}), "solver": solver}


def build_study(layout: StudyTable, folder: Path, source: str) -> Study:
    """A study from the tables of its file."""
    circuit, builder = build_circuit(layout.fluid, layout.circuit)
    with at("circuit"):
        names = names_of(circuit)
    recording, found = None, {}
    if layout.recording is not None:
        found["recordings"] = study_recordings(layout.recording, folder, circuit, names, builder)
        recording = found["recordings"][0]
        found["noise"] = study_noise(layout.recording.noise, names, builder)
    initial = _initial(layout.initial, names, recording, builder)
    if layout.fit is not None:
        found["free"], found["known"] = study_parameters(layout.fit, circuit, names, initial, builder)
        found["fit_options"] = study_fit_options(layout.fit, names, builder)
        found["steady"] = layout.fit.steady
        for one in found.get("recordings", (None,)):
            check_fit(circuit, one, names, layout.fit.derived)
    if layout.simulate is not None:
        found |= _simulation(layout.simulate, names, builder)
    found |= {"initial": initial, "numerics": _numerics(layout.numerics)}
    return Study(layout.title or Path(source).stem, source, circuit, names, recording=recording, **found)


def _locate(source: str) -> Path:
    """The file of a study; "example:NAME" is one of the package."""
    if not source.startswith(EXAMPLE):
        return Path(source)
    folder = Path(str(importlib.resources.files("jaxlines") / "examples"))
    path = folder / f"{source.removeprefix(EXAMPLE)}.toml"
    if not path.is_file():
        known = sorted(p.stem for p in folder.glob("*.toml"))
        raise StudyError(f"{source}: no such example; there are {', '.join(known) or 'none'}")
    return path


@contextlib.contextmanager
def study_file(source):
    """The content of a study file and its path, to be read inside: mistakes name the file, the line and the column.

    Raises: StudyError for a file that cannot be read.
    """
    path = _locate(str(source))
    with at(str(source)):
        if not path.is_file():
            raise StudyError("is a folder, not a study file" if path.is_dir() else "no such file")
        try:
            text = path.read_text(encoding="utf-8-sig")
            content = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise StudyError(f"not valid TOML: {error}") from error
        with with_positions(text):
            yield content, path


def load_study(source) -> Study:
    """Read a study from a TOML file, or "example:NAME" from the package.

    Raises: StudyError, in one line that starts with the file, for anything that is wrong in it.
    """
    with study_file(source) as (content, path):
        return build_study(check_layout(content), path.parent, str(source))
