"""Who computes the chunks of a sweep: a thread of this process, other processes, or a Dask cluster."""

import contextlib
import functools
import json
import pickle
import signal
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from jaxlines.inference.propagation import differences
from jaxlines.inference.samplers import Sobol
from jaxlines.inference.sketch import COARSE, Moments, QuantileSketch
from jaxlines.inference.sweep_plan import PILOT, SweepPlan

_SMALL = 1e-5
"""Step of a normal score for the slope of a quantile function."""


class Result(NamedTuple):
    """A computed piece: columns of the table, arrays of the series, seconds, and where."""

    columns: dict[str, np.ndarray]
    series: dict[str, np.ndarray]
    seconds: float
    host: str


def pilot_samples(plan: SweepPlan) -> np.ndarray:
    """Lanes spread over all that the numbers may be, shape (PILOT, names): the same for every worker."""
    return plan.uncertain.values(Sobol(0).uniforms(0, PILOT, plan.uncertain.dims))


def prepare(plan: SweepPlan, program: Any) -> dict:
    """What is fixed once for all workers: what the program is, and the scales of the sketches, from the pilot lanes."""
    found = program.run(plan.varied(pilot_samples(plan)))
    good = np.asarray(found.status) == 0
    if not good.any():
        raise ValueError(
            f"all {PILOT} trial lanes of the sweep failed: simulate the circuit with the medians of the uncertain "
            "numbers, and look at their distributions"
        )
    scales = {name: _scale(np.asarray(v)[good][:, None]) for name, v in found.reductions.items()}
    scales |= {f"series {name}": _scale(np.asarray(v)[good]) for name, v in found.outputs.items()}
    return {"description": plain(program.description), "scales": scales, "failed_of_pilot": int((~good).sum())}


def _scale(values: np.ndarray) -> dict[str, list[float]]:
    """Centre and unit of a sketch for values, shape (lanes, rows): rounded, for nothing hangs on their last digits."""
    known = np.isfinite(values).all(axis=1)  # what a reduction looks for may not be there in a good lane
    values = values[known].astype(float) if known.any() else np.zeros((1, values.shape[1]))
    centre, spread = np.median(values, axis=0), values.std(axis=0)
    size = np.maximum(np.abs(centre), np.abs(values).max(initial=0.0))
    least = np.maximum(1e-3 * spread.max(initial=0.0), 1e-9 * np.where(size > 0, size, 1.0))
    unit = np.maximum(spread, least)
    return {"centre": [float(f"{c:.6g}") for c in centre], "unit": [float(f"{u:.3g}") for u in unit]}


class Task(NamedTuple):
    """What a worker needs to compute a piece.

    Fields: token: hash of the plan; plan: pickled, for other processes; prepared: what was fixed; lanes of a call;
    here: plan and program, for a worker in this process.
    """

    token: str
    plan: bytes
    prepared: dict
    lanes: int
    here: Any = None

    @classmethod
    def local(cls, plan: SweepPlan, prepared: dict, lanes: int, program: Any) -> "Task":
        """The task of a plan that stays in this process."""
        return cls(plan.hash(), b"", prepared, lanes, (plan, program))

    @classmethod
    def remote(cls, plan: SweepPlan, prepared: dict, lanes: int) -> "Task":
        """The task of a plan for other processes. Raises TypeError for a plan that cannot be sent to them."""
        try:
            return cls(plan.hash(), pickle.dumps(plan), prepared, lanes)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise TypeError(
                f"this sweep cannot be sent to other processes ({error}): define functions at the top of a module that "
                "the workers can import, not inside a function"
            ) from error


@functools.lru_cache(maxsize=2)
def _loaded(token: str, blob: bytes, fixed: str) -> tuple[SweepPlan, Any]:
    """The plan and its program, made once in each process."""
    plan = pickle.loads(blob)
    return plan, plan.model.prepare(plan.varied(pilot_samples(plan)), json.loads(fixed))


