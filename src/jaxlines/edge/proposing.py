"""A first study for a recording: which circuit, which channels, which numbers to guess, written with comments."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.building import StudyError
from jaxlines.edge.column_roles import Column, column_spec, find_columns, find_time
from jaxlines.edge.formats import read_columns
from jaxlines.physics.fields import ATMOSPHERE

TEMPLATES = {
    "compression": "a closed volume compressed by a measured displaced volume",
    "dead-end": "a dead-ended line or volume, fed by a measured flow (or only leaking)",
    "valve": "a line filled and emptied by a servovalve with a measured command",
    "cylinder": "a double-rod cylinder moved by a servovalve, with both chamber pressures",
    "accumulator": "a bladder accumulator on a line, charged and discharged by a measured flow",
    "long-pipe": "a long pipe with waves, pressure measured at both ends",
}
MODULUS = 1.3e9
"""Modulus at which volumes are guessed [Pa]: a mineral oil in service. Only the ratio of both is seen in pressure."""

SLENDERNESS = 500.0
"""Length over bore of a pipe of which only the volume is guessed [-]."""

MANY = 20_000


@dataclasses.dataclass(frozen=True)
class Proposal:
    """A study proposed for a recording. Fields: text of the study; template; others that fit; doubts to check."""

    text: str
    template: str
    others: tuple[str, ...]
    doubts: tuple[str, ...]


def choose_template(columns: list[Column]) -> list[str]:
    """The templates that the columns can feed, the likeliest first."""
    number = {
        role: sum(c.role == role for c in columns) for role in ("pressure", "flow", "volume", "command", "position")
    }
    lines = [c for c in columns if c.role == "pressure" and not c.is_supply() and not c.is_tank()]
    found = []
    if number["volume"] and number["pressure"]:
        found.append("compression")
    if number["command"] and len(lines) >= 2 and number["position"]:
        found.append("cylinder")
    if number["command"] and number["pressure"]:
        found.append("valve")
    if number["flow"] and number["pressure"]:
        stored = any(c.says("acc|akku|speicher|accu|bladder") for c in columns)
        found += ["accumulator", "dead-end"] if stored else ["dead-end", "accumulator"]
    if len(lines) >= 2:
        ends = any(c.is_inlet() for c in lines) and any(c.is_outlet() for c in lines)
        found.insert(0 if ends and not number["command"] else len(found), "long-pipe")
    if number["pressure"] and "dead-end" not in found:
        found.append("dead-end")
    return found


def _first(columns: list[Column], role: str, *tests) -> Column | None:
    """The first column of a role for which the tests hold, or else any of that role."""
    same = [c for c in columns if c.role == role]
    return next((c for c in same if all(test(c) for test in tests)), same[0] if same else None)


def _is_line(column: Column) -> bool:
    """Whether a pressure is neither that of a supply nor that of a return line."""
    return not column.is_supply() and not column.is_tank()


def _roles(template: str, columns: list[Column]) -> dict[str, tuple[Column, tuple[str, ...]]]:
    """Name in the circuit -> column and third words, for a template."""
    lines = [c for c in columns if c.role == "pressure" and _is_line(c)] or [c for c in columns if c.role == "pressure"]
    found: dict[str, Any] = {}
    if template == "long-pipe":
        inlet = next((c for c in lines if c.is_inlet()), lines[0])
        outlet = next((c for c in lines if c.is_outlet() and c is not inlet), next(c for c in lines if c is not inlet))
        found = {
            "inlet": inlet,
            "outlet.pressure": outlet,
            "flow": next((c for c in columns if c.role == "flow"), None),
        }
        found["flow"] = found["flow"] if found["flow"] is not None and found["flow"].is_outlet() else None
    else:
        found = {"A.pressure": lines[0], "flow": _first(columns, "flow")}
    if template in ("valve", "cylinder"):
        found |= {"spool": _first(columns, "command"), "flow": None}
        found["supply"] = next(
            (c for c in columns if c.role == "pressure" and c.is_supply() and c not in lines[:2]), None
        )
    if template == "cylinder":
        found |= {"B.pressure": lines[1], "piston": _first(columns, "position")}
    if template == "compression":
        found["flow"] = _first(columns, "volume")
    rate = {"flow": ("rate",)} if template == "compression" else {}
    return {name: (column, rate.get(name, ())) for name, column in found.items() if column is not None}


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


def _numbers(template: str, roles: dict, times: np.ndarray) -> dict[str, Any]:
    """Numbers that a template needs, guessed from the recording, in units that read well."""
    series = {name: column.in_si() for name, (column, _) in roles.items()}
    pressure = series.get("A.pressure", series.get("outlet.pressure", np.full(times.size, ATMOSPHERE)))
    found: dict[str, Any] = {"volume": 1e-3, "sign": 1.0, "pressures": pressure}
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


def _secants(template: str, roles: dict, volume: float) -> list[str]:
    """Secant and tangent moduli of a compression test straight from the recording, in sentences."""
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


def _sampling(times: np.ndarray) -> str:
    """The sampling of a recording in words."""
    steps = np.diff(times)
    step = float(np.median(steps))
    uneven = "" if np.ptp(steps) < 0.05 * step else f", uneven ({np.min(steps):.3g} to {np.max(steps):.3g} s)"
    return f"{times.size} samples over {times[-1] - times[0]:.4g} s, every {step:.4g} s{uneven}"


def propose_study(
    recording: Path, *, template: str | None = None, step: str | None = None, base: Path | None = None
) -> Proposal:
    """A commented study for a recording, that runs.

    Args:
        recording: the file; see `read_columns`.
        template: one of `TEMPLATES`; by default the likeliest for the columns.
        step: of the rows ("1 ms") where the file has no time.
        base: folder of the study, from which the file is named.
    Returns: a `Proposal`; what is guessed is marked CHECK in its text.
    Raises: StudyError, ValueError, OSError saying what is missing in the file.
    """
    import jinja2

    columns = read_columns(recording)
    time, times, time_doubt = find_time(columns, step)
    used = [column for column in find_columns(columns) if column.name != time[0]]
    same = [c for c in used if c.values.size == times.size]
    fits = choose_template(same)
    names = ", ".join(map(repr, columns.names[:12]))
    if not fits:
        raise StudyError(
            f"{recording}: no column of a pressure found among {names}: name its unit in the heading: 'p [bar_g]'"
        )
    if template is not None and template not in TEMPLATES:
        raise StudyError(f"unknown template {template!r}; known: {', '.join(TEMPLATES)}")
    chosen = template or fits[0]
    try:
        roles = _roles(chosen, same)
        _check_roles(chosen, roles)
    except (IndexError, StopIteration, KeyError):
        raise StudyError(
            f"{recording}: template {chosen!r} needs more columns than {names} ({TEMPLATES[chosen]})"
        ) from None
    numbers = _numbers(chosen, roles, times)
    doubts = [
        d
        for d in (time_doubt and f"time: {time_doubt}", *(c.doubt and f"{n}: {c.doubt}" for n, (c, _) in roles.items()))
        if d
    ]
    file = recording
    if base is not None and recording.resolve().is_relative_to(base.resolve()):
        file = recording.resolve().relative_to(base.resolve())
    elif base is not None:
        file = recording.resolve()
    coarse = f"every {1e3 * float(times[-1] - times[0]) / 5000:.3g} ms"
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["toml"] = lambda value: json.dumps(value, ensure_ascii=False)
    text = environment.get_template(f"{chosen}.toml.jinja").render(
        file=file.as_posix(),
        time=column_spec(*time),
        coarser=[*time, coarse],
        time_doubt=time_doubt,
        roles=roles,
        unused=[name for name in columns.names if name not in (time[0], *(c.name for c, _ in roles.values()))],
        sampling=_sampling(times),
        many=times.size > MANY,
        notes=[*columns.notes, *_secants(chosen, roles, numbers["volume"])],
        layout=columns.layout,
        others=[name for name in fits if name != chosen],
        description=TEMPLATES[chosen],
        n=numbers,
    )
    return Proposal(text, chosen, tuple(name for name in fits if name != chosen), tuple(doubts))


def _check_roles(template: str, roles: dict) -> None:
    """Raise KeyError where a template lacks a column."""
    needed = {
        "compression": ["A.pressure", "flow"],
        "valve": ["A.pressure", "spool"],
        "accumulator": ["A.pressure", "flow"],
    }
    needed |= {"cylinder": ["A.pressure", "B.pressure", "spool", "piston"], "long-pipe": ["inlet", "outlet.pressure"]}
    for name in needed.get(template, ["A.pressure"]):
        roles[name]
