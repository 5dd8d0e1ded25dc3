"""Peers that integrate one lane a time: CVODE by scikit-sundae, SciPy, and CVODES by CasADi.

A few lanes are run on one core, and their time is divided by the number of cores, as if processes shared the lanes
without loss. The right-hand side of CVODE and SciPy is compiled by Numba; CasADi differentiates its own and compiles it
where there is a compiler.
"""

import functools
import shutil
import time
from collections.abc import Callable

import numpy as np
import servo_axis as axis
from ensemble_peers import CORES, Missing, Run
from ensemble_peers_numba import jitted, scalar_field


@functools.cache
def _compiled_field() -> Callable:
    """f(t, y, rates, numbers): fills rates of the states over SIZES, compiled by Numba."""
    field, (c1, c2, c3, c4, c5) = scalar_field("float64"), axis.SIZES
    command, interval, last = axis.command, axis.times[1] - axis.times[0], axis.SAMPLES - 2

    @jitted
    def fill(t, y, rates, numbers):
        k = min(max(int(t / interval), 0), last)
        u = command[k] + (command[k + 1] - command[k]) * (t / interval - k)
        f1, f2, f3, f4, f5 = field(y[0] * c1, y[1] * c2, y[2] * c3, y[3] * c4, y[4] * c5, u, numbers)
        rates[0], rates[1], rates[2], rates[3], rates[4] = f1 / c1, f2 / c2, f3 / c3, f4 / c4, f5 / c5

    return fill


def _one_by_one(simulate: Callable, columns, lanes, compile_seconds: float) -> Run:
    """simulate(numbers) -> p_A (samples,) for some lanes on one core, the time of all cores extrapolated."""
    numbers, found = axis.matrix(columns), []
    simulate(numbers[lanes[0]])
    began = time.perf_counter()
    for i in lanes:
        found.append(simulate(numbers[i]))
    return Run(np.stack(found), (time.perf_counter() - began) / CORES, compile_seconds, np.asarray(lanes), True)


def _prepared(columns) -> tuple[Callable, float]:
    """The compiled right-hand side, and the seconds that took."""
    began, fill = time.perf_counter(), _compiled_field()
    fill(0.0, axis.INITIAL / axis.SIZES, np.zeros(5), axis.matrix(columns)[0])
    return fill, time.perf_counter() - began


def cvode(columns, lanes, tolerance: float, method: str = "BDF") -> Run:
    """Some lanes by SUNDIALS CVODE. Args: columns; lanes; tolerance; method "BDF" or "Adams". Raises: Missing."""
    try:
        from sksundae.cvode import CVODE
    except ImportError as problem:
        raise Missing('scikit-sundae is not installed: pip install "jaxlines[bench]"') from problem
    fill, compiling = _prepared(columns)
    options = {"rtol": tolerance, "atol": tolerance, "method": method, "max_num_steps": 100_000}

    def simulate(numbers):
        solver = CVODE(lambda t, y, rates: fill(t, y, rates, numbers), **options)
        found = solver.solve(axis.times, axis.INITIAL / axis.SIZES)
        return found.y[:, 0] * axis.SIZES[0] if len(found.y) == axis.SAMPLES else np.full(axis.SAMPLES, np.nan)

    return _one_by_one(simulate, columns, lanes, compiling)


def scipy_solver(columns, lanes, tolerance: float, method: str = "LSODA") -> Run:
    """Some lanes by SciPy: "LSODA" through odeint, which is the faster way to it, others through solve_ivp."""
    from scipy.integrate import odeint, solve_ivp

    fill, compiling = _prepared(columns)
    start = axis.INITIAL / axis.SIZES
    options: dict = {"rtol": tolerance, "atol": tolerance}

    def simulate(numbers):
        rates = np.empty(5)

        def field(t, y):
            fill(t, y, rates, numbers)
            return rates.copy()

        if method == "LSODA":
            return odeint(field, start, axis.times, tfirst=True, mxstep=100_000, **options)[:, 0] * axis.SIZES[0]
        found = solve_ivp(field, (0.0, axis.END), start, method=method, t_eval=axis.times, **options)
        return found.y[0] * axis.SIZES[0] if found.success else np.full(axis.SAMPLES, np.nan)

    return _one_by_one(simulate, columns, lanes, compiling)


@functools.cache
def _casadi_integrator(method: str, setting: float) -> tuple[Callable, float]:
    """CasADi's integrator over all samples, and the seconds to build and compile it. Raises: Missing."""
    try:
        import casadi
    except ImportError as problem:
        raise Missing('casadi is not installed: pip install "jaxlines[bench]"') from problem
    began = time.perf_counter()
    y, p, t = casadi.MX.sym("y", 5), casadi.MX.sym("p", 9), casadi.MX.sym("t")
    line = casadi.MX.sym("line", 2)

    class Functions:
        """What `right_hand_side` needs of a module."""

        maximum, exp, log, sqrt = casadi.fmax, casadi.exp, casadi.log, casadi.sqrt

    states = [y[i] * axis.SIZES[i] for i in range(5)]
    rates = axis.right_hand_side(Functions)(states, line[0] + line[1] * t, [p[i] for i in range(9)])
    scaled = casadi.vertcat(*(rate / size for rate, size in zip(rates, axis.SIZES, strict=True)))
    jit = shutil.which("gcc") is not None
    options: dict = {"jit": jit, "jit_options": {"flags": ["-O3", "-march=native"]}} if jit else {}
    if jit:
        options |= {"compiler": "shell"}
    if method == "cvodes":
        options |= {"reltol": setting, "abstol": setting, "max_num_steps": 100_000}
    else:
        options |= {"number_of_finite_elements": int(setting) * (axis.SAMPLES - 1)}
    problem = {"x": y, "p": p, "u": line, "t": t, "ode": scaled}
    made = casadi.integrator("lane", method, problem, 0.0, axis.times[1:].tolist(), options)
    return made, time.perf_counter() - began


def casadi_solver(columns, lanes, setting: float, method: str = "cvodes") -> Run:
    """Some lanes by CasADi: "cvodes" to a tolerance, or "rk" with fixed steps between samples. Raises: Missing.

    The command is given to each interval as a straight line, base + slope t, so that no step crosses a knot.
    """
    slope = np.diff(axis.command) / np.diff(axis.times)
    lines = np.stack([axis.command[:-1] - slope * axis.times[:-1], slope])
    integrate, compiling = _casadi_integrator(method, setting)

    def simulate(numbers):
        try:
            found = integrate(x0=axis.INITIAL / axis.SIZES, p=numbers, u=lines)["xf"]
        except RuntimeError:
            return np.full(axis.SAMPLES, np.nan)
        return axis.SIZES[0] * np.concatenate([axis.INITIAL[:1] / axis.SIZES[0], np.asarray(found)[0]])

    return _one_by_one(simulate, columns, lanes, compiling)
