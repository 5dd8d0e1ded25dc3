"""Recordings and geometry of the waterway of a hydropower plant, and what the formulas say from geometry alone.

Input: `start_1hz.csv` or `full_1hz.csv` (t_s, p_turbine_in_bar, turbine_flow_m3s, ...) and `waterway_geometry.csv`
of the Trollheim plant (Vytvytskyi and Lie, Energies 12(12) 2303, 2019; github.com/OpenSimHub/OpenHPL, MPL-2.0).
"""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

DENSITY, GRAVITY = 1000.0, 9.80665  # of water [kg/m^3]; [m/s^2]
SOURCE = "Trollheim waterway data, github.com/OpenSimHub/OpenHPL"


class MissingData(Exception):
    """A file that the study needs is not there; says where to get it."""


@dataclasses.dataclass(frozen=True)
class Geometry:
    """The waterway by its drawing, SI: inertances rho L/A [Pa s^2/m^3], horizontal area of the shaft [m^2]."""

    tunnel_length: float
    tunnel_area: float
    tunnel_inertance: float
    tunnel_loss: float
    shaft_area: float
    shaft_inertance: float
    penstock_inertance: float
    rest_height: float

    @property
    def rigid_column_period(self) -> float:
        """T = 2 pi sqrt(L A_s/(g A_t)) of tunnel and shaft [s]; no friction, no inertia in the shaft."""
        return 2.0 * np.pi * np.sqrt(self.tunnel_length * self.shaft_area / (GRAVITY * self.tunnel_area))


def rough_loss(length, diameter, roughness) -> float:
    """R_2 = f rho L/(2 D A^2) [Pa s^2/m^6], with f of fully rough flow: 1/sqrt(f) = 2 log10(3.7 D/e) (Nikuradse)."""
    friction = (2.0 * np.log10(3.7 * diameter / roughness)) ** -2
    return friction * DENSITY * length / (2.0 * diameter * (0.25 * np.pi * diameter**2) ** 2)


def read_geometry(folder: Path) -> Geometry:
    """The numbers of `waterway_geometry.csv`. Raises: MissingData."""
    file = folder / "waterway_geometry.csv"
    if not file.exists():
        raise MissingData(f"{file} is missing: {SOURCE}")
    rows = {row["element"]: row for row in pd.read_csv(file).to_dict("records")}

    def numbers(kind: str, column: str) -> np.ndarray:
        return np.array([float(row[column]) for name, row in rows.items() if str(name).startswith(kind)])

    length, area = numbers("intake", "L_m"), 0.25 * np.pi * numbers("intake", "D_m") ** 2
    shafts = 0.25 * np.pi * numbers("surge_tank", "D_m") ** 2
    slant = numbers("surge_tank", "L_m") / numbers("surge_tank", "H_drop_m")
    pipe, section = numbers("penstock", "L_m"), 0.25 * np.pi * numbers("penstock", "D_m") ** 2
    level = float(str(rows["reservoir"]["note"]).split("=")[1].split("m")[0])
    rest = level + numbers("intake", "H_drop_m").sum()
    losses = zip(length, numbers("intake", "D_m"), numbers("intake", "roughness_m"), strict=True)
    return Geometry(
        tunnel_length=float(length.sum()),
        tunnel_area=float(length.sum() / (length / area).sum()),
        tunnel_inertance=float(DENSITY * (length / area).sum()),
        tunnel_loss=float(sum(rough_loss(*one) for one in losses)),
        shaft_area=float((shafts * slant)[0]),
        shaft_inertance=float((DENSITY * rest * slant / shafts)[0]),
        penstock_inertance=float(DENSITY * (pipe / section).sum()),
        rest_height=float(rest),
    )


@dataclasses.dataclass(frozen=True)
class Series:
    """Pressure before the turbine [Pa] and flow through it [m^3/s] over time [s]; `resting`: before it opens."""

    times: np.ndarray
    pressure: np.ndarray
    flow: np.ndarray

    @property
    def resting(self) -> np.ndarray:
        """True until 20 s before the flow first passes 2 % of its largest value (and at least for 20 samples)."""
        first = int(np.argmax(self.flow > 0.02 * self.flow.max()))
        return np.arange(self.times.size) < max(first - 20, 20)

    def until(self, end: float) -> "Series":
        """The part before this time [s]."""
        keep = self.times < end
        return Series(self.times[keep], self.pressure[keep], self.flow[keep])


def read_series(folder: Path) -> Series:
    """`full_1hz.csv` where it is, else `start_1hz.csv`. Raises: MissingData."""
    for name in ("full_1hz.csv", "start_1hz.csv"):
        if (folder / name).exists():
            rows = pd.read_csv(folder / name)
            t, p, q = (rows[c].to_numpy(float) for c in ("t_s", "p_turbine_in_bar", "turbine_flow_m3s"))
            there = np.isfinite(t) & np.isfinite(p) & np.isfinite(q)
            t, first = np.unique(t[there], return_index=True)
            return Series(t, 1e5 * p[there][first], q[there][first])
    raise MissingData(f"no start_1hz.csv or full_1hz.csv in {folder}: {SOURCE}")


def _damped_cosine(times, values, period):
    """Least squares of a quadratic trend and a damped cosine of a given period: (squares left, amplitude)."""
    t, best = times - times[0], (np.inf, 0.0)
    for decay in (0.0, 0.3, 0.6, 1.0, 1.5):  # e-folds over five periods
        wave = np.exp(-decay * t / (5.0 * period))
        angle = 2.0 * np.pi * t / period
        columns = np.column_stack([np.vander(t / t[-1], 3), wave * np.cos(angle), wave * np.sin(angle)])
        found, *_ = np.linalg.lstsq(columns, values, rcond=None)
        left = float(np.sum((values - columns @ found) ** 2))
        if left < best[0]:
            best = left, float(np.hypot(found[3], found[4]))
    return best


def surge_period(times, values, low: float = 50.0, high: float = 130.0) -> tuple[float, float]:
    """Period [s] and amplitude of a free surge: least squares of a damped cosine about a quadratic trend.

    Args: times [s], values; low, high: periods searched [s]. Returns (NaN, NaN) for less than two periods of `low`.
    """
    if times.size < 8 or times[-1] - times[0] < 2.0 * low:
        return np.nan, np.nan
    for step in (1.0, 0.1):
        grid = np.arange(low, high + 0.5 * step, step)
        period = float(grid[np.argmin([_damped_cosine(times, values, one)[0] for one in grid])])
        low, high = period - 1.0, period + 1.0
    return period, _damped_cosine(times, values, period)[1]
