"""Criteria against numbers of R, and prediction of what was left out against its closed form; optimisers."""

import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxlines.inference.comparison import compare, criteria, gaussian_log_likelihood, predict_left_out
from jaxlines.inference.least_squares import FunctionProblem, solve
from jaxlines.inference.optimisers import FunctionObjective, SquaresObjective, minimise, minimise_lbfgs

SPEED = np.repeat(
    [4, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 22, 23, 24, 25],
    [2, 2, 1, 1, 3, 2, 4, 4, 4, 3, 2, 3, 4, 3, 5, 1, 1, 4, 1],
).astype(float)
STOP = np.concatenate(
    [
        [2.0, 10, 4, 22, 16, 10, 18, 26, 34, 17, 28, 14, 20, 24, 28, 26, 34, 34, 46, 26, 36, 60, 80, 20, 26],
        [54.0, 32, 40, 32, 40, 50, 42, 56, 76, 84, 36, 46, 68, 32, 48, 52, 56, 64, 66, 54, 70, 92, 93, 120, 85],
    ]
)
"""Stopping distances of cars [ft] by speed [mph]: Ezekiel, "Methods of Correlation Analysis", 1930."""


def cars(power: int, recording=None):
    design = np.stack([SPEED**k for k in range(power + 1)], axis=1)
    groups = np.zeros(50, dtype=int) if recording is None else recording
    labels = tuple(f"b{k}" for k in range(power + 1))
    return FunctionProblem(lambda x: design @ x - STOP, labels, recording=groups)


def test_criteria_are_those_of_r():
    """lm(dist ~ speed, cars): logLik -206.5784, AIC 419.1569, BIC 424.8929."""
    end = solve(cars(1), [0.0, 0.0])
    np.testing.assert_allclose(end.x, [-17.5791, 3.9324], rtol=1e-5)
    found = criteria(gaussian_log_likelihood(end.residuals, 1), 3, 50)
    assert found.log_likelihood == pytest.approx(-206.5784, abs=1e-4)
    assert found.aic == pytest.approx(419.1569, abs=1e-4)
    assert found.bic == pytest.approx(424.8929, abs=1e-4)
    assert found.aicc == pytest.approx(found.aic + 24 / 46)


def test_left_out_rows_are_predicted_as_the_hat_matrix_says():
    problem = cars(1, np.arange(50))
    end = solve(problem, [0.0, 0.0])
    leverage = np.sum(np.linalg.qr(end.jacobian)[0] ** 2, axis=1)
    found = predict_left_out(problem, end)
    np.testing.assert_allclose([p.rms for p in found], np.abs(end.residuals / (1 - leverage)), rtol=1e-7)
    with pytest.raises(ValueError, match="at least two recordings"):
        predict_left_out(cars(1), end)


def test_models_are_ranked_by_what_they_have_not_seen():
    recording = np.arange(50) % 2
    models = {name: cars(power, recording) for name, power in (("constant", 0), ("line", 1), ("wild", 5))}
    fitted = {name: (p, solve(p, np.zeros(len(p.labels)))) for name, p in models.items()}
    with pytest.warns(UserWarning, match="constant: residuals are correlated"):
        found = compare(fitted, num_levels=1)
    assert found.best == "line"
    assert found.to_frame().loc["line", "bic"] < found.to_frame().loc["wild", "bic"]
    with pytest.raises(ValueError, match="same data"):
        few = FunctionProblem(lambda x: x, ("a",))
        compare({**fitted, "few": (few, solve(few, [0.0]))})


def halves():
    """The line's data in two batches, scaled so that the noise is about 1."""
    parts = []
    for rows in (slice(0, 50, 2), slice(1, 50, 2)):
        speed, stop = SPEED[rows] / 10.0, STOP[rows]
        bounds = np.array([-60.0, 0.0]), np.array([60.0, 120.0])
        parts.append(
            FunctionProblem(
                lambda x, speed=speed, stop=stop: (x[0] + x[1] * speed - stop) / 15.0, ("offset", "slope"), *bounds
            )
        )
    return SquaresObjective(tuple(parts))


def test_adam_on_batches_and_lbfgs_reach_the_least_squares_line():
    objective = halves()
    schedule = optax.cosine_decay_schedule(0.1, 300)
    found = minimise(objective, [30.0, 10.0], optax.adam(schedule), steps=300, batch_size=1)
    np.testing.assert_allclose(found.x, [-17.5791, 39.324], rtol=0.02)
    assert found.history[0] > 2 * found.value
    best = minimise_lbfgs(objective, [30.0, 10.0])
    assert best.status == "converged"
    np.testing.assert_allclose(best.x, [-17.5791, 39.324], rtol=1e-5)
    assert minimise(objective, [30.0, 10.0], optax.sgd(1e-9), steps=2).status == "stalled"


def test_an_objective_of_ones_own_stays_inside_its_bounds():
    """Rosenbrock's valley: (1, 1) without bounds in the way, (0.8, 0.64) with x <= 0.8."""

    def valley(x, batch):
        return (1.0 - x[0]) ** 2 + 100.0 * (x[1] - x[0] ** 2) ** 2 + 0.0 * batch

    for gradient in ("reverse", "forward"):
        free = FunctionObjective(valley, ("x", "y"), np.full(2, -3.0), np.full(2, 3.0), gradient=gradient)
        np.testing.assert_allclose(minimise_lbfgs(free, [-1.2, 1.0]).x, [1.0, 1.0], atol=1e-5)
    tight = FunctionObjective(valley, ("x", "y"), np.full(2, -3.0), np.array([0.8, 3.0]))
    held = minimise_lbfgs(tight, [-1.2, 1.0])
    np.testing.assert_allclose(held.x, [0.8, 0.64], atol=1e-5)
    assert held.status == "converged"
    broken = FunctionObjective(lambda x, batch: jnp.log(x[0] - 9.0), ("x",), np.zeros(1), np.ones(1))
    assert minimise(broken, [0.5], optax.adam(0.1), steps=2).status == "failed"
