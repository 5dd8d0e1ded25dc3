"""The search for an excitation: sequential quadratic programming from several starts, on exact derivatives."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxlines.inference.design_criteria import Goal
from jaxlines.inference.design_model import DesignModel, Outcome, message_of
from jaxlines.inference.design_space import TOLERANCE, Space

WINDOWS = 24
"""A limit of an output is kept by its largest value in each of so many pieces of the test."""

_FAR = 1e2


class Trial(NamedTuple):
    """Everything about one set of coefficients.

    outcomes: one a scenario; values: criterion of each; goal: what counts; slopes: d values / d coefficients; room:
    distance to the limits of outputs, in parts of their ranges, not negative where kept, shape (limits,); room_slopes.
    """

    outcomes: list[Outcome]
    values: np.ndarray
    goal: float
    slopes: np.ndarray
    room: np.ndarray
    room_slopes: np.ndarray

    @property
    def ok(self) -> bool:
        """Whether every simulation worked."""
        return all(outcome.ok for outcome in self.outcomes)

    @property
    def kept(self) -> bool:
        """Whether the limits of outputs are kept."""
        return self.ok and bool(np.all(self.room >= -TOLERANCE))


class OutputLimit(NamedTuple):
    """An output that the test must keep between two values [unit of the output]; infinite ones do not count."""

    name: str
    low: float
    high: float

    @property
    def range(self) -> float:
        """A size by which distances are measured."""
        finite = [abs(end) for end in (self.low, self.high) if np.isfinite(end)]
        return self.high - self.low if len(finite) == 2 else max(*finite, 1e-300)


class Start(NamedTuple):
    """One search: goal at its start and end, whether the end keeps all limits, iterations, what the optimiser said."""

    before: float
    after: float
    kept: bool
    iterations: int
    message: str


@dataclasses.dataclass(eq=False)
class Search:
    """The goal as a function of the coefficients of all excitations, with every limit.

    Fields: model; scenarios: parameter values in SI, shape (scenarios, free); goal; mask: which samples are measured,
    shape (times, sensors); limits of outputs.
    """

    model: DesignModel
    scenarios: np.ndarray
    goal: Goal
    mask: np.ndarray
    limits: tuple[OutputLimit, ...]
    count: int = 0
    _last: tuple[bytes, Trial] | None = None

    def outcome_rows(self, outcome: Outcome) -> np.ndarray:
        """Rows of the samples that are measured, shape (samples, free + known)."""
        return outcome.rows[self.mask]

    def information(self, outcomes: list[Outcome]) -> np.ndarray:
        """R'R of each scenario."""
        return np.stack([r.T @ r for r in (self.outcome_rows(o) for o in outcomes)])

    def trial(self, coefficients) -> Trial:
        """Simulate with derivatives; the last one is remembered."""
        key = np.asarray(coefficients, dtype=float).tobytes()
        if self._last is None or self._last[0] != key:
            self.count += 1
            self._last = (key, self._trial(coefficients))
        return self._last[1]

    def _trial(self, coefficients) -> Trial:
        count = len(coefficients)
        look = self.model.derive if count else self.model.evaluate
        outcomes = [look(values, coefficients) for values in self.scenarios]
        if not count:  # nothing to differentiate by
            shape = self.model.times.size, len(self.model.outputs), 0
            none = {"row_slopes": np.zeros((*outcomes[0].rows.shape, 0)), "output_slopes": np.zeros(shape)}
            outcomes = [outcome._replace(**none) for outcome in outcomes]
        if not all(outcome.ok for outcome in outcomes):
            shape, limits = (len(self.scenarios), count), self.num_limits
            no_room = -np.ones(limits), np.zeros((limits, count))  # as many as ever: the optimiser counts on it
            return Trial(outcomes, np.full(shape[0], _FAR), _FAR, np.zeros(shape), *no_room)
        information = self.information(outcomes)
        values, slopes, room = self.goal.values(information), [], []
        for outcome, criterion, own in zip(outcomes, self.goal.criteria, information, strict=True):
            assert outcome.row_slopes is not None
            pulled = self.outcome_rows(outcome) @ criterion.slope(own)
            slopes.append(2.0 * np.einsum("rp,rpk->k", pulled, outcome.row_slopes[self.mask]))
            room.append(self._room(outcome))
        distances, by = (np.concatenate(part) for part in zip(*room, strict=True))
        return Trial(outcomes, values, float(self.goal.combine(values)), np.stack(slopes), distances, by)

    def _room(self, outcome: Outcome) -> tuple[np.ndarray, np.ndarray]:
        """Distances to the limits of outputs, the smallest of each window, and their derivatives."""
        distances, slopes = [np.zeros(0)], [np.zeros((0, self.model.num_coefficients))]
        pieces = self._pieces
        for limit in self.limits:
            column = self.model.outputs.index(limit.name)
            shown = outcome.outputs[:, column]
            for end, sign in ((limit.low, 1.0), (limit.high, -1.0)):
                if not np.isfinite(end):
                    continue
                room = sign * (shown - end) / limit.range
                at = np.array([piece[np.argmin(room[piece])] for piece in pieces])
                distances.append(room[at])
                assert outcome.output_slopes is not None
                slopes.append(sign * outcome.output_slopes[at, column] / limit.range)
        return np.concatenate(distances), np.concatenate(slopes)

    @property
    def _pieces(self) -> list[np.ndarray]:
        """Indices of the samples of each window."""
        return np.array_split(np.arange(self.model.times.size), min(WINDOWS, self.model.times.size))

    @property
    def num_limits(self) -> int:
        """Distances to limits of outputs over all scenarios."""
        ends = sum(int(np.isfinite(limit.low)) + int(np.isfinite(limit.high)) for limit in self.limits)
        return ends * len(self._pieces) * len(self.scenarios)


