"""What looks wrong in a recording, in words: times out of order, dead or clipped channels, likely slips."""

from pathlib import Path

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.edge.unit_words import heading_parts, kind_of, unit_of
from jaxlines.edge.units import split_level
from jaxlines.physics.fields import ATMOSPHERE

MIN_SAMPLES = 10


def check_times(times, where: str) -> None:
    """Raise ValueError for too few samples, holes, and times that do not increase [s]."""
    if times.size < MIN_SAMPLES:
        raise ValueError(f"{where}: {times.size} samples; a recording needs {MIN_SAMPLES} or more")
    if not np.all(np.isfinite(times)):
        raise ValueError(f"{where} is empty or not finite in data row {int(np.argmin(np.isfinite(times))) + 1}")
    steps = np.diff(times)
    if not np.all(steps > 0):
        row = int(np.argmin(steps > 0)) + 2
        repeated = steps[row - 2] == 0
        slip = (
            "is the time rounded too far, or a row repeated?"
            if repeated
            else "are rows out of order, or two runs in one file?"
        )
        raise ValueError(
            f"{where} does not increase in data row {row} ({times[row - 2]:g} s, then {times[row - 1]:g} s): {slip}"
        )


def time_warnings(times, unit: str) -> list[str]:
    """What is odd about times [s] that were read in a unit: gaps, steps that look like another unit."""
    steps, found = np.diff(times), []
    step = float(np.median(steps))
    gaps = np.flatnonzero(steps > 5.0 * step)
    if gaps.size:
        first = gaps[0]
        more = f" and {gaps.size - 1} more" if gaps.size > 1 else ""
        found.append(
            f"time: gap of {steps[first]:.3g} s after {times[first]:g} s{more} (the usual step is {step:.3g} s)"
        )
    if unit == "s" and step >= 1.0 and times[-1] - times[0] > 1000.0:
        found.append(f"time: the usual step is {step:g} s: are these milliseconds?")
    if unit == "ms" and step < 1e-6:
        found.append(f"time: the usual step is {step:g} s: are these seconds?")
    return found


def pressure_warnings(values, where: str, unit: str, atmospheric_pressure: float = ATMOSPHERE) -> list[str]:
    """What is odd about absolute pressures [Pa] that were read in a unit.

    Raises: ValueError for pressures below zero, with the likely slip.
    """
    bare, suffix = split_level(unit.split()[-1])
    lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
    if lowest < 0:
        slip = f"is it gauge ({bare}_g)?" if suffix == "a" else "is the zero of the sensor wrong?"
        raise ValueError(f"{where}: absolute pressure falls to {lowest:.4g} Pa, below zero: {slip}")
    found = []
    if highest > 2e8:
        found.append(f"{where}: rises to {highest / 1e5:.4g} bar: is it kPa or psi, not {bare}?")
    rest = float(np.nanmedian(values[np.isfinite(values)][: max(5, values.size // 100)]))
    if suffix == "g" and abs(rest - 2.0 * atmospheric_pressure) < 0.04 * atmospheric_pressure:
        found.append(
            f"{where}: starts one atmosphere above gauge zero, where a vented line read in absolute pressure would be: "
            f"is it {bare}_a?"
        )
    if suffix == "a" and rest < 0.1 * atmospheric_pressure:
        found.append(
            f"{where}: starts at {rest / 1e5:.3g} bar absolute, near vacuum, where a vented line in gauge pressure "
            f"would be: is it {bare}_g?"
        )
    return found


def channel_warnings(values, where: str, si_unit: str) -> list[str]:
    """What is odd about a channel in SI: missing samples, dead, clipped."""
    unit, factor = readable_unit(si_unit, float(np.nanmax(np.abs(values))))
    finite, found = values[np.isfinite(values)], []
    if finite.size < values.size:
        missing = values.size - finite.size
        found.append(f"{where}: {missing} of {values.size} samples are missing and are left out")
    low, high = finite.min(), finite.max()
    if low == high:
        return [*found, f"{where}: constant at {low * factor:g} {unit}: is the channel dead?"]
    for extreme, word in ((low, "lowest"), (high, "highest")):
        at = np.concatenate([[False], finite == extreme, [False]])
        edges = np.flatnonzero(np.diff(at.astype(int)))
        longest = int((edges[1::2] - edges[::2]).max())
        # A rest state also repeats; a clipped signal stays at its extreme in a run and comes back.
        if at.sum() >= max(5, 0.01 * finite.size) and longest >= 3:
            share = 100.0 * at.sum() / finite.size
            found.append(
                f"{where}: {share:.2g} % of the samples sit exactly at the {word} value "
                f"{extreme * factor:.6g} {unit}: clipped?"
            )
    return found


def heading_warnings(column: str, stated: str, unit: str, path: Path, what: str) -> list[str]:
    """A unit that differs from the one that the file states for a column.

    Args: column: its heading; stated: the unit of a row of units, or ""; unit: the one it is read in; what: the
        channel, for messages.
    Returns: a sentence where both measure the same. Raises: ValueError where they do not: columns are swapped.
    """
    said = unit_of(stated) if stated else heading_parts(column)[1]
    if unit[:1].isdigit() or unit[:1] in "+-.":  # scaled: the heading may state volts
        return []
    bare = split_level(unit)[0]
    if said is None or said in ("1", "V", "mV", "mA", "A") or split_level(said)[0] == bare:
        if said is not None and "_" in said and "_" in unit and said != unit:
            return [f"{what} ({column}): the file says {said}, it is read as {unit}"]
        return []
    theirs, ours = kind_of(said), kind_of(unit_of(unit))
    if theirs != ours:
        raise ValueError(
            f"{path}: column {column!r} is in {said} by its heading, which measures {theirs}, but {what} reads it in "
            f"{unit}: are columns swapped?"
        )
    return [f"{what} ({column}): the file says {said}, it is read in {unit}"]
