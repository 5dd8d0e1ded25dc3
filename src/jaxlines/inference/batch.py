"""Many independent fits of one circuit at once: a recording, its own numbers and its own estimates per lane.

One batched residual-and-Jacobian call serves all lanes of an iteration; damping, bounds and convergence are
kept per lane, and finished lanes leave the batch.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence

import jax
import numpy as np

from jaxlines.inference.parameters import Free
from jaxlines.inference.problem import Problem, make_problem, prediction, sensitivity, set_on_host, with_inputs
from jaxlines.inference.recording import Recording
from jaxlines.inference.search import judge
from jaxlines.inference.uncertainty import covariance
from jaxlines.simulation.assembly import number_locations
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import make_method
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import STATUS

LANES = 32
"""Lanes a call: enough to use vector units, few enough that a slow lane holds up few others."""


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _predict_lanes(plan, wanted, method, locations, numbers, values, times, tolerance):
    one = functools.partial(prediction, plan, wanted, method, locations, tolerance=tolerance)
    return jax.vmap(one)(numbers, values, times)


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def _sensitivities_lanes(plan, wanted, method, locations, groups, numbers, sizes, values, times, tolerance):
    def one(numbers, values, times):
        return sensitivity(plan, wanted, method, locations, groups, numbers, sizes, values, times, tolerance)

    return jax.vmap(one)(numbers, values, times)


@dataclasses.dataclass(frozen=True)
class Batch:
    """Recordings as lanes of one compiled circuit.

    Fields: first: the problem of the first lane, which all share but for values; values, times: stacked over
    lanes; measured, used: shape (lanes, times, channels); sigma: noise levels, shape (lanes, channels).
    """

    first: Problem
    values: object
    times: np.ndarray
    measured: np.ndarray
    used: np.ndarray
    sigma: np.ndarray

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters, the same in every lane."""
        return self.first.free

    def _call(self, program, static, numbers: np.ndarray, lanes: np.ndarray, *extra) -> list[np.ndarray]:
        """Run a program over some lanes in chunks of one size; failed lanes are NaN."""
        pieces = []
        repeats = [len(group) for group in self.first.groups]
        for start in range(0, lanes.size, LANES):
            chunk = lanes[start : start + LANES]
            padded = np.concatenate([chunk, np.full(LANES - chunk.size, chunk[-1])])
            rows = np.concatenate([numbers[start : start + LANES], np.repeat(numbers[start : start + 1], LANES, 0)])
            taken = jax.tree.map(lambda leaf, padded=padded: leaf[padded], self.values)
            data = (np.repeat(rows[:LANES], repeats, axis=1), *extra, taken, self.times[padded])
            arguments = cast((*data, np.asarray(self.first.tolerance)), self.first.precision)
            with computing_in(self.first.precision):
                *arrays, status = (np.asarray(x) for x in program(*static, *arguments))
            good = np.isin(status[: chunk.size], (STATUS["ok"], STATUS["tension"]))
            size = self.measured.shape[1]
            kept = [np.asarray(a[: chunk.size, :size], dtype=np.float64) for a in arrays]
            pieces.append([np.where(good.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in kept])
        return [np.concatenate(parts) for parts in zip(*pieces, strict=True)]

    def predict(self, numbers: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        """Simulated channels of some lanes for values of the free parameters in SI, shape (lanes, times, channels)."""
        p = self.first
        return self._call(_predict_lanes, (p.plan, p.wanted, p.method, p.locations), numbers, lanes)[0]

    def sensitivities(self, numbers: np.ndarray, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulated channels of some lanes and their slopes by the free parameters."""
        p = self.first
        static = (p.plan, p.wanted, p.method, p.locations, p.groups)
        simulated, slopes = self._call(_sensitivities_lanes, static, numbers, lanes, p.sizes)
        return simulated, slopes

    def to_values(self, coordinates: np.ndarray) -> np.ndarray:
        """Values in SI from search coordinates, shape (lanes, free)."""
        return np.stack([f.to_value(coordinates[:, i]) for i, f in enumerate(self.free)], axis=1)


@dataclasses.dataclass(frozen=True)
class BatchFit:
    """Estimates of many fits.

    Fields: names of the free parameters; values and sd, shape (lanes, free), SI; status, one a lane
    ("converged", "at_bound", "stalled", "failed"); rmse, shape (lanes, channels), SI; simulated, shape (lanes,
    times, channels); channels; num_iterations; seconds.
    """

    names: tuple[str, ...]
    values: np.ndarray
    sd: np.ndarray
    status: tuple[str, ...]
    rmse: np.ndarray
    simulated: np.ndarray
    channels: tuple[str, ...]
    num_iterations: int
    seconds: float


def make_batch(
    circuit: Circuit,
    recordings: Sequence[Recording],
    *,
    free: Sequence[Free],
    local: Sequence[dict] | None = None,
    noise: dict[str, float] | None = None,
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 10_000,
    precision: str = "float64",
    interpolation: str = "linear",
) -> Batch:
    """Recordings of one length as lanes of one circuit; arguments as in `fit_batch`."""
    lengths = {recording.times.size for recording in recordings}
    if len(lengths) != 1:
        raise ValueError(f"recordings of a batch must have one length, got {sorted(lengths)[:5]} samples: cut windows")
    if local is not None and len(local) != len(recordings):
        raise ValueError(f"local needs one dictionary a recording, got {len(local)} for {len(recordings)}")
    method = make_method(solver, "forward", max_steps)
    first = make_problem(circuit, recordings[0], free, (), {}, method, tolerance, precision, interpolation)
    locations = number_locations(first.plan, first.values)
    values = []
    for lane, recording in enumerate(recordings):
        lane_values = with_inputs(first, recording, interpolation)
        for path, number in (local[lane] if local else {}).items():
            lane_values = set_on_host(lane_values, locations[resolve(path, locations)], value=number)
        values.append(lane_values)
    lanes = [dataclasses.replace(first, recording=recording) for recording in recordings]
    measured, used = (np.stack([getattr(lane, field) for lane in lanes]) for field in ("measured", "used"))
    spread = np.nanmax(np.where(used, measured, np.nan), axis=1) - np.nanmin(np.where(used, measured, np.nan), axis=1)
    sigma = np.where(spread > 0, 0.01 * spread, 1.0)
    for i, name in enumerate(first.wanted):
        sigma[:, i] = (noise or {}).get(name, sigma[:, i])
    stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *values)
    times = np.stack([lane.padded_times() for lane in lanes])
    return Batch(first, stacked, times, measured, used, sigma)


@dataclasses.dataclass
class _Lanes:
    """The state of all searches: coordinates, their cost, residuals and Jacobians, and damping."""

    coordinates: np.ndarray
    simulated: np.ndarray
    slopes: np.ndarray
    cost: np.ndarray
    damping: np.ndarray
    growth: np.ndarray


def _residuals(batch: Batch, lanes, simulated) -> np.ndarray:
    """Weighted residuals, zero where a sample is not used."""
    difference = (simulated - batch.measured[lanes]) / batch.sigma[lanes, None, :]
    return np.where(batch.used[lanes], difference, 0.0).reshape(lanes.size, -1)


def _jacobian(batch: Batch, lane: int, coordinates, slopes) -> np.ndarray:
    """Weighted Jacobian of a lane by its coordinates, zero where a sample is not used."""
    values = [f.to_value(c) for f, c in zip(batch.free, coordinates, strict=True)]
    steps = np.array([f.slope(v) for f, v in zip(batch.free, values, strict=True)])
    weighted = slopes * steps / batch.sigma[lane][:, None]
    return np.where(batch.used[lane][..., None], weighted, 0.0).reshape(-1, len(steps))


def _step(jacobian, residuals, damping, coordinates, bounds) -> np.ndarray:
    """A damped Gauss-Newton step that stays inside the bounds (Levenberg 1944, Marquardt 1963).

    Columns are scaled by the widths of the bounds, so that SI units of very different size do not matter.
    """
    widths = bounds[:, 1] - bounds[:, 0]
    jacobian = jacobian * widths
    gradient, hessian = jacobian.T @ residuals, jacobian.T @ jacobian
    margin = 1e-12 * widths
    stuck = (coordinates <= bounds[:, 0] + margin) & (gradient > 0)
    movable = ~(stuck | ((coordinates >= bounds[:, 1] - margin) & (gradient < 0)))
    step = np.zeros_like(coordinates)
    if movable.any():
        reduced = hessian[np.ix_(movable, movable)]
        reduced = reduced + np.diag(damping * np.diag(reduced) + 1e-300)
        step[movable] = np.linalg.lstsq(reduced, -gradient[movable], rcond=None)[0]
    return np.clip(coordinates + step * widths, bounds[:, 0], bounds[:, 1]) - coordinates


def _advance(batch: Batch, state: _Lanes, active: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """One trial step of the active lanes; returns which of them are finished."""
    residuals = _residuals(batch, active, state.simulated[active])
    jacobians = [_jacobian(batch, lane, state.coordinates[lane], state.slopes[lane]) for lane in active]
    steps = np.array(
        [
            _step(jacobian, residuals[i], state.damping[lane], state.coordinates[lane], bounds)
            for i, (lane, jacobian) in enumerate(zip(active, jacobians, strict=True))
        ]
    )
    trial = state.coordinates[active] + steps
    simulated, slopes = batch.sensitivities(batch.to_values(trial), active)
    cost = 0.5 * (_residuals(batch, active, simulated) ** 2).sum(axis=1)
    predicted = np.array(
        [-(r @ (j @ s)) - 0.5 * np.sum((j @ s) ** 2) for r, j, s in zip(residuals, jacobians, steps, strict=True)]
    )
    better = np.isfinite(cost) & (cost < state.cost[active])
    gain = np.where(better, (state.cost[active] - np.where(better, cost, 0.0)) / np.maximum(predicted, 1e-300), 0.0)
    accepted = active[better]
    state.coordinates[accepted], state.cost[accepted] = trial[better], cost[better]
    state.simulated[accepted], state.slopes[accepted] = simulated[better], slopes[better]
    # Nielsen's rule: damping follows the ratio of actual to predicted decrease (Nielsen, IMM-REP-1999-05).
    shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.minimum(gain, 1.0) - 1.0) ** 3)
    state.damping[active] *= np.where(better, shrink, state.growth[active])
    state.growth[active] = np.where(better, 2.0, np.minimum(state.growth[active] * 2.0, 1e3))
    tiny = np.all(np.abs(steps) < 1e-9 * (bounds[:, 1] - bounds[:, 0]), axis=1)
    settled = better & (predicted < 1e-9 * np.maximum(cost, 1e-300))
    return tiny | settled | (state.damping[active] > 1e12)


def _finish(batch: Batch, state: _Lanes, alive: np.ndarray, noise: dict, iterations: int, began: float) -> BatchFit:
    """Judge every lane and give its estimates their standard deviations."""
    lanes, count = batch.measured.shape[0], len(batch.free)
    residuals = _residuals(batch, np.arange(lanes), state.simulated)
    status, sd = [], np.full((lanes, count), np.nan)
    widths = np.array([high - low for low, high in (f.coordinate_bounds() for f in batch.free)])
    for lane in range(lanes):
        if not alive[lane]:
            status.append("failed")
            continue
        jacobian = _jacobian(batch, lane, state.coordinates[lane], state.slopes[lane])
        freedom = max(int(batch.used[lane].sum()) - count, 1)
        status.append(judge(batch.free, state.coordinates[lane], residuals[lane], jacobian, "")[0])
        level = 1.0 if noise else np.sqrt(residuals[lane] @ residuals[lane] / freedom)
        found = covariance(jacobian / level, np.zeros((jacobian.shape[0], 0)), widths, ())
        slopes = [f.slope(f.to_value(c)) for f, c in zip(batch.free, state.coordinates[lane], strict=True)]
        sd[lane] = np.sqrt(np.diag(found.joint)) * np.array(slopes)
    misfit = np.where(batch.used, state.simulated - batch.measured, 0.0)
    rmse = np.sqrt((misfit**2).sum(axis=1) / np.maximum(batch.used.sum(axis=1), 1))
    names = tuple(f.label for f in batch.free)
    values, wanted = batch.to_values(state.coordinates), batch.first.wanted
    seconds = time.perf_counter() - began
    return BatchFit(names, values, sd, tuple(status), rmse, state.simulated, wanted, iterations, seconds)


def fit_batch(
    circuit: Circuit,
    recordings: Sequence[Recording],
    *,
    free: Sequence[Free],
    local: Sequence[dict] | None = None,
    starts: np.ndarray | None = None,
    noise: dict[str, float] | None = None,
    max_iterations: int = 60,
    progress: Callable[[str, float], None] | None = None,
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 10_000,
    precision: str = "float64",
    interpolation: str = "linear",
) -> BatchFit:
    """Fit one circuit to many recordings independently, all at once.

    Args:
        circuit: the model; recordings: of one length and with the same channels.
        free: what to estimate in every recording; starts: start values in SI, shape (recordings, free), instead of
            those of `free`.
        local: for each recording the numbers that are its own: path -> value in SI, initial values included
            ("initial.A.pressure").
        noise: channel -> standard deviation; without it one per cent of the range weights the channels, and the
            standard deviations follow from the residuals.
        max_iterations: limit a lane; progress: called with a text and a fraction done.
        solver, tolerance, max_steps, precision, interpolation: as in `fit`; lanes of a call wait for the one with
            the most steps, so that `max_steps` should not be far above what a sane lane takes.
    Returns: a `BatchFit`. A lane that fails says so and disturbs no other.
    Raises: ValueError or KeyError for a wrong call.
    """
    began = time.perf_counter()
    say = progress or (lambda text, fraction: None)
    batch = make_batch(
        circuit,
        recordings,
        free=free,
        local=local,
        noise=noise,
        solver=solver,
        tolerance=tolerance,
        max_steps=max_steps,
        precision=precision,
        interpolation=interpolation,
    )
    bounds = np.array([f.coordinate_bounds() for f in batch.free])
    lanes = len(recordings)
    first = np.tile([f.start_coordinate() for f in batch.free], (lanes, 1))
    if starts is not None:
        first = np.stack([f.to_coordinate(np.asarray(starts)[:, i]) for i, f in enumerate(batch.free)], axis=1)
    first = np.clip(first, bounds[:, 0], bounds[:, 1])
    simulated, slopes = batch.sensitivities(batch.to_values(first), np.arange(lanes))
    cost = 0.5 * (_residuals(batch, np.arange(lanes), simulated) ** 2).sum(axis=1)
    alive = np.isfinite(cost)
    state = _Lanes(first, simulated, slopes, cost, np.full(lanes, 1e-3), np.full(lanes, 2.0))
    active, iterations = np.flatnonzero(alive), 0
    while active.size and iterations < max_iterations:
        finished = _advance(batch, state, active, bounds)
        active, iterations = active[~finished], iterations + 1
        say(f"iteration {iterations}, {lanes - active.size} of {lanes} fits finished", 1.0 - active.size / lanes)
    return _finish(batch, state, alive, noise or {}, iterations, began)
