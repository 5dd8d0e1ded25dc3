"""A circuit and a recording as residuals and an exact Jacobian, on a program compiled once per topology."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.recording import Recording
from jaxlines.simulation.assembly import Location, compile_circuit, number_locations, set_numbers
from jaxlines.simulation.circuit import Circuit, field_metadata
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.integration import Method, integrate, integrate_with_sensitivities
from jaxlines.simulation.observation import quantities, sensor_units
from jaxlines.simulation.paths import replace_leaves, resolve
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import MESSAGES, STATUS
from jaxlines.simulation.segments import choose_segments
from jaxlines.simulation.signals import Sampled


def bucket(size: int) -> int:
    """The next size of the form 2^k or 1.5 * 2^k, so that recordings of similar length share a program."""
    power = 2 ** math.ceil(math.log2(max(size, 16)))
    return 3 * power // 4 if size <= 3 * power // 4 else power


def prediction(plan, wanted, method, locations, numbers, values, times, tolerance):
    """Outputs (times, channels) and status for the numbers at some locations."""
    found = integrate(plan, wanted, method, set_numbers(values, locations, numbers), times, tolerance)
    return found.outputs, found.status


def sensitivity(plan, wanted, method, locations, groups, numbers, sizes, values, times, tolerance):
    """Outputs, d outputs / d parameters (times, channels, parameters) and status, by forward sensitivities.

    `groups` gives for each parameter the positions of the numbers that it drives, `sizes` a large change of it.
    """
    leaves, structure = jax.tree.flatten(set_numbers(values, locations, numbers))
    touched = sorted({position for position, _ in locations})

    def rebuild(moved):
        return jax.tree.unflatten(structure, _replaced(leaves, touched, moved))

    def move(shift):
        moved = numbers
        for parameter, members in enumerate(groups):
            moved = moved.at[np.asarray(members)].add(shift[parameter] * sizes[parameter])
        every = jax.tree.leaves(set_numbers(values, locations, moved))
        return [every[position] for position in touched]

    start = jnp.zeros(len(groups), numbers.dtype)
    slopes = [jnp.moveaxis(s, -1, 0) for s in jax.jacfwd(move)(start)]
    found, output_slopes = integrate_with_sensitivities(
        plan, wanted, method, rebuild, move(start), slopes, times, tolerance
    )
    return found.outputs, output_slopes / sizes, found.status


def _replaced(leaves: list, positions: list[int], new: list) -> list:
    """Leaves with those at some positions replaced."""
    given = dict(zip(positions, new, strict=True))
    return [given.get(position, leaf) for position, leaf in enumerate(leaves)]


_predict = jax.jit(prediction, static_argnums=(0, 1, 2, 3))
_sensitivities = jax.jit(sensitivity, static_argnums=(0, 1, 2, 3, 4))


def set_on_host(values: Values, location, factor: float = 1.0, value: float | None = None) -> Values:
    """Packed values with one number replaced, or multiplied by a factor, in NumPy."""
    leaves, structure = jax.tree.flatten(values)
    position, member = location
    leaf = np.array(leaves[position], dtype=float)
    index = ... if member is None else member
    leaf[index] = leaf[index] * factor if value is None else value
    leaves[position] = leaf
    return jax.tree.unflatten(structure, leaves)


@dataclasses.dataclass(frozen=True)
class Problem:
    """Everything that stays the same while a fit searches.

    Fields: circuit, recording, free, known; plan and values of the compiled circuit; wanted: fitted channels;
    inputs bound to signals; locations: where the numbers of free and known parameters are; groups: which of
    them each parameter drives.
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
    locations: tuple[Location, ...]
    groups: tuple[tuple[int, ...], ...]
    known_values: np.ndarray

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

    def _arguments(self, free_values):
        """What the compiled programs take, in the precision of the problem."""
        every = np.concatenate([np.asarray(free_values, dtype=float), self.known_values])
        repeated = np.concatenate([np.full(len(members), every[i]) for i, members in enumerate(self.groups)])
        return cast((repeated, self.values, self.padded_times(), np.asarray(self.tolerance)), self.precision)

    def _simulated(self, free_values) -> tuple[np.ndarray, np.ndarray]:
        """Outputs with padding, and the status code."""
        with computing_in(self.precision):
            found = _predict(self.plan, self.wanted, self.method, self.locations, *self._arguments(free_values))
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
            numbers, *data = self._arguments(free_values)
            found = _sensitivities(*static, numbers, cast(self.sizes, self.precision), *data)
            outputs, slopes, status = (np.asarray(x) for x in found)
        return self._trimmed(outputs, status), self._trimmed(slopes, status)

    def _trimmed(self, array, status) -> np.ndarray:
        """Without padding, in float64, NaN for a failed trajectory (its derivatives would be zero, not unknown).

        Tension is let through: a search may pass through it, and the end point is looked at again.
        """
        array = np.asarray(array[: self.recording.times.size], dtype=np.float64)
        return array if status in (STATUS["ok"], STATUS["tension"]) else np.full_like(array, np.nan)

    def with_numbers(self, free_values) -> tuple[Circuit, dict, dict]:
        """The circuit, the initial values and the inputs with these numbers."""
        in_circuit, in_inputs, initial = {}, {}, dict(self.initial)
        for parameter, value in zip(self.free, free_values, strict=True):
            for path in parameter.paths:
                owner, _, rest = path.partition(".")
                if owner == "initial":
                    initial[rest] = float(value)
                elif owner in self.inputs:
                    in_inputs[path] = np.asarray(value, dtype=float)
                else:
                    in_circuit[path] = float(value)
        return self.circuit.replace(in_circuit), initial, replace_leaves(self.inputs, in_inputs)


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
    """The packed values of a problem with the inputs of another recording of the same length."""
    padded = _bound(problem.circuit, recording, interpolation)[1]
    names = zip(problem.plan.signal_names, problem.values.signals, strict=True)
    signals = tuple(padded.get(name, signal) for name, signal in names)
    return dataclasses.replace(problem.values, signals=signals)


