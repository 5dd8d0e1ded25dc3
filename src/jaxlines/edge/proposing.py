"""A first study for a recording: which circuit, which channels, which numbers to guess, written with comments."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxlines.edge.building import StudyError
from jaxlines.edge.column_roles import Column, column_spec, find_columns, find_time
from jaxlines.edge.formats import Columns, read_columns
from jaxlines.edge.guessing import guessed_numbers, moduli_of_compression
from jaxlines.edge.units import conversion

TEMPLATES = {
    "compression": "a closed volume compressed by a measured displaced volume",
    "dead-end": "a dead-ended line or volume, fed by a measured flow (or only leaking)",
    "valve": "a line filled and emptied by a servovalve with a measured command",
    "cylinder": "a double-rod cylinder moved by a servovalve, with both chamber pressures",
    "accumulator": "a bladder accumulator on a line, charged and discharged by a measured flow",
    "long-pipe": "a long pipe with waves, pressure measured at both ends",
}
PISTON_AREA = 1000.0
"""Area of a piston of which only the travel is recorded [mm^2]."""

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
    moved = number["volume"] or (number["position"] and not number["command"] and not number["flow"])
    if moved and number["pressure"]:
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


def _swept(position: Column | None) -> Column | None:
    """The volume that a piston displaces, from its position and a guessed area."""
    if position is None:
        return None
    in_mm = 1e3 * conversion(position.unit, "m")[0]
    doubt = f"a piston area of {PISTON_AREA:g} mm^2 is a guess: the unit is area times travel"
    return dataclasses.replace(position, role="volume", unit=f"{PISTON_AREA * in_mm:g} mm^3", doubt=doubt)


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
        found["flow"] = _first(columns, "volume") or _swept(_first(columns, "position"))
    rate = {"flow": ("rate",)} if template == "compression" else {}
    return {name: (column, rate.get(name, ())) for name, column in found.items() if column is not None}


def _sampling(times: np.ndarray) -> str:
    """The sampling of a recording in words."""
    steps = np.diff(times)
    step = float(np.median(steps))
    uneven = "" if np.ptp(steps) < 0.05 * step else f", uneven ({np.min(steps):.3g} to {np.max(steps):.3g} s)"
    return f"{times.size} samples over {times[-1] - times[0]:.4g} s, every {step:.4g} s{uneven}"


def _named(recording: Path, base: Path | None) -> str:
    """How a study in a folder names its recording: relative where it lies beneath, else by its full path."""
    if base is None:
        return recording.as_posix()
    full, folder = recording.resolve(), base.resolve()
    return (full.relative_to(folder) if full.is_relative_to(folder) else full).as_posix()


def _rendered(chosen: str, roles: dict, time, time_doubt: str, times, columns: Columns, fits, file: str) -> str:
    """The text of a study."""
    import jinja2

    numbers = guessed_numbers(chosen, roles, times)
    coarse = f"every {1e3 * float(times[-1] - times[0]) / 5000:.3g} ms"
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["toml"] = lambda value: json.dumps(value, ensure_ascii=False)
    return environment.get_template(f"{chosen}.toml.jinja").render(
        file=file,
        time=column_spec(*time),
        coarser=[*time, coarse],
        time_doubt=time_doubt,
        roles=roles,
        unused=[name for name in columns.names if name not in (time[0], *(c.name for c, _ in roles.values()))],
        sampling=_sampling(times),
        many=times.size > MANY,
        notes=[*columns.notes, *moduli_of_compression(chosen, roles, numbers["volume"])],
        layout=columns.layout,
        others=[name for name in fits if name != chosen],
        description=TEMPLATES[chosen],
        n=numbers,
    )


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
    doubts = [
        d
        for d in (time_doubt and f"time: {time_doubt}", *(c.doubt and f"{n}: {c.doubt}" for n, (c, _) in roles.items()))
        if d
    ]
    text = _rendered(chosen, roles, time, time_doubt, times, columns, fits, _named(recording, base))
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
