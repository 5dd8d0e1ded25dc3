"""A circuit and one recording: simulated channels and their exact slopes, on a program compiled once per topology."""

import dataclasses

import jax
import numpy as np

from jaxlines.inference.parameter_checks import (
    check_parameters as check_parameters,
    number_metadata as number_metadata,
)
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.programs import (
    Place,
    bucket as bucket,
    predict_program as _predict,
    prediction as prediction,
    sensitivity as sensitivity,
    sensitivity_program as _sensitivities,
)
from jaxlines.inference.recording import Recording
from jaxlines.simulation.assembly import compile_circuit, number_locations
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.integration import Method
from jaxlines.simulation.observation import quantities, sensor_units
from jaxlines.simulation.paths import replace_leaves, resolve
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import MESSAGES, STATUS
from jaxlines.simulation.segments import choose_segments
from jaxlines.simulation.signals import Sampled


def set_on_host(values: Values, location, factor: float = 1.0, value: float | None = None) -> Values:
    """Packed values with one number replaced, or multiplied by a factor, in NumPy."""
    leaves, structure = jax.tree.flatten(values)
    position, member = location
    leaf = np.array(leaves[position], dtype=float)
    index = ... if member is None else member
    leaf[index] = leaf[index] * factor if value is None else value
    leaves[position] = leaf
    return jax.tree.unflatten(structure, leaves)


