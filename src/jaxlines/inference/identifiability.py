"""Which parameters data can tell: structurally not, practically not, or identifiable, and what only together."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxlines.inference.least_squares import LeastSquaresProblem, Solution
from jaxlines.inference.profiles import Interval, intervals
from jaxlines.inference.separating import separating_test

SINGULAR = 1e-8
"""Scaled singular values below this part of the largest count as zero: solver and rounding leave about 1e-13."""

NUM_POINTS = 5
"""Random points at which a direction must be open to be called structurally open."""

STRUCTURALLY, PRACTICALLY, IDENTIFIABLE = (
    "locally structurally non-identifiable",
    "practically non-identifiable",
    "identifiable",
)


class Structure(NamedTuple):
    """What no data of this kind could tell, however exact.

    open: label -> whether it takes part in an open direction at every point; groups: labels that are fixed only
    together (or, alone, not at all); singular_values: scaled, shape (points, parameters), largest first.
    """

    open: dict[str, bool]
    groups: tuple[tuple[str, ...], ...]
    singular_values: np.ndarray

    def sentences(self) -> tuple[str, ...]:
        """The groups in words."""
        words = []
        for *others, last in self.groups:
            if others:
                words.append(f"no such recording can tell {', '.join(others)} and {last} apart: it fixes them together")
            else:
                words.append(f"no such recording says anything about {last}")
        return tuple(words)


def structure(problem: LeastSquaresProblem, *, points: int = NUM_POINTS, seed: int = 0) -> Structure:
    """Local structural identifiability from the rank of the Jacobian at random points within the bounds.

    Columns are scaled by the widths of the bounds; no data enter, only slopes, so that noise plays no part. Points
    where the model fails are replaced.

    Args: points: at least `NUM_POINTS`.
    Raises: ValueError for infinite bounds or fewer points; RuntimeError when the model fails nearly everywhere.
    Reference: Jacquez and Greif, Mathematical Biosciences 77, 1985; Stigter and Molenaar, Automatica 58, 2015.
    """
    if points < NUM_POINTS:
        raise ValueError(f"at least {NUM_POINTS} points are needed, got {points}: one point may be special")
    widths = problem.upper - problem.lower
    if not np.all(np.isfinite(widths)):
        raise ValueError("random points need finite bounds: give every parameter a lower and an upper one")
    rng, spectra, projectors = np.random.default_rng(seed), [], []
    for _ in range(10 * points):
        point = problem.lower + rng.random(widths.size) * widths
        slopes = problem.jacobian(point) * widths
        if not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(problem.residuals(point)))):
            continue
        _, singular, right = np.linalg.svd(slopes, full_matrices=True)
        singular = np.concatenate([singular, np.zeros(widths.size - singular.size)])
        null = right[singular <= SINGULAR * singular[0]]
        spectra.append(singular)
        projectors.append(null.T @ null)
        if len(spectra) == points:
            break
    else:
        raise RuntimeError(f"the model fails at most points within the bounds: only {len(spectra)} of {points} worked")
    share = np.min([np.diag(p) for p in projectors], axis=0)
    taking_part = share > 1e-3
    groups = _groups(projectors[0], taking_part)
    labels = problem.labels
    return Structure(
        {label: bool(taking_part[i]) for i, label in enumerate(labels)},
        tuple(tuple(labels[i] for i in group) for group in groups),
        np.array(spectra),
    )


def _groups(projector, taking_part) -> list[list[int]]:
    """Coordinates that open directions tie together: connected parts of the projector on them."""
    left, groups = set(np.flatnonzero(taking_part)), []
    while left:
        group, front = set(), {min(left)}
        while front:
            group |= front
            linked = np.abs(projector[sorted(front)]).max(axis=0) > 1e-3
            front = (set(np.flatnonzero(linked)) & left) - group
        groups.append(sorted(int(i) for i in group))
        left -= group
    return groups


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """The class of a parameter, one of three, its likelihood interval, and why.

    "practically non-identifiable": the profile stays below 3.84 up to the bounds on both sides; with one open side the
    class is "identifiable" and the sentence says that data give a limit only.
    """

    label: str
    kind: str
    interval: Interval | None
    sentence: str


def assess(
    problem: LeastSquaresProblem,
    solution: Solution,
    *,
    noise: str = "known",
    seed: int = 0,
    freedom=None,
    inflation=None,
    words: Callable[[str, float], str] | None = None,
) -> dict[str, Identifiability]:
    """Class every parameter after a fit: label -> `Identifiability`.

    Args: noise, freedom, inflation: as in `profiles.intervals`; words: (label, coordinate) -> text, such as its value
    with a unit. A class that is not "identifiable" says what test would tell more.
    """
    words = words or (lambda label, x: f"{x:.6g}")
    form = structure(problem, seed=seed)
    sentences = {label: s for group, s in zip(form.groups, form.sentences(), strict=True) for label in group}
    groups = {label: group for group in form.groups for label in group}
    found = {}
    for label, own in intervals(problem, solution, noise=noise, freedom=freedom, inflation=inflation).items():
        low, high = own.ends
        if form.open[label]:
            word = f"{sentences[label]}; {separating_test(groups[label])}"
            found[label] = Identifiability(label, STRUCTURALLY, own, word)
        elif own.kind == "failed":
            reason = own.low.message if own.low.status == "failed" else own.high.message
            found[label] = Identifiability(label, IDENTIFIABLE, None, f"its interval was not found: {reason}")
        elif own.kind == "open":
            word = f"any value within its bounds fits within the noise; {separating_test((label,))}"
            found[label] = Identifiability(label, PRACTICALLY, own, word)
        elif own.kind == "two_sided":
            word = f"95 % within {words(label, low)} .. {words(label, high)}"
            found[label] = Identifiability(label, IDENTIFIABLE, own, word)
        else:
            upper = own.kind == "upper_limit"
            limit = f"at most {words(label, high)}" if upper else f"at least {words(label, low)}"
            found[label] = Identifiability(label, IDENTIFIABLE, own, f"a limit only: {limit}; its bound is the other")
    return found
