"""Pictures of fits and simulations: each function draws into Axes (new ones by default) and returns them."""

import itertools

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.inference.analysis import ChannelFit
from jaxlines.inference.curves import Curve
from jaxlines.simulation.line_response import LineResponse

MEASURED, SIMULATED, BAND = "#8b95a5", "#2f7fd1", "#2f7fd1"
MAX_POINTS = 4000


def decimate(times, values, limit: int = MAX_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """At most `limit` points of a curve that keep the lowest and the highest value of every stretch.

    Missing values (NaN) stay where a whole stretch is missing.
    """
    times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    if times.size <= limit:
        return times, values
    edges = np.linspace(0, times.size, max(1, limit // 2) + 1).astype(int)
    keep: set[int] = set()
    for start, stop in itertools.pairwise(edges):
        piece = values[start:stop]
        if np.all(np.isnan(piece)):
            keep.add(start)
        else:
            keep |= {start + int(np.nanargmin(piece)), start + int(np.nanargmax(piece))}
    kept = np.array(sorted(keep))
    return times[kept], values[kept]


def _axes(axes):
    """The given axes, or new ones on a figure of their own."""
    if axes is not None:
        return axes
    from matplotlib.figure import Figure

    return Figure(figsize=(7.5, 3.2), layout="constrained").add_subplot()


def _label(name: str, unit: str) -> str:
    """ "A.pressure [MPa]"."""
    return f"{name} [{unit}]" if unit else name


def _largest(values) -> float:
    """Largest absolute value that is finite; 0 when there is none."""
    finite = np.abs(np.asarray(values, dtype=float))
    finite = finite[np.isfinite(finite)]
    return float(finite.max()) if finite.size else 0.0


def plot_channel(channel: ChannelFit, name: str, axes=None, limit: int = MAX_POINTS):
    """Measured and simulated values of a fitted channel over time."""
    axes = _axes(axes)
    unit, factor = readable_unit(channel.unit, _largest(channel.measured))
    measured = np.where(channel.used, channel.measured, np.nan) * factor
    axes.plot(*decimate(channel.times, measured, limit), color=MEASURED, lw=2.4, alpha=0.7, label="measured")
    axes.plot(*decimate(channel.times, channel.simulated * factor, limit), color=SIMULATED, lw=1.4, label="simulated")
    axes.set(xlabel="time [s]", ylabel=_label(name, unit))
    axes.legend(frameon=False, loc="best")
    axes.margins(x=0)
    return axes


def plot_residuals(channel: ChannelFit, name: str, axes=None, limit: int = MAX_POINTS):
    """Measured minus simulated over time, with the band of twice the noise."""
    axes = _axes(axes)
    residuals = np.where(channel.used, channel.measured - channel.simulated, np.nan)
    unit, factor = readable_unit(channel.unit, _largest(residuals))
    axes.axhspan(-2 * channel.sigma * factor, 2 * channel.sigma * factor, color=BAND, alpha=0.15, lw=0)
    axes.plot(*decimate(channel.times, residuals * factor, limit), color=MEASURED, lw=0.8)
    axes.axhline(0.0, color=SIMULATED, lw=1.0)
    axes.set(xlabel="time [s]", ylabel=_label("residual", unit))
    axes.margins(x=0)
    return axes


def _plot_band(pressure, middle, low, high, label: str, factor: float, axes):
    """A curve over pressure with its band."""
    unit, scale = readable_unit("Pa", _largest(pressure))
    axes.fill_between(pressure * scale, low * factor, high * factor, color=BAND, alpha=0.25, lw=0, label="95 %")
    axes.plot(pressure * scale, middle * factor, color=SIMULATED, lw=1.4)
    axes.set(xlabel=f"absolute pressure [{unit}]", ylabel=label)
    axes.legend(frameon=False, loc="best")
    axes.margins(x=0)
    return axes


def plot_bulk_modulus(curve: Curve, axes=None):
    """Effective bulk modulus of a line over pressure, with its 95 % band."""
    unit, factor = readable_unit("Pa", _largest(curve.bulk_modulus))
    bands = curve.bulk_modulus, curve.bulk_modulus_low, curve.bulk_modulus_high
    return _plot_band(curve.pressure, *bands, f"effective bulk modulus [{unit}]", factor, _axes(axes))


def plot_wave_speed(curve: Curve, axes=None):
    """Wave speed of a line over pressure, with its 95 % band."""
    bands = curve.wave_speed, curve.wave_speed_low, curve.wave_speed_high
    return _plot_band(curve.pressure, *bands, "wave speed [m/s]", 1.0, _axes(axes))


def plot_line_response(response: LineResponse, axes=None):
    """Bode plot of a line's input impedance, as simulated and exact: magnitude and phase over frequency.

    Args: response: of `line_response`; axes: two Axes, one above the other (new ones by default). Returns them.
    """
    if axes is None:
        from matplotlib.figure import Figure

        axes = Figure(figsize=(7.5, 5.0), layout="constrained").subplots(2, 1, sharex=True)
    size, phase = axes
    curves = {"exact": (response.exact, MEASURED, 3.0), "as simulated": (response.simulated, SIMULATED, 1.3)}
    for label, (impedance, colour, width) in curves.items():
        size.loglog(response.frequencies, np.abs(impedance), color=colour, lw=width, label=label)
        phase.semilogx(response.frequencies, np.degrees(np.angle(impedance)), color=colour, lw=width)
    size.set_title(f"{response.name}, {response.end} at the far end, {1e-6 * float(response.pressure):.3g} MPa")
    size.set_ylabel("impedance [Pa s/m³]")
    size.legend()
    phase.set(xlabel="frequency [Hz]", ylabel="phase [°]", ylim=(-185, 185), yticks=range(-180, 181, 90))
    return axes