INPUT_NUMBERS = ("gain", "offset")
"""Numbers of a recorded input that a fit can free beside its delay: true value = gain * recorded value + offset."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """What stays the same of one recording while a fit searches.

    Fields: circuit under the conditions of the recording, recording, free, known; plan and values of the compiled
    circuit; wanted: fitted channels; inputs bound to signals; locations: where free and known parameters act; groups:
    which of these places each parameter drives; steady: whether it starts in the steady state.
    """

    circuit: Circuit
    recording: Recording
    free: tuple[Free, ...]
    known: tuple[Known, ...]
    initial: dict
    inputs: dict[str, Sampled]
    plan: Plan
    values: Values
    wanted: tuple[str, ...]
    units: tuple[str, ...]
    method: Method
    precision: str
    tolerance: float
    locations: tuple[Place, ...]
    groups: tuple[tuple[int, ...], ...]
    known_values: np.ndarray
    steady: bool = False

    @property
    def measured(self) -> np.ndarray:
        """Measured values of the fitted channels, shape (times, channels)."""
        return np.stack([self.recording.channels[name] for name in self.wanted], axis=1)

    @property
    def used(self) -> np.ndarray:
        """Which samples count, shape (times, channels)."""
        return np.stack([self.recording.mask[name] for name in self.wanted], axis=1)

    def padded_times(self) -> np.ndarray:
        """Times with the last one repeated up to the bucket."""
        times = self.recording.times
        return np.concatenate([times, np.full(bucket(times.size) - times.size, times[-1])])

    @property
    def sizes(self) -> np.ndarray:
        """A large change of each parameter, by which its sensitivities are scaled."""
        known = np.maximum(np.abs(self.known_values), [k.sd for k in self.known])
        return np.concatenate([[f.bounds[1] - f.bounds[0] for f in self.free], known])

    def arguments(self, free_values):
        """What the compiled programs take, in the precision of the problem."""
        every = np.concatenate([np.asarray(free_values, dtype=float), self.known_values])
        repeated = np.concatenate([np.full(len(members), every[i]) for i, members in enumerate(self.groups)])
        return cast((repeated, self.values, self.padded_times(), np.asarray(self.tolerance)), self.precision)

    def _simulated(self, free_values) -> tuple[np.ndarray, np.ndarray]:
        """Outputs with padding, and the status code."""
        with computing_in(self.precision):
            arguments = self.arguments(free_values)
            found = _predict(self.plan, self.wanted, self.method, self.locations, *arguments, self.steady)
            return np.asarray(found[0]), np.asarray(found[1])

    def predict(self, free_values) -> np.ndarray:
        """Simulated channels, shape (times, channels); NaN when the simulation fails."""
        return self._trimmed(*self._simulated(free_values))

    def why_it_fails(self, free_values) -> str:
        """What the simulation with these values says of itself."""
        return list(MESSAGES.values())[int(self._simulated(free_values)[1])]

    def sensitivities(self, free_values) -> tuple[np.ndarray, np.ndarray]:
        """Simulated channels and their slopes by every free and known parameter, in SI (not coordinates)."""
        with computing_in(self.precision):
            static = (self.plan, self.wanted, self.method, self.locations, self.groups)
            numbers, *data = self.arguments(free_values)
            found = _sensitivities(*static, numbers, cast(self.sizes, self.precision), *data, self.steady)
            outputs, slopes, status = (np.asarray(x) for x in found)
        return self._trimmed(outputs, status), self._trimmed(slopes, status)

    def _trimmed(self, array, status) -> np.ndarray:
        """Without padding, in float64, NaN for a failed trajectory (its derivatives would be zero, not unknown).

        Tension is let through: a search may pass through it, and the end point is looked at again.
        """
        array = np.asarray(array[: self.recording.times.size], dtype=np.float64)
        return array if status in (STATUS["ok"], STATUS["tension"]) else np.full_like(array, np.nan)

    def with_numbers(self, free_values) -> tuple[Circuit, dict | str, dict]:
        """The circuit, the initial values (or "steady") and the inputs with these numbers."""
        in_circuit, in_inputs, initial = {}, {}, dict(self.initial)
        moved = {name: [1.0, 0.0] for name in self.inputs}
        for parameter, value in zip(self.free, free_values, strict=True):
            for path, ratio in zip(parameter.paths, parameter.path_ratios, strict=True):
                owner, _, rest = path.partition(".")
                number = float(value) * ratio
                if owner == "initial":
                    initial[rest] = number
                elif owner in self.circuit.components:
                    in_circuit[path] = number
                elif owner in self.inputs and rest in INPUT_NUMBERS:
                    moved[owner][INPUT_NUMBERS.index(rest)] = number
                elif owner in self.inputs:
                    in_inputs[path] = np.asarray(number, dtype=float)
                else:
                    in_circuit[path] = number
        for name, (gain, offset) in moved.items():
            if (gain, offset) != (1.0, 0.0):
                in_inputs[f"{name}.values"] = gain * self.inputs[name].values + offset
        circuit = self.circuit.replace(in_circuit)
        return circuit, "steady" if self.steady else initial, replace_leaves(self.inputs, in_inputs)


def _split_channels(circuit: Circuit, plan: Plan, recording: Recording) -> tuple[list[str], dict[str, str]]:
    """Channels that are fitted, and the unit of every output of the circuit."""
    units = {name: q.unit for name, q in quantities(plan).items()} | sensor_units(circuit, plan)
    inputs = circuit.external_inputs()
    fitted = []
    for channel in recording.channels:
        if channel in inputs:
            continue
        if channel not in units:
            resolve(channel, [*units, *inputs], "output or input")
        fitted.append(channel)
    if not fitted:
        raise ValueError(
            f"{recording.name}: no channel of the recording is an output of the circuit; channels: "
            f"{', '.join(recording.channels)}; outputs: {', '.join(units)}"
        )
    return fitted, units


def recorded_inputs(circuit: Circuit, recording: Recording, interpolation: str) -> dict[str, Sampled]:
    """The channels that drive the circuit, as signals; missing samples are refused."""
    signals = {}
    for name in circuit.external_inputs():
        if name not in recording.channels:
            raise ValueError(
                f"{recording.name}: the circuit needs a channel {name!r} as input; "
                f"it has {', '.join(recording.channels)}"
            )
        values, good = recording.channels[name], recording.mask[name]
        if not good.all():
            at = recording.times[int(np.argmin(good))]
            raise ValueError(
                f"{recording.name}: input channel {name!r} has {int((~good).sum())} missing samples, the first at "
                f"{at:g} s: an input must be complete (fill it, or choose a window without the gap)"
            )
        signals[name] = Sampled(recording.times, values, interpolation)
    return signals


def _bound(circuit: Circuit, recording: Recording, interpolation: str) -> tuple[dict[str, Sampled], dict[str, Sampled]]:
    """The recorded inputs as signals, and the same padded to a bucket."""
    signals = recorded_inputs(circuit, recording, interpolation)
    bind_inputs(circuit, signals, recording.times)
    return signals, {name: signal.padded(bucket(recording.times.size)) for name, signal in signals.items()}


def with_inputs(problem: Problem, recording: Recording, interpolation: str) -> Values:
    """The packed values of a problem with the inputs of another recording of the same length.

    Raises: ValueError for a recording with conditions or start values of its own, which these values would not have.
    """
    if recording.conditions or recording.initial is not None:
        raise ValueError(
            f"{recording.name}: conditions and start values of a recording are for `fit`; give the numbers that differ "
            "between recordings of a batch as `local`"
        )
    padded = _bound(problem.circuit, recording, interpolation)[1]
    names = zip(problem.plan.signal_names, problem.values.signals, strict=True)
    signals = tuple(padded.get(name, signal) for name, signal in names)
    return dataclasses.replace(problem.values, signals=signals)


def conditioned(circuit: Circuit, recording: Recording, initial: dict | str | None) -> tuple[Circuit, dict | str]:
    """The circuit and the start values under the conditions of a recording, its own start values first."""
    start = recording.initial if recording.initial is not None else (initial or {})
    if isinstance(start, str) and start != "steady":
        raise ValueError(f'{recording.name}: initial must be a table of start values or "steady", got {start!r}')
    in_circuit = {path: v for path, v in recording.conditions.items() if not path.startswith("initial.")}
    told = {path.removeprefix("initial."): v for path, v in recording.conditions.items() if path not in in_circuit}
    if told and isinstance(start, str):
        raise ValueError(f'{recording.name}: it cannot start "steady" and at {", ".join(told)} of its conditions')
    try:
        circuit = circuit.replace(in_circuit)
    except (KeyError, ValueError) as error:
        raise type(error)(f"{recording.name}, conditions: {error.args[0]}") from error
    return circuit, start if isinstance(start, str) else start | told


def _places(plan: Plan, values: Values, inputs, parameters) -> tuple[tuple[Place, ...], tuple[tuple[int, ...], ...]]:
    """Where parameters act, and which of the places each drives."""
    known, places, groups = parameter_locations(plan, values, inputs), [], []
    for parameter in parameters:
        paths = parameter.paths if isinstance(parameter, Free) else (parameter.path,)
        ratios = parameter.path_ratios if isinstance(parameter, Free) else (1.0,)
        groups.append(tuple(range(len(places), len(places) + len(paths))))
        places += [known[path]._replace(ratio=ratio) for path, ratio in zip(paths, ratios, strict=True)]
    return tuple(places), tuple(groups)


def parameter_locations(plan: Plan, values: Values, inputs) -> dict[str, Place]:
    """Path of every number that a fit can free -> where it acts; recorded inputs have gain and offset besides."""
    found = {path: Place(*location) for path, location in number_locations(plan, values).items()}
    for name in inputs:
        samples = found[f"{name}.values"].position
        new = {f"{name}.gain": "scale", f"{name}.offset": "shift"}
        found |= {path: Place(samples, None, 1.0, mode) for path, mode in new.items() if path not in found}
    return found


def make_problem(
    circuit, recording, free, known, initial, method, tolerance, precision, interpolation="linear"
) -> Problem:
    """Check a fit's arguments and compile them into a problem. Raises as `fit` documents."""
    circuit, start = conditioned(circuit, recording, initial)
    steady, told = start == "steady", start if isinstance(start, dict) else {}
    with computing_in(precision):
        signals, padded = _bound(circuit, recording, interpolation)
        circuit = _enough_segments(circuit, recording, signals, told, free)
        plan, values = compile_circuit(circuit, told, padded)
        fitted, units = _split_channels(circuit, plan, recording)
        known_places = parameter_locations(plan, values, signals)
    free, known = check_parameters(circuit, free, known, known_places)
    full = {resolve(path, known_places): value for path, value in recording.conditions.items()}
    recording = dataclasses.replace(recording, conditions=full)
    _check_recorded(recording, free, signals, steady)
    locations, groups = _places(plan, values, signals, [*free, *known])
    known_values = np.asarray([_number(values, known_places, k.path) for k in known])
    return Problem(
        circuit=circuit,
        recording=recording,
        free=free,
        known=known,
        initial=told,
        inputs=signals,
        plan=plan,
        values=values,
        wanted=tuple(fitted),
        units=tuple(units[name] for name in fitted),
        method=method,
        precision=precision,
        tolerance=tolerance,
        locations=locations,
        groups=groups,
        known_values=known_values,
        steady=steady,
    )


