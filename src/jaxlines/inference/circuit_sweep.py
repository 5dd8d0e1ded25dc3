"""Sweeps of circuits: `sweep`, and the model that a plan runs."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from jaxlines.inference.distributions import AbstractDistribution
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.samplers import AbstractSampler, LatinHypercube, Rows, Sobol
from jaxlines.inference.statistics import QUANTILES
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_plan import AbstractModel, SweepPlan
from jaxlines.inference.sweep_result import SweepResult
from jaxlines.inference.sweep_run import Progress
from jaxlines.inference.uncertain import Draws, JointNormal, Uncertain, from_fit
from jaxlines.simulation.assembly import compile_circuit, number_locations
from jaxlines.simulation.circuit import Circuit, field_metadata
from jaxlines.simulation.ensemble import MOST_ON_GPU, EnsembleProgram, workers
from jaxlines.simulation.ensemble_columns import Varied
from jaxlines.simulation.ensemble_derivatives import DERIVATIVE_LANES, ensemble_jacobian
from jaxlines.simulation.ensemble_pilot import prepare_ensemble
from jaxlines.simulation.ensemble_result import Audit
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.observation import sensor_units
from jaxlines.simulation.paths import resolve
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.quantities import quantities
from jaxlines.simulation.reductions import AbstractReduction, Crossing, OfOneOutput, TimeOfPeak
from jaxlines.simulation.segments import FEWEST, undecided_lines, with_segments


@dataclasses.dataclass(frozen=True, eq=False)
class CircuitModel(AbstractModel):
    """A circuit over some times, as a sweep runs it (see `prepare_ensemble` for the arguments)."""

    circuit: Circuit
    times: np.ndarray
    inputs: dict[str, Any] | None = None
    initial: dict[str, float] | None = None
    outputs: tuple[str, ...] = ()
    reductions: dict[str, Any] = dataclasses.field(default_factory=dict)
    tolerance: float = 1e-4
    engine: str = "auto"
    precision: str = "float64"

    @functools.cached_property
    def _known(self) -> tuple[tuple[str, ...], dict[str, str]]:
        """The paths of all numbers, and the units of all outputs."""
        settled = with_segments(self.circuit, dict.fromkeys(undecided_lines(self.circuit), FEWEST))
        with computing_in("float64"):
            bound = bind_inputs(settled, self.inputs, self.times)
            plan, values = compile_circuit(settled, self.initial, bound)
            units = {name: q.unit for name, q in quantities(plan).items()} | sensor_units(settled, plan)
            return tuple(number_locations(plan, values)), units

    @functools.cached_property
    def units(self) -> dict[str, str]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Name of an output or a reduction -> SI unit."""
        known = self._known[1]
        units = {name: known[resolve(name, known, "output")] for name in self.outputs}
        return units | {name: reduced_unit(reduction, known) for name, reduction in self.reductions.items()}

    def full_paths(self, uncertain: Uncertain) -> dict[str, tuple[str, ...]]:
        """Name of an uncertain number -> the full paths it drives. Raises KeyError that suggests near names."""
        known = self._known[0]
        return {name: tuple(resolve(path, known) for path in uncertain.paths(name)) for name in uncertain.names}

    def limits(self, path: str) -> tuple[float, float, str]:
        """The lowest and highest legal value of the number at a full path, and its SI unit."""
        owner = path.partition(".")[0]
        if owner == "fluid" or owner in self.circuit.components:
            metadata = field_metadata(self.circuit, path)
            if metadata:
                return metadata["low"], metadata["high"], metadata["unit"]
        if owner == "initial" and path.endswith(".pressure"):
            return 0.0, 1e9, "Pa"
        return -np.inf, np.inf, "1"

    def prepare(self, pilot: dict[str, np.ndarray], fixed: dict | None = None) -> "CircuitProgram":
        """The ensemble program; engine, steps and calibration of errors from the pilot lanes, or as `fixed` says."""
        lanes: Varied = {**pilot}
        engine, steps, audit = self.engine, None, 8
        if fixed is not None:
            engine, steps, audit = fixed["engine"], fixed["steps"] or None, 0
        program = prepare_ensemble(
            self.circuit,
            self.times,
            lanes,
            inputs=self.inputs,
            initial=self.initial,
            outputs=self.outputs,
            reductions=self.reductions,
            tolerance=self.tolerance,
            engine=engine,
            steps=steps,
            precision=self.precision,
            audit=audit,
        )
        if fixed is not None:
            known = Audit(np.zeros(0, dtype=int), self.tolerance, np.nan, {}, fixed["factor"])
            program = dataclasses.replace(program, audit=known)
        return CircuitProgram(program)

    def lanes_at_once(self) -> int:
        """Lanes that keep all cores, or the device, busy."""
        import jax

        return 4096 * workers() if jax.default_backend() == "cpu" else MOST_ON_GPU * workers()


