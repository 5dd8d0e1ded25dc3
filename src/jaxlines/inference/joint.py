"""Several recordings, priors and a noise model as one least-squares problem with an exact Jacobian."""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from jaxlines.inference.loss import Loss
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.priors import Prior
from jaxlines.inference.problem import Problem


class RowGroups(NamedTuple):
    """Where the rows of a problem come from: integers of shape (rows,), -1 in the rows of priors.

    recording: index among the recordings; channel: index among the problem's channels; time: index of the sample.
    """

    recording: np.ndarray
    channel: np.ndarray
    time: np.ndarray


@dataclasses.dataclass(frozen=True)
class JointProblem:
    """What a fit minimises: half the sum of squares of weighted residuals and rows of priors.

    The search runs in coordinates x (see `Free.transform`). A row is (simulated - measured)/sigma, shaped by the loss;
    sigma is held (`with_sigma` gives the problem with other ones), so that rows are a function of x alone.

    Fields: trials: one `Problem` a recording; free: every parameter with its own label, local ones once a recording;
    columns: for each recording the positions of its parameters among `free`; known, known_columns: the same for numbers
    with an uncertainty; sigma: noise levels of each recording, shape (times, channels); loss.
    """

    trials: tuple[Problem, ...]
    free: tuple[Free, ...]
    columns: tuple[tuple[int, ...], ...]
    known: tuple[Known, ...]
    known_columns: tuple[tuple[int, ...], ...]
    sigma: tuple[np.ndarray, ...]
    loss: Loss

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.label for parameter in self.free)

    @functools.cached_property
    def _bounds(self) -> np.ndarray:
        return np.array([f.coordinate_bounds() for f in self.free]).T

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the coordinates."""
        return self._bounds[0]

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the coordinates."""
        return self._bounds[1]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the coordinates."""
        return self.lower, self.upper

    @property
    def start(self) -> np.ndarray:
        """Coordinates of the start that was given."""
        return np.array([f.start_coordinate() for f in self.free])

    @functools.cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of all fitted channels."""
        return tuple(dict.fromkeys(name for trial in self.trials for name in trial.wanted))

    def to_values(self, x) -> np.ndarray:
        """Values in SI at coordinates."""
        return np.array([f.to_value(c) for f, c in zip(self.free, x, strict=True)])

    def to_coordinates(self, values) -> np.ndarray:
        """Coordinates of values in SI."""
        return np.array([f.to_coordinate(v) for f, v in zip(self.free, values, strict=True)], dtype=float)

    def steps(self, x) -> np.ndarray:
        """d value / d coordinate of every parameter."""
        return np.array([float(f.slope(v)) for f, v in zip(self.free, self.to_values(x), strict=True)])

    def own(self, recording: int, values) -> np.ndarray:
        """The values that a recording sees, in the order of its own parameters."""
        return np.asarray(values, dtype=float)[list(self.columns[recording])]

    def predict(self, values) -> list[np.ndarray]:
        """Simulated channels of each recording, shape (times, channels); NaN where a simulation fails."""
        return [trial.predict(self.own(i, values)) for i, trial in enumerate(self.trials)]

    def sensitivities(self, values) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Simulated channels of each recording and their slopes by its own free, then known, parameters, in SI."""
        found = [trial.sensitivities(self.own(i, values)) for i, trial in enumerate(self.trials)]
        return [simulated for simulated, _ in found], [slopes for _, slopes in found]

    def why_it_fails(self, values) -> str:
        """What the first simulation that fails says of itself."""
        for i, trial in enumerate(self.trials):
            if not np.all(np.isfinite(trial.predict(self.own(i, values)))):
                where = f"{trial.recording.name}: " if len(self.trials) > 1 else ""
                return where + trial.why_it_fails(self.own(i, values))
        return "a derivative is not finite"

    def misfit(self, simulated) -> np.ndarray:
        """(simulated - measured)/sigma of every used sample, recordings one after another."""
        parts = zip(self.trials, simulated, self.sigma, strict=True)
        return np.concatenate([((s - trial.measured) / sigma)[trial.used] for trial, s, sigma in parts])

    def by_values(self, slopes) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of the misfit by free values in SI (samples, free), and by known ones (samples, known)."""
        used = [int(trial.used.sum()) for trial in self.trials]
        free, known = np.zeros((sum(used), len(self.free))), np.zeros((sum(used), len(self.known)))
        at = 0
        for i, (trial, slope, sigma) in enumerate(zip(self.trials, slopes, self.sigma, strict=True)):
            rows, split = slice(at, at + used[i]), len(self.columns[i])
            weighted = (slope / sigma[..., None])[trial.used]
            free[rows, list(self.columns[i])] = weighted[:, :split]
            known[rows, list(self.known_columns[i])] = weighted[:, split:]
            at += used[i]
        return free, known

    @functools.cached_property
    def _prior_rows(self) -> list[tuple[int, Prior]]:
        """Parameters whose prior adds a row."""
        return [(i, f.prior) for i, f in enumerate(self.free) if isinstance(f.prior, Prior) and not f.prior.flat]

    def prior_residuals(self, values) -> np.ndarray:
        """Rows of the priors, shape (priors,)."""
        return np.array([prior.residual(values[i]) for i, prior in self._prior_rows])

    def prior_slopes(self, values) -> np.ndarray:
        """Slopes of the rows of the priors by values in SI, shape (priors, free)."""
        slopes = np.zeros((len(self._prior_rows), len(self.free)))
        for row, (i, prior) in enumerate(self._prior_rows):
            slopes[row, i] = prior.slope(values[i])
        return slopes

    def rows(self, values, simulated) -> np.ndarray:
        """All rows from what was simulated with these values."""
        return np.concatenate([self.loss.rows(self.misfit(simulated)), self.prior_residuals(values)])

    def row_slopes(self, x, simulated, slopes) -> np.ndarray:
        """Slopes of all rows by coordinates, shape (rows, free)."""
        by_data = self.loss.row_slopes(self.misfit(simulated))[:, None] * self.by_values(slopes)[0]
        return np.concatenate([by_data, self.prior_slopes(self.to_values(x))]) * self.steps(x)

    def residuals(self, x) -> np.ndarray:
        """All rows at coordinates, shape (rows,); NaN where a simulation fails."""
        values = self.to_values(x)
        return self.rows(values, self.predict(values))

    def jacobian(self, x) -> np.ndarray:
        """Slopes of all rows by coordinates, shape (rows, free)."""
        return self.row_slopes(x, *self.sensitivities(self.to_values(x)))

    @functools.cached_property
    def residual_groups(self) -> RowGroups:
        """Recording, channel and sample of every row."""
        recordings, channels, times = [], [], []
        for i, trial in enumerate(self.trials):
            time, channel = np.nonzero(trial.used)
            recordings.append(np.full(time.size, i))
            channels.append(np.array([self.channels.index(name) for name in trial.wanted])[channel])
            times.append(time)
        none = np.full(len(self._prior_rows), -1)
        return RowGroups(*(np.concatenate([*parts, none]) for parts in (recordings, channels, times)))

    @property
    def recording(self) -> np.ndarray:
        """Index of the recording of every row, -1 for a prior."""
        return self.residual_groups.recording

    @property
    def channel(self) -> np.ndarray:
        """Index of the channel (among `channels`) of every row, -1 for a prior."""
        return self.residual_groups.channel

    @property
    def time(self) -> np.ndarray:
        """Index of the sample of every row, -1 for a prior."""
        return self.residual_groups.time

    def log_likelihood(self, simulated) -> float:
        """ln of the density of the recordings at what was simulated, at the present noise levels; without priors."""
        misfit = self.misfit(simulated)
        parts = zip(self.trials, self.sigma, strict=True)
        logs = sum(float(np.log(sigma[trial.used]).sum()) for trial, sigma in parts)
        return -float(self.loss.cost(misfit).sum()) - logs - misfit.size * self.loss.log_normaliser()

    def with_sigma(self, sigma) -> "JointProblem":
        """The problem with other noise levels, one array (times, channels) a recording."""
        return dataclasses.replace(self, sigma=tuple(np.asarray(s, dtype=float) for s in sigma))
