"""Peers of the fit experiment: SciPy's least squares over SciPy LSODA, over Numba, and over CasADi.

Each fits recordings one after another, with the trust-region reflective search of `scipy.optimize.least_squares`. SciPy
and Numba take forward differences of 1e-3 in the logarithm's place, which is what solvers with a tolerance of 1e-6
can bear; CasADi differentiates its fixed steps exactly.
"""

import functools
import math
import shutil
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import servo_axis as axis
import speed_fit_problem as problem
from ensemble_peers import Missing
from ensemble_peers_numba import _numba, _program
from ensemble_peers_sundials import _compiled_field
from scipy.integrate import odeint
from scipy.optimize import least_squares

TOLERANCE, STEP, GOAL = 1e-6, 1e-3, 1e-6
"""Relative tolerance of simulations; step of differences; relative decrease at which a search ends."""


class Fits(NamedTuple):
    """What a peer did: values (fits, 4); seconds: wall and of the processor, for these fits; simulations of one fit."""

    values: np.ndarray
    seconds: float
    processor_seconds: float
    simulations: float
    compile_seconds: float


def fitted(task: problem.Task, simulate: Callable, jacobian: Callable | None, compile_seconds: float = 0.0) -> Fits:
    """All fits of a task, one after another.

    simulate(coordinates) -> p_A (samples,); jacobian(coordinates) -> its slopes, or None: differences by SciPy.
    """
    found, evaluations = [], 0
    began, processor = time.perf_counter(), time.process_time()
    for pressure, start in zip(task.pressure, task.starts, strict=True):
        result = least_squares(
            lambda x, pressure=pressure: (simulate(x) - pressure) / problem.NOISE,
            problem.to_coordinate(start),
            jac="2-point" if jacobian is None else jacobian,  # pyright: ignore[reportArgumentType]
            diff_step=STEP if jacobian is None else None,
            bounds=(0.0, 1.0),
            x_scale="jac",
            ftol=GOAL,
            xtol=GOAL,
            gtol=None,  # pyright: ignore[reportArgumentType] - SciPy takes it
        )
        found.append(problem.to_value(result.x))
        evaluations += result.nfev + result.njev * (result.x.size if jacobian is None else 1)
    seconds, processor = time.perf_counter() - began, time.process_time() - processor
    return Fits(np.array(found), seconds, processor, evaluations / len(found), compile_seconds)


def _plain_field() -> Callable:
    """f(t, y over SIZES, numbers) in plain Python with `math`, which is faster than NumPy for single numbers."""

    class Functions:
        """What `right_hand_side` needs of a module."""

        maximum, exp, log, sqrt = max, math.exp, math.log, math.sqrt

    derivative = axis.right_hand_side(Functions)
    command, interval, last = axis.command.tolist(), float(axis.times[1] - axis.times[0]), axis.SAMPLES - 2
    c1, c2, c3, c4, c5 = axis.SIZES.tolist()

    def field(t, y, numbers):
        k = min(max(int(t / interval), 0), last)
        u = command[k] + (command[k + 1] - command[k]) * (t / interval - k)
        a, b, c, d, e = y.tolist()
        f1, f2, f3, f4, f5 = derivative((a * c1, b * c2, c * c3, d * c4, e * c5), u, numbers)
        return [f1 / c1, f2 / c2, f3 / c3, f4 / c4, f5 / c5]

    return field


def scipy_lsoda(task: problem.Task, compiled: bool = False) -> Fits:
    """SciPy alone: LSODA through `odeint`, the faster way to it; compiled: the right-hand side by Numba. Raises:
    Missing."""
    began, start = time.perf_counter(), axis.INITIAL / axis.SIZES
    if compiled:
        fill, rates = _compiled_field(), np.empty(5)
        fill(0.0, start, rates, problem.numbers_of(task.truth[0]))

        def field(t, y, numbers):
            fill(t, y, rates, numbers)
            return rates.copy()

    else:
        field = _plain_field()
    compiling = time.perf_counter() - began

    def simulate(x):
        numbers = problem.numbers_of(problem.to_value(x))
        numbers = numbers if compiled else numbers.tolist()
        options = {"rtol": TOLERANCE, "atol": TOLERANCE, "mxstep": 100_000, "tfirst": True}
        return odeint(field, start, axis.times, args=(numbers,), **options)[:, 0] * axis.SIZES[0]

    return fitted(task, simulate, None, compiling)


