"""Pictures of designed tests: each function draws into Axes (new ones by default) and returns them."""

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.edge.plots import BAND, MAX_POINTS, MEASURED, SIMULATED, _axes, _label, _largest, decimate
from jaxlines.inference.design_result import Design


def plot_design_input(design: Design, name: str, axes=None):
    """A designed input over time, the starting one behind it, and the limits of its level."""
    axes, profile = _axes(axes), design.profiles[name]
    unit, factor = readable_unit(profile.unit, _largest(profile.values))
    for end in (profile.low, profile.high):
        axes.axhline(end * factor, color=MEASURED, lw=0.8, ls=":")
    axes.plot(profile.times, profile.base_values * factor, color=MEASURED, lw=1.4, label="starting test")
    axes.plot(profile.times, profile.values * factor, color=SIMULATED, lw=1.8, marker=".", label="designed test")
    axes.set(xlabel="time [s]", ylabel=_label(name, unit))
    axes.legend(frameon=False, loc="best")
    axes.margins(x=0)
    return axes


def plot_design_output(design: Design, name: str, axes=None, limit: int = MAX_POINTS):
    """What an output will show in the designed and the starting test, its limits, and the instants that are read."""
    axes, values = _axes(axes), design.outputs[name]
    unit, factor = readable_unit(design.output_units[name], _largest(values))
    ends = [end for own in design.limits if own.name == name for end in (own.low, own.high) if np.isfinite(end)]
    for end in ends:
        axes.axhline(end * factor, color=MEASURED, lw=0.8, ls=":")
    times = design.candidate_times
    base = design.base_outputs[name] * factor
    axes.plot(*decimate(times, base, limit), color=MEASURED, lw=1.4, label="starting test")
    axes.plot(*decimate(times, values * factor, limit), color=SIMULATED, lw=1.6, label="designed test")
    if name in design.candidate_sensors:
        read = design.measured[:, design.candidate_sensors.index(name)] > 0
        if 0 < read.sum() < read.size:
            axes.plot(times[read], values[read] * factor, "o", ms=4, color=SIMULATED, label="readings")
    axes.set(xlabel="time [s]", ylabel=_label(name, unit))
    axes.legend(frameon=False, loc="best")
    axes.margins(x=0)
    return axes


def plot_design_gain(design: Design, axes=None):
    """Standard deviation of each parameter after the designed test, in parts of that after the starting test."""
    axes = _axes(axes)
    rows = [row for row in design.table() if row["ratio"] is not None]
    shares, places = [100.0 / row["ratio"] for row in rows], np.arange(len(rows))
    axes.barh(places, shares, color=BAND, alpha=0.5, height=0.6)
    axes.axvline(100.0, color=MEASURED, lw=1.2, ls="--")
    axes.set_yticks(places, [row["name"] for row in rows])
    axes.invert_yaxis()
    axes.set_xlabel("standard deviation [% of the starting test's]")
    return axes
