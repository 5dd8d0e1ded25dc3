"""Quantities with units, by pint: texts such as "12.8 mm" or "2 bar_g" become numbers in SI, checked.

A pressure that is a level (counted from zero or from atmosphere) says which: `bar_a`, `bar_g`, `psi_a`,
`psi_g`, `Pa_a`, ... Differences, offsets and stiffnesses take the bare unit. Which fields are levels is stated
by `level=True` where they are declared.
"""

import functools
import math
import re
from typing import Any

from jaxlines.physics.fields import ATMOSPHERE

_NUMBER = re.compile(r"\s*([+-]?(?:inf|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?))\s*(.*?)\s*", re.DOTALL)
_LEVEL = re.compile(r"(.+)_([ag])")
_DEFINITIONS = ("rev = revolution", "gpm = gallon / minute", "lpm = liter / minute")
_CYCLES = re.compile(r"hertz")


@functools.cache
def _registry():
    """The one registry of units, made when the first text is read."""
    import pint

    registry = pint.UnitRegistry()
    for definition in _DEFINITIONS:
        registry.define(definition)
    return registry


def _parse(text: str):
    """A pint unit from its text. Raises ValueError for what is no unit."""
    try:
        return _registry().parse_units(text.replace("%", "percent"))
    except Exception as error:  # pint and its tokenizer raise many kinds
        raise ValueError(f"unknown unit {text!r}: write it like mm, L/min, cm^3/rev, cSt, GPa, bar_a, bar_g") from error


def split_level(unit: str) -> tuple[str, str]:
    """The bare unit and "a", "g" or "" from a unit such as "bar_g"."""
    match = _LEVEL.fullmatch(unit.strip())
    return (match[1], match[2]) if match else (unit.strip(), "")


def is_pressure(unit: str) -> bool:
    """Whether a unit, without its suffix, measures pressure. Raises ValueError for an unknown one."""
    return _parse(split_level(unit)[0]).is_compatible_with("Pa")


def base_unit(unit: str) -> str:
    """The SI unit of the same kind, such as "Pa", "m^3/s", "1"."""
    if is_pressure(unit):
        return "Pa"
    base = _registry().Quantity(1, _parse(split_level(unit)[0])).to_base_units().units
    return "1" if base.dimensionless and not str(base).count("radian") else f"{base:~C}".replace("**", "^")


def _angle_power(unit):
    """Power of the radian in a unit, which pint would otherwise let pass as a pure number."""
    root = _registry().Quantity(1, unit).to_root_units()
    power: Any = dict(root.unit_items()).get("radian", 0)
    return power


def _angle_factor(text: str, given, wanted) -> float:
    """2 pi where cycles (Hz) meet radians; an error where an angle is missing or too many."""
    surplus = _angle_power(given) - _angle_power(wanted)
    if surplus == 0:
        return 1.0
    if surplus == -1 and _CYCLES.search(str(given)):
        return 2.0 * math.pi
    if surplus == 1 and _CYCLES.search(str(wanted)):
        return 1.0 / (2.0 * math.pi)
    raise ValueError(
        f"unit {text!r} and {wanted:~C} differ by an angle: write rad, deg or rev into it (rpm, Hz for speeds)"
    )


def _check_level(text: str, suffix: str, si_unit: str, level: bool | None) -> None:
    """Absolute or gauge must be said of a level, and of nothing else."""
    bare = split_level(text)[0]
    if suffix and (si_unit != "Pa" or not is_pressure(bare)):
        raise ValueError(f"unit {text!r}: _a (absolute) and _g (gauge) belong to pressures")
    if suffix and level is False:
        raise ValueError(
            f"unit {text!r}: this is a difference or a stiffness, neither absolute nor gauge: write {bare}"
        )
    if level and not suffix and is_pressure(bare):
        raise ValueError(f"{text!r} does not say from where it counts: write {bare}_a (absolute) or {bare}_g (gauge)")


def conversion(unit: str, si_unit: str, *, level: bool | None = None, atmospheric_pressure: float = ATMOSPHERE):
    """Factor and offset from a unit to an SI unit: value_SI = factor * value + offset.

    Args: unit as written; si_unit to reach; level: True for a pressure that must say absolute or gauge, False
        for one that must not, None for either; atmospheric_pressure: zero of gauge pressures [Pa].
    "Hz" is accepted where the SI unit is rad/s (80 Hz is 2 pi 80 rad/s), and the other way round.
    Raises: ValueError for an unknown unit, another dimension, a missing angle, a missing or wrong suffix.
    """
    bare, suffix = split_level(unit)
    given, wanted = _parse(bare), _parse(si_unit)
    if not given.is_compatible_with(wanted):
        raise ValueError(f"unit {unit!r} does not measure what is asked for, which is in {si_unit}")
    _check_level(unit, suffix, si_unit, level)
    angle = _angle_factor(unit, given, wanted)
    quantity = _registry().Quantity
    offset = float(quantity(0.0, given).to(wanted).magnitude)
    factor = float(quantity(1.0, given).to(wanted).magnitude) - offset
    return angle * factor, offset + (atmospheric_pressure if suffix == "g" else 0.0)


def si(value, unit: str, *, level: bool | None = None, atmospheric_pressure: float = ATMOSPHERE) -> float:
    """A number in an SI unit from a text: `si("12.8 mm", "m")` is 0.0128, `si("2 bar_g", "Pa")` 301325.

    Args: value: a text with its unit, or a plain number where the unit is "1" ("0.5 %" is 0.005);
        unit: SI unit of the result; level, atmospheric_pressure: see `conversion`.
    "Hz" is accepted where the unit is rad/s: 80 Hz is 2 pi 80 rad/s.
    Raises: ValueError for a number without unit, an unknown unit, another dimension, a pressure level
        without _a or _g; TypeError for what is neither text nor number.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        if unit == "1":
            return float(value)
        raise ValueError(f'{value!r} has no unit: write it as a text such as "{value!r} {_example(unit, level)}"')
    if not isinstance(value, str):
        raise TypeError(f'expected a number or a text with a unit such as "1 {_example(unit, level)}", got {value!r}')
    match = _NUMBER.fullmatch(value)
    if match is None or "," in match[2]:
        comma = ": decimals take a point, not a comma" if "," in value else ""
        raise ValueError(f'{value!r} is no number with a unit such as "1 {_example(unit, level)}"{comma}')
    if not match[2] and unit != "1":
        raise ValueError(f'{value!r} has no unit: write for example "{match[1]} {_example(unit, level)}"')
    factor, offset = conversion(match[2] or "1", unit, level=level, atmospheric_pressure=atmospheric_pressure)
    return factor * float(match[1]) + offset


def _example(unit: str, level: bool | None) -> str:
    """A unit to suggest: for levels with its suffix."""
    return "bar_a" if level and unit == "Pa" else unit
