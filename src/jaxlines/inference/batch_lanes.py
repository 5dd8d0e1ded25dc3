"""Recordings as the lanes of a batched fit: what was measured, how it is weighted, and the engine that simulates it."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxlines.inference.batch_adaptive import AdaptiveLanes, adaptive_lanes
from jaxlines.inference.batch_lockstep import LockstepLanes, NotInStep, lockstep_lanes
from jaxlines.inference.batch_memory import remembered
from jaxlines.inference.loss import Loss
from jaxlines.inference.noise import Noise, as_noise, estimate_noise
from jaxlines.inference.parameters import Free
from jaxlines.inference.problem import Problem, make_problem, recorded_inputs, with_inputs
from jaxlines.inference.recording import Recording
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import make_method
from jaxlines.simulation.segments import undecided_lines

ENGINES = ("auto", "explicit", "implicit", "adaptive")

PILOT_SHARE, PILOT_RANGE = 1.0, (1e-5, 1e-2)
"""Tolerance of the first steps: a share of the noise, and within which limits. Searches go on with finer steps, so that
it decides over time, not over results."""


@dataclasses.dataclass(frozen=True)
class Batch:
    """Recordings as lanes of one circuit.

    Fields: first: the problem of the first lane, which all share but for values; engine; measured, used: shape
    (lanes, times, channels); sigma: first noise levels, same shape; noise: of each channel, what is known of it;
    own_noise: levels that the recordings give, NaN where they give none, or None when none does.
    """

    first: Problem
    engine: LockstepLanes | AdaptiveLanes
    measured: np.ndarray
    used: np.ndarray
    sigma: np.ndarray
    noise: tuple[Noise, ...]
    own_noise: np.ndarray | None = None

    @property
    def free(self) -> tuple[Free, ...]:
        """The free parameters, the same in every lane."""
        return self.first.free

    @property
    def lanes(self) -> int:
        """How many recordings there are."""
        return self.measured.shape[0]

    def predict(self, numbers: np.ndarray, lanes: np.ndarray, level: int = 2) -> np.ndarray:
        """Simulated channels of some lanes for values of the free parameters in SI, shape (lanes, times, channels).

        level: of accuracy, see `effort` of the engine: 0 as the search begins, each one finer than the one before.
        """
        return self._run(numbers, lanes, level, False)[0]

    def sensitivities(self, numbers: np.ndarray, lanes: np.ndarray, level: int = 2) -> tuple[np.ndarray, np.ndarray]:
        """Simulated channels of some lanes and their slopes by the free parameters (last axis)."""
        return self._run(numbers, lanes, level, True)

    def _run(self, numbers, lanes, level: int, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        shape = (lanes.size, *self.measured.shape[1:])
        shown = np.empty(shape)
        partials = np.empty((*shape, len(self.free)) if slopes else 0)

        def take(part, outputs, found) -> None:
            shown[part] = outputs
            if slopes:
                partials[part] = found

        self.engine.run(np.asarray(numbers, dtype=float), np.asarray(lanes), level, take, slopes=slopes)
        return shown, partials

    def to_values(self, coordinates: np.ndarray) -> np.ndarray:
        """Values in SI from search coordinates, shape (lanes, free)."""
        return np.stack([f.to_value(coordinates[:, i]) for i, f in enumerate(self.free)], axis=1)

    def levels(self, simulated: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        """Noise levels of some lanes from their simulated channels, shape (lanes, times, channels).

        What is estimated is estimated in each lane, from what its simulated channels leave over.
        """
        sigma, used = np.empty_like(simulated), self.used[lanes]
        total = np.maximum(used.sum(axis=(1, 2)), 1)
        freedom = np.maximum(1.0 - len(self.free) / total, 1.0 / total)
        for c, noise in enumerate(self.noise):
            shown, keep = simulated[..., c], used[..., c] & self._judged(lanes)[..., c]
            errors = np.where(keep, shown - self.measured[lanes][..., c], 0.0)
            if not noise.estimated:
                sigma[..., c] = noise.level(shown)
            elif noise.uniform:  # the closed form of `estimate_noise`
                floor = 1e-12 * np.abs(np.where(keep, self.measured[lanes][..., c], 0.0)).max(axis=1) + 1e-300
                level = np.sqrt((errors**2).sum(axis=1) / (np.maximum(keep.sum(axis=1), 1) * freedom))
                sigma[..., c] = np.maximum(level, floor)[:, None]
            else:
                for i in range(lanes.size):
                    found = self._estimated(noise, errors[i][keep[i]], shown[i][keep[i]], freedom[i])
                    sigma[i, :, c] = found.level(shown[i])
        return self._filled(sigma, lanes)

    @staticmethod
    def _estimated(noise: Noise, errors, shown, freedom: float) -> Noise:
        floor = 1e-12 * max(float(np.abs(shown).max(initial=0.0)), 1e-300)
        found = estimate_noise(noise, errors, shown, freedom, Loss(), floor)
        return Noise(found.absolute or floor, found.relative or 0.0)

    def _judged(self, lanes) -> np.ndarray:
        """Samples whose noise the recording does not give."""
        shape = (lanes.size, *self.measured.shape[1:])
        return np.ones(shape, bool) if self.own_noise is None else ~np.isfinite(self.own_noise[lanes])

    def _filled(self, sigma: np.ndarray, lanes) -> np.ndarray:
        """Levels with those that the recordings give put in."""
        return sigma if self.own_noise is None else np.where(self._judged(lanes), sigma, self.own_noise[lanes])


def _own_numbers(recordings: Sequence[Recording], local: Sequence[dict] | None) -> list[dict[str, float]]:
    """Path -> number of every recording: its conditions, its start values, and what is given as local."""
    found = []
    for lane, recording in enumerate(recordings):
        start = recording.initial or {}
        if isinstance(start, str) or any(isinstance(value, str) for value in start.values()):
            raise ValueError(
                f"{recording.name}: start values of a batch must be numbers, got {start!r}: set them, or let them free"
            )
        own = recording.conditions | {f"initial.{name}": value for name, value in start.items()}
        found.append(own | (local[lane] if local else {}))
    return found


def _check(recordings: Sequence[Recording], local: Sequence[dict] | None, engine: str, solver) -> None:
    """Raise for recordings that cannot be lanes of one batch."""
    if not recordings:
        raise ValueError("a batch needs at least one recording")
    lengths = {recording.times.size for recording in recordings}
    if len(lengths) != 1:
        raise ValueError(f"recordings of a batch must have one length, got {sorted(lengths)[:5]} samples: cut windows")
    if local is not None and len(local) != len(recordings):
        raise ValueError(f"local needs one dictionary a recording, got {len(local)} for {len(recordings)}")
    if engine not in ENGINES:
        raise ValueError(f"engine must be {', '.join(ENGINES)}, got {engine!r}")
    if solver is not None and engine not in ("auto", "adaptive"):
        raise ValueError(f'solver goes with engine="adaptive", got engine="{engine}"')


def _measured(first: Problem, recordings: Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Measured values and which of them count, shape (lanes, times, channels)."""
    for recording in recordings:
        missing = [name for name in first.wanted if name not in recording.channels]
        if missing:
            raise ValueError(
                f"{recording.name}: it has no channel {missing[0]!r}, which the first recording of the batch has; its "
                f"channels: {', '.join(recording.channels)}"
            )
    lanes = [dataclasses.replace(first, recording=recording) for recording in recordings]
    return np.stack([lane.measured for lane in lanes]), np.stack([lane.used for lane in lanes])


