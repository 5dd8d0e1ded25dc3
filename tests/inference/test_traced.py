"""A fit's problem as a traced function is the same problem."""

import dataclasses

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference.distributions import LogNormal, Normal
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.loss import Loss
from jaxlines.inference.problem import make_problem
from jaxlines.inference.traced import as_function
from jaxlines.simulation.integration import make_method

from .cases import FREE, NOISE, TIMES, control_line, recording


@pytest.mark.slow
def test_rows_and_slopes_are_those_of_the_fit():
    free = tuple(
        dataclasses.replace(f, prior=p)
        for f, p in zip(FREE, (LogNormal(1.4e9, 0.1), None, Normal(1e-12, 1e-13), None), strict=True)
    )
    data = recording(np.linspace(3e5, 1e6, TIMES.size), 0)
    method = make_method(None, "forward", 4096)
    trial = make_problem(control_line(), data, free, (), {}, method, 1e-8, "float64")
    sigma = np.full((TIMES.size, 1), NOISE)
    problem = JointProblem((trial,), free, ((0, 1, 2, 3),), (), ((),), (sigma,), loss=Loss())
    traced = as_function(problem)
    x = problem.to_coordinates([1.5e9, 5e-3, 2e-12, 2.5e5])
    np.testing.assert_allclose(traced.residuals(x), problem.residuals(x), rtol=1e-6, atol=1e-4)
    expected = problem.jacobian(x)
    np.testing.assert_allclose(
        traced.jacobian(x) / np.abs(expected).max(axis=0), expected / np.abs(expected).max(axis=0), atol=1e-5
    )
    assert traced.labels == problem.labels and traced.recording[-1] == -1
    with pytest.raises(ValueError, match="gauss"):
        as_function(dataclasses.replace(problem, loss=Loss("huber")))
    assert isinstance(free[0], jl.Free)
