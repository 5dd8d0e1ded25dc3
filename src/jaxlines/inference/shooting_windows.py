"""The recordings of a fit cut into windows, each with a start of its own, as lanes of one program."""

import dataclasses
import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlines.inference.joint import JointProblem
from jaxlines.inference.problem import Problem, bucket
from jaxlines.inference.programs import Place, place_numbers, sensitivity, steady_start
from jaxlines.inference.shooting_equations import Pieces
from jaxlines.inference.start_values import measured_start
from jaxlines.simulation.paths import leaf_paths
from jaxlines.simulation.plan import Plan, scales
from jaxlines.simulation.precision import cast, computing_in
from jaxlines.simulation.result import STATUS
from jaxlines.simulation.vector_field import starting_point


class StateNames(NamedTuple):
    """The states of a circuit: names of the outputs that show them, and where their start values are, in the order of
    `plan.ravel`."""

    names: tuple[str, ...]
    places: tuple[Place, ...]


def state_names(problem: Problem) -> StateNames:
    """The states of the circuit of a problem."""
    from jaxlines.physics.component import DOMAINS

    plan, paths = problem.plan, list(leaf_paths(problem.values))
    names, places = [], []
    for index, (node, domain) in enumerate(plan.free_nodes):
        names.append(f"{node}.{DOMAINS[domain].potential}")
        places.append(Place(paths.index("initial.potentials"), index))
    for k, kind in enumerate(plan.kinds):
        for state in kind.states:
            position = paths.index(f"initial.states.{k}.{state.name}")
            for *own, member in np.ndindex(*state.shape, len(kind.members)):
                names.append(".".join([kind.members[member], state.name, *map(str, own)]))
                places.append(Place(position, (*own, member)))
    return StateNames(tuple(names), tuple(places))


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def _windows(plan: Plan, wanted, method, places, groups, numbers, sizes, values, times, tolerance):
    """Outputs (windows, times, wanted), their slopes by the numbers (last axis) and status, a window a lane."""

    def one(numbers, times):
        return sensitivity(plan, wanted, method, places, groups, numbers, sizes, values, times, tolerance)

    return jax.vmap(one)(numbers, times)


@functools.partial(jax.jit, static_argnums=(0, 1, 4))
def _start(plan: Plan, places, numbers, values, steady: bool, time):
    """The states at the beginning, (d,), and their slopes by the numbers at places, (d, places)."""

    def states(numbers):
        moved = place_numbers(values, places, numbers)
        moved = steady_start(plan, moved, time) if steady else moved
        potentials, states = starting_point(plan, moved, time)
        blocks = [states[k][s.name] for k, kind in enumerate(plan.kinds) for s in kind.states]
        return jnp.concatenate([jnp.ravel(jnp.asarray(block)) for block in (potentials, *blocks)])

    return states(numbers), jax.jacfwd(states)(numbers)


