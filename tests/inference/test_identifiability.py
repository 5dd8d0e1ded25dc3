"""Classes of identifiability on models whose answer is known, with their words."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlines.inference.identifiability import IDENTIFIABLE, PRACTICALLY, STRUCTURALLY, assess, structure
from jaxlines.inference.least_squares import FunctionProblem, solve

TIMES = np.linspace(0.0, 2.0, 25)
DATA = 6.0 * np.exp(-0.8 * TIMES) + 0.05 * np.random.default_rng(0).standard_normal(25)
LABELS = ("gain", "volume", "rate", "late", "idle")
LOW, HIGH = np.array([0.5, 0.5, 0.1, 0.0, -1.0]), np.array([20.0, 20.0, 3.0, 1.0, 1.0])


def rows(x):
    """Only gain * volume is seen, `late` acts on a hundredth of the noise, `idle` on nothing."""
    return (x[0] * x[1] * jnp.exp(-x[2] * TIMES) + 5e-4 * x[3] * TIMES**3 + 0.0 * x[4] - DATA) / 0.05


@pytest.fixture(scope="module")
def problem():
    return FunctionProblem(rows, LABELS, LOW, HIGH)


def test_open_directions_are_found_without_data_and_named(problem):
    found = structure(problem)
    assert found.open == {"gain": True, "volume": True, "rate": False, "late": False, "idle": True}
    assert found.groups == (("gain", "volume"), ("idle",))
    assert "tell gain and volume apart" in found.sentences()[0] and "about idle" in found.sentences()[1]
    assert np.all(found.singular_values[:, 3] <= 1e-8 * found.singular_values[:, 0])
    assert np.all(found.singular_values[:, 2] > 1e-8 * found.singular_values[:, 0])


def test_every_parameter_gets_its_class(problem):
    found = assess(problem, solve(problem, [3.0, 3.0, 1.5, 0.5, 0.0]))
    kinds = {label: entry.kind for label, entry in found.items()}
    assert kinds == {
        "gain": STRUCTURALLY,
        "volume": STRUCTURALLY,
        "rate": IDENTIFIABLE,
        "late": PRACTICALLY,
        "idle": STRUCTURALLY,
    }
    rate = found["rate"].interval
    assert rate is not None and rate.ends[0] < 0.8 < rate.ends[1] and rate.ends[1] - rate.ends[0] < 0.1
    assert "any value" in found["late"].sentence


def test_a_limit_is_called_a_limit():
    problem = FunctionProblem(lambda x: x[0] * TIMES + x[1] - 0.1, ("leak", "level"), np.zeros(2), np.full(2, 9.0))
    found = assess(problem, solve(problem, [1.0, 1.0]))
    assert found["leak"].kind == IDENTIFIABLE and "a limit only" in found["leak"].sentence


def test_few_points_and_infinite_bounds_are_refused(problem):
    with pytest.raises(ValueError, match="one point may be special"):
        structure(problem, points=2)
    with pytest.raises(ValueError, match="finite bounds"):
        structure(FunctionProblem(rows, LABELS))
    broken = FunctionProblem(lambda x: jnp.log(x[0] - 2.0) * TIMES, ("a",), np.zeros(1), np.ones(1))
    with pytest.raises(RuntimeError, match="fails at most points"):
        structure(broken)
