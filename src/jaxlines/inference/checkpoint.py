"""Every accepted iterate of a fit on disk, so that a killed one goes on where it was and ends at the same numbers.

The search is deterministic: where it goes follows from what was evaluated. What is written is therefore every
evaluation, in the small form that the search sees (see `search.Evaluator`): a run that starts again takes these from
the file, in moments, until it comes to where the other one ended.
"""

import dataclasses
import hashlib
import importlib.metadata
import json
import os
import re
import uuid
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxlines.inference.joint import JointProblem

FORMAT = 1


@dataclasses.dataclass
class Memory:
    """Evaluations of a fit by stage of the search and coordinates; on disk if it has a path."""

    path: Path | None = None
    key: str = ""
    stages: dict[str, dict[str, dict[str, Any]]] = dataclasses.field(default_factory=dict)

    def recall(self, stage: str, x: np.ndarray) -> dict[str, Any]:
        """What is known at coordinates; empty when nothing is."""
        return self.stages.setdefault(stage, {}).setdefault(_name(x), {})

    def keep(self, stage: str, x: np.ndarray, *, write: bool = False, **found) -> None:
        """Remember something at coordinates; with `write`, put the whole memory on disk at once."""
        self.recall(stage, x).update(found)
        if write:
            self.write()

    def write(self) -> None:
        """Put the memory on disk, whole or not at all."""
        if self.path is None:
            return
        text = json.dumps({"format": FORMAT, "problem": self.key, "stages": self.stages}, allow_nan=False)
        temporary = self.path.with_name(f".{self.path.name}.{uuid.uuid4().hex[:8]}")
        try:
            with open(temporary, "x", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, self.path)
        finally:
            temporary.unlink(missing_ok=True)


def _name(x: np.ndarray) -> str:
    """Coordinates as a text that holds every bit."""
    return " ".join(float(c).hex() for c in x)


def problem_key(problem: JointProblem, *more) -> str:
    """A hash of everything that the result of a fit depends on."""
    digest = hashlib.sha256()

    def add(thing) -> None:
        if isinstance(thing, np.ndarray | jax.Array):
            array = np.ascontiguousarray(thing)
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(array.tobytes())
        else:
            digest.update(re.sub(r" at 0x[0-9a-f]+", "", repr(thing)).encode())  # addresses differ between runs

    for trial in problem.trials:
        for thing in (trial.plan, trial.method, trial.locations, trial.groups, trial.tolerance, trial.precision):
            add(thing)
        for array in (*jax.tree.leaves(trial.values), trial.recording.times, trial.measured, trial.used):
            add(array)
        add(trial.steady)
    for sigma in problem.sigma:
        add(sigma)
    add(importlib.metadata.version("jaxlines"))
    for thing in (problem.free, problem.columns, problem.known, problem.known_columns, problem.loss, *more):
        add(thing)
    return digest.hexdigest()


def open_memory(path, key: str) -> Memory:
    """The memory of a fit: that of a file that is there, or a new one (nowhere on disk if the path is None).

    Raises: ValueError for a file of another problem, or one that is no checkpoint.
    """
    if path is None:
        return Memory()
    path = Path(path)
    if not path.parent.is_dir():
        raise ValueError(f"checkpoint {path}: there is no folder {path.parent}")
    if not path.is_file():
        return Memory(path, key)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        found, version, stages = content["problem"], content["format"], content["stages"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"checkpoint {path}: it is no checkpoint of a fit: give another file name") from error
    if version != FORMAT or found != key:
        raise ValueError(
            f"checkpoint {path}: it belongs to another fit (circuit, recordings, parameters or options differ): delete "
            "it to begin anew, or give another file name"
        )
    return Memory(path, key, stages)
