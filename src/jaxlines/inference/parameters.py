"""What is free in a fit and what is held fixed with an uncertainty: arguments of the call, never state on a model."""

import dataclasses

import numpy as np

from jaxlines.inference.distributions import AbstractDistribution
from jaxlines.inference.priors import Prior, as_prior

TRANSFORMS = ("identity", "log", "logit")


@dataclasses.dataclass(frozen=True)
class Free:
    """A parameter to be estimated.

    Args:
        path: the number in the circuit ("fluid.bulk_modulus", "initial.A.pressure"), or several that share
            the value.
        bounds: lowest and highest value, SI.
        start: where the search starts, SI; the middle of the transformed range by default.
        transform: coordinate in which the search runs and intervals are formed: "identity", "log" (positive
            numbers known to an order of magnitude) or "logit" (numbers that must stay inside their bounds).
        name: how results call it; the first path by default.
        ratios: with several paths, the number at each is the value times its ratio (all 1 by default).
        local: one value for each recording (labels then end in the recording's name), instead of one for all.
        prior: what is known of the value beforehand: a distribution, such as Normal(1.4e9, 1e8). Its ends narrow the
            bounds. See `Prior` for what a fit makes of it.
    Raises: ValueError for bounds that are not finite and increasing, a start outside them, a log transform
        with a bound that is not positive, an unknown transform, ratios that are not one a path.
    """

    path: str | tuple[str, ...]
    bounds: tuple[float, float]
    start: float | None = None
    transform: str = "identity"
    name: str = ""
    ratios: tuple[float, ...] | None = None
    local: bool = False
    prior: Prior | AbstractDistribution | None = None

    def __post_init__(self):
        object.__setattr__(self, "prior", as_prior(self.prior))
        object.__setattr__(self, "bounds", self._within_prior())
        self._check_ratios()
        low, high = (float(b) for b in self.bounds)
        if self.transform not in TRANSFORMS:
            raise ValueError(f"{self.label}: transform must be one of {', '.join(TRANSFORMS)}, got {self.transform!r}")
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(f"{self.label}: bounds must be finite and increasing, got {low:g}..{high:g}")
        if self.transform == "log" and low <= 0.0:
            raise ValueError(
                f'{self.label}: a log transform needs positive bounds, got {low:g}..{high:g}: use "identity"'
            )
        if self.start is not None and not low <= self.start <= high:
            raise ValueError(
                f"{self.label}: start {self.start:g} is outside its bounds {low:g}..{high:g}: other units?"
            )
        if self.transform == "logit" and self.start in (low, high):
            raise ValueError(f"{self.label}: a logit transform cannot start on a bound, got {self.start:g}")

    def _within_prior(self) -> tuple[float, float]:
        """The bounds, narrowed by the ends of the prior. Raises ValueError when nothing is left."""
        if not isinstance(self.prior, Prior):
            return self.bounds
        low, high = (float(b) for b in self.bounds)
        ends = max(low, self.prior.support[0]), min(high, self.prior.support[1])
        if low < high and not ends[0] < ends[1]:
            raise ValueError(
                f"{self.label}: the prior ({self.prior}) leaves nothing of the bounds {low:g}..{high:g}: other units?"
            )
        return ends

    def _check_ratios(self) -> None:
        """Make ratios a tuple of floats. Raises ValueError unless there is one a path, finite and not 0."""
        if self.ratios is None:
            return
        object.__setattr__(self, "ratios", tuple(float(r) for r in self.ratios))
        if len(self.ratios) != len(self.paths) or not np.all(np.isfinite(self.ratios)) or 0.0 in self.ratios:
            raise ValueError(
                f"{self.label}: ratios must be one finite number other than 0 for each of the {len(self.paths)} "
                f"paths, got {self.ratios}"
            )

    @property
    def paths(self) -> tuple[str, ...]:
        """All paths that the parameter drives."""
        return (self.path,) if isinstance(self.path, str) else tuple(self.path)

    @property
    def path_ratios(self) -> tuple[float, ...]:
        """The ratio of the number at each path to the value."""
        return (1.0,) * len(self.paths) if self.ratios is None else self.ratios

    @property
    def label(self) -> str:
        """How results call it."""
        return self.name or self.paths[0]

    def to_coordinate(self, value):
        """The search coordinate of a value."""
        low, high = self.bounds
        if self.transform == "log":
            return np.log(value)
        if self.transform == "logit":
            return np.log((value - low) / (high - value))
        return np.asarray(value, dtype=float)

    def to_value(self, coordinate):
        """The value at a search coordinate."""
        low, high = self.bounds
        if self.transform == "log":
            return np.exp(coordinate)
        if self.transform == "logit":
            return low + (high - low) / (1.0 + np.exp(-coordinate))
        return np.asarray(coordinate, dtype=float)

    def slope(self, value):
        """d value / d coordinate at a value."""
        low, high = self.bounds
        if self.transform == "log":
            return np.asarray(value, dtype=float)
        if self.transform == "logit":
            return (value - low) * (high - value) / (high - low)
        return np.ones_like(np.asarray(value, dtype=float))

    def coordinate_bounds(self) -> tuple[float, float]:
        """Bounds of the coordinate; a logit coordinate covers 1e-9 to 1 - 1e-9 of the range."""
        low, high = self.bounds
        if self.transform == "logit":
            margin = 1e-9 * (high - low)
            low, high = low + margin, high - margin
        return float(self.to_coordinate(low)), float(self.to_coordinate(high))

    def start_coordinate(self) -> float:
        """Coordinate of the start."""
        low, high = self.coordinate_bounds()
        return 0.5 * (low + high) if self.start is None else float(np.clip(self.to_coordinate(self.start), low, high))


@dataclasses.dataclass(frozen=True)
class Known:
    """A number held fixed whose standard uncertainty `sd` (SI) is carried into the result (GUM, Type B)."""

    path: str
    sd: float

    def __post_init__(self):
        if not (np.isfinite(self.sd) and self.sd > 0):
            raise ValueError(f"{self.path}: the standard uncertainty must be positive, got {self.sd:g}")
