"""Pictures of fits and simulations: each function draws into Axes (new ones by default) and returns them."""

import warnings
from collections.abc import Sequence

import numpy as np

from jaxlines.edge.display import readable_unit
from jaxlines.inference.analysis import ChannelFit
from jaxlines.inference.curves import Curve
from jaxlines.inference.least_squares import LeastSquaresProblem
from jaxlines.inference.posterior import Posterior
from jaxlines.inference.starts import Start
from jaxlines.inference.uncertainty import UNINFORMED
from jaxlines.simulation.line_response import LineResponse

MEASURED, SIMULATED, BAND = "#7c8796", "#2f7fd1", "#2f7fd1"
MAX_POINTS = 4000


def decimate(times, values, limit: int = MAX_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """At most `limit` points of a curve that keep the lowest and the highest value of every stretch.

    Missing values (NaN) stay where a whole stretch is missing.
    """
    times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    if times.size <= limit:
        return times, values
    width = -(-times.size // max(1, limit // 2))
    padded = np.concatenate([values, np.full(-times.size % width, np.nan)]).reshape(-1, width)
    missing = np.isnan(padded)
    starts = width * np.arange(len(padded))
    lowest = starts + np.where(missing, np.inf, padded).argmin(axis=1)
    highest = starts + np.where(missing, -np.inf, padded).argmax(axis=1)
    kept = np.unique([lowest, highest])
    return times[kept], values[kept]


def decimate_band(times, low, high, limit: int = MAX_POINTS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At most `limit` points of a band: of every stretch the lowest of `low` and the highest of `high`."""
    times, low, high = (np.asarray(values, dtype=float) for values in (times, low, high))
    if times.size <= limit:
        return times, low, high
    starts = np.linspace(0, times.size, limit + 1).astype(int)[:-1]
    return times[starts], np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)


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


def plot_starts(starts: Sequence[Start], axes=None):
    """Waterfall of a search from many starts: the cost at which each ended above the best, best first.

    Starts that end on a common step have found the same optimum; a single lowest point was found once and may not be
    the lowest there is. Failed starts are left out of the curve and counted in the label.

    Args: starts: of `Fit.starts`; axes (new ones by default). Returns the Axes; cost without unit, half a sum of
    squares. Reference: Raue and others, PLoS ONE 8, e74335, 2013.
    """
    from matplotlib.ticker import MaxNLocator

    axes = _axes(axes)
    costs = np.sort([start.cost for start in starts if np.isfinite(start.cost)])
    failed = len(starts) - costs.size
    label = f"{costs.size} ended" + (f", {failed} failed" if failed else "")
    above = np.maximum(costs - costs[:1], 1e-3)  # what differs by less is the same optimum
    axes.plot(np.arange(1, costs.size + 1), above, color=SIMULATED, lw=1.0, marker="o", ms=4, label=label)
    if costs.size:
        axes.set(yscale="log", ylim=(5e-4, max(1.0, 3 * above[-1])))
    axes.set(xlabel="starts, best first", ylabel="cost above the best")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(frameon=False, loc="upper left")
    return axes


def plot_profile(values, profile, name: str, unit: str = "1", axes=None, *, best=None, interval=None, level=3.84):
    """Profile likelihood of a number: twice the rise of the cost where the number is held and all others are fitted.

    Args: values [SI], shape (points,); profile: of `profile_curve`, shape (points,); name, unit of the number; axes;
    best: the estimate [SI]; interval: its two ends [SI], infinite where open; level: the height below which the 95 %
    interval lies (3.84 for known noise). Returns the Axes. Reference: Raue and others, Bioinformatics 25, 2009.
    """
    axes = _axes(axes)
    values, profile = np.asarray(values, dtype=float), np.asarray(profile, dtype=float)
    label, factor = readable_unit(unit, _largest(values))
    axes.plot(values * factor, profile, color=SIMULATED, lw=1.4, marker=".", label="profile")
    axes.axhline(level, color=MEASURED, lw=1.0, ls="--")
    if interval is not None:
        low, high = (float(np.clip(end, values.min(), values.max())) * factor for end in interval)
        axes.axvspan(low, high, color=BAND, alpha=0.15, lw=0)
    if best is not None:
        axes.axvline(best * factor, color=SIMULATED, lw=1.0, ls=":")
    axes.set(xlabel=_label(name, label), ylabel="2 (cost - lowest cost)", ylim=(0.0, None))
    axes.legend(frameon=False, loc="best")
    return axes


def plot_directions(problem: LeastSquaresProblem, coordinates, axes=None):
    """What data tell: each direction in the space of the free numbers as a bar, the best known at the top.

    A bar is made of the shares of the numbers in its direction (squares of the parts of a right singular vector of the
    Jacobian, scaled by the widths of the bounds). Its name is the standard error along it in % of those widths; pale
    ones are known no better than from the bounds alone, and the numbers in them cannot be told apart.

    Args: problem, coordinates: as `Fit.problem` and `Fit.coordinates`, with finite bounds; axes (new ones by default).
    Returns the Axes. Reference: Vajda and others, Chemical Engineering Science 40, 1985.
    """
    from matplotlib import colormaps

    axes = _axes(axes)
    scaled = problem.jacobian(np.asarray(coordinates, dtype=float)) * (problem.upper - problem.lower)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    place, left, colours = np.arange(singular.size), np.zeros(singular.size), colormaps["tab10"](np.arange(10))
    for k, (label, share) in enumerate(zip(problem.labels, directions.T**2, strict=True)):
        bars = axes.barh(place, 100 * share, left=left, height=0.7, color=colours[k % 10], label=label)
        left += 100 * share
        for bar, value in zip(bars, singular, strict=True):
            bar.set_alpha(1.0 if value > 1.0 / UNINFORMED else 0.35)
    errors = 100 / np.maximum(singular, 1e-12)
    names = [f"{error:.2g} %" if error < 100 * UNINFORMED else "open" for error in errors]
    axes.set(
        xlabel="share in the direction [%]", ylabel="standard error, of the bounds", ylim=(singular.size - 0.5, -0.5)
    )
    axes.set_yticks(place, names)
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    return axes


def plot_posterior(posterior: Posterior, to_values=None, axes=None):
    """Draws of a posterior, each pair of numbers against each other and each alone on the diagonal, by ArviZ.

    Args: posterior: of `sample_posterior`; to_values: coordinates -> values [SI], both shape (parameters,); axes, shape
    (parameters, parameters) (new ones by default). Divergent draws are marked. Returns the Axes.
    Raises: ImportError without ArviZ; ValueError for one number alone, which has no pair.
    """
    count = len(posterior.labels)
    if count < 2:
        raise ValueError(f"pairs need two numbers or more, the posterior has {', '.join(posterior.labels)} alone")
    draws = posterior.to_arviz(to_values)
    if axes is None:
        from matplotlib.figure import Figure

        axes = Figure(figsize=(2.6 * count, 2.4 * count), layout="constrained").subplots(count, count)
    import arviz  # to_arviz has seen to it that it is there

    names, divergent = list(posterior.labels), bool(posterior.divergences)
    style = {"color": SIMULATED, "s": 3, "alpha": 0.4, "rasterized": True}
    with warnings.catch_warnings():  # ArviZ calls what Matplotlib is about to drop
        warnings.simplefilter("ignore")
        arviz.plot_pair(
            draws, var_names=names, marginals=True, divergences=divergent, scatter_kwargs=style, ax=axes, textsize=9
        )
    return axes
