"""What is known before a test: by priors, and by an earlier fit."""

import dataclasses

import numpy as np

from jaxlines.inference.analysis import slopes_by_values
from jaxlines.inference.design_criteria import stated_covariance
from jaxlines.inference.design_model import DesignModel
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.priors import Prior
from jaxlines.inference.search import Found


@dataclasses.dataclass(frozen=True, eq=False)
class Before:
    """What is known before the test, at values in SI.

    Fields: rows: of priors and of an earlier fit, shape (rows, free + held), by free parameters in scaled coordinates,
    then by held numbers in units of their standard uncertainty: the known ones of the test, then those that only the
    earlier recordings rest on; num_free.
    """

    rows: np.ndarray
    num_free: int

    @property
    def information(self) -> np.ndarray:
        """R_f'R, and the bounds as if they were a standard deviation as wide as they are: (free, free + held)."""
        free = self.rows[:, : self.num_free]
        return free.T @ self.rows + np.eye(self.num_free, self.rows.shape[1])

    @property
    def covariance(self) -> np.ndarray:
        """What the rows state of the free parameters in scaled coordinates; infinite where nothing is known."""
        if not self.rows.size:
            return np.diag(np.full(self.num_free, np.inf))
        return stated_covariance(self.rows, self.num_free)

    @property
    def sizes(self) -> np.ndarray:
        """Standard deviation before the test in scaled coordinates; 1, the width of the bounds, where none is known."""
        sd = np.sqrt(np.diag(self.covariance))
        return np.where(np.isfinite(sd), np.minimum(sd, 1.0), 1.0)

    def with_rows(self, rows) -> np.ndarray:
        """Rows of a test, shape (samples, free + known), and these below them."""
        wide = np.zeros((len(rows), self.rows.shape[1]))
        wide[:, : rows.shape[1]] = rows
        return np.concatenate([wide, self.rows])


def known_before(model: DesignModel, values, earlier: Fit | None) -> Before:
    """Priors, or an earlier fit (which counted its priors already). Raises ValueError when its parameters differ.

    Start values are new in every test: of these the priors count, and not what an earlier recording said.
    """
    size = len(model.free)
    counted = np.array([isinstance(f.prior, Prior) and not f.prior.flat for f in model.free])
    if earlier is None:
        told = np.zeros((0, size + len(model.known)))
    else:
        told = _earlier_rows(model, earlier)
        counted &= _start_values(model)
    rows = np.zeros((int(counted.sum()), told.shape[1]))
    for row, i in enumerate(np.flatnonzero(counted)):
        prior = model.free[i].prior
        assert isinstance(prior, Prior)
        rows[row, i] = prior.slope(values[i]) * model.slopes(values)[i] * model.scale[i]
    return Before(np.concatenate([told, rows]), size)


def _start_values(model: DesignModel) -> np.ndarray:
    """Whether each free parameter is a start value, shape (free,)."""
    return np.array([all(path.startswith("initial.") for path in f.paths) for f in model.free])


def _earlier_rows(model: DesignModel, earlier: Fit) -> np.ndarray:
    """What an earlier fit tells of all but its own start values, as few rows with that information (see `Before`)."""
    problem, x = earlier.problem, earlier.coordinates
    if problem is None or x is None:
        raise ValueError("the earlier fit failed, so that it says nothing of what is known")
    mine = [(f.label, f.transform) for f in model.free]
    theirs = [(f.label, f.transform) for f in problem.free]
    if mine != theirs:
        raise ValueError(
            "the earlier fit must have the same free parameters and transforms: "
            f"{', '.join(n for n, _ in theirs)}; the design has {', '.join(n for n, _ in mine)}"
        )
    values = problem.to_values(x)
    simulated, slopes = problem.sensitivities(values)
    found = Found(values, x, tuple(simulated), tuple(slopes), np.nan, "", "", 0)
    free, held = slopes_by_values(problem, found)
    free, held = free * model.slopes(values) * model.scale, held * np.array([k.sd for k in problem.known])
    start = _start_values(model)
    count, size = int(start.sum()), len(mine)
    upper = np.asarray(np.linalg.qr(np.concatenate([free[:, start], free[:, ~start], held], axis=1), mode="r"))
    shared = {k.path: size + i for i, k in enumerate(model.known) if not k.path.startswith("initial.")}
    columns, width = [], size + len(model.known)
    for number in problem.known:
        columns.append(shared.get(number.path, width))
        width += number.path not in shared
    rows = np.zeros((len(upper) - count, width))
    rows[:, np.flatnonzero(~start)] = upper[count:, count:size]
    rows[:, columns] = upper[count:, size:]
    return rows
