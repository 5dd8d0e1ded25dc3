"""The benchmark problem of ensembles: a servo axis with entrained air, stated twice, and two variants of it.

A four-way servovalve drives a hydraulic motor with inertia through two control lines; five states, nine numbers that
vary from lane to lane, two seconds, 201 samples. `right_hand_side(xp)` states it in plain arithmetic for any engine
(xp: a module with maximum, exp, log and sqrt), `circuit()` with ordinary components of jaxlines; the two agree to
rounding wherever pressures are above 1e4 Pa, see `right_hand_side_difference`.

    dp_A/dt = K(p_A)/V_A (Q_A - D w - C (p_A - p_B))       K = K_l (1 + r)/(1 + r K_l/(n p)),  r = R (p_0/p)^(1/n)
    dp_B/dt = K(p_B)/V_B (Q_B + D w + C (p_A - p_B))       Q = g x dp/(dp^2 + 1e10 Pa^2)^(1/4) through each land
    J dw/dt = D (p_A - p_B) - B w                          x'' + 2 zeta w_n x' + w_n^2 x = w_n^2 u

Pressures are absolute; p in K is at least 1e4 Pa; the command u is linear between samples. `STIFF` has volumes of
1e-6 m^3 and a hundredth of the inertia, so that the load pressure of a reversal stays some 4 MPa as the small volumes
can hold (with the inertia of the large axis they would see 1e9 Pa). The line variant is in `line_problem.py`.
"""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.integrate import solve_ivp

import jaxlines as jl
from jaxlines.simulation.assembly import compile_circuit, number_locations, set_numbers
from jaxlines.simulation.plan import Plan, Values
from jaxlines.simulation.vector_field import rates

SUPPLY, RETURN, ATMOSPHERE = 20.7e6, 0.35e6, 101325.0
DISPLACEMENT, VISCOUS, DAMPING = 1e-4, 2.0, 0.7
TRANSITION, FLOOR = 1e5, 1e4
END, SAMPLES = 2.0, 201
INITIAL = np.array([10e6, 10e6, 0.0, 0.0, 0.0])
"""p_A, p_B [Pa], motor speed [rad/s], spool [-], spool rate [1/s]."""
SIZES = np.array([1e6, 1e6, 1.0, 1.0, 100.0])
"""Typical size of each state: absolute tolerances are relative to these."""

times = np.linspace(0.0, END, SAMPLES)
command = 0.5 * np.sign(np.sin(2.0 * np.pi * times + 0.3)) * (0.3 + 0.7 * np.abs(np.sin(5.0 * times)))

COLUMNS = ("volume_a", "volume_b", "bulk_modulus", "air_ratio", "polytropic_index", "leakage", "valve_gain")
COLUMNS = (*COLUMNS, "inertia", "spool_frequency")
"""V_A, V_B [m^3], K_l [Pa], R [-], n [-], C [m^3/(s Pa)], g [m^3/(s sqrt(Pa))], J [kg m^2], w_n [rad/s]."""


class Variant(NamedTuple):
    """Volumes of the two lines [m^3] and middle inertia [kg m^2]."""

    volume_a: float
    volume_b: float
    inertia: float


AXIS, STIFF = Variant(0.0271, 0.0277, 40.0), Variant(1e-6, 1e-6, 0.4)


def lane_numbers(count: int, seed: int = 0, variant: Variant = AXIS) -> dict[str, np.ndarray]:
    """The numbers of `count` lanes, name -> array (count,), in the order of COLUMNS."""
    random = np.random.default_rng(seed)
    return {
        "volume_a": np.full(count, variant.volume_a),
        "volume_b": np.full(count, variant.volume_b),
        "bulk_modulus": 1.29e9 * random.uniform(0.8, 1.1, count),
        "air_ratio": 10.0 ** random.uniform(-4.0, -1.5, count),
        "polytropic_index": random.uniform(1.0, 1.4, count),
        "leakage": random.uniform(1e-12, 1e-11, count),
        "valve_gain": random.uniform(0.8, 1.2, count) * 1e-3 / np.sqrt(7e6),
        "inertia": random.uniform(0.5, 2.0, count) * variant.inertia,
        "spool_frequency": random.uniform(20.0, 60.0, count) * 2.0 * np.pi,
    }


def matrix(columns: dict[str, np.ndarray]) -> np.ndarray:
    """The columns side by side, shape (lanes, 9)."""
    return np.stack([columns[name] for name in COLUMNS], axis=-1)


