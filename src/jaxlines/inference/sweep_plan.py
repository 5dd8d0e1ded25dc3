"""What a sweep computes, and the name it has by it: the hash of everything that its numbers depend on."""

import abc
import dataclasses
import functools
import hashlib
import inspect
import json
import math
from typing import Any

import numpy as np

from jaxlines.inference.samplers import AbstractSampler
from jaxlines.inference.uncertain import Draws, JointNormal, Uncertain

SCHEMA = 1
MAX_COUNT = 100_000_000
PILOT = 64
"""Lanes from which an engine, its steps and the scales of the sketches are chosen."""

_LONGEST = 64
_TAIL = 1e-9
RESERVED = ("index", "status", "error")


class AbstractModel(abc.ABC):
    """What a sweep runs: outputs over time and reductions of them, for many lanes at once.

    Fields of every model: times [s]; outputs: names of sensors over time; reductions: name -> what is reduced and how;
    units: name of an output or a reduction -> SI unit.
    """

    times: np.ndarray
    outputs: tuple[str, ...]
    reductions: dict[str, Any]
    units: dict[str, str]

    @abc.abstractmethod
    def full_paths(self, uncertain: Uncertain) -> dict[str, tuple[str, ...]]:
        """Name of an uncertain number -> the full paths it drives. Raises KeyError for a path that does not exist."""

    @abc.abstractmethod
    def limits(self, path: str) -> tuple[float, float, str]:
        """The lowest and highest legal value of the number at a full path, and its SI unit."""

    @abc.abstractmethod
    def prepare(self, pilot: dict[str, np.ndarray], fixed: dict | None = None) -> Any:
        """A program for lanes like the pilot's: `run(varied)` gives `outputs`, `reductions`, `status` and `error`, and
        `description` is what its numbers depend on (engine, steps, precision) and what it ran on (versions). With
        `fixed`, the description of an earlier program, one that gives the same numbers."""

    def lanes_at_once(self) -> int:
        """How many lanes keep a machine busy: the largest chunk that is chosen by default."""
        return 2048