@dataclasses.dataclass(frozen=True)
class Cut:
    """One recording in windows.

    Fields: problem; states; edges: the samples where windows begin, and the last sample, (windows + 1,).
    """

    problem: Problem
    states: StateNames
    edges: np.ndarray

    @functools.cached_property
    def _moving(self) -> tuple[tuple[Place, ...], tuple[tuple[int, ...], ...], tuple[int, ...]]:
        """Places in windows; which of them each quantity drives, and which quantity that is, among the free and known
        parameters and then the states. Start values are the states' business."""
        own, initial = self.problem, {p.position for p in self.states.places}
        driven = [
            [p for p in (own.locations[m] for m in members) if p.position not in initial] for members in own.groups
        ]
        places, groups, drivers = [], [], []
        for i, found in enumerate([*driven, *([place] for place in self.states.places)]):
            if found:
                groups.append(tuple(range(len(places), len(places) + len(found))))
                drivers.append(i)
                places += found
        return tuple(places), tuple(groups), tuple(drivers)

    @functools.cached_property
    def _times(self) -> np.ndarray:
        """Times of each window, the last one repeated, (windows, longest)."""
        times, lengths = self.problem.recording.times, np.diff(self.edges) + 1
        index = np.minimum(np.arange(bucket(int(lengths.max()))), lengths[:, None] - 1) + self.edges[:-1, None]
        return times[index]

    def run(self, values: np.ndarray, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fitted channels, then states, (windows, times, channels + d), and slopes by free and known parameters in SI,
        then by states; NaN for a window that fails."""
        own, (places, groups, drivers) = self.problem, self._moving
        every = np.concatenate([values, own.known_values])
        every = np.concatenate([np.tile(every, (len(states), 1)), states], axis=1)
        numbers = np.repeat(every[:, list(drivers)], [len(g) for g in groups], axis=1)
        sizes = np.concatenate([own.sizes, scales(own.plan)])[list(drivers)]
        with computing_in(own.precision):
            data = cast((numbers, sizes, own.values, self._times, np.asarray(own.tolerance)), own.precision)
            wanted = (*own.wanted, *self.states.names)
            outputs, found, status = map(np.asarray, _windows(own.plan, wanted, own.method, places, groups, *data))
        good = np.isin(status, (STATUS["ok"], STATUS["tension"]))
        slopes = np.zeros((*outputs.shape, every.shape[1]))
        slopes[..., list(drivers)] = np.where(good[:, None, None, None], found, np.nan)
        return np.where(good[:, None, None], outputs, np.nan).astype(float), slopes

    def start(self, values) -> tuple[np.ndarray, np.ndarray]:
        """The states at the beginning, (d,), and their slopes by the free and known parameters in SI."""
        own, time = self.problem, self.problem.recording.times[0]
        numbers, packed, *_ = own.arguments(values)
        with computing_in(own.precision):
            found = _start(own.plan, own.locations, numbers, packed, own.steady, time)
            states, slopes = (np.asarray(part, dtype=float) for part in found)
        return states, np.stack([slopes[:, list(members)].sum(axis=1) for members in own.groups], axis=1)

    def rows_of(self, window: int) -> slice:
        """The samples that count in a window: its last one is the first of the next."""
        last = self.edges[window + 1] + (window == len(self.edges) - 2)
        return slice(int(self.edges[window]), int(last))

    def stitched(self, values, states) -> tuple[np.ndarray, np.ndarray]:
        """What one trajectory through all windows shows, (times, channels), and its slopes by free and known parameters
        in SI: those of each window, and those of its beginning carried through it."""
        outputs, slopes = self.run(values, states)
        shown, d, carried = len(self.problem.wanted), states.shape[1], self.start(values)[1]
        simulated, by = np.empty((self.edges[-1] + 1, shown)), np.empty((self.edges[-1] + 1, shown, carried.shape[1]))
        for k in range(len(states)):
            at, last = self.rows_of(k), self.edges[k + 1] - self.edges[k]
            total = slopes[k, ..., :-d] + slopes[k, ..., -d:] @ carried
            simulated[at], by[at] = outputs[k, : at.stop - at.start, :shown], total[: at.stop - at.start, :shown]
            carried = total[last, shown:]
        return simulated, by

    def guess(self, values) -> np.ndarray:
        """States to begin with at the beginnings of windows, (windows, d): measured ones from the recording, others
        from a single trajectory, or from the start where that fails."""
        own, at, names = self.problem, self.edges[:-1], self.states.names
        shown = dataclasses.replace(own, wanted=names, units=("",) * len(names)).predict(values)
        states = np.where(np.isfinite(shown).all(), shown[at], self.start(values)[0])
        for k, (first, last) in enumerate(itertools.pairwise(own.recording.times[self.edges])):
            piece = own.recording.window(float(first), float(last))
            for i, name in enumerate(names):
                measured = measured_start(own.circuit, piece, name)
                states[k, i] = states[k, i] if measured is None else measured.value
        return states


@dataclasses.dataclass(frozen=True)
class CutRecordings:
    """All recordings of a problem in windows; see `shooting_equations.Windows`."""

    problem: JointProblem
    cuts: tuple[Cut, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.problem.labels

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates."""
        return self.problem.lower

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates."""
        return self.problem.upper

    @property
    def units(self) -> np.ndarray:
        """Typical sizes of the states."""
        return scales(self.cuts[0].problem.plan)

    def guess(self, x) -> tuple[np.ndarray, ...]:
        """States to begin with, see `Cut.guess`."""
        values = self.problem.to_values(x)
        return tuple(cut.guess(self.problem.own(i, values)) for i, cut in enumerate(self.cuts))

    def stitched(self, x, states) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """As `JointProblem.sensitivities`, from the windows."""
        values = self.problem.to_values(x)
        found = [cut.stitched(self.problem.own(i, values), states[i]) for i, cut in enumerate(self.cuts)]
        return [simulated for simulated, _ in found], [slopes for _, slopes in found]

    def evaluate(self, x, states: tuple[np.ndarray, ...]) -> tuple[Pieces, ...]:
        """Every recording at coordinates and states."""
        values, steps = self.problem.to_values(x), self.problem.steps(x)
        return tuple(self._piece(i, values, steps, own) for i, own in enumerate(states))

    def _piece(self, i: int, values, steps, states) -> Pieces:
        cut, problem, columns = self.cuts[i], self.problem, list(self.problem.columns[i])
        trial, d, own = cut.problem, states.shape[1], problem.own(i, values)
        outputs, slopes = cut.run(own, states)
        start, start_slopes = cut.start(own)
        shown, last = len(trial.wanted), (np.arange(len(states)), np.diff(cut.edges))
        rows, by = np.zeros((*outputs.shape[:2], shown)), slopes[:, :, :shown]
        for k in range(len(states)):
            at = cut.rows_of(k)
            size, used = at.stop - at.start, trial.used[at]
            misfit = np.where(used, (outputs[k, :size, :shown] - trial.measured[at]) / problem.sigma[i][at], 0.0)
            rows[k, :size] = np.where(used, problem.loss.rows(misfit), 0.0)
            by[k, :size] *= np.where(used, problem.loss.row_slopes(misfit) / problem.sigma[i][at], 0.0)[..., None]
            by[k, size:] = 0.0
        by, end_slopes = by.reshape(len(states), -1, slopes.shape[-1]), slopes[:, :, shown:][last]

        def by_coordinates(part):
            wide = np.zeros((*part.shape[:-1], values.size))
            wide[..., columns] = part[..., : len(columns)]
            return wide * steps

        return Pieces(
            start=start,
            start_x=by_coordinates(start_slopes),
            rows=rows.reshape(len(states), -1),
            row_states=by[..., -d:],
            row_x=by_coordinates(by),
            ends=outputs[..., shown:][last],
            end_states=end_slopes[..., -d:],
            end_x=by_coordinates(end_slopes),
        )

    def prior(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Rows of priors and their slopes by the coordinates."""
        values = self.problem.to_values(x)
        return self.problem.prior_residuals(values), self.problem.prior_slopes(values) * self.problem.steps(x)


def cut_recordings(problem: JointProblem, windows: int) -> CutRecordings:
    """All recordings of a problem cut into so many windows. Raises ValueError for too many, and for circuits whose
    past is more than their states."""
    cuts = []
    for trial in problem.trials:
        intervals = trial.recording.times.size - 1
        if windows != int(windows) or not 1 <= windows <= intervals // 2:
            raise ValueError(
                f"windows must be a whole number 1..{intervals // 2} for the {intervals + 1} samples of "
                f"{trial.recording.name} (two intervals each at least), got {windows}"
            )
        past = [sensor.name for sensor in trial.plan.sensors if sensor.delayed]
        past += [name for c in trial.plan.controllers if c.sampled for name in trial.plan.kinds[c.kind].members]
        if past:
            raise ValueError(
                f"windows need states that a simulation can start from, and {', '.join(past)} remembers more: sampled "
                "controllers and delays of sensors have a past besides"
            )
        edges = np.round(np.linspace(0, intervals, windows + 1)).astype(int)
        cuts.append(Cut(trial, state_names(trial), edges))
    return CutRecordings(problem, tuple(cuts))
