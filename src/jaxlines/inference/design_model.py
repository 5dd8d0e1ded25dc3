"""A planned test as a compiled program: weighted slopes of its readings, and their derivatives by the input."""

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxlines.inference.design_excitation import AbstractExcitation
from jaxlines.inference.noise import Noise, as_noise
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.problem import (
    _number,
    _places,
    check_parameters,
    parameter_locations,
)
from jaxlines.inference.programs import Place, sensitivity
from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.integration import Method
from jaxlines.simulation.observation import quantities, sensor_units
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import MESSAGES, STATUS
from jaxlines.simulation.segments import choose_segments


class Outcome(NamedTuple):
    """What a test would give with some values of the parameters.

    rows: d output / d parameter over the noise, parameters in units of `DesignModel.scale`, known ones of their
    standard uncertainty, shape (times, sensors, free + known); outputs: shape (times, sensors + limited); status: of
    the simulation ("ok", ...). row_slopes and output_slopes: derivatives by the coefficients of the excitations, with a
    last axis of coefficients, or None.
    """

    rows: np.ndarray
    outputs: np.ndarray
    status: str
    row_slopes: np.ndarray | None = None
    output_slopes: np.ndarray | None = None

    @property
    def ok(self) -> bool:
        """Whether the numbers can be used."""
        return self.status == "ok" and bool(np.all(np.isfinite(self.rows)))


class _Static(NamedTuple):
    """What the compiled programs are made for."""

    plan: Plan
    wanted: tuple[str, ...]
    sensors: int
    method: Method
    places: tuple[Place, ...]
    groups: tuple[tuple[int, ...], ...]
    signals: tuple[int, ...]
    steady: bool


def _weighted(static: _Static, coefficients, data):
    """Weighted rows and outputs, and the status, for coefficients of the excitations."""
    numbers, sizes, scale, noise, values, bases, times, tolerance = data
    driven = [base + basis @ own for (base, basis), own in zip(bases, coefficients, strict=True)]
    values = eqx.tree_at(lambda v: [v.signals[i].values for i in static.signals], values, driven) if driven else values
    outputs, slopes, status = sensitivity(
        static.plan,
        static.wanted,
        static.method,
        static.places,
        static.groups,
        numbers,
        sizes,
        values,
        times,
        tolerance,
        static.steady,
    )
    shown, absolute, relative = outputs[:, : static.sensors], *noise
    sigma = jnp.sqrt(absolute**2 + (relative * shown) ** 2)
    return (slopes[:, : static.sensors] * scale / sigma[..., None], outputs), status


_evaluate = jax.jit(_weighted, static_argnums=0)


@functools.partial(jax.jit, static_argnums=0)
def _derive(static: _Static, coefficients, data):
    """The same with its derivatives by every coefficient, along all of them at once."""
    flat, back = ravel_pytree(coefficients)

    def of(flat):
        found, status = _weighted(static, back(flat), data)
        return found, (found, status)

    slopes, (found, status) = jax.jacfwd(of, has_aux=True)(flat)
    return found, slopes, status


