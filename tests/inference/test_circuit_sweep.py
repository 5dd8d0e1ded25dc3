"""Sweeps of a circuit: equal numbers on every engine and in every chunk, real failures, clear refusals."""

import dataclasses

import numpy as np
import pytest

from jaxlines.inference.circuit_sweep import CircuitModel, circuit_plan, named_outputs, sweep, uncertain_numbers
from jaxlines.inference.distributions import LogNormal, Normal, Truncated, Uniform
from jaxlines.inference.samplers import MonteCarlo, Rows, Sobol
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.uncertain import Draws
from jaxlines.physics.containers import Pipe
from jaxlines.physics.fluids import Oil
from jaxlines.physics.lines import Line
from jaxlines.physics.resistances import LaminarLeak
from jaxlines.physics.sources import FlowSource, Tank
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.reductions import Crossing, Custom, Final, Peak, TimeOfPeak
from jaxlines.simulation.simulate import simulate

TIMES = np.linspace(0.0, 1.0, 21)
PIPE = Pipe(length=20.83, inner_diameter=0.04285, outer_diameter=0.06032, youngs_modulus=206.84e9, poissons_ratio=0.25)
CIRCUIT = Circuit(
    Oil(bulk_modulus=1.5e9, density=850.0, kinematic_viscosity=27.7e-6, air_fraction=5e-3, polytropic_index=1.2),
    {
        "line": Line("A", path_length=20.83, parts=[PIPE]),
        "valve": FlowSource("A", flow="flow"),
        "leak": LaminarLeak("A", "tank", conductance=5e-12),
        "reservoir": Tank("tank"),
    },
)
NUMBERS = {
    "fluid.air_fraction": LogNormal(5e-3, 0.4),
    "fluid.bulk_modulus": Truncated(Normal(1.5e9, 1e8), low=1e9),
    "leak.conductance": Uniform(1e-12, 1e-11),
    "initial.A.pressure": Uniform(1.1e5, 4e5),
}
GIVEN = {"inputs": {"flow": 1e-4}, "outputs": {"peak": Peak("A.pressure"), "p": "A.pressure"}}


@pytest.fixture(scope="module")
def plan():
    return circuit_plan(CIRCUIT, TIMES, NUMBERS, sampler=MonteCarlo(2), **GIVEN)


@pytest.fixture(scope="module")
def reference(plan, tmp_path_factory):
    return run_sweep(plan, 300, store=tmp_path_factory.mktemp("reference"), chunk=256)


def table_of(result) -> bytes:
    return (result.folder / "table.parquet").read_bytes()


def test_lanes_are_simulations(reference):
    """Against the adaptive solver, lane by lane."""
    table = reference.table()
    for i in (0, 100, 299):
        row = table.iloc[i]
        changed = CIRCUIT.replace({p: row[p] for p in NUMBERS if not p.startswith("initial")})
        alone = simulate(changed, TIMES, GIVEN["inputs"], initial={"A.pressure": row["initial.A.pressure"]})
        assert row["peak"] == pytest.approx(np.max(alone["A.pressure"]), rel=2e-4)
    assert reference["peak"].unit == "Pa"
    assert np.array_equal(table.index, np.arange(300))


def test_chunks_give_the_same_bytes(plan, reference, tmp_path):
    small = run_sweep(plan, 300, store=tmp_path / "small", chunk=32)
    assert table_of(small) == table_of(reference)


@pytest.mark.slow
def test_processes_and_dask_give_the_same_bytes(plan, reference, tmp_path):
    four = run_sweep(plan, 300, store=tmp_path / "four", chunk=32, workers=4)
    assert table_of(four) == table_of(reference)
    dask = run_sweep(plan, 300, store=tmp_path / "dask", chunk=256, where="dask", workers=2)
    assert table_of(dask) == table_of(reference)


def test_resuming_prepares_the_same_program(plan, reference, tmp_path):
    run_sweep(plan, 128, store=tmp_path, chunk=64)
    assert table_of(run_sweep(plan, 300, store=tmp_path, resume=True)) == table_of(reference)


def test_a_misspelt_path_and_a_wrong_unit_are_refused_before_any_work():
    with pytest.raises(KeyError, match=r"fluid\.air_fractoin.*did you mean fluid\.air_fraction"):
        sweep(CIRCUIT, TIMES, {"fluid.air_fractoin": LogNormal(5e-3, 0.4)}, 100, **GIVEN)
    with pytest.raises(
        ValueError, match=r"fluid\.air_fraction: its distribution reaches -0\.0\d+, but .* must be 0\.\."
    ) as _:
        sweep(CIRCUIT, TIMES, {"fluid.air_fraction": Normal(5e-3, 5e-3)}, 100, **GIVEN)
    with pytest.raises(ValueError, match="100,000,000 lanes at most"):
        sweep(CIRCUIT, TIMES, NUMBERS, 10**9, **GIVEN)
    with pytest.raises(TypeError, match="an output is the name of a sensor or a reduction"):
        sweep(CIRCUIT, TIMES, NUMBERS, 100, outputs=[3.0])
    with pytest.raises(KeyError, match=r"'B\.pressure'"):
        run_sweep(circuit_plan(CIRCUIT, TIMES, NUMBERS, outputs=["B.pressure"], inputs={"flow": 1e-4}), 10)


