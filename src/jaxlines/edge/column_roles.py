"""What the columns of a recording are likely to be: time, pressures, flows, positions, commands; in which units."""

import dataclasses
import re

import numpy as np

from jaxlines.edge.formats import Columns
from jaxlines.edge.time_stamps import TIME_STAMP, format_of_stamps
from jaxlines.edge.unit_words import bare_unit, heading_parts, kind_of, unit_of
from jaxlines.edge.units import conversion
from jaxlines.physics.fields import ATMOSPHERE

_NAMES = {
    "time": r"(t|time|zeit|temps|timestamp|date.?time|datum|uhrzeit|sec|k|sample)\b|.*(time|zeit)(stamp|stempel)?$",
    "temperature": r".*temp(eratur|erature)?\b|t_?(oil|oel|öl|tank)",
    "pressure": r"p([\W_\d]|$)|p(_|s|t|a|b|p)\b|.*(press|druck|pression)|p[gs]?_?\d",
    "flow": r"q([\W_\d]|$)|.*(flow|durchfluss|zulauf|volumenstrom|debit|débit)|fs_?\d",
    "volume": r"vol|.*(volum|displaced|verdr)|dv\b|v$",
    "command": r".*(spool|cmd|command|stell|servo|signal|solenoid)|u([\W_\d]|$)|.*(valve|ventil)",
    "position": r"(x|y|s)([\W_\d]|$)|.*(pos|weg|hub|stroke|travel|displacement)",
    "speed": r"(v|n)[\W_\d]|.*(speed|veloc|geschw|drehzahl)",
}
_BY_KIND = {"share": "command", "voltage": "command", "current": "command", "length": "position"}
_USED = ("pressure", "flow", "volume", "command", "position")
_INPUT_WORDS = {
    "supply": r"supply|pump|system|versorg|speise|\bps?\b|p_?s\b|p_?p\b|p0",
    "tank": r"tank|return|r(ü|ue)ck|p_?t\b|p_?r\b",
}
_PLACES = {"inlet": r"in\b|_in|inlet|ein|up|_1\b|1$", "outlet": r"out|aus|down|end|_2\b|2$"}


def column_spec(name: str, unit: str, *third: str) -> str | list[str]:
    """A column, its unit and third word as a study file names them, in one text where the heading says the unit."""
    return name if not third and name.endswith(f"[{unit}]") else [name, unit, *third]


@dataclasses.dataclass(frozen=True)
class Column:
    """A column that a study can use.

    Fields: name: its heading; role: "pressure", "flow", "volume", "command", "position" or another kind; unit: in the
    notation of study files; values: as in the file; doubt: what a reader should check, "" for nothing.
    """

    name: str
    role: str
    unit: str
    values: np.ndarray
    doubt: str = ""

    def spec(self, *third: str) -> str | list[str]:
        """The column as a study file names it: the heading alone where that ends with the unit in brackets."""
        return column_spec(self.name, self.unit, *third)

    def says(self, words: str) -> bool:
        """Whether the heading contains a pattern."""
        return re.search(words, self.name.lower()) is not None

    def is_supply(self) -> bool:
        """Whether a pressure is that of a supply."""
        return self.says(_INPUT_WORDS["supply"])

    def is_tank(self) -> bool:
        """Whether a pressure is that of a return line."""
        return self.says(_INPUT_WORDS["tank"])

    def is_inlet(self) -> bool:
        """Whether a column belongs to the first end of a pipe."""
        return self.says(_PLACES["inlet"])

    def is_outlet(self) -> bool:
        """Whether a column belongs to the far end of a pipe."""
        return self.says(_PLACES["outlet"])

    def in_si(self) -> np.ndarray:
        """The values in SI; pressures absolute."""
        match = re.fullmatch(r"([-+\d.eE]+) (.+)", self.unit)
        scale, unit = (float(match[1]), match[2]) if match else (1.0, self.unit)
        target = {"pressure": "Pa", "flow": "m^3/s", "volume": "m^3", "command": "1", "position": "m"}[self.role]
        factor, offset = conversion(unit, target)
        return scale * factor * self.values + offset


def _role_of(name: str, unit: str | None) -> str:
    """The role of a column by its unit, or else by its heading."""
    kind = kind_of(unit)
    by_name = next((role for role, words in _NAMES.items() if re.match(words, name.lower())), "")
    if kind in ("", "other"):
        return by_name
    if kind in ("share", "voltage", "current") and by_name not in ("", "command", "position"):
        return by_name if by_name in _USED else "other"
    return _BY_KIND.get(kind, kind)