@dataclasses.dataclass(frozen=True, eq=False)
class DesignModel:
    """A circuit under a test that is to be designed.

    Fields: circuit; times of samples [s]; sensors: candidates, by name; limited: further outputs that have limits;
    units of all outputs of the circuit; excitations; inputs: other inputs as signals; free and known parameters; noise
    of the sensors; compiled parts.
    """

    circuit: Circuit
    times: np.ndarray
    sensors: tuple[str, ...]
    limited: tuple[str, ...]
    units: dict[str, str]
    excitations: tuple[AbstractExcitation, ...]
    inputs: dict[str, Any]
    free: tuple[Free, ...]
    known: tuple[Known, ...]
    noise: tuple[Noise, ...]
    initial: dict
    known_values: np.ndarray
    static: _Static
    values: Values
    tolerance: float
    precision: str

    @functools.cached_property
    def scale(self) -> np.ndarray:
        """Widths of the coordinates of the free parameters, by which they are scaled."""
        return np.array([np.ptp(f.coordinate_bounds()) for f in self.free])

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of all outputs, sensors first."""
        return self.static.wanted

    @property
    def num_coefficients(self) -> int:
        """Numbers to be chosen."""
        return sum(e.start_coefficients.size for e in self.excitations)

    def split(self, coefficients) -> list[np.ndarray]:
        """Coefficients of each excitation."""
        ends = np.cumsum([e.start_coefficients.size for e in self.excitations])[:-1]
        return np.split(np.asarray(coefficients, dtype=float), ends)

    def slopes(self, values) -> np.ndarray:
        """d value / d coordinate of the free parameters at values in SI."""
        return np.array([float(f.slope(v)) for f, v in zip(self.free, values, strict=True)])

    def _data(self, values, coefficients):
        """The arguments of the programs, in the precision of the model."""
        every = np.concatenate([np.asarray(values, dtype=float), self.known_values])
        numbers = np.concatenate([np.full(len(own), every[i]) for i, own in enumerate(self.static.groups)])
        widths = [f.bounds[1] - f.bounds[0] for f in self.free]
        sds = np.array([k.sd for k in self.known])
        sizes = np.concatenate([widths, np.maximum(np.abs(self.known_values), sds)])
        scale = np.concatenate([self.slopes(values) * self.scale, sds])
        noise = tuple(
            np.array([getattr(n, part) for n in self.noise], dtype=float) for part in ("absolute", "relative")
        )
        bases = [(e.base, e.basis) for e in self.excitations]
        data = (numbers, sizes, scale, noise, self.values, bases, self.times, np.asarray(self.tolerance))
        return cast((self.split(coefficients) if self.excitations else [], data), self.precision)

    def evaluate(self, values, coefficients=()) -> Outcome:
        """What the test would give with these parameter values in SI."""
        with computing_in(self.precision):
            (rows, outputs), status = _evaluate(self.static, *self._data(values, coefficients))
            return Outcome(np.asarray(rows, float), np.asarray(outputs, float), _word(status))

    def derive(self, values, coefficients) -> Outcome:
        """The same with the derivatives by the coefficients."""
        with computing_in(self.precision):
            found, slopes, status = _derive(self.static, *self._data(values, coefficients))
            rows, outputs, row_slopes, output_slopes = (np.asarray(x, float) for x in (*found, *slopes))
            return Outcome(rows, outputs, _word(status), row_slopes, output_slopes)

    def drive(self, coefficients) -> dict[str, Any]:
        """All inputs as signals."""
        parts = zip(self.excitations, self.split(coefficients), strict=True) if self.excitations else ()
        return self.inputs | {e.input: e.signal(own) for e, own in parts}


def _word(status) -> str:
    """The name of a status code."""
    return {code: word for word, code in STATUS.items()}[int(status)]


def message_of(status: str) -> str:
    """What a status says in words."""
    return MESSAGES[status]


def _known_noise(noise: dict, sensors: tuple[str, ...]) -> tuple[Noise, ...]:
    """The noise of every sensor. Raises ValueError where it is missing or would have to be estimated."""
    for name in noise:
        if name not in sensors:
            raise ValueError(f"noise is given for {name!r}, which is no sensor of the test: {', '.join(sensors)}")
    levels = tuple(as_noise(noise.get(name), name) for name in sensors)
    for name, level in zip(sensors, levels, strict=True):
        if level.estimated:
            raise ValueError(
                f"noise of {name} is missing: before a test it cannot be estimated; give its standard deviation in SI, "
                f"such as noise={{{name!r}: 4e4}} (that of an earlier recording, or of the data sheet)"
            )
    return levels


def _settled_circuit(circuit: Circuit, free, initial: dict, signals: dict, times) -> Circuit:
    """The circuit with enough segments for the inputs to begin with, over the bounds of the free parameters."""
    variants = []
    for path, ratio, bound in [
        (p, r, b) for f in free for p, r in zip(f.paths, f.path_ratios, strict=True) for b in f.bounds
    ]:
        owner, _, rest = path.partition(".")
        if owner == "initial":
            variants.append((circuit, initial | {rest: bound * ratio}))
        elif owner == "fluid" or owner in circuit.components:
            variants.append((circuit.replace({path: bound * ratio}, check=False), initial))
    return choose_segments(circuit, times, signals, initial=initial, variants=variants)


def make_model(
    circuit: Circuit,
    free,
    *,
    times,
    sensors,
    noise: dict,
    excitations=(),
    inputs: dict | None = None,
    known=(),
    initial: dict | str | None = None,
    limited=(),
    method: Method,
    tolerance: float,
    precision: str,
) -> DesignModel:
    """Check and compile. Raises ValueError or KeyError, as `design` documents."""
    times, excitations = np.asarray(times, dtype=float), tuple(excitations)
    if times.ndim != 1 or times.size < 2 or not np.all(np.diff(times) > 0):
        raise ValueError(f"times of the samples [s] must be two or more and increase, got shape {times.shape}")
    steady, told = initial == "steady", dict(initial) if isinstance(initial, dict) else {}
    for name, value in told.items():
        if isinstance(value, str):
            raise ValueError(f"initial {name!r} must be a number in SI before the test, got {value!r}")
    driven = {e.input: e.signal(e.start_coefficients) for e in excitations}
    _check_inputs(circuit, excitations, inputs or {})
    with computing_in(precision):
        signals = bind_inputs(circuit, {**(inputs or {}), **driven}, times)
        circuit = _settled_circuit(circuit, free, told, signals, times)
        plan, values = compile_circuit(circuit, told, signals)
        units = {name: q.unit for name, q in quantities(plan).items()} | sensor_units(circuit, plan)
        where = parameter_locations(plan, values, ())
    for name in (*sensors, *limited):
        if name not in units:
            resolve(name, list(units), "output")
    free, known = check_parameters(circuit, free, known, where)
    places, groups = _places(plan, values, (), [*free, *known])
    wanted = (*sensors, *(name for name in limited if name not in sensors))
    spots = tuple(plan.signal_names.index(e.input) for e in excitations)
    return DesignModel(
        circuit=circuit,
        times=times,
        sensors=tuple(sensors),
        limited=tuple(limited),
        units=units,
        excitations=excitations,
        inputs={name: signal for name, signal in signals.items() if name not in driven},
        free=free,
        known=known,
        noise=_known_noise(noise, tuple(sensors)),
        initial=told,
        known_values=np.array([_number(values, where, k.path) for k in known]),
        static=_Static(plan, wanted, len(tuple(sensors)), method, places, groups, spots, steady),
        values=values,
        tolerance=tolerance,
        precision=precision,
    )


def _check_inputs(circuit: Circuit, excitations, inputs: dict) -> None:
    """Raise ValueError for an excitation of what is no input, or twice."""
    needed, seen = circuit.external_inputs(), set(inputs)
    for one in excitations:
        if one.input not in needed:
            raise ValueError(
                f"the circuit has no input {one.input!r} to be designed; it has {', '.join(sorted(needed)) or 'none'}"
            )
        if one.input in seen:
            raise ValueError(f"input {one.input!r} is given twice: it is either designed or given")
        seen.add(one.input)
