"""The control line as lanes of an ensemble: fits, end points and bootstrap samples of many data sets share calls."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from coverage_line import LABELS, NOISE_SD, Line

import jaxlines as jl
from jaxlines.inference.end_points import Asked, EndPoint, Search
from jaxlines.inference.least_squares import Solution
from jaxlines.inference.noise_models import Autoregression, whiten

CHUNK = 1024
"""Lanes whose rows and slopes are held at once."""

TOLERANCE = 1e-6
"""Of the engine; at 601 samples the pressure is then within 0.1 Pa of a tight solution, the noise being 40 kPa."""


@dataclasses.dataclass(frozen=True)
class Lanes:
    """Pressure and its slopes by the coordinates, for many points at once."""

    line: Line
    program: jl.EnsembleProgram

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressure [Pa], (points, samples), and slopes by the coordinates, (points, samples, 4), at x (points, 4)."""
        values = self.line.to_values(x)
        found = jl.ensemble_jacobian(self.program, _varied(self.line, values))
        slopes = [found.slopes["A.pressure"][f.paths[0]] for f in self.line.free]
        steps = np.stack([f.slope(values[:, i]) for i, f in enumerate(self.line.free)], axis=-1)
        return found.outputs["A.pressure"], np.stack(slopes, axis=-1) * steps[:, None, :]


def _varied(line: Line, values) -> dict[str, np.ndarray]:
    """Values in SI, (points, 4), by path."""
    return {f.paths[0]: np.ascontiguousarray(values[:, i]) for i, f in enumerate(line.free)}


def make_lanes(line: Line) -> Lanes:
    """The ensemble, its steps chosen at points around the truth."""
    rng, middle = np.random.default_rng(0), line.to_coordinates(line.truth)
    spread = 0.02 * rng.standard_normal((128, len(LABELS))) * np.array([1.0, 10.0, 1e-12, 1e6])
    near = np.clip(middle + spread, line.lower, line.upper)
    signals, varied = line.problem.inputs, _varied(line, line.to_values(near))
    options = {"outputs": ["A.pressure"], "tolerance": TOLERANCE, "engine": "explicit"}
    return Lanes(line, jl.prepare_ensemble(line.circuit, line.times, varied, signals, **options))


def whitened(columns: np.ndarray, models: Sequence[Autoregression | None]) -> np.ndarray:
    """Columns of rows, (lanes, samples, columns), with the correlation of each lane's noise, if any, taken out."""
    return np.stack([own if m is None else whiten(own, m) for own, m in zip(columns, models, strict=True)])


def rows_of(lanes: Lanes, x, data, models) -> tuple[np.ndarray, np.ndarray]:
    """Weighted rows (points, samples) and slopes (points, samples, 4), whitened by the models."""
    pressure, slopes = lanes.at(x)
    joined = np.concatenate([slopes, (pressure - data)[..., None]], axis=-1) / NOISE_SD
    joined = whitened(joined, models) if any(m is not None for m in models) else joined
    return joined[..., -1], joined[..., :-1]


def gauss_newton(lanes: Lanes, x, data, models=None, rounds: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of every lane from nearby points: ends (points, 4), and the last step in standard errors.

    data: (points, samples); models: the noise of each lane, or None. Steps are cut at the bounds.
    """
    x, last = np.array(x), np.full(len(x), np.inf)
    models = [None] * len(x) if models is None else models
    for first in range(0, len(x), CHUNK):
        part = slice(first, first + CHUNK)
        for _ in range(rounds):
            rows, slopes = rows_of(lanes, x[part], data[part], models[part])
            inner = np.einsum("lsi,lsj->lij", slopes, slopes)
            size = np.sqrt(np.einsum("lii->li", inner))
            aside = np.einsum("lsi,ls->li", slopes, rows) / size
            step = -np.linalg.solve(inner / (size[:, :, None] * size[:, None, :]), aside[..., None])[..., 0] / size
            variance = np.sum(rows**2, axis=1) / (rows.shape[1] - len(LABELS))
            last[part] = np.sqrt(np.einsum("li,lij,lj->l", step, inner, step) / variance)
            x[part] = np.clip(x[part] + step, lanes.line.lower, lanes.line.upper)
    return x, last


def condensed(rows: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R of [J r] = Q R: rows (points, 5) and slopes (points, 5, 4) of the same costs, gradients and J'J."""
    triangle = np.asarray(np.linalg.qr(np.concatenate([slopes, rows[..., None]], axis=-1), mode="r"))
    return triangle[..., -1], triangle[..., :-1]


def solution(x, rows, slopes) -> Solution:
    """An optimum with condensed rows."""
    return Solution(x, 0.5 * float(rows @ rows), "converged", "", rows, slopes, x, 0)


def drive(lanes: Lanes, searches: Sequence[Search], of: np.ndarray, data, models, say) -> list[EndPoint]:
    """Run searches for end points side by side: each round answers what all of them ask with one simulation of a batch.

    of: the lane of each search, whose data and noise model it sees.
    """
    ends: list[EndPoint | None] = [None] * len(searches)
    asked: dict[int, Asked] = {i: next(search) for i, search in enumerate(searches)}
    known: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    turn = 0
    while asked:
        fresh = [i for i, question in asked.items() if not (i in known and np.array_equal(known[i][0], question.x))]
        for first in range(0, len(fresh), CHUNK):
            part = fresh[first : first + CHUNK]
            x, own = np.stack([asked[i].x for i in part]), of[part]
            rows, slopes = condensed(*rows_of(lanes, x, data[own], [models[k] for k in own]))
            known |= {i: (x[k], rows[k], slopes[k]) for k, i in enumerate(part)}
        for i, question in list(asked.items()):
            try:
                asked[i] = searches[i].send(known[i][2] if question.slopes else known[i][1])
            except StopIteration as stop:
                ends[i] = stop.value
                del asked[i], known[i]
        turn += 1
        if turn % 10 == 0:
            say(f"round {turn}: {len(asked)} of {len(searches)} end points left")
    return [end for end in ends if end is not None]
