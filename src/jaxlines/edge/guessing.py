"""Numbers that a first study needs and no file states, guessed from the recording so that the study runs."""

from typing import Any

import numpy as np

from jaxlines.physics.fields import ATMOSPHERE

MODULUS = 1.3e9
"""Modulus at which volumes are guessed [Pa]: a mineral oil in service. Only the ratio of both is seen in pressure."""

SLENDERNESS = 500.0
"""Length over bore of a pipe of which only the volume is guessed [-]."""


def _fed_volume(times, pressure, flow) -> tuple[float, float]:
    """Volume [m^3] that would have the guessed modulus, and the sign of the flow.

    From the flow that came in while pressure rose over the upper half of its range, where air matters least.
    """
    top = int(np.nanargmax(pressure))
    middle = 0.5 * (np.nanmin(pressure) + np.nanmax(pressure))
    below = np.flatnonzero(pressure[:top] < middle)
    start = int(below[-1]) if below.size else 0
    if top - start < 2:
        return 1e-3, 1.0
    step = np.diff(times[start : top + 1])
    part = np.nan_to_num(flow[start : top + 1])
    fed = float(np.sum(0.5 * (part[1:] + part[:-1]) * step))
    rise = float(pressure[top] - pressure[start])
    if fed == 0.0 or rise <= 0.0:
        return 1e-3, 1.0
    return float(np.clip(MODULUS * abs(fed) / rise, 1e-6, 10.0)), float(np.sign(fed))


def guessed_numbers(template: str, roles: dict, times: np.ndarray) -> dict[str, Any]:
    """Numbers that a template needs, guessed from the recording, in units that read well.

    Args: template; roles: name in the circuit -> column and third words; times [s].
    Returns: volume [m^3], sign of the flow, leak [m^3/(s Pa)], and others in the unit that their name says.
    """
    series = {name: column.in_si() for name, (column, _) in roles.items()}
    pressure = series.get("A.pressure", series.get("outlet.pressure", np.full(times.size, ATMOSPHERE)))
    found: dict[str, Any] = {"volume": 1e-3, "sign": 1.0}
    if "flow" in series:
        flow = np.gradient(series["flow"], times) if template == "compression" else series["flow"]
        found["volume"], found["sign"] = _fed_volume(times, pressure, flow)
    slope = float(np.nanpercentile(np.abs(np.gradient(pressure, times)), 99.0))
    highest = float(np.nanmax(series.get("supply", pressure)))
    found["supply_bar"] = round(1.15 * highest / 1e5, 0)
    through = float(np.nanmax(np.abs(series["flow"]))) if template == "dead-end" and "flow" in series else None
    through = slope * found["volume"] / MODULUS if through is None else 0.02 * through
    found["leak"] = max(through, 1e-12) / max(highest, ATMOSPHERE)
    found["rated_flow"] = max(1.5 * slope * found["volume"] / MODULUS, 1e-7) * 6e4
    if "piston" in series:
        x = series["piston"]
        low, high = float(np.nanmin(x)), float(np.nanmax(x))
        margin = max(0.1 * (high - low), 1e-3)
        speed = float(np.nanpercentile(np.abs(np.gradient(x, times)), 99.0))
        found |= {"stroke_mm": 1e3 * (high - low + 2.0 * margin), "offset_mm": 1e3 * (low - margin)}
        found |= {
            "start_mm": 1e3 * (float(x[np.isfinite(x)][0]) - low + margin),
            "rated_flow": max(1e-3 * speed * 1.5, 1e-6) * 6e4,
        }
    start = float(pressure[np.isfinite(pressure)][0])
    found["start_bar"] = max(start, 2e4) / 1e5
    bore = (4.0 * found["volume"] / (np.pi * SLENDERNESS)) ** (1.0 / 3.0)
    found |= {"bore_mm": 1e3 * bore, "length": SLENDERNESS * bore}
    found["precharge_bar"] = max(0.6 * float(np.nanmin(pressure)) / 1e5, 1.0)
    return found


def moduli_of_compression(template: str, roles: dict, volume: float) -> list[str]:
    """Secant and tangent moduli of a compression test straight from the recording, in sentences; none for others.

    Secant V_0 (p_1 - p_0)/(V displaced), tangent V_0 dp/dV over the upper fifth of the pressures; `volume` V_0 [m^3].
    """
    if template != "compression":
        return []
    pressure, displaced = roles["A.pressure"][0].in_si(), roles["flow"][0].in_si()
    good = np.isfinite(pressure) & np.isfinite(displaced)
    pressure, displaced = pressure[good], displaced[good]
    top = int(np.argmax(pressure))
    p, v = pressure[: top + 1], displaced[: top + 1]
    if top < 10:
        return []
    secant = volume * (p[-1] - p[0]) / abs(v[-1] - v[0])
    upper = p > p[0] + 0.8 * (p[-1] - p[0])
    tangent = abs(np.polyfit(v[upper], p[upper], 1)[0]) * volume if upper.sum() > 2 and np.ptp(v[upper]) > 0 else np.nan
    return [
        "straight from the recording, for the volume below (both moduli grow in proportion to it):",
        f"secant modulus from {p[0] / 1e5:.4g} to {p[-1] / 1e5:.4g} bar_a: {secant / 1e9:.3g} GPa",
        f"tangent modulus near {p[-1] / 1e5:.4g} bar_a: {tangent / 1e9:.3g} GPa",
    ]