def test_outputs_and_numbers_as_users_give_them():
    series, reductions = named_outputs(["A.pressure", Peak("A.pressure"), Final("B.pressure")])
    assert series == ("A.pressure",)
    assert list(reductions) == ["Peak A.pressure", "Final B.pressure"]
    cases = Draws(("x", "y"), np.ones((2, 2)))
    numbers = uncertain_numbers([{("a", "b"): Normal(0, 1), "c": Normal(1, 1)}, cases], {("a", "c"): 0.5})
    assert numbers.names == ("a", "c", "x", "y")
    assert numbers.paths("a") == ("a", "b")
    assert numbers.dims == 3
    with pytest.raises(TypeError, match=r"expected .path: distribution."):
        uncertain_numbers(3.0)


def test_units_and_limits_come_from_the_circuit():
    outputs = {"t": Crossing("A.pressure", 1e6), "p": Peak("A.pressure"), "own": Custom(len, ("A.pressure",))}
    model = CircuitModel(CIRCUIT, TIMES, {"flow": 1e-4}, None, ("A.pressure",), outputs)
    assert model.units == {"A.pressure": "Pa", "t": "s", "p": "Pa", "own": "1"}
    assert model.limits("initial.A.pressure") == (0.0, 1e9, "Pa")
    assert model.limits("fluid.bulk_modulus")[2] == "Pa"


def test_a_time_of_peak_has_no_derivative_but_a_linear_propagation():
    outputs = {"peak": Peak("A.pressure"), "when": TimeOfPeak("A.pressure")}
    with pytest.raises(ValueError, match="'when' has no derivative: leave it out, take a Crossing"):
        circuit_plan(CIRCUIT, TIMES, NUMBERS, inputs={"flow": 1e-4}, outputs=outputs, derivatives=True)
    linear = sweep(CIRCUIT, TIMES, NUMBERS, 64, inputs={"flow": 1e-4}, outputs=outputs).found.linear
    assert linear["peak"].method == "exact derivatives"
    assert linear["when"].method != "exact derivatives"


def test_a_table_is_run_row_by_row():
    cases = Draws.from_table({"fluid.air_fraction": [1e-3, 1e-2], "fluid.bulk_modulus": [1.2e9, 1.6e9]})
    plan = circuit_plan(CIRCUIT, TIMES, cases, **GIVEN)
    assert isinstance(plan.sampler, Rows)
    assert plan.hash() != circuit_plan(CIRCUIT, TIMES, cases, tolerance=1e-5, **GIVEN).hash()
    changed = dataclasses.replace(cases, rows=cases.rows * 1.0000001)
    assert plan.hash() != circuit_plan(CIRCUIT, TIMES, changed, **GIVEN).hash()
    assert isinstance(circuit_plan(CIRCUIT, TIMES, NUMBERS, **GIVEN).sampler, Sobol)


@pytest.mark.slow
def test_exact_derivatives_are_those_of_central_differences(plan):
    """By the chain rule to the normal scores, against differences of the table's own function."""
    exact = dataclasses.replace(plan, derivatives=True, kept_series=0)
    result = run_sweep(exact, 64, chunk=64)
    table, linear = result.table(), result.found.linear["peak"]
    assert linear.method == "exact derivatives"
    pilot = plan.varied(plan.samples(0, 64))
    program = plan.model.prepare(pilot)
    step = 1e-4 * pilot["leak.conductance"]
    up, down = (program.run({**pilot, "leak.conductance": pilot["leak.conductance"] + s}) for s in (step, -step))
    slope = (up.reductions["peak"] - down.reductions["peak"]) / (2 * step)
    # A uniform number on (a, b): dx/dz = (b - a) times the normal density at z.
    from scipy.stats import norm

    score = norm.ppf((pilot["leak.conductance"] - 1e-12) / 9e-12)
    expected = slope * 9e-12 * norm.pdf(score)
    assert np.allclose(table["d(peak)/dz(leak.conductance)"], expected, rtol=1e-3, atol=1e-6 * np.abs(expected).max())
    bound = result.found.sensitivities["peak"][1]
    assert bound.method == "derivatives"
    assert np.all(bound.measures["total_bound"] >= 0)
