"""Pictures of starts, profiles, directions, posteriors and ensembles: each draws the numbers it is given."""

import numpy as np
import pytest

from jaxlines.edge.plots import decimate_band, plot_directions, plot_posterior, plot_profile, plot_starts
from jaxlines.edge.sweep_plots import plot_ensemble
from jaxlines.inference.least_squares import FunctionProblem
from jaxlines.inference.posterior import Posterior
from jaxlines.inference.starts import Start
from jaxlines.simulation.ensemble_result import LANE_STATUS, Ensemble


def ended(*costs: float) -> list[Start]:
    """Searches that ended at some costs."""
    return [Start(i, np.zeros(1), np.zeros(1), cost, "", "", 3) for i, cost in enumerate(costs)]


def test_waterfall_of_starts_is_sorted_above_the_best():
    axes = plot_starts(ended(14.0, 10.0, np.inf, 10.0))
    (line,) = axes.get_lines()
    np.testing.assert_allclose(np.asarray(line.get_ydata()), [1e-3, 1e-3, 4.0])
    np.testing.assert_allclose(np.asarray(line.get_xdata()), [1, 2, 3])
    assert line.get_label() == "3 ended, 1 failed"
    assert axes.get_yscale() == "log"
    assert plot_starts(ended(np.inf)).get_lines()[0].get_label() == "0 ended, 1 failed"


def test_profile_in_units_that_read_well():
    values = np.linspace(1e9, 2e9, 11)
    axes = plot_profile(values, ((values - 1.5e9) / 1e8) ** 2, "K", "Pa", best=1.5e9, interval=(1.304e9, np.inf))
    np.testing.assert_allclose(np.asarray(axes.get_lines()[0].get_xdata()), values / 1e9)
    assert axes.get_xlabel() == "K [GPa]"
    stripe = axes.patches[0].get_extents().transformed(axes.transData.inverted())
    assert (stripe.x0, stripe.x1) == pytest.approx((1.304, 2.0))


def test_directions_of_two_numbers_known_by_their_sum_alone():
    slopes = np.array([[10.0, 5.0], [20.0, 10.0], [0.0, 0.0]])  # scaled by the widths: only a + b is seen
    problem = FunctionProblem(lambda x: slopes @ x, ("a", "b"), np.zeros(2), np.array([1.0, 2.0]))
    axes = plot_directions(problem, np.zeros(2))
    first, second = axes.containers
    np.testing.assert_allclose([bar.get_width() for bar in first], [50.0, 50.0])
    np.testing.assert_allclose([bar.get_x() for bar in second], [50.0, 50.0])
    names = [text.get_text() for text in axes.get_yticklabels()]
    assert names[0] == f"{100 / np.sqrt(2 * (10.0**2 + 20.0**2)):.2g} %"
    assert names[1] == "open"


def test_posterior_pairs_show_every_number():
    pytest.importorskip("arviz")
    draws = np.random.default_rng(0).normal(size=(2, 50, 2)) + np.array([0.0, 7.0])
    flat = np.zeros((2, 50))
    posterior = Posterior(("a.x", "b"), draws, draws[..., :0], flat, flat > 0, np.ones(2), np.full(2, 500.0))
    axes = plot_posterior(posterior)
    pair = axes[1, 0].collections[0].get_offsets()
    np.testing.assert_allclose(np.sort(pair[:, 1]), np.sort(draws[..., 1].ravel()))
    assert axes[1, 0].get_xlabel() == "a.x"
    alone = Posterior(("a",), draws[..., :1], draws[..., :0], flat, flat > 0, np.ones(1), np.full(1, 500.0))
    with pytest.raises(ValueError, match="pairs need two numbers or more, the posterior has a alone"):
        plot_posterior(alone)


def ensemble(codes) -> Ensemble:
    """Lanes 0, 1, 2, ... MPa, constant in time."""
    lanes = np.arange(len(codes))[:, None] * 1e6 + np.zeros(20)
    codes = np.array(codes)
    about = {"engine": "lockstep", "steps": 1, "precision": "float64"}
    return Ensemble(
        np.arange(20.0), {"A.pressure": lanes}, {}, codes, np.zeros(len(codes)), None, {"A.pressure": "Pa"}, about, {}
    )


def test_bands_of_an_ensemble_are_of_the_lanes_that_can_be_trusted():
    failed = LANE_STATUS["non_finite"]
    axes = plot_ensemble(ensemble([0, 0, 0, 0, 0, failed]), "A.pressure", probabilities=(0.25, 0.5, 0.75))
    lines = {line.get_label(): line.get_ydata() for line in axes.get_lines()}
    np.testing.assert_allclose(lines["median"], 2.0)
    heights = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((1.0, 3.0))
    assert axes.get_ylabel() == "A.pressure [MPa]"
    with pytest.raises(ValueError, match="no lane can be trusted"):
        plot_ensemble(ensemble([failed]), "A.pressure")


def test_decimated_bands_keep_their_widest_places():
    times = np.arange(1000.0)
    low, high = -np.ones(1000), np.ones(1000)
    low[333], high[777] = -9.0, 9.0
    kept, lowest, highest = decimate_band(times, low, high, 50)
    assert kept.size == 50
    assert (lowest.min(), highest.max()) == (-9.0, 9.0)
    assert kept[np.argmin(lowest)] <= 333 < kept[np.argmin(lowest) + 1]