def _own_noise(first: Problem, recordings: Sequence[Recording]) -> np.ndarray | None:
    """Noise levels that the recordings give, shape (lanes, times, channels)."""
    if not any(recording.noise for recording in recordings):
        return None
    nothing = np.full(first.recording.times.size, np.nan)
    return np.stack([np.stack([r.noise.get(name, nothing) for name in first.wanted], axis=1) for r in recordings])


def _first_levels(noise: Sequence[Noise], measured, used) -> np.ndarray:
    """Noise levels to begin with: what is known, else one per cent of a channel's range in each recording."""
    shown = np.where(used, measured, np.nan)
    with np.errstate(invalid="ignore"):
        empty = ~used.any(axis=1)
        spread = np.where(empty, 0.0, np.nanmax(np.where(empty[:, None], 0.0, shown), axis=1))
        spread = spread - np.where(empty, 0.0, np.nanmin(np.where(empty[:, None], 0.0, shown), axis=1))
    sigma = np.broadcast_to(np.where(spread > 0, 0.01 * spread, 1.0)[:, None], measured.shape).copy()
    for c, of in enumerate(noise):
        if not of.estimated:
            sigma[..., c] = np.maximum(of.level(np.where(used[..., c], measured[..., c], 0.0)), 1e-3 * sigma[..., c])
    return sigma


