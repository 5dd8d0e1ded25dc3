"""What an accumulator takes in when the pressure steps, what is shared by all cycles, and the pre-charge of one cycle.

    taken = V_o(p_after) - V_o(p_before) + C_line (p_after - p_before),   V_o: `jaxlines.Accumulator.oil_volume`,
    p_pre(T) = p_label (1 + s (T - 293.15 K)/293.15 K)

The gas is as warm as the oil; s is 1 for an ideal gas filled at 20 C. Shared: V_0, n, C_line, s, width of the switch.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from precharge_data import Cycles

import jaxlines as jl
from jaxlines.inference.least_squares import FunctionProblem, solve
from jaxlines.inference.robust_covariance import uncertainty_under_noise
from jaxlines.simulation.precision import computing_in

LABELS = ("volume_l", "polytropic_index", "line_ml_per_bar", "warming", "switch_width", "meter_per_kelvin")
LOWER, UPPER = np.array([0.05, 1.0, 0.0, 0.0, 0.003, -0.02]), np.array([5.0, 1.79, 2.0, 3.0, 0.05, 0.02])
START = np.array([0.5, 1.4, 0.1, 1.0, 0.02, 0.0])
NOISE, FREEDOM = 1e-6, 2.0  # of a volume taken in [m^3], and degrees of freedom of its Student distribution
BLOCK = 20  # neighbouring cycles that are kept together
GRID = np.arange(50e5, 190e5, 0.25e5)  # pre-charges tried [Pa absolute at 20 C]
CHI_SQUARE, CAP = 3.84, 9.0  # of the 95 % interval; squares of residuals count at most so much (outliers)


def taken_in(shared, precharge, temperature, before, after):
    """Volume taken in [m^3]. Args: shared numbers, see `LABELS`; the rest broadcast: [Pa], [K], [Pa], [Pa]."""
    volume, index, line, warming, width, meter = (shared[i] for i in range(len(LABELS)))
    warm = precharge * (1.0 + warming * (temperature - 293.15) / 293.15)
    accumulator = jl.Accumulator("line", 1e-3 * volume, warm, index, width)
    gained = accumulator.oil_volume(after) - accumulator.oil_volume(before)
    return (gained + 1e-11 * line * (after - before)) * (1.0 + meter * (temperature - 318.15))


def student(rows):
    """Rows whose squares are those of a Student likelihood, r^2 -> (v + 1) ln(1 + r^2/v): outliers count little."""
    size = rows**2 / FREEDOM + 1e-12
    return rows * jnp.sqrt((1.0 + 1.0 / FREEDOM) * jnp.log1p(size) / size)


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Shared numbers with 95 % ends, noise of a step [m^3, shape (steps,)], and what the residuals say.

    excess: by how much the cost at the label exceeds the least cost in 95 % of the cycles calibrated on; 3.84 if steps
    erred independently. It takes up what all steps of a cycle share, and bounds the intervals of readings.
    """

    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    status: str
    noise: np.ndarray
    bias: np.ndarray
    sentence: str
    neighbours: float
    excess: float = CHI_SQUARE

    @property
    def at_bound(self) -> list[str]:
        """Shared numbers that lie on a bound."""
        near = np.minimum(self.values - LOWER, UPPER - self.values) < 1e-6 * (UPPER - LOWER)
        return [name for name, on in zip(LABELS, near, strict=True) if on]


def _order(cycles: Cycles, keep) -> dict:
    """Where rows come from: blocks of `BLOCK` neighbouring cycles as recordings, steps as channels, cycles as times."""
    number = cycles.number[keep[0]]
    return {"recording": number // BLOCK, "channel": keep[1], "time": number % BLOCK}


def calibrate(cycles: Cycles) -> Calibration:
    """Shared numbers from cycles whose labels are believed (Student likelihood), intervals by the residuals' noise."""
    keep = np.nonzero(cycles.usable)
    label, warmth = cycles.label[keep[0]], cycles.temperature[keep[0]]
    before, after, taken = cycles.before[keep], cycles.after[keep], cycles.taken[keep]

    def rows(x):
        return student((taken_in(x, label, warmth, before, after) - taken) / NOISE)

    problem = FunctionProblem(rows, LABELS, LOWER, UPPER, **_order(cycles, keep))
    end = solve(problem, START)
    noise = uncertainty_under_noise(problem, end)
    reach = noise.factor * noise.sd
    left = np.full(cycles.taken.shape, np.nan)
    with computing_in("float64"):
        left[keep] = np.asarray(taken_in(end.x, label, warmth, before, after)) - taken
    mean = np.nanmean(left, axis=1)
    mean = mean[np.isfinite(mean)]
    found = Calibration(
        values=end.x,
        low=np.maximum(end.x - reach, LOWER),
        high=np.minimum(end.x + reach, UPPER),
        status=end.status,
        noise=1.4826 * np.nanmedian(np.abs(left - np.nanmedian(left, axis=0)), axis=0),
        bias=np.nanmedian(left, axis=0),
        sentence=noise.sentence,
        neighbours=float(np.corrcoef(mean[1:], mean[:-1])[0, 1]),
    )
    return dataclasses.replace(found, excess=excess(cycles, found))


def costs(cycles: Cycles, calibration: Calibration) -> np.ndarray:
    """Sum of squares over steps, in noise levels, for every pre-charge of `GRID` and every cycle."""
    with computing_in("float64"):
        shown = taken_in(
            calibration.values,
            jnp.asarray(GRID)[:, None, None],
            cycles.temperature[None, :, None],
            cycles.before[None],
            cycles.after[None],
        )
        squares = np.square((np.asarray(shown) - cycles.taken) / calibration.noise)
    return np.where(cycles.usable, np.minimum(squares, CAP), 0.0).sum(axis=2)


def excess(cycles: Cycles, calibration: Calibration) -> float:
    """The 95 % quantile of the cost at the label less the least cost, over cycles; at least 3.84.

    Reference: Vovk, Gammerman and Shafer, "Algorithmic Learning in a Random World", 2005 (conformal prediction).
    """
    cost, told = costs(cycles, calibration), cycles.usable.any(axis=1)
    labelled = cost[np.argmin(np.abs(GRID[:, None] - cycles.label), axis=0), np.arange(cycles.label.size)]
    return max(CHI_SQUARE, float(np.quantile((labelled - cost.min(axis=0))[told], 0.95)))


class Reading(NamedTuple):
    """Pre-charge of each cycle with the ends of its 95 % interval [Pa absolute at 20 C], NaN where nothing is usable;
    open_ended: the interval reaches an end of what was tried. It holds for cycles like those calibrated on (`excess`),
    and is too narrow at other temperatures, where the calibration itself is in doubt."""

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    open_ended: np.ndarray


def read_precharge(cycles: Cycles, calibration: Calibration) -> Reading:
    """The pre-charge of every cycle by likelihood over a grid, from pressure, flow and temperature alone."""
    cost = costs(cycles, calibration)
    inside = cost <= cost.min(axis=0) + calibration.excess
    best = GRID[np.argmin(cost, axis=0)]
    low, high = GRID[np.argmax(inside, axis=0)], GRID[GRID.size - 1 - np.argmax(inside[::-1], axis=0)]
    told = cycles.usable.any(axis=1)
    ends = [np.where(told, x, np.nan) for x in (best, low, high)]
    return Reading(ends[0], ends[1], ends[2], inside[0] | inside[-1] | ~told)