def _level(name: str, unit: str, values: np.ndarray) -> tuple[str, str]:
    """A pressure's unit with _g or _a, and a doubt where the numbers do not decide it."""
    factor = conversion(unit, "Pa")[0]
    low = float(np.nanmin(values)) * factor
    if low < 0.5 * ATMOSPHERE:
        return f"{unit}_g", ""
    if low < 1.05 * ATMOSPHERE:
        return f"{unit}_a", f"its lowest value is {low / 1e5:.3g} bar, one atmosphere: taken as absolute; is it?"
    return (
        f"{unit}_g",
        f"gauge (_g) or absolute (_a)? {name!r} does not say, and never comes near zero: gauge is a guess",
    )


def _pressure_unit(values: np.ndarray) -> str:
    """The unit of pressures that state none, by their size."""
    highest = float(np.nanmax(np.abs(values)))
    return "Pa" if highest > 5e4 else "psi" if highest > 1200.0 else "bar" if highest > 1.0 else "MPa"


def _guessed_unit(role: str, values: np.ndarray) -> str:
    """A likely unit for a column that states none."""
    highest = float(np.nanmax(np.abs(values))) if values.size else 0.0
    if role == "pressure":
        return _pressure_unit(values)
    if role == "command":
        return "1" if highest <= 1.5 else "10 %" if highest <= 12.0 else "%"
    return {"flow": "L/min", "volume": "mL", "position": "mm" if highest > 3.0 else "m"}[role]


def _unit(role: str, name: str, unit: str | None, values: np.ndarray) -> tuple[str, str]:
    """Unit and doubt of a column in use."""
    doubt = ""
    if role == "command" and unit in ("V", "mV", "A", "mA"):
        highest = float(np.nanmax(np.abs(values)))
        full = 10.0 ** np.ceil(np.log10(max(highest, 1e-12)) - 1e-9)
        return f"{100.0 / full:g} %", f"{full:g} {unit} is taken as a full command (100 %)"
    if unit is None or (kind_of(unit) == "share" and role != "command"):
        unit = _guessed_unit(role, values)
        doubt = f"the file states no unit: {unit} is a guess from the size of the numbers"
    if role == "pressure" and unit == bare_unit(unit):
        unit, level = _level(name, unit, values)
        doubt = "; ".join(filter(None, [doubt, level]))
    return unit, doubt


def _numeric(values) -> np.ndarray | None:
    """A column as numbers; None where it is text, all empty, or time stamps."""
    import pandas

    series = pandas.Series(values)
    if series.dtype.kind in "Mm":
        return None
    numbers = pandas.Series(pandas.to_numeric(series, errors="coerce")).to_numpy(dtype=float, na_value=np.nan)
    return numbers if np.isfinite(numbers).sum() > 0.5 * max(len(series), 1) else None


def find_columns(columns: Columns) -> list[Column]:
    """The columns of a file that a study can use, with their likely roles and units; without the time."""
    found = []
    for name, raw in columns.values.items():
        values = _numeric(raw)
        title, stated = heading_parts(name)
        unit = unit_of(columns.units.get(name, "")) or stated
        role = _role_of(title.rpartition("/")[2].rpartition(".")[2].strip(), unit)
        if values is None or role not in _USED:
            continue
        chosen, doubt = _unit(role, name, unit, values)
        found.append(Column(name, role, chosen, values, doubt))
    return found


def find_time(columns: Columns, step: str | None = None) -> tuple[list[str], np.ndarray, str]:
    """The time of a recording: as a study names it, in seconds, and what to check.

    Args: columns; step: of the rows ("1 ms"), where the file has no time.
    """
    from jaxlines.edge.units import si

    rows = max((len(values) for values in columns.values.values()), default=0)
    if step is not None:
        return ["#", step], si(step, "s") * np.arange(rows), ""
    for name, raw in columns.values.items():
        title, stated = heading_parts(name)
        unit = unit_of(columns.units.get(name, "")) or stated
        form = format_of_stamps(raw) if _numeric(raw) is None else None
        if form is not None:
            from jaxlines.edge.time_stamps import seconds_of_stamps

            return [name, f"{TIME_STAMP} {form}".strip()], seconds_of_stamps(raw, form, name), ""
        title = title.rpartition("/")[2].rpartition(".")[2].strip().lower()
        if kind_of(unit) != "time" and not (unit is None and re.match(_NAMES["time"], title)):
            continue
        values = _numeric(raw)
        if values is None or title in ("k", "sample"):
            continue
        doubt = ""
        if unit is None:
            steps = float(np.nanmedian(np.diff(values)))
            unit = "ms" if steps >= 1.0 and values[-1] - values[0] > 1000.0 else "s"
            doubt = f"the file states no unit of time: {unit} is a guess"
        return [name, unit], conversion(unit, "s")[0] * values, doubt
    return ["#", "1 ms"], 1e-3 * np.arange(rows), "the file has no time: 1 ms from row to row is a guess"