def compute(task: Task, start: int, stop: int) -> Result:
    """Compute the lanes start..stop. Nothing else than the task enters: any worker gets the same numbers.

    Raises: RuntimeError when this worker would compute with another engine, other steps or another precision.
    """
    import platform
    import time

    begun = time.perf_counter()
    plan, program = task.here or _loaded(task.token, task.plan, json.dumps(task.prepared["description"]))
    check_same(task.prepared["description"], program.description)
    samples = plan.samples(start, stop)
    found = run_lanes(plan, program, samples, task.lanes)
    status = np.asarray(found.status).astype(np.int16)
    columns = {"index": np.arange(start, stop, dtype=np.int64)}
    columns |= {name: samples[:, j] for j, name in enumerate(plan.uncertain.names)}
    columns |= {name: np.asarray(values, dtype=np.float64) for name, values in found.reductions.items()}
    columns |= {"status": status, "error": np.asarray(found.error, dtype=np.float64)}
    if plan.derivatives:
        columns |= _derivatives(plan, program, start, stop, task.lanes)
    series = _series(plan, task, found.outputs, status == 0, start)
    return Result(columns, series, time.perf_counter() - begun, platform.node())


def check_same(prepared: dict, mine: dict) -> None:
    """Raise RuntimeError when two descriptions of a program would not give the same numbers."""
    for key in ("engine", "precision", "steps"):
        if prepared.get(key) != plain(mine.get(key)):
            raise RuntimeError(
                f"this worker would compute with {key} {mine.get(key)!r}, the sweep was begun with "
                f"{prepared.get(key)!r}: use the same versions and settings, or begin a new sweep"
            )


