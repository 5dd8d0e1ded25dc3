"""The search of a fit by multiple shooting: for long, oscillating or chaotic recordings."""

import dataclasses
from collections.abc import Callable

import numpy as np

from jaxlines.inference.checkpoint import Memory
from jaxlines.inference.joint import JointProblem
from jaxlines.inference.search import Failed, Found, judge, search
from jaxlines.inference.shooting_search import CONTINUOUS, At, Joined, Unstartable, join
from jaxlines.inference.shooting_windows import CutRecordings, cut_recordings


def search_in_windows(
    problem: JointProblem,
    start: np.ndarray,
    report: Callable[[int, float], None],
    *,
    windows: int,
    stage: str = "search",
    memory: Memory | None = None,
    max_evaluations: int = 200,
) -> Found:
    """`search` begun in windows with starts of their own that the search ties together.

    A single trajectory from a poor start is out of step with an oscillating recording after a few periods, and
    its sum of squares has a minimum for every period that it may slip by. Short windows that begin where the
    recording is cannot slip. Once the gaps are closed, the parameters start the usual search, whose optimum is the
    result; where that is lost (chaos), it is that of the windows, with `followed` False.

    windows: in how many parts each recording is cut; max_evaluations: of all windows at once; the rest as in `search`.
    Raises: ValueError as `cut_recordings`; Failed when a window cannot be simulated at the start.
    References: Bock, "Recent advances in parameter identification techniques for O.D.E.", 1983; Peifer and Timmer,
    "Parameter estimation in ordinary differential equations for biochemical processes using the method of multiple
    shooting", IET Systems Biology 1, 2007.
    """
    cut, memory = cut_recordings(problem, windows), memory or Memory()
    begin, known = np.clip(start, problem.lower, problem.upper), memory.recall(f"{stage}, windows", start)
    if known:
        at = At(np.array(known["coordinates"]), tuple(map(np.array, known["states"])), *known["rest"])
    else:
        at = At(begin, cut.guess(begin))

    def save(at: At) -> None:
        states = [own.tolist() for own in at.states]
        memory.keep(f"{stage}, windows", start, coordinates=at.x.tolist(), states=states, rest=list(at[2:]), write=True)

    try:
        joined = join(cut, at, max_evaluations=max_evaluations, report=report, save=save)
    except Unstartable as failure:
        raise Failed(str(failure)) from failure
    ends = [_of_windows(cut, joined)]
    try:

        def go_on(count, cost):
            report(joined.num_evaluations + count, cost)

        alone = search(problem, joined.x, go_on, stage=f"{stage}, after windows", memory=memory)
        if joined.gap > CONTINUOUS or alone.cost <= ends[0].cost * (1.0 + 1e-3) + 1e-6:
            ends.insert(0, alone)
    except Failed:
        pass
    return dataclasses.replace(ends[0], num_evaluations=joined.num_evaluations + ends[0].num_evaluations)


def _of_windows(cut: CutRecordings, joined: Joined) -> Found:
    """The end of the windows as that of the one trajectory that they are."""
    problem, x = cut.problem, joined.x
    simulated, slopes = cut.stitched(x, joined.states)
    values = problem.to_values(x)
    residuals, jacobian = problem.rows(values, simulated), problem.row_slopes(x, simulated, slopes)
    said = f"windows with gaps up to {joined.gap:.1e} of a typical size"
    status, message = judge(problem.free, x, residuals, jacobian, said)
    if joined.gap > CONTINUOUS:
        status, message = "stalled", f"the search stopped before the windows were one trajectory: {said}"
    else:
        message = f"{message}; {said}: a single trajectory cannot follow the recording that far"
    cost = 0.5 * float(residuals @ residuals)
    return Found(values, x, tuple(simulated), tuple(slopes), cost, status, message, 0, followed=False)
