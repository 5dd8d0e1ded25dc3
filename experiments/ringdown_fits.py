"""Every run fitted by a structure, in one batch; what comes out as a table in counts and seconds."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console
from ringdown_data import COSINE_SIZES, Ringdown, cosine_start, damped_cosine
from ringdown_model import PASCAL, SCALE, VOLUME, Structure
from scipy.optimize import least_squares

import jaxlines as jl
from jaxlines.inference.batch_lanes import Batch, make_batch

NUMERICS = {"interpolation": "cubic", "tolerance": 1e-6, "max_steps": 3000}
OTHER = {
    1: {"line.resistance": 1.5, "line.inertance": 1.5, "fluid.bulk_modulus": 0.7},
    2: {"line.resistance": 1.3, "line.inertance": 0.8, "line.passage_resistance": 0.7, "line.passage_inertance": 1.4,
        "fluid.bulk_modulus": 0.8, "line.hose_volume": 0.75, "actuator.duration": 1.4},
}  # fmt: skip
"""Factors by which the second search starts elsewhere, by number of lumps."""


class Fits(NamedTuple):
    """Per-run fits: the better of the searches, RMSE in per cent of hold, whether both ended there and converged."""

    result: jl.BatchFit
    percent: np.ndarray
    converged: np.ndarray


def batch_of(runs: list[Ringdown], structure: Structure, starts: np.ndarray) -> Batch:
    """The runs as lanes of one circuit."""
    return make_batch(
        structure.circuit,
        [structure.recording(run) for run in runs],
        free=structure.free,
        local=[structure.own_numbers(run) for run in runs],
        starts=starts,
        **NUMERICS,
    )


def _searched(runs: list[Ringdown], structure: Structure, moved: dict, console: Console, name: str) -> jl.BatchFit:
    with console.status(name) as status:
        return jl.fit_batch(
            structure.circuit,
            [structure.recording(run) for run in runs],
            free=structure.free,
            local=[structure.own_numbers(run) for run in runs],
            starts=np.array([structure.starts(run, moved) for run in runs]),
            progress=lambda text, share: status.update(f"{name}: {text} ({share:.0%})"),
            **NUMERICS,
        )


def _better(first: jl.BatchFit, second: jl.BatchFit) -> jl.BatchFit:
    """Lane by lane the fit with the smaller misfit."""
    take = second.rmse[:, 0] < first.rmse[:, 0] * (1.0 - 1e-6)
    arrays = ("values", "sd", "rmse", "simulated")
    chosen = {
        name: np.where(take[(...,) + (None,) * (old.ndim - 1)], getattr(second, name), old)
        for name, old in ((name, getattr(first, name)) for name in arrays)
    }
    words = {
        name: tuple(b if t else a for t, a, b in zip(take, getattr(first, name), getattr(second, name), strict=True))
        for name in ("status", "messages")
    }
    return dataclasses.replace(first, **chosen, **words)


def fit_all(runs: list[Ringdown], structure: Structure, console: Console, name: str, twice: bool = True) -> Fits:
    """Fit every run, `twice` from different starts; converged means that both searches did and agree."""
    hold = np.array([run.hold for run in runs]) * PASCAL
    first = _searched(runs, structure, {}, console, name)
    if not twice:
        return Fits(first, 100.0 * first.rmse[:, 0] / hold, np.array(first.status) == "converged")
    second = _searched(runs, structure, OTHER[structure.lumps], console, name)
    away = np.abs(first.values - second.values)
    late = np.array([f.transform == "identity" for f in structure.free])
    near = (away < np.where(late, 1e-4, 0.02 * np.abs(first.values))).all(axis=1)
    both = np.array([a == b == "converged" for a, b in zip(first.status, second.status, strict=True)])
    agree = near & (100.0 * np.abs(first.rmse - second.rmse)[:, 0] / hold < 0.005)
    best = _better(first, second)
    return Fits(best, 100.0 * best.rmse[:, 0] / hold, both & agree)


def residuals(runs: list[Ringdown], fits: Fits) -> np.ndarray:
    """Measured less simulated pressure, per cent of hold, shape (runs, samples)."""
    hold = np.array([run.hold for run in runs])[:, None]
    return 100.0 * (np.array([run.pressure for run in runs]) - fits.result.simulated[:, :, 0] / PASCAL) / hold


def neighbours(left: np.ndarray) -> np.ndarray:
    """Correlation of neighbouring residuals of every run."""
    left = left - left.mean(axis=1, keepdims=True)
    return (left[:, 1:] * left[:, :-1]).mean(axis=1) / left.var(axis=1)


def baseline(runs: list[Ringdown]) -> np.ndarray:
    """RMSE of the damped cosine fitted to every run, per cent of hold."""
    errors = []
    for run in runs:
        measured = run.pressure / run.hold
        found = least_squares(
            lambda v, run=run, measured=measured: damped_cosine(run, v) - measured,
            cosine_start(run),
            x_scale=COSINE_SIZES,
        )
        errors.append(100.0 * np.sqrt(np.mean(found.fun**2)))
    return np.array(errors)


def in_counts(structure: Structure, values: np.ndarray) -> dict[str, np.ndarray]:
    """Values in SI as resistances [counts/(counts/s)], inertances, capacitances [counts/counts], times [ms]."""
    si = dict(zip([f.paths[0] for f in structure.free], values.T, strict=True))
    gauge = VOLUME / si["fluid.bulk_modulus"] * SCALE
    found = {"resistance": si["line.resistance"] / SCALE, "inertance": si["line.inertance"] / SCALE}
    if structure.lumps == 2:
        found |= {
            "passage_resistance": si["line.passage_resistance"] / SCALE,
            "passage_inertance": si["line.passage_inertance"] / SCALE,
            "hose_capacitance": si["line.hose_volume"] / si["fluid.bulk_modulus"] * SCALE,
        }
    found |= {"port_capacitance" if structure.lumps == 2 else "capacitance": gauge}
    found["delay_ms"] = 1e3 * (si["rate.delay"] if structure.measured else si["actuator.delay"])
    if "actuator.duration" in si:
        found["stop_duration_ms"] = 1e3 * si["actuator.duration"]
    return found


def modes(found: dict[str, np.ndarray]) -> np.ndarray:
    """Eigenvalues of the linear circuit at rest [1/s], shape (runs, states): frequency and damping of each mode."""
    one = np.ones_like(found["resistance"])
    if "hose_capacitance" not in found:
        rows = [[-found["resistance"] / found["inertance"], -one / found["inertance"]],
                [one / found["capacitance"], 0 * one]]  # fmt: skip
        return np.linalg.eigvals(np.moveaxis(np.array(rows), -1, 0))
    i_1, i_2 = found["inertance"], found["passage_inertance"]
    hose, gauge = found["hose_capacitance"], found["port_capacitance"]
    rows = [
        [-found["resistance"] / i_1, -one / i_1, 0 * one, 0 * one],
        [one / hose, 0 * one, -one / hose, 0 * one],
        [0 * one, one / i_2, -found["passage_resistance"] / i_2, -one / i_2],
        [0 * one, 0 * one, one / gauge, 0 * one],
    ]
    return np.linalg.eigvals(np.moveaxis(np.array(rows), -1, 0))


def table(runs: list[Ringdown], structure: Structure, fits: Fits) -> pd.DataFrame:
    """One row a run, in counts: parameters, modes, status."""
    found = in_counts(structure, fits.result.values)
    roots: Any = modes(found)
    order = np.argsort(np.where(roots.imag > 0, roots.imag, np.inf), axis=1)[:, : structure.lumps]
    upper: Any = np.take_along_axis(roots, order, axis=1)
    whole = found["capacitance"] if structure.lumps == 1 else found["hose_capacitance"] + found["port_capacitance"]
    columns: dict = {
        "run_id": [run.run_id for run in runs],
        "unit": [run.unit for run in runs],
        "port": [run.port for run in runs],
        "hold_counts": [run.hold for run in runs],
        "speed_counts_per_s": [run.speed for run in runs],
        "rmse_percent": fits.percent,
        **found,
        "stiffness": 1.0 / whole,
    }
    for k, tail in enumerate(["", "_second_mode"][: structure.lumps]):
        columns |= {
            f"frequency_hz{tail}": upper[:, k].imag / (2 * np.pi),
            f"damping_ratio{tail}": -upper[:, k].real / np.abs(upper[:, k]),
        }
    columns["residual_autocorrelation"] = neighbours(residuals(runs, fits))
    columns["status"] = [
        s if c or s != "converged" else "starts disagree"
        for s, c in zip(fits.result.status, fits.converged, strict=True)
    ]
    return pd.DataFrame(columns)
