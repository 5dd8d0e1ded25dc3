"""Measured tables: monotone interpolation that works inside compiled code, and valves known by tables.

A table's own axis stands first, (samples,) for one component and (samples, count, [lanes]) for a kind, as the axes
of states do, so that numbers and pressures still apply element by element.
"""

from typing import Any

import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation
from jaxlines.physics.fields import Number, array_module, driven, is_concrete, port, quantity
from jaxlines.physics.resistances import orifice_flow, passed


def monotone_cubic(xs, ys, x, ends: str = "hold"):
    """Value at x of the monotone cubic interpolant through a table: once differentiable, no overshoot.

    Args: xs, strictly increasing, shape (samples, ...), two or more; ys: values of the same or a broadcastable
        shape; x: where, shape (...); ends: "hold" (the last value beyond the ends, where the slope jumps) or "odd"
        (xs and ys start at zero, the slope there is such that the odd continuation is twice differentiable; a
        straight line beyond the last sample).
    Reference: see `monotone_slopes`.
    """
    return hermite(xs, ys, monotone_slopes(xs, ys, ends), x, ends)


def monotone_slopes(xs, ys, ends: str = "hold"):
    """Slope at each sample, shape (samples, ...): harmonic mean of the neighbouring secants, zero at extremes.

    At the ends that of the last secant, or with "odd" at the first as `monotone_cubic` says.

    Reference: Fritsch and Butland, "A method for constructing local monotone piecewise cubic interpolants",
        SIAM J. Sci. Stat. Comput. 5, 1984 (slopes of equally weighted neighbours).
    """
    xp = array_module(xs, ys)
    xs, ys = _padded(xp, xs, np.ndim(ys)), _padded(xp, ys, np.ndim(xs))
    secants = (ys[1:] - ys[:-1]) / (xs[1:] - xs[:-1])
    before, after = secants[:-1], secants[1:]
    alike = xp.where(before > 0.0, after > 0.0, (before < 0.0) & (after < 0.0))
    inner = xp.where(alike, 2.0 * before * (after / xp.where(alike, before + after, 1.0)), 0.0)
    inner = xp.concatenate([inner, secants[-1:]])
    first = 1.5 * secants[:1] - 0.5 * inner[:1] if ends == "odd" else secants[:1]
    return xp.concatenate([first, inner])


def hermite(xs, ys, slopes, x, ends: str = "hold"):
    """Value at x of the piecewise cubic with given values and slopes at its samples; arguments as `monotone_cubic`."""
    xp = array_module(xs, ys, slopes, x)
    dimensions = max(np.ndim(xs), np.ndim(ys), np.ndim(slopes), np.ndim(x) + 1)
    xs, ys, slopes = (_padded(xp, table, dimensions) for table in (xs, ys, slopes))
    x = _padded(xp, x, dimensions - 1)
    # Not clip: its derivative is halved exactly on a sample.
    inside = xp.where(x < xs[0], xs[0], xp.where(x > xs[-1], xs[-1], x))
    index = xp.sum(x >= xs[1:-1], axis=0)[None]

    def at(table, index):
        return xp.take_along_axis(table, index, axis=0)[0]

    start, low, width = at(xs, index), at(ys, index), at(xs[1:] - xs[:-1], index)
    share, rise = (inside - start) / width, at(ys, index + 1) - low
    first, last = at(slopes, index) * width, at(slopes, index + 1) * width
    bend = share * (1.0 - share) * ((1.0 - share) * (first - rise) + share * (rise - last))
    value = low + share * rise + bend
    return value if ends == "hold" else value + slopes[-1] * (x - inside)


def _padded(xp, table, dimensions: int):
    """An array with axes of length one added behind, so that its first axes line up."""
    table = xp.asarray(table)
    return table.reshape(table.shape + (1,) * max(dimensions - table.ndim, 0))


def check_increasing(name: str, numbers) -> None:
    """Raise ValueError unless an axis of a table is a list of two or more, strictly increasing."""
    if np.ndim(numbers) != 1 or np.size(numbers) < 2:
        raise ValueError(f"{name} of a table must be a list of two or more numbers, got shape {np.shape(numbers)}")
    if is_concrete(numbers) and not np.all(np.diff(numbers) > 0.0):
        at = int(np.argmin(np.diff(numbers) > 0.0)) + 1
        raise ValueError(f"{name} of a table must increase; they do not at number {at} ({numbers[at]:g})")


def _check_shape(name: str, numbers, shape: tuple[int, ...], meaning: str) -> None:
    """Raise ValueError unless the values of a table have the shape that its axes ask for."""
    if np.shape(numbers) != shape:
        raise ValueError(f"{name} of a table must have shape {shape} ({meaning}), got {np.shape(numbers)}")


