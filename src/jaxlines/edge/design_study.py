"""From a study file with a table [design] to the arguments of `design`."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxlines.edge.building import Builder, StudyError
from jaxlines.edge.design_tables import DesignTable, ExciteTable
from jaxlines.edge.fit_tables import study_noise
from jaxlines.edge.naming import at, look_up
from jaxlines.edge.study import Study, build_study, study_file
from jaxlines.edge.tables import check_layout
from jaxlines.inference.design import design
from jaxlines.inference.design_excitation import AbstractExcitation
from jaxlines.inference.design_inputs import Knots, Multisine, Scaled
from jaxlines.inference.design_result import Design
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.noise import Noise, as_noise
from jaxlines.inference.parameters import Known
from jaxlines.simulation.observation import is_gauge
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.signals import as_signal

_OPTIONS = {"num_sensors", "num_samples", "evenly", "robust", "scenarios", "starts", "max_iterations", "seed"}
DEFAULT_SAMPLES = 201


@dataclasses.dataclass(frozen=True, eq=False)
class DesignStudy:
    """A study with its [design]: the `Study`; what `design` is called with; whether a fit of the recording counts."""

    study: Study
    arguments: dict[str, Any]
    after_fit: bool

    def design(self, progress=None) -> Design:
        """Design the test. Raises StudyError with the place; as `design`."""
        arguments = dict(self.arguments)
        if self.after_fit:
            fit = self.study.fit(progress)
            if fit.status == "failed":
                raise StudyError(f"design.after_fit: the fit failed: {fit.message}")
            arguments["earlier"] = fit
            arguments["noise"] = {name: _seen_noise(fit, name, arguments["noise"]) for name in arguments["sensors"]}
        with at("design"):
            return design(self.study.circuit, self.study.free, progress=progress, **arguments)


def load_design(source, target: Sequence[str] = (), criterion: str | None = None) -> DesignStudy:
    """Read a study with a table [design].

    Args: source: a TOML file, or "example:NAME"; target, criterion: instead of the file's.
    Raises: StudyError, in one line that starts with the file, for anything that is wrong in it.
    """
    with study_file(source) as (content, path):
        layout = check_layout(content)
        if layout.design is None:
            raise StudyError(
                "there is no test to design: add a table [design] with limits, and [[design.excite]] with input, low "
                "and high"
            )
        return design_of(build_study(layout, path.parent, str(source)), layout.design, target, criterion)


def design_of(
    study: Study, table: DesignTable, target: Sequence[str] = (), criterion: str | None = None
) -> DesignStudy:
    """The design of a study from its table. Raises StudyError with the place."""
    if not study.free:
        raise StudyError("design: nothing is free: add [[fit.free]] with path and bounds")
    builder = Builder(float(study.circuit.fluid.atmospheric_pressure))
    times = _times(study, table, builder)
    excite = [_excitation(study, one, times, builder, f"design.excite.{i}") for i, one in enumerate(table.excite)]
    sensors = _sensors(study, table)
    noise = _noise(study, table, sensors, builder)
    wanted = list(target) or table.target
    initial, starting = _initial(study, noise)
    driven = {one.input for one in excite}
    arguments = {
        "times": times,
        "sensors": sensors,
        "noise": noise,
        "excite": excite,
        "target": (wanted[0] if len(wanted) == 1 else wanted) or None,
        "criterion": criterion or table.criterion,
        "limits": _limits(study, table, builder),
        "inputs": {name: signal for name, signal in _inputs(study).items() if name not in driven},
        "known": [*study.known, *starting],
        "initial": initial,
        **table.model_dump(include=_OPTIONS),
        **study.numerics,
    }
    return DesignStudy(study, arguments, table.after_fit)


def _times(study: Study, table: DesignTable, builder: Builder) -> np.ndarray:
    """Instants at which can be measured [s]."""
    recorded = study.recording.times if study.recording is not None else study.times
    if table.stop is None:
        if recorded is None:
            raise StudyError('design: how long is the test? Give stop = "30 s"')
        if table.samples is None:
            return recorded
        return np.linspace(recorded[0], recorded[-1], table.samples)
    stop = builder.number(table.stop, {"unit": "s"}, "design.stop")
    if not stop > 0.0:
        raise StudyError(f"design.stop: a test must last longer than 0 s, got {stop:g} s")
    return np.linspace(0.0, stop, table.samples or DEFAULT_SAMPLES)


def _sensors(study: Study, table: DesignTable) -> list[str]:
    """Outputs that can be measured."""
    for name in table.sensors:
        look_up(name, study.names.outputs, "design.sensors", "output")
    channels = study.recording.channels if study.recording is not None else {}
    found = table.sensors or [name for name in channels if name in study.names.outputs]
    if not found:
        raise StudyError('design: nothing is measured: give sensors = ["A.pressure"]')
    return found


def _noise(study: Study, table: DesignTable, sensors: list[str], builder: Builder) -> dict[str, Any]:
    """Noise of the sensors: of the table, else of the recording."""
    given = study_noise(table.noise, study.names, builder, "design.noise")
    noise = {name: level for name, level in (study.noise | given).items() if name in sensors}
    for name in sensors:
        if not table.after_fit and as_noise(noise.get(name), name).estimated:
            unit = look_up(name, study.names.outputs, "design.noise", "output")["unit"]
            raise StudyError(
                f"design.noise: that of {name} is missing: before a test it cannot be estimated; give its standard "
                f'deviation, such as noise = {{ "{name}" = "1 {unit}" }}, or after_fit = true'
            )
    return noise


def _seen_noise(fit: Fit, name: str, given: dict[str, Any]) -> Noise | None:
    """Noise of a sensor as it was given, else what an earlier fit found in its residuals."""
    level = as_noise(given.get(name), name)
    if not level.estimated:
        return level
    found = [channel.sigma for label, channel in fit.channels.items() if label.partition(" [")[0] == name]
    return Noise(float(np.sqrt(np.mean(np.square(found))))) if found else None


def _inputs(study: Study) -> dict[str, Any]:
    """The inputs of the recording, else those of [simulate]."""
    return study.inputs | study._recorded_inputs()


def _initial(study: Study, noise: dict[str, Any]) -> tuple[dict | str, list[Known]]:
    """Start values, and the uncertainty of those that a fit takes from the first sample."""
    if study.steady:
        return "steady", []
    free, told = {path for f in study.free for path in f.paths}, study._start(on_recording=True)
    taken = [
        name for name in told if f"initial.{name}" not in free and study.initial.get(name, "measured") == "measured"
    ]
    levels = {name: noise.get(name) for name in taken}
    found = []
    for name, level in levels.items():
        sd = level.level(told[name]) if isinstance(level, Noise) and not level.estimated else level
        if isinstance(sd, float | np.floating | np.ndarray) and float(sd) > 0.0:
            found.append(Known(f"initial.{name}", float(sd)))
    return told, found


def _limits(study: Study, table: DesignTable, builder: Builder) -> dict[str, tuple[float | None, float | None]]:
    """Limits of outputs in SI."""
    found = {}
    for name, pair in table.limits.items():
        where = f"design.limits.{name}"
        metadata = look_up(name, study.names.outputs, "design.limits", "output")
        if len(pair) != 2:
            raise StudyError(f'{where}: give the lowest and the highest value ("none" for no limit), got {pair!r}')
        gauge = is_gauge(study.circuit, name)
        found[name] = tuple(None if end == "none" else builder.shown(end, metadata, where, gauge) for end in pair)
    return found


def _excitation(study: Study, one: ExciteTable, times, builder: Builder, where: str) -> AbstractExcitation:
    """An input to be chosen, in SI."""
    metadata = look_up(one.input, study.names.inputs, where, "input")
    change = {**metadata, "level": False}
    steep = {"unit": "1/s" if metadata["unit"] == "1" else f"{metadata['unit']}/s", "level": False}

    def number(key: str, kind: dict):
        value = getattr(one, key)
        return None if value is None else builder.number(value, kind, f"{where}.{key}")

    low, high, rate = number("low", metadata), number("high", metadata), number("rate", steep)
    energy = None if one.energy == "start" else number("energy", {"unit": _squared(metadata["unit"])})
    with at(where):
        assert low is not None and high is not None
        if one.kind == "knots":
            knots = _knots(one, times, builder, where)
            values = _start(study, one, knots, builder, metadata, where)
            ends = {"first": number("first", metadata), "last": number("last", metadata)}
            made: AbstractExcitation = Knots(one.input, knots, low, high, values, rate=rate, energy=energy, **ends)
        elif one.kind == "multisine":
            heights = one.start and [builder.number(v, change, f"{where}.start") for v in one.start]
            frequencies = [builder.number(f, {"unit": "Hz"}, f"{where}.frequencies") for f in one.frequencies]
            mean = number("mean", metadata)
            made = Multisine(one.input, frequencies, float(times[-1]), low, high, mean, heights, rate, energy)
        else:
            grid = _knots(one, times, builder, where)
            values = _start(study, one, grid, builder, metadata, where)
            if values is None:
                raise StudyError("there is no profile to scale: give start, or the input in [simulate.inputs]")
            made = Scaled(one.input, grid, values, low, high, *one.factor, rate=rate, energy=energy)
        if one.energy != "start":
            return made
        return dataclasses.replace(made, energy=made.energy_of(made.start_coefficients))  # pyright: ignore


def _squared(unit: str) -> str:
    """The unit of the integral of a square over time."""
    return "s" if unit == "1" else f"({unit})^2*s"


def _knots(one: ExciteTable, times, builder: Builder, where: str) -> np.ndarray:
    """Times of the knots [s]."""
    if isinstance(one.knots, list):
        return np.array([builder.number(t, {"unit": "s"}, f"{where}.knots") for t in one.knots])
    return np.linspace(times[0], times[-1], one.knots or 21)


def _start(study: Study, one: ExciteTable, knots, builder: Builder, metadata: dict, where: str):
    """Values to begin with: those given, else the study's own input at the knots within the limits, else None."""
    if one.start is not None:
        return np.array([builder.number(v, metadata, f"{where}.start") for v in one.start])
    signal = _inputs(study).get(one.input)
    if signal is None:
        return None
    low, high = (builder.number(end, metadata, where) for end in (one.low, one.high))
    with computing_in("float64"):
        values = np.array([np.asarray(as_signal(signal, knots)(t), dtype=float) for t in knots])
    values[[0, -1]] = [
        value if fixed is None else builder.number(fixed, metadata, where)
        for value, fixed in zip(values[[0, -1]], (one.first, one.last), strict=True)
    ]
    return np.clip(values, low, high)