def describe(value: Any) -> Any:
    """A value as JSON that is equal for equal values: objects by type and fields, long arrays by their hash.

    Raises: TypeError for what has no such description (a function without a name, an open file).
    """
    if isinstance(value, np.bool_ | np.integer):
        return value.item()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else repr(float(value))
    if isinstance(value, dict):
        return {_key(key): describe(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [describe(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: describe(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"type": type(value).__qualname__, **fields}
    if hasattr(value, "__array__"):
        return _array(np.asarray(value))
    if isinstance(value, type):
        return f"{value.__module__}.{value.__qualname__}"
    if inspect.isfunction(value):
        code = value.__code__
        content = repr((code.co_code, [c for c in code.co_consts if not inspect.iscode(c)], code.co_names))
        return {"function": value.__qualname__, "sha256": hashlib.sha256(content.encode()).hexdigest()}
    raise TypeError(f"a sweep cannot name {value!r} in its plan: use numbers, texts and objects of jaxlines")


def _key(key: Any) -> str:
    return key if isinstance(key, str) else " ".join(str(word) for word in key)


def _array(array: np.ndarray) -> Any:
    if array.size <= _LONGEST:
        return describe(array.tolist())
    whole = np.ascontiguousarray(array)
    digest = hashlib.sha256(whole.tobytes()).hexdigest()
    return {"shape": list(array.shape), "dtype": str(array.dtype), "sha256": digest}


@dataclasses.dataclass(frozen=True)
class SweepPlan:
    """What every lane of a sweep is. Neither the count of lanes nor how they are computed belongs to it.

    Args: model; uncertain numbers; sampler; derivatives: whether each lane has the derivatives of its reductions;
        kept_series: of how many of the first lanes the outputs over time are kept whole (bands are kept of all).
    Raises: KeyError for a path that does not exist; ValueError for a distribution that reaches illegal values, a
        sampler that does not suit the numbers, a name that is taken.
    """

    model: AbstractModel
    uncertain: Uncertain
    sampler: AbstractSampler
    derivatives: bool = False
    kept_series: int = 20

    def __post_init__(self):
        names = [*self.uncertain.names, *self.model.reductions]
        taken = sorted({name for name in names if names.count(name) > 1 or name in RESERVED})
        if taken:
            raise ValueError(f"{taken[0]!r} is the name of two columns of the table: give the reduction another name")
        if not self.model.reductions and not self.model.outputs:
            raise ValueError('a sweep needs outputs: reductions such as {"peak": Peak("A.pressure")}, or sensors')
        if (self.sampler.independent or self.derivatives) and not self.uncertain.independent:
            needs = "derivatives=True" if self.derivatives else type(self.sampler).__name__
            raise ValueError(
                f"{needs} needs independent numbers: leave out correlations and joint distributions, or use Sobol()"
            )
        self.sampler.total(self.uncertain.dims)
        _check_limits(self.model, self.uncertain, self.paths)

    @functools.cached_property
    def paths(self) -> dict[str, tuple[str, ...]]:
        """Name of an uncertain number -> the full paths that it drives."""
        return self.model.full_paths(self.uncertain)

    def identity(self) -> dict:
        """All that the numbers of a lane depend on, as JSON."""
        model = {"type": type(self.model).__qualname__, "content": describe(self.model)}
        return {"schema": SCHEMA, "model": model, **{name: describe(getattr(self, name)) for name in _OWN}}

    def hash(self) -> str:
        """The name of the plan: 16 hexadecimal digits of the SHA-256 of its identity."""
        text = json.dumps(self.identity(), separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def samples(self, start: int, stop: int) -> np.ndarray:
        """The uncertain numbers of the lanes start..stop, SI, shape (stop - start, names)."""
        return self.uncertain.values(self.sampler.uniforms(start, stop, self.uncertain.dims))

    def varied(self, samples: np.ndarray) -> dict[str, np.ndarray]:
        """Samples, shape (lanes, names), by the full paths that they drive."""
        paths = self.paths
        return {path: samples[:, j] for j, name in enumerate(self.uncertain.names) for path in paths[name]}

    def check_count(self, count: int) -> None:
        """Raise ValueError for a count of lanes that this plan cannot have."""
        dims = self.uncertain.dims
        total, block, kind = self.sampler.total(dims), self.sampler.block(dims), type(self.sampler).__name__
        if count < 1:
            raise ValueError(f"count must be 1 or more, got {count}")
        if max(count, total or 0) > MAX_COUNT:
            columns = len(self.uncertain.names) + len(self.model.reductions) + 3
            size = 8e-9 * max(count, total or 0) * columns
            raise ValueError(
                f"a sweep has {MAX_COUNT:,} lanes at most, got {max(count, total or 0):,}: its table alone would take "
                f"{size:,.0f} GB. A million lanes give a 1 % quantile to 1 % of its probability: is a zero too many?"
            )
        if total is not None and count != total:
            raise ValueError(f"{kind} has {total} lanes, got count={count}: leave count out")
        if count % block:
            near = max(block, round(count / block) * block)
            raise ValueError(f"{kind} needs a multiple of {block} lanes, got count={count}: {near} is near")


_OWN = ("uncertain", "sampler", "derivatives", "kept_series")


def _reach(uncertain: Uncertain) -> dict[str, tuple[float, float]]:
    """The lowest and the highest value of each number that is not practically impossible (probability 1e-9)."""
    ends = {n: (float(d.quantile(np.asarray(_TAIL))), float(d.quantile(np.asarray(1 - _TAIL))))
            for n, d in uncertain.single.items()}  # fmt: skip
    for group in uncertain.joint:
        if isinstance(group, JointNormal):
            half = 6.0 * np.sqrt(np.diag(group.covariance))
            ends |= {n: (m - h, m + h) for n, m, h in zip(group.names, group.mean, half, strict=True)}
        elif isinstance(group, Draws):
            ends |= {n: (c.min(), c.max()) for n, c in zip(group.names, group.rows.T, strict=True)}
    return ends


def _check_limits(model: AbstractModel, uncertain: Uncertain, paths) -> None:
    """Raise ValueError when a number would take values that it cannot have."""
    for name, (lowest, highest) in _reach(uncertain).items():
        for path in paths[name]:
            low, high, unit = model.limits(path)
            if lowest < low or highest > high:
                wrong, unit = lowest if lowest < low else highest, "" if unit == "1" else f" {unit}"
                raise ValueError(
                    f"{name}: its distribution reaches {wrong:.4g}{unit}, but {path} must be {low:g}..{high:g}{unit}: "
                    "use LogNormal or Truncated, or look at the unit"
                )