class Best(NamedTuple):
    """The best coefficients seen that keep every limit; trial: what they give (None: none seen)."""

    coefficients: np.ndarray
    trial: Trial | None


class _Watch:
    """Trials at scaled coefficients; keeps the best that is within every limit."""

    def __init__(self, search: Search, space: Space, best: Best):
        self.search, self.space, self.best = search, space, best

    def __call__(self, z) -> Trial:
        coefficients = self.space.coefficients(z)
        trial = self.search.trial(coefficients)
        better = self.best.trial is None or trial.goal < self.best.trial.goal
        if better and trial.kept and self.space.kept(z):
            self.best = Best(coefficients, trial)
        return trial


def _plain(at: _Watch, z) -> dict:
    """The arguments of SciPy's `minimize` that make the mean of all scenarios small."""
    constraints = at.space.constraints()
    if at.search.limits:
        by = at.space.width
        constraints.append({"type": "ineq", "fun": lambda z: at(z).room, "jac": lambda z: at(z).room_slopes * by})
    return {
        "fun": lambda z: at(z).goal,
        "x0": z,
        "jac": lambda z: at(z).slopes.mean(axis=0) * at.space.width,
        "bounds": [tuple(pair) for pair in at.space.ends],
        "constraints": constraints,
    }


def _worst(at: _Watch, z) -> dict:
    """The same for the worst scenario: an upper bound of all of them, the last variable, is lowered (epigraph form)."""
    plain, size = _plain(at, z), z.size

    def widened(constraint: dict) -> dict:
        def slope(y):
            jac = np.atleast_2d(constraint["jac"](y[:size]))
            return np.concatenate([jac, np.zeros((len(jac), 1))], axis=1)

        return {"type": "ineq", "fun": lambda y: constraint["fun"](y[:size]), "jac": slope}

    def above_slope(y):
        by = at(y[:size]).slopes * at.space.width
        return np.concatenate([-by, np.ones((len(by), 1))], axis=1)

    above = {"type": "ineq", "fun": lambda y: y[size] - at(y[:size]).values, "jac": above_slope}
    return {
        "fun": lambda y: float(y[size]),
        "x0": np.append(z, at(z).goal),
        "jac": lambda y: np.eye(size + 1)[size],
        "bounds": [*plain["bounds"], (-_FAR, _FAR)],
        "constraints": [*(widened(c) for c in plain["constraints"]), above],
    }


def descend(search: Search, space: Space, z, best: Best, max_iterations: int) -> tuple[Best, Start]:
    """One search by sequential quadratic programming (SciPy's SLSQP) from scaled coefficients z.

    Returns: the best point within every limit that was seen until now, and how the search went.
    Reference: Kraft, "A software package for sequential quadratic programming", DFVLR-FB 88-28, 1988.
    """
    from scipy.optimize import minimize

    at = _Watch(search, space, best)
    before = at(z).goal
    made = _worst(at, z) if search.goal.how == "worst" else _plain(at, z)
    found = minimize(**made, method="SLSQP", options={"maxiter": max_iterations, "ftol": 1e-7})
    end = found.x[: z.size]
    last = at(end)
    kept = last.kept and space.kept(end)
    return at.best, Start(before, last.goal, kept, int(found.nit), str(found.message))


def random_start(search: Search, space: Space, rng: np.random.Generator) -> np.ndarray:
    """A random profile within the limits of the inputs, drawn towards the given one until it can be simulated."""
    drawn = space.nearest(rng.uniform(space.ends[:, 0], space.ends[:, 1]))
    given = space.nearest(space.start)
    for share in (1.0, 0.5, 0.25, 0.1):
        z = given + share * (drawn - given)
        if search.trial(space.coefficients(z)).ok:
            return z
    return given


def check_start(search: Search, space: Space) -> Trial:
    """What the given start gives. Raises ValueError where it cannot be simulated."""
    trial = search.trial(space.coefficients(space.nearest(space.start)))
    for number, outcome in enumerate(trial.outcomes):
        if not outcome.ok:
            words = message_of(outcome.status) if outcome.status != "ok" else "a derivative is not finite"
            whose = "the nominal values" if number == 0 else f"parameter sample {number}"
            raise ValueError(
                f"the starting excitation cannot be simulated with {whose}: {words}: begin with a milder one"
            )
    return trial