def plain(value: Any) -> Any:
    """As it comes back from JSON."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def run_lanes(plan: SweepPlan, program: Any, samples: np.ndarray, lanes: int) -> Any:
    """Run samples in calls of `lanes`, the last one filled up, so that one program serves all; outputs trimmed."""
    pieces = []
    for first in range(0, len(samples), lanes):
        piece = samples[first : first + lanes]
        filled = np.concatenate([piece, np.broadcast_to(piece[:1], (lanes - len(piece), piece.shape[1]))])
        pieces.append((len(piece), program.run(plan.varied(filled))))
    return _Joined(pieces)


class _Joined:
    """Results of several calls as one."""

    def __init__(self, pieces):
        first = pieces[0][1]
        self.outputs = {name: _join(pieces, lambda r, n=name: r.outputs[n]) for name in first.outputs}
        self.reductions = {name: _join(pieces, lambda r, n=name: r.reductions[n]) for name in first.reductions}
        self.status, self.error = _join(pieces, lambda r: r.status), _join(pieces, lambda r: r.error)


def _join(pieces, take) -> np.ndarray:
    return np.concatenate([np.asarray(take(result))[:size] for size, result in pieces])


def _derivatives(plan: SweepPlan, program: Any, start: int, stop: int, lanes: int) -> dict[str, np.ndarray]:
    """Columns d(reduction)/dz(number): derivatives with respect to the standard normal scores of the numbers."""
    from scipy.special import ndtr, ndtri

    scores = ndtri(plan.sampler.uniforms(start, stop, plan.uncertain.dims))
    exact = getattr(program, "derivatives", None)
    if exact is None:
        found = differences(
            lambda z: run_lanes(plan, program, plan.uncertain.values(ndtr(z)), lanes).reductions,
            scores,
            np.ones(scores.shape[1]),
        )
    else:
        up, down = (plan.uncertain.values(ndtr(scores + step)) for step in (_SMALL, -_SMALL))
        slopes = (up - down) / (2 * _SMALL)
        driven = [plan.paths[name] for name in plan.uncertain.names]
        found = {
            name: np.stack([sum(np.asarray(of[path]) for path in paths) for paths in driven], axis=1) * slopes
            for name, of in exact(plan.varied(plan.uncertain.values(ndtr(scores)))).items()
        }
    names = plan.uncertain.names
    return {derivative_column(r, name): d[:, j] for r, d in found.items() for j, name in enumerate(names)}


def derivative_column(reduction: str, name: str) -> str:
    """How the table calls the derivative of a reduction with respect to the normal score of a number."""
    return f"d({reduction})/dz({name})"


def _series(plan: SweepPlan, task: Task, outputs: dict, good: np.ndarray, start: int) -> dict[str, np.ndarray]:
    """Sketches, moments and kept series of the outputs over time, as arrays by name."""
    arrays: dict[str, np.ndarray] = {}
    kept = max(0, min(plan.kept_series - start, len(good)))
    for name, values in outputs.items():
        values, scale = np.asarray(values, dtype=np.float64), task.prepared["scales"][f"series {name}"]
        sketch, moments = QuantileSketch(scale["centre"], scale["unit"], COARSE), Moments.of(values[good])
        sketch.add(values[good])
        arrays |= {f"{name}/{part}": array for part, array in sketch.arrays().items()}
        arrays |= {f"{name}/mean": moments.mean, f"{name}/squares": moments.squares}
        arrays |= {f"{name}/count": np.asarray(moments.count), f"{name}/kept": values[:kept]}
    return arrays


class Engine(NamedTuple):
    """What runs tasks: an executor (`submit` gives futures), how many tasks to have under way, and how to end it."""

    executor: Any
    slots: int
    close: Any


def make_engine(name: str, workers: int = 1, timeout: float = 30.0) -> Engine:
    """An engine by name.

    Args: name: "local" (this process; with more workers, that many processes), or "dask://HOST:PORT" (a scheduler),
        "dask" (a cluster on this machine); workers; timeout [s] for a scheduler to answer.
    Raises: ValueError for another name; ImportError without Dask; OSError when no scheduler answers.
    """
    if workers < 1:
        raise ValueError(f"workers must be 1 or more, got {workers}")
    if name == "local":
        return _local(workers)
    if name == "dask" or name.startswith("dask://"):
        return _dask(name.removeprefix("dask").removeprefix("://"), workers, timeout)
    raise ValueError(f'engine must be "local", "dask" or "dask://HOST:PORT", got {name!r}')


def _local(workers: int) -> Engine:
    """Two threads, so that sampling, computing (on all cores) and writing overlap, or some processes."""
    import multiprocessing

    executor: Executor
    if workers == 1:
        executor = ThreadPoolExecutor(2, "sweep")
        return Engine(executor, 4, lambda: executor.shutdown(cancel_futures=True))
    executor = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _leave_interrupts)
    return Engine(executor, 2 * workers, lambda: executor.shutdown(cancel_futures=True))


def _leave_interrupts() -> None:
    """Ctrl-C reaches all processes of a terminal: the first one ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _dask(address: str, workers: int, timeout: float) -> Engine:
    """A Dask cluster; its workers return their chunks, so that they need no shared folder."""
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise ImportError("the engine dask needs Dask: pip install 'jaxlines[dask]'") from error
    if address:
        client = Client(f"tcp://{address}", timeout=timeout)
        return Engine(DaskExecutor(client), 2 * max(workers, _threads(client)), client.close)
    cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=":0")
    client = Client(cluster)

    def close():
        client.close()
        with contextlib.suppress(Exception):
            cluster.close()

    return Engine(DaskExecutor(client), 2 * workers, close)


def _threads(client: Any) -> int:
    """How many tasks a cluster runs at once."""
    return sum(client.nthreads().values())


class DaskExecutor:
    """Futures of concurrent.futures from a Dask client; a task whose worker dies is tried again by the scheduler."""

    def __init__(self, client):
        self.pool = client.get_executor(retries=3, pure=False)

    def submit(self, function, *arguments):
        """Run a function somewhere."""
        return self.pool.submit(function, *arguments)
