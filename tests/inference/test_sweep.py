"""Sweeps of models with known answers: indices, failed lanes, equal numbers however they are cut, clear refusals."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from jaxlines.inference.distributions import Discrete, LogNormal, Normal, Uniform
from jaxlines.inference.samplers import (
    Grid,
    LatinHypercube,
    MonteCarlo,
    Morris,
    Rows,
    ShapleyEffects,
    Sobol,
    SobolIndices,
)
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_plan import SweepPlan, describe
from jaxlines.inference.uncertain import Draws, Uncertain

from .sweep_cases import (
    ANGLES,
    FAILED,
    G_FIRST,
    G_TOTAL,
    G_VARIANCE,
    ISHIGAMI_FIRST,
    ISHIGAMI_PAIR,
    ISHIGAMI_TOTAL,
    ISHIGAMI_VARIANCE,
    UNITS,
    Analytic,
    ishigami,
)

ISHIGAMI, G = Analytic("ishigami", ("a", "b", "c")), Analytic("g", ("a", "b", "c", "d"))
LINEAR = Analytic("linear", ("a", "b"))
WAVE = dataclasses.replace(ISHIGAMI, outputs=("wave",))


def indices(model, uncertain, sampler, count, **options):
    """The sensitivity of "y" of a sweep."""
    return run_sweep(SweepPlan(model, uncertain, sampler, **options), count).found.sensitivities["y"][-1]


def test_ishigami_indices_are_the_closed_forms():
    """Ishigami and Homma, 1990."""
    found = indices(ISHIGAMI, ANGLES, SobolIndices(second_order=True), 8 * 2048)
    assert found.measures["first"] == pytest.approx(ISHIGAMI_FIRST, abs=0.03)
    assert found.measures["total"] == pytest.approx(ISHIGAMI_TOTAL, abs=0.03)
    assert found.measures["second"][0, 2] == pytest.approx(ISHIGAMI_PAIR, abs=0.04)
    assert abs(found.measures["second"][0, 1]) < 0.04
    covered = np.abs(found.measures["total"] - ISHIGAMI_TOTAL) <= 2 * found.confidence["total"]
    assert covered.all()


def test_g_function_indices_are_the_closed_forms():
    """Saltelli and Sobol, 1995: S_i = 1/(3 (1 + a_i)^2)/V."""
    found = indices(G, UNITS, SobolIndices(), 6 * 4096)
    assert found.measures["first"] == pytest.approx(G_FIRST, abs=0.02)
    assert found.measures["total"] == pytest.approx(G_TOTAL, abs=0.02)


def test_morris_ranks_the_g_function_and_shapley_shares_its_variance():
    morris = indices(G, UNITS, Morris(), 5 * 500)
    assert np.all(np.diff(morris.measures["mu_star"]) < 0)
    shapley = indices(G, UNITS, ShapleyEffects(), 5 * 4000)
    assert shapley.measures["share"].sum() == pytest.approx(1.0)
    assert np.all(shapley.measures["share"] > G_FIRST - 2 * shapley.confidence["share"])
    assert np.all(shapley.measures["share"] < G_TOTAL + 2 * shapley.confidence["share"])


def test_derivatives_bound_the_total_index():
    """Equality for a linear model of normal numbers, S_i = c_i^2 s_i^2/V."""
    normal = Uncertain({"a": Normal(0, 3.0), "b": Normal(1, 1.0)})
    found = indices(LINEAR, normal, Sobol(), 1024, derivatives=True)
    assert found.measures["total_bound"] == pytest.approx([9 / 13, 4 / 13], rel=5e-3)
    assert found.measures["rms"] == pytest.approx([3.0, 2.0], rel=1e-9)
    bound = indices(G, UNITS, Sobol(), 1024, derivatives=True).measures["total_bound"]
    assert np.all(bound > G_TOTAL)


def test_tornado_shows_the_swing():
    found = indices(LINEAR, Uncertain({"a": Uniform(0, 1), "b": Uniform(0, 1)}), Sobol(), 4096)
    assert found.measures["swing"] == pytest.approx([0.9, 1.8], abs=0.02)


def test_moments_quantiles_and_exceedance_of_ishigami():
    """Mean a/2 and the variance of the closed form; quantiles against a plain sort of many lanes."""
    result = run_sweep(SweepPlan(ISHIGAMI, ANGLES, Sobol()), 1 << 14, thresholds={"y": [8.0]})
    exact = ishigami(ANGLES.values(MonteCarlo(9).uniforms(0, 200_000, 3)))
    assert result["y"].mean == pytest.approx(3.5, abs=0.01)
    assert result["y"].sd == pytest.approx(np.sqrt(ISHIGAMI_VARIANCE), rel=5e-3)
    for quantile in result["y"].quantiles:
        assert quantile.value == pytest.approx(np.quantile(exact, quantile.probability), abs=0.2)
        assert quantile.ci95[0] < quantile.value < quantile.ci95[1]
        assert quantile.bounds == pytest.approx((quantile.value,) * 2)
    found = result["y"].exceedances[0]
    assert found.wilson[0] < (exact > 8.0).mean() < found.wilson[1]
    assert G_VARIANCE > 0
    worst = result.found.worst["y"]
    assert np.allclose(ishigami(np.stack([worst[n] for n in "abc"], axis=1)), worst["y"])
    assert worst["y"][0] == result.table()["y"].max()


def test_linear_propagation_and_its_error():
    """GUM: y = 1 + a + 2 b, u = sqrt(9 + 4); nothing is left over."""
    normal = Uncertain({"a": Normal(0, 3.0), "b": Normal(1, 1.0)})
    exact = run_sweep(SweepPlan(LINEAR, normal, Sobol()), 1024).found.linear["y"]
    assert exact.value == pytest.approx(3.0, abs=0.02)
    assert exact.sd == pytest.approx(np.sqrt(13), rel=5e-3)
    assert exact.derivatives == pytest.approx([1.0, 2.0])
    assert exact.shares == pytest.approx([9 / 13, 4 / 13], rel=5e-3)
    assert exact.remainder < 1e-9
    assert run_sweep(SweepPlan(ISHIGAMI, ANGLES, Sobol()), 1024).found.linear["y"].remainder > 0.5


def test_ten_thousand_lanes_with_one_percent_failed():
    """A lane fails where a < -pi + 2 pi/100: the quantiles of all lanes lie within the bounds."""
    model = dataclasses.replace(ISHIGAMI, fails_below=-np.pi + 2 * np.pi / 100, outputs=("wave",))
    result = run_sweep(SweepPlan(model, ANGLES, Sobol()), 10_000)
    samples = ANGLES.values(Sobol().uniforms(0, 10_000, 3))
    failed, every = samples[:, 0] < model.fails_below, ishigami(samples)
    assert result.found.failed == {FAILED: int(failed.sum())}
    assert result.failed_fraction == pytest.approx(0.01, abs=1e-3)
    table = result.table()
    assert len(table) == 10_000
    assert np.array_equal(table["status"] != 0, failed)
    for quantile in result["y"].quantiles[1:-1]:
        exact = np.quantile(every, quantile.probability)
        assert quantile.bounds[0] - 0.01 <= exact <= quantile.bounds[1] + 0.01
        assert quantile.bounds[1] - quantile.bounds[0] > 1e-3
    low, high = result.found.bands["wave"].bounds[0.5]
    assert np.all(low < high)
    assert "99 of 10,000 lanes failed (0.99 %)" in str(result)


def test_failed_blocks_bound_the_indices():
    model = dataclasses.replace(ISHIGAMI, fails_below=-3.1)
    found = indices(model, ANGLES, SobolIndices(), 5 * 1024)
    assert 0 < found.failed_blocks < 0.1 * found.blocks
    low, high = found.bounds["total"]
    assert np.all((low <= found.measures["total"]) & (found.measures["total"] <= high))


def test_bands_are_quantiles_at_every_time():
    result = run_sweep(SweepPlan(WAVE, ANGLES, Sobol(), kept_series=7), 2048, quantiles=(0.1, 0.5, 0.9))
    y = ishigami(ANGLES.values(Sobol().uniforms(0, 2048, 3)))
    series, band = y[:, None] * np.sin(WAVE.times), result.found.bands["wave"]
    for q in (0.1, 0.5, 0.9):
        exact = np.quantile(series, q, axis=0, method="inverted_cdf")
        assert np.allclose(band.quantiles[q], exact, atol=0.02 * series.std())
    assert np.allclose(band.mean, series.mean(axis=0))
    assert np.allclose(band.sd, series.std(axis=0, ddof=1))
    assert np.array_equal(band.high, series.max(axis=0))
    assert np.array_equal(result.found.kept["wave"], series[:7])
    data = result.to_xarray()
    assert data["wave"].dims == ("quantile", "time")
    assert data.attrs["count"] == 2048


@pytest.mark.parametrize(("chunk", "workers"), [(32, 1), (77, 1), pytest.param(256, 4, marks=pytest.mark.slow)])
def test_results_do_not_depend_on_chunks_and_workers(tmp_path, chunk, workers):
    plan = SweepPlan(WAVE, ANGLES, MonteCarlo(4))
    reference = run_sweep(plan, 1000, store=tmp_path / "a", chunk=500)
    other = run_sweep(plan, 1000, store=tmp_path / "b", chunk=chunk, workers=workers)
    assert (other.folder / "table.parquet").read_bytes() == (reference.folder / "table.parquet").read_bytes()
    for q, values in reference.found.bands["wave"].quantiles.items():
        assert np.array_equal(values, other.found.bands["wave"].quantiles[q])
    assert np.allclose(reference.found.bands["wave"].mean, other.found.bands["wave"].mean, rtol=1e-13)
    assert other["y"].quantiles == reference["y"].quantiles


def test_grid_rows_and_tables():
    values = Uncertain({"a": Discrete((1.0, 2.0)), "b": Discrete((0.0, 5.0, 7.0))})
    grid = run_sweep(SweepPlan(LINEAR, values, Grid((2, 3))))
    assert np.array_equal(grid.table()["y"], [2, 12, 16, 3, 13, 17])
    cases = Draws.from_table({"a": [3.0, 1.0, 2.0], "b": [0.0, 0.5, 1.0]})
    rows = run_sweep(SweepPlan(LINEAR, Uncertain({}, joint=(cases,)), Rows(3)))
    assert np.array_equal(rows.table()["y"], [4.0, 3.0, 5.0])


def test_one_number_may_drive_several_paths():
    both = Uncertain({"x": Uniform(0, 1)}, {"x": ("a", "b")})
    table = run_sweep(SweepPlan(LINEAR, both, Sobol()), 64).table()
    assert np.allclose(table["y"], 1 + 3 * table["x"])


def test_the_identity_is_equal_for_equal_plans_only():
    plan = SweepPlan(ISHIGAMI, ANGLES, Sobol(1))
    assert plan.hash() == SweepPlan(Analytic("ishigami", ("a", "b", "c")), ANGLES, Sobol(1)).hash()
    others = [
        SweepPlan(ISHIGAMI, ANGLES, Sobol(2)),
        SweepPlan(ISHIGAMI, ANGLES, MonteCarlo(1)),
        SweepPlan(ISHIGAMI, Uncertain({**ANGLES.single, "a": Uniform(-3.0, np.nextafter(3.0, 4.0))}), Sobol(1)),
        SweepPlan(dataclasses.replace(ISHIGAMI, times=np.linspace(0, 1, 6)), ANGLES, Sobol(1)),
        SweepPlan(ISHIGAMI, ANGLES, Sobol(1), kept_series=3),
    ]
    assert len({plan.hash(), *(other.hash() for other in others)}) == 6
    long = np.arange(1000.0)
    assert describe(long) == describe(long.copy()) != describe(long + 1e-12)
    with pytest.raises(TypeError, match="cannot name"):
        describe(object())


CORRELATED = Uncertain({"a": LogNormal(1, 1), "b": Normal(0, 1)}, correlation={("a", "b"): 0.1})


def plan_of(sampler: Any = None, uncertain: Any = ANGLES, **changes):
    """A plan that is made when it is called for."""
    numbers = uncertain if isinstance(uncertain, Uncertain) else Uncertain(uncertain)
    return lambda: SweepPlan(dataclasses.replace(ISHIGAMI, **changes), numbers, sampler or Sobol())


@pytest.mark.parametrize(
    ("plan", "count", "error", "text"),
    [
        (plan_of(uncertain={"aa": Uniform(0, 1)}), 8, KeyError, "'aa'; did you mean a, b"),
        (lambda: Uncertain({"a": Normal(0, -1)}), 8, ValueError, "sd positive"),
        (plan_of(), 10**9, ValueError, "100,000,000 lanes at most.*zero too many"),
        (plan_of(), None, ValueError, "say how many lanes"),
        (plan_of(), 0, ValueError, "1 or more, got 0"),
        (plan_of(SobolIndices()), 1000003, ValueError, "multiple of 5 lanes.*1000005 is near"),
        (plan_of(Grid((5, 5))), None, ValueError, "3 columns need 3"),
        (plan_of(LatinHypercube(0, 50)), 60, ValueError, "has 50 lanes, got count=60"),
        (plan_of(low=0.0), 8, ValueError, "reaches -3.142"),
        (plan_of(SobolIndices(), CORRELATED), 8, ValueError, "SobolIndices needs independent numbers"),
        (plan_of(reductions={"a": 1}), 8, ValueError, "'a' is the name of two"),
        (plan_of(reductions={}), 8, ValueError, "needs outputs"),
    ],
)
def test_wrong_plans_are_refused_before_any_work(plan, count, error, text, tmp_path):
    with pytest.raises(error, match=text):
        run_sweep(plan(), count, store=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_sweep_whose_trial_lanes_all_fail_says_so():
    with pytest.raises(ValueError, match="all 64 trial lanes"):
        run_sweep(SweepPlan(dataclasses.replace(ISHIGAMI, fails_below=10.0), ANGLES, Sobol()), 64)
