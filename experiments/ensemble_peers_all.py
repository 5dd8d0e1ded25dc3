"""All peers of the ensemble experiment, at the settings that are compared: name -> function that gives rows.

`attempted(axis_peers(...))` runs them; those that are not installed are reported with the reason.
"""

from collections.abc import Callable

import ensemble_peers_c as bound
import ensemble_peers_diffrax as vmapped
import ensemble_peers_numba as by_hand
import ensemble_peers_sundials as single
import jax
import line_problem as line
import numpy as np
from ensemble_peers import Row, Run, measured
from servo_axis import Reference, times

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
STEPS = (3, 4, 6, 8)
BUILDS = {"SIMD C, plain": bound.PLAIN, "SIMD C, best": bound.BEST}
Peers = dict[str, Callable[[], list[Row]]]


def _rows(engine: str, precision: str, reference: Reference, settings: dict[str, Callable[[], Run]]) -> list[Row]:
    """A row for every setting of an engine."""
    return [measured(engine, precision, setting, run(), reference) for setting, run in settings.items()]


def _by_tolerance(run: Callable[[float], Run], tolerances) -> dict[str, Callable[[], Run]]:
    """Settings of an engine that takes a tolerance."""
    return {f"tolerance {tolerance:g}": lambda tolerance=tolerance: run(tolerance) for tolerance in tolerances}


def axis_peers(columns, reference: Reference, few, repeats: int = 3) -> Peers:
    """Peers on the servo axis, or its stiff variant.

    Args: columns of all lanes; reference; few: lanes of the reference for engines that take one a time; repeats.
    """
    peers: Peers = {}
    for precision in ("float64", "float32"):

        def numba(precision=precision):
            runs = _by_tolerance(lambda x: by_hand.dopri5(columns, x, precision, repeats), TOLERANCES)
            return _rows("Numba DOPRI5", precision, reference, runs)

        peers[f"Numba DOPRI5, {precision}"] = numba
        for name, build in BUILDS.items():

            def simd(precision=precision, name=name, build=build):
                runs = {
                    f"{n} steps a sample": lambda n=n: bound.simd_c(columns, n, precision, build, repeats)
                    for n in STEPS
                }
                return _rows(name, precision, reference, runs)

            peers[f"{name}, {precision}"] = simd
    peers |= {
        "vmap(diffrax Tsit5)": lambda: _vmapped(columns, reference, repeats),
        "scikit-sundae CVODE": lambda: _one_by_one("scikit-sundae CVODE BDF", single.cvode, columns, reference, few),
        "SciPy LSODA": lambda: _one_by_one("SciPy LSODA", single.scipy_solver, columns, reference, few),
        "SciPy RK45": lambda: _one_by_one("SciPy RK45", single.scipy_solver, columns, reference, few, "RK45"),
        "CasADi CVODES": lambda: _one_by_one("CasADi CVODES", single.casadi_solver, columns, reference, few),
        "CasADi RK4": lambda: _rows(
            "CasADi RK4", "float64", reference, {"4 steps": lambda: single.casadi_solver(columns, few, 4, "rk")}
        ),
    }
    return peers


def _vmapped(columns, reference: Reference, repeats: int) -> list[Row]:
    """vmap(diffrax Tsit5): steps over the knots of the command, or ending on them; and on the circuit's own field."""
    over = _by_tolerance(lambda x: vmapped.vmap_tsit5(columns, x, repeats=repeats), TOLERANCES[1:4])
    ending = _by_tolerance(lambda x: vmapped.vmap_tsit5(columns, x, repeats=repeats, at_knots=True), (1e-4,))
    circuit = _by_tolerance(lambda x: vmapped.vmap_circuit(columns, x, repeats=repeats), (1e-5,))
    runs = over | {f"{name}, steps end on knots": run for name, run in ending.items()}
    runs |= {f"{name}, on the circuit": run for name, run in circuit.items()}
    return _rows("vmap(diffrax Tsit5)", "float64", reference, runs)


def _one_by_one(engine: str, solver: Callable, columns, reference: Reference, few, *method: str) -> list[Row]:
    """An engine that takes a few lanes one by one, at two tolerances."""
    runs = _by_tolerance(lambda x: solver(columns, few, x, *method), (1e-5, 1e-6))
    return _rows(engine, "float64", reference, runs)


def stiff_peers(columns, reference: Reference, repeats: int = 1) -> Peers:
    """vmap(diffrax Kvaerno5) on the stiff variant, all lanes; the rest of `axis_peers` takes it as well."""

    def kvaerno():
        runs = _by_tolerance(lambda x: vmapped.vmap_kvaerno5(columns, x, repeats=repeats), (1e-3, 1e-4, 1e-5))
        return _rows("vmap(diffrax Kvaerno5)", "float64", reference, runs)

    return {"vmap(diffrax Kvaerno5)": kvaerno}


def line_peers(columns, reference: Reference, chunk: int = 16, repeats: int = 1, tolerances=(1e-4,)) -> Peers:
    """vmap(diffrax), explicit and implicit, on the circuit of the line; columns are those of `line_problem.varied`.

    Kvaerno5 takes seconds a lane (its Newton iterations factorise 83 by 83 numbers each): give it few lanes.
    """
    numbers = np.stack(list(columns.values()), axis=-1)

    def run(implicit: bool):
        with jax.enable_x64(True):
            lane = vmapped.circuit_lane(line.program(), line.OUTPUT, times)
        name = f"vmap(diffrax {'Kvaerno5' if implicit else 'Tsit5'})"
        options = {"implicit": implicit, "threads": not implicit, "chunk": chunk, "repeats": repeats}
        runs = _by_tolerance(lambda x: vmapped.vmap_diffrax(numbers, lane, x, **options), tolerances)
        return _rows(name, "float64", reference, runs)

    return {"vmap(diffrax Tsit5), line": lambda: run(False), "vmap(diffrax Kvaerno5), line": lambda: run(True)}