def _check_recorded(recording: Recording, free: tuple[Free, ...], signals: dict[str, Sampled], steady: bool) -> None:
    """Raise for parameters that the inputs, conditions or the start of a recording rule out."""
    for path in (path for parameter in free for path in parameter.paths):
        owner, _, rest = path.partition(".")
        if steady and owner == "initial":
            raise ValueError(
                f'{path} cannot be free: {recording.name} starts "steady", so that it follows from the rest'
            )
        if path in recording.conditions:
            raise ValueError(f"{path} is free and among the conditions of {recording.name}: it cannot be both")
        if rest == "delay" and owner in signals and signals[owner].method == "hold":
            raise ValueError(
                f'{path} cannot be estimated with interpolation="hold", whose jumps have no derivative: use "cubic"'
            )


def settled(circuit: Circuit, recording: Recording, initial: dict, free, interpolation: str) -> Circuit:
    """The circuit with the numbers of segments that a recording needs within the bounds of the free parameters."""
    signals = _bound(circuit, recording, interpolation)[0]
    return _enough_segments(circuit, recording, signals, {k: v for k, v in initial.items() if v != "measured"}, free)


def _enough_segments(circuit: Circuit, recording: Recording, signals: dict, initial: dict, free) -> Circuit:
    """The circuit with the numbers of segments that the slowest waves within the bounds need."""
    variants = []
    driven = [(p, r, b) for f in free for p, r in zip(f.paths, f.path_ratios, strict=True) for b in f.bounds]
    for path, ratio, bound in driven:
        owner, _, rest = path.partition(".")
        if owner == "initial":
            variants.append((circuit, initial | {rest: bound * ratio}))
        elif owner == "fluid" or owner in circuit.components:
            variants.append((circuit.replace({path: bound * ratio}, check=False), initial))
    return choose_segments(circuit, recording.times, signals, initial=initial, variants=variants)


def _number(values: Values, places: dict[str, Place], path: str) -> float:
    """The present value of a number by its path; 1 for the gain of an input, 0 for its offset."""
    place = places[path]
    if place.mode != "set":
        return float(place.mode == "scale")
    leaf = np.asarray(jax.tree.leaves(values)[place.position])
    return float(leaf if place.member is None else np.ravel(leaf[place.member])[0])
