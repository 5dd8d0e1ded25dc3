"""Lanes of a batched fit by the adaptive solver, each with steps of its own: for what lanes in step cannot follow."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

import jax
import numpy as np

from jaxlines.inference.problem import Problem, set_on_host, with_inputs
from jaxlines.inference.programs import prediction, sensitivity
from jaxlines.inference.recording import Recording
from jaxlines.simulation.assembly import number_locations
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import STATUS

LANES = 32
"""Lanes a call: enough to use vector units, few enough that a slow lane holds up few others."""

TIGHTER = 0.1
"""Factor on the tolerance at each level of accuracy."""


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _predict_lanes(plan, wanted, method, places, numbers, values, times, tolerance):
    one = functools.partial(prediction, plan, wanted, method, places, tolerance=tolerance)
    return jax.vmap(one)(numbers, values, times)


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def _sensitivities_lanes(plan, wanted, method, places, groups, numbers, sizes, values, times, tolerance):
    def one(numbers, values, times):
        return sensitivity(plan, wanted, method, places, groups, numbers, sizes, values, times, tolerance)

    return jax.vmap(one)(numbers, values, times)


@dataclasses.dataclass(frozen=True)
class AdaptiveLanes:
    """Recordings as lanes of the adaptive solver.

    Fields: first: the problem of the first lane, which all share but for values; values, times: stacked over lanes;
    bad: lanes whose own numbers are not finite.
    """

    first: Problem
    values: object
    times: np.ndarray
    bad: np.ndarray
    name = "adaptive"

    def effort(self, level: int) -> float:
        """The relative tolerance at a level of accuracy."""
        return self.first.tolerance * TIGHTER**level

    def slope_level(self, level: int) -> int:
        """The level of the slopes that go with outputs of a level."""
        return level

    def run(
        self,
        numbers: np.ndarray,
        lanes: np.ndarray,
        level: int,
        take: Callable,
        *,
        outputs: bool = True,
        slopes: bool = False,
    ) -> None:
        """Simulate lanes with values of the free parameters; see `batch_lockstep.LockstepLanes.run`."""
        for start in range(0, lanes.size, LANES):
            part = np.arange(start, min(start + LANES, lanes.size))
            shown, partials = self._call(numbers[part], lanes[part], level, slopes)
            take(part, shown if outputs else None, partials)

    def _call(self, numbers, lanes, level: int, slopes: bool) -> tuple[np.ndarray, np.ndarray | None]:
        """Outputs (lanes, samples, channels) and slopes (lanes, samples, channels, free); NaN for failed lanes."""
        first, index = self.first, np.concatenate([np.arange(lanes.size), np.zeros(LANES - lanes.size, int)])
        static = (first.plan, first.wanted, first.method, first.locations)
        repeats = [len(group) for group in first.groups]
        taken = jax.tree.map(lambda leaf: leaf[lanes[index]], self.values)
        data = (taken, self.times[lanes[index]], np.asarray(self.effort(level)))
        repeated = np.repeat(numbers[index], repeats, axis=1)
        with computing_in(first.precision):
            if slopes:
                arguments = cast((repeated, first.sizes, *data), first.precision)
                found = _sensitivities_lanes(*static, first.groups, *arguments)
            else:
                found = _predict_lanes(*static, *cast((repeated, *data), first.precision))
            *arrays, status = (np.asarray(x)[: lanes.size] for x in found)
        good = np.isin(status, (STATUS["ok"], STATUS["tension"])) & ~self.bad[lanes]
        size = first.recording.times.size
        kept = [np.asarray(a[:, :size], dtype=np.float64) for a in arrays]
        kept = [np.where(good.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in kept]
        return kept[0], kept[1] if slopes else None


def adaptive_lanes(
    first: Problem, recordings: Sequence[Recording], own: Sequence[dict[str, float]], interpolation: str
) -> AdaptiveLanes:
    """Recordings, each with its own numbers (path -> SI), as lanes. Raises: KeyError for an unknown path."""
    locations = number_locations(first.plan, first.values)
    values = []
    for recording, numbers in zip(recordings, own, strict=True):
        lane_values = with_inputs(first, recording, interpolation)
        for path, number in numbers.items():
            lane_values = set_on_host(lane_values, locations[resolve(path, locations)], value=number)
        values.append(lane_values)
    stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *values)
    times = np.stack([dataclasses.replace(first, recording=recording).padded_times() for recording in recordings])
    bad = np.array([not np.all(np.isfinite(list(numbers.values()))) for numbers in own])
    return AdaptiveLanes(first, stacked, times, bad)
