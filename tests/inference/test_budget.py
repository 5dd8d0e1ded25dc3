"""Uncertainty budgets against the worked examples of the GUM (JCGM 100:2008, annex H)."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from jaxlines.inference.budget import Budget, Source, known_sensitivities, measurement_budget, parameter_budget


def end_gauge():
    """Example H.1: length of an end gauge by comparison, in nm."""
    sources = [
        Source("standard", 50.000623e6, 25.0, "nm", "B", 18),
        Source("difference", 215.0, 9.7, "nm", "A", 25.6),
        Source("expansion difference", 0.0, 0.58e-6, "1/K", "B", 50),
        Source("temperature difference", 0.0, 0.029, "K", "B", 2),
        Source("expansion", 11.5e-6, 1.2e-6, "1/K", "B"),
        Source("temperature", -0.1, 0.41, "K", "B"),
    ]
    return measurement_budget(
        lambda standard, d, da, dt, a, t: standard + d - standard * (da * t + a * dt), sources, result="l", unit="nm"
    )


def test_the_end_gauge_of_the_gum():
    budget = end_gauge()
    assert budget.value == pytest.approx(50.000838e6, abs=0.5)
    assert budget.sd == pytest.approx(32.0, abs=0.5)
    assert np.floor(budget.freedom) == 16
    assert budget.coverage_factor(0.99) == pytest.approx(2.92, abs=0.005)
    assert budget.expanded(0.99) == pytest.approx(93.0, abs=0.6)
    np.testing.assert_allclose([abs(s.contribution) for s in budget.sources], [25, 9.7, 2.9, 16.6, 0, 0], atol=0.1)


@pytest.mark.parametrize(
    ("function", "value", "sd"),
    [
        (lambda v, i, phase: v / i * jnp.cos(phase), 127.732, 0.071),
        (lambda v, i, phase: v / i * jnp.sin(phase), 219.847, 0.295),
        (lambda v, i, phase: v / i, 254.260, 0.236),
    ],
)
def test_resistance_reactance_and_impedance_of_the_gum(function, value, sd):
    """Example H.2: correlated readings of voltage, current and phase."""
    sources = [
        Source("V", 4.9990, 0.0032, "V", "A", 4),
        Source("I", 19.6610e-3, 0.0095e-3, "A", "A", 4),
        Source("phase", 1.04446, 0.00075, "rad", "A", 4),
    ]
    matrix = np.array([[1.0, -0.36, 0.86], [-0.36, 1.0, -0.65], [0.86, -0.65, 1.0]])
    budget = measurement_budget(function, sources, correlations=matrix)
    assert budget.value == pytest.approx(value, abs=1e-3)
    assert budget.sd == pytest.approx(sd, abs=1.5e-3)


def test_the_table_is_exported(tmp_path):
    budget = end_gauge()
    budget.to_csv(tmp_path / "budget.csv")
    table = pd.read_csv(tmp_path / "budget.csv")
    assert list(table["quantity"])[-1] == "l" and table["standard uncertainty"].iloc[-1] == pytest.approx(budget.sd)
    assert table["share"].iloc[:-1].sum() == pytest.approx(1.0)
    assert budget.to_markdown().count("\n") == 8 and "degrees of freedom" in str(budget)


def test_known_numbers_of_a_fit_act_as_a_second_fit_says():
    """Slope b of y = b x - k z by least squares: moving k by 1 moves the estimate by exactly this much."""
    rng = np.random.default_rng(0)
    x, z, y = rng.standard_normal((3, 20))
    b = [float(x @ (y + k * z) / (x @ x)) for k in (0.0, 1.0)]
    gain = known_sensitivities(x[:, None], -z[:, None])
    assert gain[0, 0] == pytest.approx(b[1] - b[0], rel=1e-10)
    budget = parameter_budget(
        "b",
        b[0],
        "1",
        0.3,
        19,
        [Source("k", 0.0, 0.4, sensitivity=float(gain[0, 0]))],
        scatter_sd=0.6,
        num_recordings=9,
    )
    assert budget.sd == pytest.approx(np.sqrt(0.3**2 + 0.2**2 + (0.4 * gain[0, 0]) ** 2), rel=1e-12)
    assert [s.kind for s in budget.sources] == ["A", "A", "B"]


def test_wrong_calls_are_refused_and_empty_budgets_have_no_doubt():
    with pytest.raises(ValueError, match="must not be negative"):
        measurement_budget(lambda x: x, [Source("x", 1.0, -1.0)])
    with pytest.raises(ValueError, match="shape"):
        measurement_budget(lambda x: x, [Source("x", 1.0, 1.0)], correlations=np.eye(2))
    assert Budget("x", 1.0, "1", (Source("a", 1.0, 2.0),)).coverage_factor() == pytest.approx(1.959964)