def check_parameters(circuit: Circuit, free, known, locations) -> tuple[tuple[Free, ...], tuple[Known, ...]]:
    """Free and known parameters with full paths; raises for unknown, repeated or out-of-range ones."""
    full_free, full_known, seen = [], [], set()
    for parameter in free:
        paths = tuple(resolve(path, locations) for path in parameter.paths)
        full_free.append(dataclasses.replace(parameter, path=paths, name=parameter.label))
    for number in known:
        full_known.append(dataclasses.replace(number, path=resolve(number.path, locations)))
    for path in [p for f in full_free for p in f.paths] + [k.path for k in full_known]:
        if path in seen:
            raise ValueError(f"{path} is given twice among the free and known parameters")
        seen.add(path)
    for parameter in full_free:
        for path in parameter.paths:
            metadata = number_metadata(circuit, path)
            if metadata and not (metadata["low"] <= parameter.bounds[0] and parameter.bounds[1] <= metadata["high"]):
                low, high, slip = metadata["low"], metadata["high"], metadata.get("slip")
                raise ValueError(
                    f"{path}: bounds must lie in {low:g}..{high:g} {metadata['unit']}, got "
                    f"{parameter.bounds[0]:g}..{parameter.bounds[1]:g}{': ' + slip if slip else ''}"
                )
    if not full_free:
        raise ValueError("a fit needs at least one free parameter, such as Free('fluid.bulk_modulus', (0.6e9, 2.5e9))")
    return tuple(full_free), tuple(full_known)


def number_metadata(circuit: Circuit, path: str) -> dict:
    """Unit and range of a number or an initial value; empty where none is declared."""
    owner = path.partition(".")[0]
    if owner == "fluid" or owner in circuit.components:
        return field_metadata(circuit, path)
    if owner == "initial" and path.endswith(".pressure"):
        return {"unit": "Pa", "low": 0.0, "high": 1e9, "slip": "pressures are absolute and in Pa"}
    return {}


def make_problem(
    circuit, recording, free, known, initial, method, tolerance, precision, interpolation="linear"
) -> Problem:
    """Check a fit's arguments and compile them into a problem. Raises as `fit` documents."""
    with computing_in(precision):
        signals, padded = _bound(circuit, recording, interpolation)
        circuit = _settled(circuit, recording, signals, initial or {}, free)
        plan, values = compile_circuit(circuit, initial, padded)
        fitted, units = _split_channels(circuit, plan, recording)
        known_locations = number_locations(plan, values)
    free, known = check_parameters(circuit, free, known, known_locations)
    paths, groups = [], []
    for parameter in [*free, *known]:
        members = parameter.paths if isinstance(parameter, Free) else (parameter.path,)
        groups.append(tuple(range(len(paths), len(paths) + len(members))))
        paths += members
    known_values = np.asarray([float(_number(values, known_locations, k.path)) for k in known])
    return Problem(
        circuit=circuit,
        recording=recording,
        free=free,
        known=known,
        initial=dict(initial or {}),
        inputs=signals,
        plan=plan,
        values=values,
        wanted=tuple(fitted),
        units=tuple(units[name] for name in fitted),
        method=method,
        precision=precision,
        tolerance=tolerance,
        locations=tuple(known_locations[path] for path in paths),
        groups=tuple(groups),
        known_values=known_values,
    )


def _settled(circuit: Circuit, recording: Recording, signals: dict, initial: dict, free) -> Circuit:
    """The circuit with the numbers of segments that the slowest waves within the bounds need."""
    variants = []
    for path, bound in [(p, b) for f in free for p in f.paths for b in f.bounds]:
        owner, _, rest = path.partition(".")
        if owner == "initial":
            variants.append((circuit, initial | {rest: bound}))
        elif owner == "fluid" or owner in circuit.components:
            variants.append((circuit.replace({path: bound}, check=False), initial))
    return choose_segments(circuit, recording.times, signals, initial=initial, variants=variants)


def _number(values: Values, locations, path: str):
    """The present value of a number by its path."""
    position, member = locations[path]
    leaf = np.asarray(jax.tree.leaves(values)[position])
    return leaf if member is None else leaf[member].flat[0]
