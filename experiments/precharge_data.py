"""Exchanges of oil between line and accumulator in the cycles of a hydraulic test rig.

Input: `all_cycles_1hz.parquet` (cycle, t_s, PS1 [bar], FS1 [l/min], TS1 [degC], ...: means over 1 s) and `profile.csv`
(cycle, cooler_pct, accumulator_bar, stable_flag, ...) of the condition-monitoring rig of ZeMA (UCI "Condition
monitoring of hydraulic systems"; Helwig, Pignanelli and Schuetze, 2015). The accumulators lie before the flow meter.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd

STEPS = (19, 29, 39, 49)
"""Seconds of a cycle in which the load valve changes the pressure while the pump delivers without a stop."""
SOURCE = 'UCI machine learning repository, "Condition monitoring of hydraulic systems"'
ATMOSPHERE_BAR = 1.01325


class MissingData(Exception):
    """A file that the study needs is not there; says where to get it."""


@dataclasses.dataclass(frozen=True)
class Cycles:
    """One row a cycle, one column a step of pressure.

    taken: oil that the line and accumulator took in [m^3]; before, after: absolute pressures [Pa]; usable: a step of
    at least 3 bar, nothing missing; temperature of the oil [K]; label: pre-charge by the rig [Pa absolute];
    group: the cooler's setting; stable: whether the rig had settled; number: of the cycle.
    """

    taken: np.ndarray
    before: np.ndarray
    after: np.ndarray
    usable: np.ndarray
    temperature: np.ndarray
    label: np.ndarray
    group: np.ndarray
    stable: np.ndarray
    number: np.ndarray

    def __getitem__(self, keep) -> "Cycles":
        return Cycles(**{f.name: getattr(self, f.name)[keep] for f in dataclasses.fields(self)})


def exchange(pressure: np.ndarray, flow: np.ndarray, second: int):
    """Volume that passed the meter beyond the steady flow around a step, and pressures before and after.

    Args: pressure [bar], flow [l/min]: means over 1 s, shape (cycles, seconds); second: of the step. The steady flow
    falls with pressure (leakage of the pump) and is drawn as a straight line between both plateaus.
    Returns: volume that left the accumulator [l], pressure before and after [bar], each of shape (cycles,).
    """
    early, late, middle = slice(second - 4, second - 1), slice(second + 3, second + 6), slice(second - 1, second + 3)
    before, after = pressure[:, early].mean(axis=1), pressure[:, late].mean(axis=1)
    first, last = flow[:, early].mean(axis=1), flow[:, late].mean(axis=1)
    step = np.where(np.abs(after - before) < 1.0, np.nan, after - before)
    share = (pressure[:, middle] - before[:, None]) / step[:, None]
    steady = first[:, None] + (last - first)[:, None] * share
    return (flow[:, middle] - steady).sum(axis=1) / 60.0, before, after


def cycles_of(table: pd.DataFrame, profile: pd.DataFrame) -> Cycles:
    """Every cycle of which all seconds are there."""
    wide = {name: table.pivot(index="cycle", columns="t_s", values=name) for name in ("PS1", "FS1", "TS1")}
    index = np.intersect1d(wide["PS1"].index.to_numpy(), profile["cycle"].to_numpy())
    pressure, flow, warmth = (wide[name].loc[index].to_numpy(float) for name in ("PS1", "FS1", "TS1"))
    found = [exchange(pressure, flow, second) for second in STEPS]
    left, before, after = (np.stack(part, axis=1) for part in zip(*found, strict=True))
    rows = profile.set_index("cycle").loc[index]
    return Cycles(
        taken=-1e-3 * left,
        before=1e5 * (before + ATMOSPHERE_BAR),
        after=1e5 * (after + ATMOSPHERE_BAR),
        usable=np.isfinite(left) & (np.abs(after - before) > 3.0),
        temperature=warmth.mean(axis=1) + 273.15,
        label=1e5 * (rows["accumulator_bar"].to_numpy(float) + ATMOSPHERE_BAR),
        group=rows["cooler_pct"].to_numpy(),
        stable=rows["stable_flag"].to_numpy() == 0,
        number=index,
    )


def read_cycles(folder: Path) -> Cycles:
    """The rig's cycles. Raises: MissingData."""
    files = [folder / "all_cycles_1hz.parquet", folder / "profile.csv"]
    for file in files:
        if not file.exists():
            raise MissingData(f"{file} is missing: {SOURCE}")
    return cycles_of(pd.read_parquet(files[0], columns=["cycle", "t_s", "PS1", "FS1", "TS1"]), pd.read_csv(files[1]))
