"""A fit that is killed goes on from its last iterate and ends at the same numbers, bit by bit."""

import json
import os
import signal
import subprocess
import sys
import textwrap
from typing import Any

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference.problem import Problem

from .cases import linear_line

TIMES = np.linspace(0.0, 10.0, 24)
FLOW = 1e-5 * (1.0 + np.sin(TIMES))


def problem_of_a_fit(seed: int = 0) -> dict[str, Any]:
    """A curved problem: bulk modulus and leakage of a line, from far away, three starts."""
    pressure = 3e5 + 4e6 * (1.0 - np.exp(-TIMES / 5.0)) + 1e4 * np.random.default_rng(seed).standard_normal(24)
    free = [
        jl.Free("fluid.bulk_modulus", (3e8, 8e9), start=4e9, transform="log"),
        jl.Free("leak.conductance", (1e-14, 1e-10), start=5e-11, transform="log"),
    ]
    return {
        "circuit": linear_line(conductance=2e-12),
        "recording": jl.Recording(TIMES, {"A.pressure": pressure, "flow": FLOW}),
        "free": free,
        "initial": {"A.pressure": 3e5},
        "starts": 3,
        "check": False,
    }


def numbers(fit) -> list[str]:
    """Everything that must be the same, to the last bit."""
    found = [*fit.coordinates, *(e.sd for e in fit.parameters.values()), fit.noise["A.pressure"].absolute]
    found += [x for s in fit.starts for x in (*s.start, *s.end, s.cost)]
    return [float(x).hex() for x in found]


@pytest.fixture(scope="module")
def whole():
    return jl.fit(**problem_of_a_fit())


class Stopped(Exception):
    """A fit that was interrupted."""


def test_an_interrupted_fit_goes_on_and_ends_at_the_same_numbers(whole, tmp_path, monkeypatch):
    path, calls = tmp_path / "fit.ckpt.json", []

    def stop(text, fraction):
        calls.append(text)
        if "start 2" in text and "evaluation 3" in text:
            raise Stopped

    with pytest.raises(Stopped):
        jl.fit(**problem_of_a_fit(), checkpoint=path, progress=stop)
    before, evaluated = sum("evaluation" in text for text in calls), []
    predict = Problem.predict
    monkeypatch.setattr(Problem, "predict", lambda self, values: evaluated.append(1) or predict(self, values))
    again = jl.fit(**problem_of_a_fit(), checkpoint=path)
    assert numbers(again) == numbers(whole)
    assert again.num_evaluations == whole.num_evaluations
    resumed = len(evaluated)
    evaluated.clear()
    jl.fit(**problem_of_a_fit(), checkpoint=tmp_path / "other.json")
    assert before > 5 and resumed <= len(evaluated) - before + 4  # but what came after the last accepted iterate
    evaluated.clear()
    third = jl.fit(**problem_of_a_fit(), checkpoint=path)  # finished: nothing is searched
    assert numbers(third) == numbers(whole) and len(evaluated) < 25


def test_a_checkpoint_of_another_problem_is_refused(tmp_path):
    path = tmp_path / "fit.ckpt.json"
    jl.fit(**problem_of_a_fit(), checkpoint=path)
    content = json.loads(path.read_text())
    assert set(content["stages"]) >= {"start 0", "start 1", "start 2"}
    for other in ({}, {"starts": 2}, {"loss": "huber"}):
        change: dict[str, Any] = problem_of_a_fit(seed=0 if other else 1)
        change.update(other)
        with pytest.raises(ValueError, match=r"belongs to another fit .*: delete it to begin anew"):
            jl.fit(**change, checkpoint=path)
    path.write_text("{}")
    with pytest.raises(ValueError, match="it is no checkpoint of a fit"):
        jl.fit(**problem_of_a_fit(), checkpoint=path)
    with pytest.raises(ValueError, match="there is no folder"):
        jl.fit(**problem_of_a_fit(), checkpoint=tmp_path / "none" / "fit.json")


@pytest.mark.slow
def test_a_killed_process_goes_on(whole, tmp_path):
    """SIGKILL in the midst of the second start; a new process finishes with the numbers of an uninterrupted one."""
    path = tmp_path / "fit.ckpt.json"
    script = textwrap.dedent(
        f"""
        import json, os, signal, sys
        sys.path.insert(0, {os.getcwd()!r})
        import jaxlines as jl
        from tests.inference.test_problem_checkpoint import numbers, problem_of_a_fit

        def say(text, fraction):
            if sys.argv[1] == "die" and "start 2" in text and "evaluation 5" in text:
                os.kill(os.getpid(), signal.SIGKILL)

        print(json.dumps(numbers(jl.fit(**problem_of_a_fit(), checkpoint={str(path)!r}, progress=say))))
        """
    )
    run = [sys.executable, "-c", script]
    assert subprocess.run([*run, "die"], check=False).returncode == -signal.SIGKILL
    assert "start 1" in json.loads(path.read_text())["stages"]
    done = subprocess.run([*run, "finish"], check=True, capture_output=True, text=True)
    assert json.loads(done.stdout) == numbers(whole)