def right_hand_side(xp) -> Callable:
    """f(y, u, numbers) -> the rates of the five states, each shaped as the states are; see the head of this file."""

    def modulus(p, liquid, air, index):
        p = xp.maximum(p, FLOOR)
        ratio = air * xp.exp(xp.log(ATMOSPHERE / p) / index)
        return liquid * (1.0 + ratio) / (1.0 + ratio * liquid / (index * p))

    def land(drop, gain):
        return gain * drop / xp.sqrt(xp.sqrt(drop * drop + TRANSITION * TRANSITION))

    def derivative(y, u, numbers):
        p_a, p_b, speed, spool, rate = y
        volume_a, volume_b, liquid, air, index, leakage, gain, inertia, frequency = numbers
        forward, reverse = gain * xp.maximum(spool, 0.0), gain * xp.maximum(-spool, 0.0)
        flow_a = land(SUPPLY - p_a, forward) - land(p_a - RETURN, reverse)
        flow_b = land(SUPPLY - p_b, reverse) - land(p_b - RETURN, forward)
        through = DISPLACEMENT * speed + leakage * (p_a - p_b)
        return (
            modulus(p_a, liquid, air, index) / volume_a * (flow_a - through),
            modulus(p_b, liquid, air, index) / volume_b * (flow_b + through),
            (DISPLACEMENT * (p_a - p_b) - VISCOUS * speed) / inertia,
            rate,
            frequency * frequency * (u - spool) - 2.0 * DAMPING * frequency * rate,
        )

    return derivative


class Reference(NamedTuple):
    """Where the truth is known: which lanes, and their p_A, shape (lanes, samples) [Pa]."""

    lanes: np.ndarray
    pressure: np.ndarray


def reference(columns, lanes, tolerance: float = 1e-11, method: str = "DOP853") -> Reference:
    """p_A of chosen lanes to (nearly) rounding: SciPy, started afresh at every knot of the command.

    Lanes are integrated together, 64 at a time. Args: columns; lanes: their indices; tolerance, relative, and
    absolute of the states over SIZES; method: of `solve_ivp`, others such as "LSODA" go one by one.
    """
    lanes, slope, derivative = np.asarray(lanes), np.diff(command) / np.diff(times), right_hand_side(np)
    width, shown = 64 if method == "DOP853" else 1, []
    for chunk in np.split(lanes, range(width, len(lanes), width)):
        numbers = matrix(columns)[chunk].T
        y = np.repeat((INITIAL / SIZES)[:, None], len(chunk), axis=1).ravel()
        path = [y]
        for k in range(SAMPLES - 1):

            def field(t, y, k=k, numbers=numbers):
                u = command[k] + slope[k] * (t - times[k])
                return (np.stack(derivative(y.reshape(5, -1) * SIZES[:, None], u, numbers)) / SIZES[:, None]).ravel()

            span = (times[k], times[k + 1])
            found = solve_ivp(field, span, path[-1], method=method, rtol=tolerance, atol=tolerance)
            if not found.success:
                raise RuntimeError(f"no reference in lanes {chunk} at {times[k]:g} s: {found.message}")
            path.append(found.y[:, -1])
        shown.append(np.stack(path).reshape(SAMPLES, 5, -1)[:, 0].T * SIZES[0])
    return Reference(lanes, np.concatenate(shown))


def circuit(variant: Variant = AXIS) -> jl.Circuit:
    """The axis from ordinary components; input "spool"."""
    oil = jl.Oil(
        1.29e9, 850.0, 30e-6, air_fraction=0.01, polytropic_index=1.2, mass="article", air=jl.LegacySimscapeAir()
    )
    valve = jl.Servovalve(
        "P", "T", "A", "B", "spool", rated_flow=1e-3, rated_pressure_drop=14e6, natural_frequency=250.0,
        damping_ratio=DAMPING, transition=TRANSITION, opening="sharp",
    )  # fmt: skip
    return jl.Circuit(
        oil,
        {
            "supply": jl.PressureSource("P", SUPPLY),
            "return": jl.Tank("T", RETURN),
            "valve": valve,
            "line_a": jl.Line("A", jl.Vessel(variant.volume_a)),
            "line_b": jl.Line("B", jl.Vessel(variant.volume_b)),
            "motor": jl.Motor("A", "B", "T", "shaft", DISPLACEMENT, 5e-12, 0.0, VISCOUS),
            "inertia": jl.Inertia("shaft", variant.inertia),
        },
    )


