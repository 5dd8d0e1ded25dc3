"""Many starts of a search, spread over the bounds, and the table of where each ended."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxlines.inference.checkpoint import Memory
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.search import Failed, Found

SAMPLINGS = ("sobol", "latin")


class Start(NamedTuple):
    """One start of a search: its number (0 is the one that was given), values where it began and ended in SI.

    cost: half the sum of squares at the end, at the noise levels that were given or guessed first, infinite when the
    search failed; status and message as of a fit.
    """

    number: int
    start: np.ndarray
    end: np.ndarray
    cost: float
    status: str
    message: str
    num_evaluations: int


def start_points(problem: JointProblem, count: int, seed: int, sampling: str = "sobol") -> np.ndarray:
    """The given start, then points over the coordinate bounds, shape (count, free).

    sampling: "sobol" (scrambled Sobol sequence) or "latin" (Latin hypercube).
    """
    if sampling not in SAMPLINGS:
        raise ValueError(f"sampling must be one of {', '.join(SAMPLINGS)}, got {sampling!r}")
    first = problem.start
    if count <= 1:
        return first[None]
    from scipy.stats import qmc

    if sampling == "sobol":
        unit = qmc.Sobol(first.size, rng=seed).random(2 ** int(np.ceil(np.log2(count))))[: count - 1]
    else:
        unit = qmc.LatinHypercube(first.size, rng=seed).random(count - 1)
    return np.concatenate([first[None], problem.lower + unit * (problem.upper - problem.lower)])


def best_of(
    problem: JointProblem,
    points: np.ndarray,
    memory: Memory,
    say: Callable[[str, float], None],
    find: Callable[..., Found],
) -> tuple[Found, list[Start], list[str]]:
    """The best end point of several searches, the table of all, best first, and remarks.

    find: `search.search`, or another search with its arguments. Raises: Failed when every search failed.
    """
    found: list[Found] = []
    table: list[Start] = []
    for number, point in enumerate(points):

        def report(count, cost, number=number):
            share = (number + 1.0 - np.exp(-count / 15.0)) / len(points)
            say(f"start {number + 1} of {len(points)}, evaluation {count}, cost {cost:.5g}", 0.9 * share)

        begin = problem.to_values(point)
        try:
            end = find(problem, point, report, stage=f"start {number}", memory=memory)
        except Failed as failure:
            table.append(Start(number, begin, np.full_like(begin, np.nan), np.inf, "failed", str(failure), 0))
            continue
        found.append(end)
        table.append(Start(number, begin, end.values, end.cost, end.status, end.message, end.num_evaluations))
    trouble = [f"start {s.number + 1}: {s.message}" for s in table if s.status == "failed"]
    if not found:
        raise Failed("; ".join(trouble))
    best = min(found, key=lambda f: f.cost)
    if len(points) > 1:
        agree = sum(f.cost < best.cost * (1 + 1e-3) + 1e-9 for f in found)
        trouble.append(f"{agree} of {len(points)} starts reached the best optimum")
    return best, sorted(table, key=lambda s: s.cost), trouble
