"""Numbers in SI as people read them: a fitting unit and no more digits than the uncertainty leaves."""

import math
import re
from typing import NamedTuple

from jaxlines.inference.uncertainty import Estimate

_SCALES = {
    "Pa": ((2e8, "GPa", 1e-9), (5e5, "MPa", 1e-6), (20.0, "kPa", 1e-3)),
    "m^3/(s*Pa)": ((1e-10, "L/(min·bar)", 6e9), (0.0, "cm³/(min·bar)", 6e12)),
    "m^3/s": ((0.0, "L/min", 6e4),),
    "m^3": ((1.0, "m³", 1.0), (0.0, "L", 1e3)),
    "m": ((0.1, "m", 1.0), (0.0, "mm", 1e3)),
    "s": ((1.0, "s", 1.0), (0.0, "ms", 1e3)),
}
_NUMBER = r"[+-]?\d+\.?\d*(?:e[+-]?\d+)?"
_UNITS = "|".join(re.escape(unit) for unit in _SCALES if unit != "s")
_IN_SI = re.compile(rf"(?<![\w.])({_NUMBER})( to | \.\. )?((?(2){_NUMBER})) ({_UNITS})(?![\w^*/])")


def readable_unit(unit: str, size: float) -> tuple[str, float]:
    """A unit in which a number of this size [SI] reads well, and the factor to it."""
    for least, label, factor in _SCALES.get(unit, ()):
        if math.isfinite(size) and abs(size) >= least:
            return label, factor
    return ("" if unit == "1" else unit.replace("^2", "²").replace("^3", "³").replace("*", "·")), 1.0


def readable(unit: str, *numbers: float) -> str:
    """Numbers of one unit [SI] as "0.6 to 3 GPa"."""
    label, factor = readable_unit(unit, max(numbers, key=abs))
    return f"{' to '.join(f'{number * factor:.4g}' for number in numbers)} {label}".strip()


def readable_text(sentence: str) -> str:
    """A sentence with its numbers in SI ("1.365e+09 to 1.392e+09 Pa") in units that read well."""
    return _IN_SI.sub(lambda m: readable(m[4], *(float(number) for number in (m[1], m[3]) if number)), sentence)


def rounded(value: float, sd: float | None) -> str:
    """A number with two digits of its standard deviation, or five digits without one."""
    if not math.isfinite(value):
        return str(value)
    if value == 0.0:
        return "0"
    digits = 5
    if sd is not None and math.isfinite(sd) and sd > 0.0:
        digits = min(8, max(2, math.floor(math.log10(abs(value))) - math.floor(math.log10(sd)) + 2))
    return f"{value:#.{digits}g}".rstrip(".")


class Row(NamedTuple):
    """An estimate as texts: value, standard deviation, 95 % interval, unit, note."""

    value: str
    sd: str
    interval: str
    unit: str
    note: str


def estimate_row(estimate: Estimate) -> Row:
    """An estimate as a row of a table."""
    limit = estimate.ci95[1] if estimate.kind == "upper_limit" and estimate.ci95 else None
    unit, factor = readable_unit(estimate.unit, estimate.value if limit is None else limit)
    sd, note = None if estimate.sd is None else estimate.sd * factor, readable_text(estimate.note)
    value = rounded(estimate.value * factor, sd)
    if limit is not None:
        return Row(f"< {limit * factor:.3g}", "", f"0 to {limit * factor:.3g}", unit, note)
    if estimate.ci95 is None or sd is None:
        return Row(value, "", "not identified", unit, note)
    low, high = (rounded(end * factor, sd) for end in estimate.ci95)
    return Row(value, f"{sd:.2g}", f"{low} to {high}", unit, note)