def make_batch(
    circuit: Circuit,
    recordings: Sequence[Recording],
    *,
    free: Sequence[Free],
    local: Sequence[dict] | None = None,
    starts: np.ndarray | None = None,
    noise: dict | None = None,
    engine: str = "auto",
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 10_000,
    precision: str = "float64",
    interpolation: str = "linear",
) -> Batch:
    """Recordings of one length as lanes of one circuit; arguments as in `fit_batch`."""
    _check(recordings, local, engine, solver)
    own = _own_numbers(recordings, local)
    bare = [dataclasses.replace(recording, conditions={}, initial=None) for recording in recordings]
    method = make_method(solver, "forward", max_steps)
    first = _first_problem(circuit, bare[0], free, method, tolerance, precision, interpolation)
    for name in noise or {}:
        if name not in first.wanted:
            raise ValueError(f"noise is given for {name!r}, which is not fitted; fitted: {', '.join(first.wanted)}")
    levels = tuple(as_noise((noise or {}).get(name), name) for name in first.wanted)
    measured, used = _measured(first, bare)
    own_noise = _own_noise(first, bare)
    sigma = _first_levels(levels, measured, used)
    if own_noise is not None:
        sigma = np.where(np.isfinite(own_noise), own_noise, sigma)
    begin = np.tile([f.to_value(f.start_coordinate()) for f in first.free], (len(bare), 1))
    begin = begin if starts is None else checked_starts(starts, begin.shape)
    batch = Batch(
        first, adaptive_lanes(first, bare[:1], own[:1], interpolation), measured, used, sigma, levels, own_noise
    )
    if engine != "adaptive" and solver is None:
        try:
            loosest = _pilot_tolerance(measured, used, sigma)
            lanes = lockstep_lanes(first, bare, own, begin, interpolation, engine, loosest)
            return dataclasses.replace(batch, engine=lanes)
        except NotInStep as reason:
            if engine != "auto":
                raise ValueError(f'engine="{engine}" does not fit: {reason}: use engine="adaptive" or "auto"') from None
    return dataclasses.replace(batch, engine=adaptive_lanes(first, bare, own, interpolation))


def _first_problem(circuit, recording: Recording, free, method, tolerance, precision, interpolation) -> Problem:
    """The problem of the first lane, made once for a circuit, parameters, times and channels.

    Where the number of segments of a line follows from what drives it, the inputs count as well.
    """
    driving = {name: recording.channels.get(name) for name in circuit.external_inputs()}
    parts = (circuit, tuple(free), method, tolerance, precision, interpolation)
    key = (*parts, recording.times, tuple(recording.channels), driving if undecided_lines(circuit) else None)

    def make() -> Problem:
        own = dataclasses.replace(recording, times=recording.times.copy())
        return make_problem(circuit, own, free, (), {}, method, tolerance, precision, interpolation)

    known = remembered(key, make)
    inputs = recorded_inputs(circuit, recording, interpolation)
    own = dataclasses.replace(known, recording=recording, inputs=inputs)
    return dataclasses.replace(own, values=with_inputs(own, recording, interpolation))


def checked_starts(starts, shape: tuple[int, ...]) -> np.ndarray:
    """Start values. Raises: ValueError for another shape."""
    starts = np.asarray(starts, dtype=float)
    if starts.shape != shape:
        raise ValueError(f"starts must have shape {shape} (recordings, free), got {starts.shape}")
    return starts


def _pilot_tolerance(measured, used, sigma) -> float:
    """The tolerance of the first steps as a share of the outputs' magnitudes."""
    size = np.where(used, np.abs(measured), 0.0).max(axis=(0, 1))
    level = np.median(np.where(used, sigma, np.nanmax(sigma)), axis=(0, 1))
    shares = level[size > 0.0] / size[size > 0.0]
    return float(np.clip(PILOT_SHARE * np.min(shares, initial=1.0), *PILOT_RANGE))
