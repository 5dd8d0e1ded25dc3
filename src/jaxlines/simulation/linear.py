"""Linearisation at an operating point: state-space matrices, eigenvalues, frequency response."""

import dataclasses
import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.observation import observe, quantities, sensor_units, shown_by_default
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.plan import Plan, ravel, scales, unravel
from jaxlines.simulation.precision import computing_in, is_traced
from jaxlines.simulation.signals import Constant
from jaxlines.simulation.steady import SteadyState, at_instant, state_labels, steady_state
from jaxlines.simulation.vector_field import rates, starting_point


class Mode(NamedTuple):
    """An eigenvalue [1/s], its natural frequency |s| [rad/s], its damping ratio -Re(s)/|s| [-] (1 at the origin).

    states: names of the states that take part most, largest first, by participation factors.
    """

    eigenvalue: complex
    natural_frequency: float
    damping_ratio: float
    states: tuple[str, ...]

    @property
    def frequency(self) -> float:
        """Natural frequency [Hz]."""
        return self.natural_frequency / (2.0 * np.pi)


@dataclasses.dataclass(frozen=True)
class StateSpace:
    """dx/dt = A x + B u, y = C x + D u for small deviations from an operating point, in SI.

    Fields: a, b, c, d: matrices; states, inputs, outputs: names; state_scales: typical sizes of the states, in which
    eigenvalues and responses are computed; at: value of every output at the operating point; residual: largest rate
    there, in typical sizes per second (zero for a steady state).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    state_scales: np.ndarray
    at: dict[str, float]
    residual: float

    def _scaled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B and C for states in units of their typical sizes."""
        size = self.state_scales
        return self.a * size / size[:, None], self.b / size[:, None], self.c * size

    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of A [1/s], slowest first."""
        found = np.linalg.eigvals(self._scaled()[0])
        return found[np.lexsort((np.imag(found), np.abs(found)))]

    def is_stable(self) -> bool:
        """Whether every eigenvalue has a negative real part; what runs on freely (an angle) counts as not stable."""
        return bool(np.all(np.real(self.eigenvalues()) < 0.0))

    def modes(self) -> list[Mode]:
        """Eigenvalues with natural frequency, damping and the states that take part; one of each conjugate pair."""
        found, right = np.linalg.eig(self._scaled()[0])
        left = np.linalg.pinv(right)
        modes = []
        for i in np.lexsort((np.imag(found), np.abs(found))):
            if np.imag(found[i]) < 0.0:
                continue
            size, part = abs(found[i]), np.abs(right[:, i] * left[i])
            most = [j for j in np.argsort(-part, kind="stable")[:3] if part[j] > 0.1 * np.max(part)]
            damping = float(-np.real(found[i]) / size) if size > 0.0 else 1.0
            modes.append(Mode(complex(found[i]), float(size), damping, tuple(self.states[j] for j in most)))
        return modes

    def frequency_response(self, frequencies, output: str | None = None, input: str | None = None) -> np.ndarray:
        """Output per input at frequencies [Hz], complex, in SI: C (j w - A)^-1 B + D.

        Args: frequencies: shape (frequencies,) or a number; output, input: names; all of them when left out, with
            shape (frequencies, outputs, inputs).
        Raises: KeyError for an unknown name.
        """
        a, b, c = self._scaled()
        rows = slice(None) if output is None else self.outputs.index(resolve(output, self.outputs, "output"))
        columns = slice(None) if input is None else self.inputs.index(resolve(input, self.inputs, "input"))
        w = 2j * np.pi * np.asarray(frequencies, dtype=float)
        inner = np.linalg.solve(w[..., None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (*w.shape, *b.shape)))
        return (c @ inner + self.d)[..., rows, columns]

    def __str__(self) -> str:
        lines = [f"{len(self.states)} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"]
        for mode in self.modes():
            of = ", ".join(mode.states)
            lines.append(f"{mode.eigenvalue:.4g} 1/s: {mode.frequency:.4g} Hz, damping {mode.damping_ratio:.3g} ({of})")
        return "\n".join(lines)


def linearise(
    circuit: Circuit,
    inputs: dict | None = None,
    *,
    at: SteadyState | dict | None = None,
    outputs=None,
    input_names=None,
    time: float = 0.0,
) -> StateSpace:
    """The linear equations for small deviations from an operating point, with exact derivatives.

    Args:
        circuit; inputs: name -> number or signal, as for `simulate`.
        at: a steady state, or initial values by name (any point: see `StateSpace.residual`); by default the steady
            state of the inputs.
        outputs: names of sensors and quantities ("A.pressure", "leak.a.flow"); by default the sensors, or all
            potentials and states where there are none.
        input_names: external inputs to linearise in; all by default.
        time: at which all signals are taken [s].
    Raises: as `steady_state`; TypeError in code that JAX traces; ValueError for a sampled controller; KeyError for an
        unknown output or input.
    Validity: small deviations; friction, laps and valves that switch have slopes that change within their widths.
    """
    if is_traced(circuit, inputs, at):
        raise TypeError("linearise returns NumPy matrices: call it outside of code that JAX traces")
    if at is None:
        at = steady_state(circuit, inputs, time=time)
    initial = at.initial if isinstance(at, SteadyState) else at
    with computing_in("float64"):
        settled, held = at_instant(circuit, inputs, time, initial)
        if isinstance(at, SteadyState):
            settled = at.circuit
        return _equations(settled, initial, held, outputs, input_names)


def _equations(circuit: Circuit, initial: dict, held: dict, outputs, input_names) -> StateSpace:
    """The linear equations about initial values, with inputs that are constant."""
    plan, values = compile_circuit(circuit, initial, held)
    _refuse_sampled(plan)
    names = tuple(resolve(name, held, "input") for name in (held if input_names is None else input_names))
    units = {name: q.unit for name, q in quantities(plan).items()} | sensor_units(circuit, plan)
    wanted = list(circuit.sensors()) or shown_by_default(plan) if outputs is None else outputs
    wanted = tuple(resolve(name, units, "output") for name in wanted)
    rate, shown, slopes = jax.tree.map(np.asarray, _slopes(plan, wanted, names, values))
    (a, b), (c, d) = slopes
    size = scales(plan)
    return StateSpace(
        a * size[:, None] / size,
        b * size[:, None],
        c / size,
        d,
        tuple(state_labels(plan)),
        names,
        wanted,
        size,
        dict(zip(wanted, map(float, shown), strict=True)),
        float(np.max(np.abs(rate), initial=0.0)),
    )


def _refuse_sampled(plan: Plan) -> None:
    """Raise ValueError for a sampled controller, whose output does not follow a differential equation."""
    for controller in plan.controllers:
        if controller.sampled:
            name = plan.kinds[controller.kind].members[0]
            raise ValueError(
                f"{name!r} is sampled, so that the circuit has no linear differential equation: linearise it with a "
                "continuous controller in its place, or with its output as an input"
            )


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _slopes(plan, wanted, names, values):
    """Rates of the scaled states, outputs, and the derivatives of both in scaled states and inputs."""
    where = [plan.signal_names.index(name) for name in names]

    def seen(y, given):
        signals = list(values.signals)
        for i, value in zip(where, given, strict=True):
            signals[i] = Constant(value)
        changed = eqx.tree_at(lambda v: v.signals, values, tuple(signals))
        potentials, states = unravel(plan, y)
        rate = ravel(plan, *rates(plan, changed, 0.0, potentials, states))
        shown = observe(plan, changed, wanted, 0.0, potentials, states) if wanted else jnp.zeros(0)
        return (rate, shown), (rate, shown)

    y = ravel(plan, *starting_point(plan, values, 0.0))
    given = jnp.stack([values.signals[i].value for i in where]) if where else jnp.zeros(0)
    slopes, (rate, shown) = jax.jacfwd(seen, argnums=(0, 1), has_aux=True)(y, given)
    return rate, shown, slopes
