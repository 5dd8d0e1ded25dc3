"""Units as instruments and spreadsheets write them, in the notation of study files: "barg" as "bar_g"."""

import functools
import re

from jaxlines.edge.units import base_unit, split_level

_SPELLINGS = {
    "l/min": "L/min", "lpm": "L/min", "l/mn": "L/min", "ltr/min": "L/min", "lit/min": "L/min", "l/s": "L/s",
    "ml/s": "mL/s", "ml/min": "mL/min", "ml": "mL", "l": "L", "cc": "cm^3", "ccm": "cm^3", "gpm": "gpm",
    "sec": "s", "secs": "s", "seconds": "s", "second": "s", "sek": "s", "msec": "ms", "millisec": "ms",
    "milliseconds": "ms", "minutes": "min", "hours": "hour", "h": "hour",
    "m3/s": "m^3/s", "m3s": "m^3/s", "m3/h": "m^3/hour", "m^3/h": "m^3/hour",
    "mpa": "MPa", "kpa": "kPa", "pa": "Pa", "hpa": "hPa", "bar": "bar", "mbar": "mbar", "psi": "psi",
    "1/min": "rpm", "min-1": "rpm", "min^-1": "rpm", "u/min": "rpm", "rpm": "rpm", "upm": "rpm",
    "°": "deg", "degc": "degC", "°c": "degC", "pct": "%", "prozent": "%", "percent": "%", "mm^3": "mm^3",
}  # fmt: skip
_LEVEL = re.compile(r"(bar|mbar|psi|m?pa|kpa|hpa)[ _]?[\[(]?(a|g|abs|absolute|gauge|rel|relativ|relative|ü|e)[\])]?")
# As a last word without brackets only units that are no abbreviation of something else ("p_in", "q_min", "x_cmd").
_LAST_WORDS = [
    "s", "ms", "us", "sec", "bar", "mbar", "psi", "Pa", "kPa", "MPa", "hPa", "L/min", "l/min", "lpm", "gpm", "L/s",
    "m^3/s", "m3s", "m3/s", "mL/s", "mL", "ml", "cm^3", "m^3", "mm", "cm", "mm/s", "m/s", "rpm", "1/min", "rad/s",
    "deg", "rad", "kN", "Nm", "%", "pct", "mV", "mA", "degC", "°C", "Hz", "kHz", "barg", "bara", "psig", "psia",
    "bar_g", "bar_a", "psi_g", "psi_a", "Pa_g", "Pa_a", "kPa_g", "kPa_a", "MPa_g", "MPa_a",
]  # fmt: skip
_ABSOLUTE = ("a", "abs", "absolute")
_SUPERSCRIPTS = str.maketrans({"²": "^2", "³": "^3", "·": "*", "μ": "u", "µ": "u"})


@functools.cache
def unit_of(text: str) -> str | None:
    """A unit in the notation of study files, or None for what is no unit.

    "barg", "bar(g)" and "bar rel" become "bar_g", "psia" becomes "psi_a", "l/min" "L/min", "cm³" "cm^3".
    """
    word = text.strip().strip("[]").strip().translate(_SUPERSCRIPTS)
    if word.startswith("(") and word.endswith(")"):
        word = word[1:-1].strip()
    if word in ("-", "1"):
        return "1"
    level = _LEVEL.fullmatch(word.lower())
    if level:
        return f"{_SPELLINGS[level[1]]}_{'a' if level[2] in _ABSOLUTE else 'g'}"
    word = _SPELLINGS.get(word, _SPELLINGS.get(word.lower(), word))
    if not word or len(word) > 24 or not re.search(r"[A-Za-z%]", word):
        return None
    try:
        base_unit(word)
    except ValueError:
        return None
    return word


def bare_unit(unit: str) -> str:
    """A unit without "_a" or "_g"."""
    return split_level(unit)[0]


def heading_parts(heading: str) -> tuple[str, str | None]:
    """The name in a heading and the unit that it states, if any.

    Units stand in brackets ("p [bar_g]", "p (psi)"), after a comma or slash with a space ("p, bar"), or as the last
    word after an underscore or space ("p_bar", "t_ms", "Druck bar") where that word is hardly anything else.
    """
    heading = heading.strip()
    match = re.fullmatch(r"(.*?)[ _]*[\[(]([^\[\]]+?)[\])]", heading)
    if match and unit_of(match[2]):
        return match[1].strip(), unit_of(match[2])
    match = re.fullmatch(r"(.+?)(?:, ?| / | in |[ _])([^ ,_]+(?:_[ag])?)", heading)
    if match and match[2] in _LAST_WORDS:
        return match[1].strip(), unit_of(match[2])
    return heading, None


def kind_of(unit: str | None) -> str:
    """What a unit measures: "pressure", "flow", "volume", "length", "area", "speed", "time", ...; "" if unknown."""
    if unit is None:
        return ""
    kinds = {"Pa": "pressure", "m^3/s": "flow", "m^3": "volume", "m": "length", "m/s": "speed", "s": "time"}
    kinds |= {"rad/s": "angular speed", "rad": "angle", "1": "share", "N": "force", "K": "temperature", "V": "voltage"}
    kinds |= {
        "kg*m^2/s^2": "torque",
        "kg*m/s^2": "force",
        "A": "current",
        "kg*m^2/A/s^3": "voltage",
        "1/s": "frequency",
    }
    base = base_unit(unit).replace(" ", "")
    return kinds.get(base, "other")