def initial() -> dict[str, float]:
    """Start values of the circuit by name."""
    return {"A.pressure": INITIAL[0], "B.pressure": INITIAL[1]}


def inputs() -> dict[str, jl.Sampled]:
    """Inputs of the circuit by name."""
    return {"spool": jl.Sampled(times, command)}


def varied(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The nine varied numbers by their paths in `circuit`, path -> array (lanes,)."""
    return {
        "line_a.parts.0.volume": columns["volume_a"],
        "line_b.parts.0.volume": columns["volume_b"],
        "fluid.bulk_modulus": columns["bulk_modulus"],
        "fluid.air_fraction": columns["air_ratio"] / (1.0 + columns["air_ratio"]),
        "fluid.polytropic_index": columns["polytropic_index"],
        "motor.internal_leakage": columns["leakage"],
        "valve.rated_flow": columns["valve_gain"] * np.sqrt(7e6),
        "inertia.moment_of_inertia": columns["inertia"],
        "valve.natural_frequency": columns["spool_frequency"],
    }


class Compiled(NamedTuple):
    """A circuit compiled once, and where the varied numbers are: `values(numbers)` sets those of one lane."""

    plan: Plan
    base: Values
    locations: tuple

    def values(self, numbers) -> Values:
        return set_numbers(self.base, self.locations, numbers)


def compiled(circuit: jl.Circuit, paths, initial: dict, inputs: dict) -> Compiled:
    """A circuit compiled with places for the numbers at `paths`."""
    plan, values = compile_circuit(circuit, initial, inputs)
    places = number_locations(plan, values)
    return Compiled(plan, values, tuple(places[path] for path in paths))


def random_states(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and states, shape (count, 5), with pressures from 0.02 to 25 MPa absolute."""
    random = np.random.default_rng(seed)
    low, high = np.array([2e4, 2e4, -20.0, -1.0, -100.0]), np.array([25e6, 25e6, 20.0, 1.0, 100.0])
    return random.uniform(0.0, END, count), low + (high - low) * random.uniform(size=(count, 5))


def _field_of_circuit(program: Compiled, numbers, t, y):
    """Rates of the five states of one lane by the vector field of the circuit."""
    plan, values = program.plan, program.values(numbers)
    nodes, kinds = [node for node, _ in plan.free_nodes], [kind.members for kind in plan.kinds]
    k = kinds.index(("valve",))
    potentials = jax.numpy.stack([y[("A", "B", "shaft").index(node)] for node in nodes])
    states: list[dict[str, Any]] = [{} for _ in plan.kinds]
    states[k] = {"spool": y[3:4], "spool_rate": y[4:5]}
    found, rate = rates(plan, values, t, potentials, tuple(states))
    ordered = [found[nodes.index(name)] for name in ("A", "B", "shaft")]
    return jax.numpy.stack([*ordered, rate[k]["spool"][0], rate[k]["spool_rate"][0]])


def right_hand_side_difference(count: int = 1000, variant: Variant = AXIS, data: Path | None = None) -> float:
    """Largest difference of the circuit's rates from the reference's at random states, relative to the rates.

    Each rate is compared with itself, or with the typical (rms) rate of its state where it happens to be small.
    data: a folder with a `servo_axis.py` that states the problem independently; it is compared as well.
    """
    columns, (t, y) = lane_numbers(count, variant=variant), random_states(count)
    paths = varied(columns)
    with jax.enable_x64(True):
        program = compiled(circuit(variant), paths, initial(), inputs())
        field = jax.jit(jax.vmap(lambda numbers, t, y: _field_of_circuit(program, numbers, t, y)))
        ours = np.asarray(field(np.stack(list(paths.values()), axis=-1), t, y))
    statements, u = [right_hand_side(np)], np.interp(t, times, command)
    if data is not None and (data / "servo_axis.py").exists():
        spec = importlib.util.spec_from_file_location("stated_elsewhere", data / "servo_axis.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        statements.append(module.right_hand_side(np))
    worst = 0.0
    for statement in statements:
        theirs = np.stack(statement(y.T, u, matrix(columns).T), axis=-1)
        typical = np.sqrt(np.mean(theirs * theirs, axis=0))
        worst = max(worst, float(np.max(np.abs(ours - theirs) / np.maximum(np.abs(theirs), typical))))
    return worst