class CircuitProgram:
    """An `EnsembleProgram` as a sweep uses it: `run`, `description`, and `derivatives` where the engine has them."""

    def __init__(self, program: EnsembleProgram):
        self.program = program
        self.run = program.run
        self.description = program.description
        self.derivatives = None if self.description["engine"] == "adaptive" else self._derivatives

    def _derivatives(self, varied: dict[str, np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
        """Reduction that has derivatives -> path -> exact derivatives, shape (lanes,)."""
        lanes: Varied = {**varied}
        chunk = DERIVATIVE_LANES[self._differentiable.precision]
        return ensemble_jacobian(self._differentiable, lanes, chunk=chunk).reduction_slopes

    @functools.cached_property
    def _differentiable(self) -> EnsembleProgram:
        """The program with those of its reductions that have derivatives."""
        inner = self.program.program
        kept = [k for k, reduction in enumerate(inner.reductions) if reduction.differentiable]
        reductions, taken = (tuple(of[k] for k in kept) for of in (inner.reductions, inner.taken))
        inner = inner._replace(reductions=reductions, taken=taken)
        return dataclasses.replace(self.program, names=tuple(self.program.names[k] for k in kept), program=inner)


def reduced_unit(reduction: Any, units: Mapping[str, str]) -> str:
    """The SI unit of a reduction: a time's, or that of the output it reduces; of one of your own it is not known."""
    if isinstance(reduction, TimeOfPeak | Crossing):
        return "s"
    if isinstance(reduction, OfOneOutput):
        return units[resolve(reduction.output, units, "output")]
    return "1"


def named_outputs(outputs) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Sensors over time and reductions by name, from a list of both (a reduction is then its own name) or a dict.

    Raises: TypeError for something else.
    """
    if isinstance(outputs, str):
        outputs = [outputs]
    items = outputs.items() if isinstance(outputs, Mapping) else [(None, item) for item in outputs]
    series, reductions = [], {}
    for name, item in items:
        if isinstance(item, str):
            series.append(item)
        elif isinstance(item, AbstractReduction):
            reductions[name or f"{type(item).__name__} {', '.join(item.outputs)}"] = item
        else:
            raise TypeError(
                f"an output is the name of a sensor or a reduction such as Peak('A.pressure'), got {item!r}"
            )
    return tuple(series), reductions


def uncertain_numbers(numbers: Any, correlation: Mapping[tuple[str, str], float] | None = None) -> Uncertain:
    """Uncertain numbers from what a user gives: path(s) -> distribution, a fit, joint distributions, a table.

    Args: numbers: a dictionary from a path (or a tuple of paths that share the value) to a distribution; an
        `Uncertain`; a `Fit`; a `JointNormal` or `Draws`; a pandas DataFrame of cases; or a list of several of these.
    Raises: TypeError for something else; as `Uncertain`.
    """
    single: dict[str, AbstractDistribution] = {}
    shared: dict[str, tuple[str, ...]] = {}
    pairs, joint = dict(correlation or {}), []
    for item in numbers if isinstance(numbers, list | tuple) else [numbers]:
        if isinstance(item, Fit):
            item = from_fit(item)
        if isinstance(item, Uncertain):
            single, shared = {**single, **item.single}, {**shared, **item.shared}
            pairs, joint = {**item.correlation, **pairs}, [*joint, *item.joint]
        elif isinstance(item, JointNormal | Draws):
            joint.append(item)
        elif isinstance(item, Mapping):
            for paths, distribution in item.items():
                name = paths if isinstance(paths, str) else paths[0]
                single[name] = distribution
                if not isinstance(paths, str):
                    shared[name] = tuple(paths)
        elif hasattr(item, "columns"):
            joint.append(Draws.from_table(item))
        else:
            raise TypeError(f"expected {{path: distribution}}, a Fit, JointNormal, Draws or a table, got {item!r}")
    return Uncertain(single, shared, pairs, tuple(joint))


def circuit_plan(
    circuit: Circuit,
    times,
    uncertain,
    *,
    outputs,
    inputs: dict | None = None,
    initial: dict | None = None,
    correlation: Mapping[tuple[str, str], float] | None = None,
    sampler: AbstractSampler | None = None,
    count: int | None = None,
    derivatives: bool = False,
    kept_series: int = 20,
    tolerance: float = 1e-4,
    engine: str = "auto",
    precision: str = "float64",
) -> SweepPlan:
    """The plan of a circuit's sweep. Arguments and errors as `sweep`."""
    numbers = uncertain_numbers(uncertain, correlation)
    series, reductions = named_outputs(outputs)
    without = [name for name, reduction in reductions.items() if not reduction.differentiable]
    if derivatives and without:
        raise ValueError(f"{without[0]!r} has no derivative: leave it out, take a Crossing, or derivatives=False")
    if sampler is None:
        alone = not numbers.single and len(numbers.joint) == 1 and isinstance(numbers.joint[0], Draws)
        rows = len(numbers.joint[0].rows) if alone else 0  # pyright: ignore[reportAttributeAccessIssue]
        sampler = Rows(rows) if alone and count is None else Sobol()
    if isinstance(sampler, LatinHypercube) and sampler.count is None:
        sampler = dataclasses.replace(sampler, count=count)
    times = np.asarray(times, dtype=float)
    model = CircuitModel(circuit, times, inputs, initial, series, reductions, tolerance, engine, precision)
    return SweepPlan(model, numbers, sampler, derivatives, kept_series)


def sweep(
    circuit: Circuit,
    times,
    uncertain,
    count: int | None = None,
    *,
    outputs,
    inputs: dict | None = None,
    initial: dict | None = None,
    correlation: Mapping[tuple[str, str], float] | None = None,
    sampler: AbstractSampler | None = None,
    derivatives: bool = False,
    kept_series: int = 20,
    tolerance: float = 1e-4,
    engine: str = "auto",
    precision: str = "float64",
    store=None,
    resume: bool = False,
    allow_changes: bool = False,
    chunk: int | None = None,
    where: str = "local",
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    thresholds: dict[str, list[float]] | None = None,
    quantiles=QUANTILES,
    linear: bool = True,
    progress: Callable[[Progress], Any] | None = None,
) -> SweepResult:
    """Run a circuit for many values of its uncertain numbers, and say what spreads, how far, and because of what.

    What is computed:
        circuit, times [s], inputs, initial: as for `simulate`.
        uncertain: path (or tuple of paths that share the value) -> distribution, {"fluid.air_fraction":
            LogNormal(5e-3, 0.5)}; or a `Fit`, `JointNormal`, `Draws`, a DataFrame of cases, or a list of these. Paths
            are those of numbers of the circuit, of inputs ("flow.amplitude") and of start values
            ("initial.A.pressure"). SI, pressures absolute.
        correlation: (path, path) -> correlation of normal scores (Gaussian copula).
        outputs: reductions, kept of every lane ([Peak("A.pressure")], or by name {"peak": Peak("A.pressure")}), and
            names of sensors, whose quantiles at every time are kept ("A.pressure").
        sampler: Sobol() by default (every row once for a table); MonteCarlo, LatinHypercube, Grid; SobolIndices,
            Morris, ShapleyEffects for sensitivities; count: of lanes.
        derivatives: also of each reduction in every lane, for bounds of the total Sobol indices.
        kept_series: of how many of the first lanes the outputs over time are kept whole.
        tolerance, engine, precision: of the ensemble.

    How:
        store: a folder that survives (by default one that goes with the result); resume: go on with what is there;
            allow_changes: begin a new sweep beside the one that is there when the plan has changed.
        chunk: lanes of a call and of a file; results do not depend on it.
        where: "local", "dask" or "dask://HOST:PORT"; workers: processes; shard (i, n): only every n-th chunk, for batch
            queues with nothing but a shared folder. With several processes, protect scripts by
            `if __name__ == "__main__":`.
        thresholds: reduction -> values whose exceedance is asked for; quantiles: probabilities; linear: linear
            propagation next to sampling; progress: called with a `Progress` after every chunk.

    Returns: a `SweepResult`: `result["peak A.pressure"].quantile(0.95)`, bands, sensitivities, `table()`, `print`.
    Raises: KeyError, ValueError, TypeError for a wrong call, before any work; as `run_sweep`.
    """
    plan = circuit_plan(
        circuit,
        times,
        uncertain,
        outputs=outputs,
        inputs=inputs,
        initial=initial,
        correlation=correlation,
        sampler=sampler,
        count=count,
        derivatives=derivatives,
        kept_series=kept_series,
        tolerance=tolerance,
        engine=engine,
        precision=precision,
    )
    return run_sweep(
        plan,
        count,
        store=store,
        resume=resume,
        allow_changes=allow_changes,
        chunk=chunk,
        where=where,
        workers=workers,
        shard=shard,
        thresholds=thresholds,
        quantiles=quantiles,
        linear=linear,
        progress=progress,
    )
