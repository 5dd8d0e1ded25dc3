"""Many independent fits of one circuit at once: a recording, its own numbers and its own estimates per lane.

One batched residual-and-Jacobian call serves all lanes of an iteration; damping, bounds and convergence are
kept per lane, and finished lanes leave the batch.
"""

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from jaxlines.inference import batch_search, batch_verdict
from jaxlines.inference.batch_lanes import Batch as Batch, checked_starts, make_batch as make_batch
from jaxlines.inference.noise import Noise
from jaxlines.inference.parameters import Free
from jaxlines.inference.recording import Recording
from jaxlines.simulation.circuit import Circuit


@dataclasses.dataclass(frozen=True)
class BatchFit:
    """Estimates of many fits.

    Fields: names of the free parameters; values and sd, shape (lanes, free), SI; status, one a lane
    ("converged", "at_bound", "near_failure", "stalled", "failed"); rmse, shape (lanes, channels), SI; simulated, shape
    (lanes, times, channels); channels; num_iterations: of the lane with the most; seconds; messages: why each lane has
    its status; offset (lanes,): how far, in standard errors, the optimum is from the estimate when it is simulated
    with twice the steps of the search; engine; effort (lanes,): steps between samples, or the tolerance, of that
    last look; noise, shape (lanes, channels): standard deviation of the noise, the mean over samples, SI; iterations
    (lanes,).
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
    messages: tuple[str, ...] = ()
    offset: np.ndarray | None = None
    engine: str = "adaptive"
    effort: np.ndarray | None = None
    noise: np.ndarray | None = None
    iterations: np.ndarray | None = None

    def __str__(self) -> str:
        """How many fits ended how, and the spread of each estimate over those that converged."""
        counts = ", ".join(f"{count} {status}" for status, count in Counter(self.status).most_common())
        lines = [f"{len(self.status)} fits ({self.engine}): {counts}"]
        good = np.array(self.status) == "converged"
        for i, name in enumerate(self.names):
            if good.any():
                low, middle, high = np.percentile(self.values[good, i], [5, 50, 95])
                sd = np.median(self.sd[good, i])
                lines.append(f"  {name}: median {middle:.4g}, 5..95 % {low:.4g}..{high:.4g}, typical sd {sd:.2g}")
        return "\n".join(lines)


def _result(batch: Batch, state: batch_search.Searches, began: float) -> BatchFit:
    """Judge every lane and give its estimates their standard deviations."""
    bounds = batch_search.bounds_of(batch)
    verdicts = [batch_verdict.judge(batch, state, lane, bounds) for lane in range(batch.lanes)]
    misfit = np.where(batch.used, state.simulated - batch.measured, 0.0)
    return BatchFit(
        names=tuple(f.label for f in batch.free),
        values=batch.to_values(state.coordinates),
        sd=batch_verdict.standard_deviations(batch, state, bounds),
        status=tuple(verdict.status for verdict in verdicts),
        rmse=np.sqrt((misfit**2).sum(axis=1) / np.maximum(batch.used.sum(axis=1), 1)),
        simulated=state.simulated,
        channels=batch.first.wanted,
        num_iterations=int(state.iterations.max()),
        seconds=time.perf_counter() - began,
        messages=tuple(verdict.message for verdict in verdicts),
        offset=state.offset,
        engine=batch.engine.name,
        effort=np.array([batch.engine.effort(level) for level in state.level]),
        noise=state.sigma.mean(axis=1),
        iterations=state.iterations,
    )


def fit_batch(
    circuit: Circuit,
    recordings: Sequence[Recording],
    *,
    free: Sequence[Free],
    local: Sequence[dict] | None = None,
    starts: np.ndarray | None = None,
    noise: dict[str, float | Noise] | None = None,
    engine: str = "auto",
    max_iterations: int = 60,
    progress: Callable[[str, float], None] | None = None,
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 10_000,
    precision: str = "float64",
    interpolation: str = "linear",
) -> BatchFit:
    """Fit one circuit to many recordings independently, all at once.

    Main arguments:
        circuit: the model; recordings: of one length and with the same channels.
        free: what to estimate in every recording, priors included; starts: start values in SI, shape (recordings,
            free), instead of those of `free`.
        local: for each recording the numbers that are its own: path -> value in SI, initial values included
            ("initial.A.pressure"). Conditions and start values of the recordings are such numbers as well.
        noise: channel -> standard deviation or `Noise`; what is not given is estimated in each recording from its
            residuals, as in `fit`.

    Other arguments:
        engine: "explicit" or "implicit" (lanes in step; the pilot finds the first number of steps at the start
            values), "adaptive" (each lane with steps of its own), or "auto": in step where that is possible:
            recordings with the same sampling, no gain or offset of an input free, no sampled controllers or delayed
            sensors. Whatever the engine, every end point is simulated again with twice the steps (or a tenth of
            the tolerance), and the search goes on with these until the optimum stays where it is within 0.005 of a
            standard error.
        max_iterations: limit a lane; progress: called with a text and a fraction done.
        solver, tolerance, max_steps: of the adaptive engine, as in `fit`; its lanes wait for the one with the most
            steps, so that `max_steps` should not be far above what a sane lane takes.
        precision, interpolation: as in `fit`.

    Returns: a `BatchFit`. A lane that fails says so and disturbs no other.
    Raises: ValueError or KeyError for a wrong call.
    """
    began = time.perf_counter()
    batch = make_batch(
        circuit,
        recordings,
        free=free,
        local=local,
        starts=starts,
        noise=noise,
        engine=engine,
        solver=solver,
        tolerance=tolerance,
        max_steps=max_steps,
        precision=precision,
        interpolation=interpolation,
    )
    return fit_lanes(batch, starts, max_iterations, progress, began)


def fit_lanes(
    batch: Batch,
    starts: np.ndarray | None = None,
    max_iterations: int = 60,
    progress: Callable[[str, float], None] | None = None,
    began: float | None = None,
) -> BatchFit:
    """Fit the lanes of a batch that is made already; arguments as in `fit_batch`; began: since when time counts."""
    began = time.perf_counter() if began is None else began
    bounds = batch_search.bounds_of(batch)
    first = np.tile([f.start_coordinate() for f in batch.free], (batch.lanes, 1))
    if starts is not None:
        values = checked_starts(starts, first.shape)
        first = np.stack([f.to_coordinate(values[:, i]) for i, f in enumerate(batch.free)], axis=1)
    state = batch_search.begin(batch, np.clip(first, bounds[:, 0], bounds[:, 1]))
    batch_search.search(batch, state, max_iterations, progress or (lambda text, share: None))
    return _result(batch, state, began)