def numba_dopri5(task: problem.Task, threads: int) -> Fits:
    """The same over Dormand-Prince 5(4) compiled by Numba; the differences of a Jacobian in parallel. Raises:
    Missing."""
    program, numba = _program("float64"), _numba()
    began = time.perf_counter()
    program(problem.numbers_of(task.truth[:1]), TOLERANCE, np.empty((1, axis.SAMPLES)))
    compiling, before = time.perf_counter() - began, numba.get_num_threads()
    last: list = [None, None]

    def run(points: np.ndarray) -> np.ndarray:
        out = np.empty((len(points), axis.SAMPLES))
        program(problem.numbers_of(problem.to_value(points)), TOLERANCE, out)
        return out

    def simulate(x):
        last[0], last[1] = x.copy(), run(x[None])[0]
        return last[1]

    def jacobian(x):
        base = last[1] if np.array_equal(last[0], x) else simulate(x)
        steps = np.where(x < 0.5, STEP, -STEP)
        return ((run(x + np.diag(steps)) - base) / steps[:, None]).T / problem.NOISE

    numba.set_num_threads(min(threads, before))
    try:
        return fitted(task, simulate, jacobian, compiling)
    finally:
        numba.set_num_threads(before)


@functools.cache
def _casadi_functions(steps: int) -> tuple[Callable, Callable, float]:
    """p_A of coordinates by RK4 with fixed steps, its Jacobian, and the seconds to build them. Raises: Missing."""
    try:
        import casadi
    except ImportError as missing:
        raise Missing('casadi is not installed: pip install "jaxlines[bench]"') from missing
    began = time.perf_counter()

    class Functions:
        """What `right_hand_side` needs of a module."""

        maximum, exp, log, sqrt = casadi.fmax, casadi.exp, casadi.log, casadi.sqrt

    derivative, h = axis.right_hand_side(Functions), float(axis.times[1] - axis.times[0]) / steps
    begin, x, line = casadi.SX.sym("begin", 5), casadi.SX.sym("x", 4), casadi.SX.sym("line", 2)
    numbers: list = [problem.KNOWN.get(name, 0.0) for name in axis.COLUMNS]
    for i, (low, high) in enumerate(zip(problem.LOWEST.tolist(), problem.HIGHEST.tolist(), strict=True)):
        numbers[problem.PLACES[i]] = low * casadi.exp(x[i] * math.log(high / low))

    def rate(y, t: float):
        found = derivative([y[i] * float(axis.SIZES[i]) for i in range(5)], line[0] + line[1] * t, numbers)
        return casadi.vertcat(*(f / float(size) for f, size in zip(found, axis.SIZES, strict=True)))

    y = begin
    for k in range(steps):
        k1 = rate(y, k * h)
        k2 = rate(y + 0.5 * h * k1, (k + 0.5) * h)
        k3 = rate(y + 0.5 * h * k2, (k + 0.5) * h)
        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + rate(y + h * k3, (k + 1) * h))
    count = axis.SAMPLES - 1
    every = casadi.Function("interval", [begin, x, line], [y]).mapaccum(count)
    free = casadi.MX.sym("x", 4)
    lines = np.stack([axis.command[:-1], np.diff(axis.command) / np.diff(axis.times)])
    path = every(axis.INITIAL / axis.SIZES, casadi.repmat(free, 1, count), casadi.DM(lines))
    pressure = float(axis.SIZES[0]) * path[0, :].T
    options: dict = {}
    if shutil.which("gcc") is not None:
        options = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O3", "-march=native"]}}
    simulate = casadi.Function("simulate", [free], [pressure], options)
    jacobian = casadi.Function("slopes", [free], [casadi.jacobian(pressure, free)], options)
    return simulate, jacobian, time.perf_counter() - began


def casadi_rk4(task: problem.Task, steps: int = 4) -> Fits:
    """The same over CasADi: RK4 with fixed steps between samples, compiled, differentiated exactly. Raises: Missing."""
    simulate, slopes, compiling = _casadi_functions(steps)
    first = axis.INITIAL[:1]
    none = np.zeros((1, 4))
    return fitted(
        task,
        lambda x: np.concatenate([first, np.asarray(simulate(x))[:, 0]]),
        lambda x: np.concatenate([none, np.asarray(slopes(x))]) / problem.NOISE,
        compiling,
    )