class CurveValve(AbstractComponent):
    """A valve with a measured curve of its flow coefficient: Q = (C_d A)(x) sqrt(2 dp/rho).

    Args: a, b: nodes; opening x, a number, a signal or the name of an input [-]; openings, increasing, shape (n,)
        [-]; flow_areas: C_d A at each of them, shape (n,) [m^2]; transition [Pa], see `Orifice`. Beyond the table
        the ends are held.
    Raises: ValueError for a table with wrong shapes or openings that do not increase.
    Validity: turbulent; between the samples a monotone cubic.
    Typical values: C_d A is 1.964e-5 m^2 for each unit of K_v (m^3/h of water, 1000 kg/m^3, at 1 bar).
    Reference: see `orifice_flow` and `monotone_cubic`.
    """

    a: str = port()
    b: str = port()
    opening: Number = driven("1", low=-10.0, high=1e3)
    openings: Number = quantity("1", low=-10.0, high=1e3)
    flow_areas: Number = quantity("m^2", low=0.0, high=100.0, slip="was it given in mm^2?")
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=1e3)

    def __check_init__(self):
        check_increasing("openings", self.openings)
        _check_shape("flow_areas", self.flow_areas, np.shape(self.openings), "one for each opening")

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density = at.fluid.density_at(0.5 * (p_a + p_b))
        area = monotone_cubic(self.openings, self.flow_areas, at.given["opening"])
        return passed(at, orifice_flow(area, 1.0, density, p_a, p_b, self.transition))


class TableValve(AbstractComponent):
    """A valve with a measured table of its flow over opening and pressure difference: Q(x, dp) sqrt(rho_N/rho).

    Args: a, b: nodes; opening x, a number, a signal or the name of an input [-]; openings, increasing, shape (n,) [-];
        pressure_drops, increasing, above zero, shape (m,) [Pa]; flows, shape (n, m), never falling with the pressure
        drop [m^3/s]; rated_density rho_N of the fluid that was measured with [kg/m^3].
    Raises: ValueError for a table with wrong shapes, an axis that does not increase, or flows that fall.
    Validity: odd in the pressure difference; nearly proportional to it below the first pressure drop, a straight line
        above the last; beyond the openings the ends are held. At the openings of the table flow never falls with the
        pressure difference; between them too where its rows are alike in shape. The same holds of the opening.
    Typical values: 5..20 openings, pressure drops 0.1..20 MPa.
    Reference: see `monotone_slopes`; along the pressure drops and along the openings.
    """

    a: str = port()
    b: str = port()
    opening: Number = driven("1", low=-10.0, high=1e3)
    openings: Number = quantity("1", low=-10.0, high=1e3)
    pressure_drops: Number = quantity("Pa", low=1.0, high=1e9, slip="they are differences above zero; given in bar?")
    flows: Number = quantity("m^3/s", low=0.0, high=1e3, slip="was it given in L/min?")
    rated_density: Number = quantity("kg/m^3", low=100.0, high=3000.0, slip="was it given in g/cm^3?", default=850.0)

    def __check_init__(self):
        check_increasing("openings", self.openings)
        check_increasing("pressure_drops", self.pressure_drops)
        shape = (np.size(self.openings), np.size(self.pressure_drops))
        _check_shape("flows", self.flows, shape, "a row for each opening, a column for each pressure drop")
        if is_concrete(self.flows):
            falls = np.argwhere(np.diff(self.flows, axis=1) < 0.0)
            if falls.size:
                row, column = falls[0]
                raise ValueError(
                    f"flows of a table must not fall with the pressure drop; they do in row {row}, "
                    f"from column {column} to {column + 1}"
                )

    def evaluate(self, at: Situation) -> Contribution:
        p_a, p_b = at.potential["a"], at.potential["b"]
        density = at.fluid.density_at(0.5 * (p_a + p_b))
        flow = self.measured_flow(at.given["opening"], p_a - p_b)
        return passed(at, flow * array_module(self, density).sqrt(self.rated_density / density))

    def measured_flow(self, opening, drop) -> Any:
        """Q(x, dp) of the table [m^3/s] at an opening [-] and a pressure difference [Pa], positive or negative."""
        xp = array_module(self, opening, drop)
        size = xp.where(drop < 0.0, -drop, drop)  # not abs: its derivative at zero is zero
        # Slopes along the openings come from the table, not from flows at this drop, which are all zero at rest.
        slopes = monotone_slopes(xp.asarray(self.openings)[:, None], self.flows)
        flows, slopes = (self._along_drops(table, size) for table in (self.flows, slopes))
        flow = hermite(self.openings, flows, slopes, opening)
        return xp.where(drop < 0.0, -flow, flow)

    def _along_drops(self, table, size):
        """The rows of a table at a positive pressure difference, shape (openings, ...)."""
        xp = array_module(self, table, size)
        columns, drops = xp.moveaxis(xp.asarray(table), 1, 0), xp.asarray(self.pressure_drops)
        columns, drops = (xp.concatenate([xp.zeros_like(t[:1]), t]) for t in (columns, drops))
        return monotone_cubic(drops[:, None], columns, xp.asarray(size)[None], ends="odd")
