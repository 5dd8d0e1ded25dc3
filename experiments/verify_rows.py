"""A row of the verification: one formula, one case, a number that the package did not produce, and ours.

An oracle's number is written as a text, as it was printed: half of its last digit is then the tolerance, unless
another one is given. A number that follows from a closed form is a float and must be met to 1e-11.
"""

from collections.abc import Iterable
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np

ARITHMETIC, CLOSED = "independent arithmetic", "closed form"
PROGRAM, CHART = "other program", "published chart"
KINDS = (ARITHMETIC, CLOSED, PROGRAM, CHART)

LEAST_TOLERANCE = 1e-11
ERROR_FLOOR = 1e-12
"""Errors below it are rounding, which differs between processors, and are printed as less than it."""
HALF_DIGIT = 0.51  # of the last printed digit; the oracle itself was rounded


class Oracle(NamedTuple):
    """Where a number comes from: its kind, one of `KINDS`, and its source."""

    kind: str
    source: str


APART = Oracle(ARITHMETIC, "computed apart from this package, with NumPy and SciPy")
THIRTY = Oracle(ARITHMETIC, "computed with 30-digit arithmetic (mpmath)")
BY_HAND = Oracle(ARITHMETIC, "by hand")
FORM = Oracle(CLOSED, "closed form")


class Row(NamedTuple):
    """One number against its oracle; error and tolerance are relative unless `absolute`."""

    formula: str
    case: str
    unit: str
    kind: str
    source: str
    expected: str
    ours: float | complex
    error: float
    tolerance: float
    absolute: bool
    floor: float

    @property
    def passes(self) -> bool:
        """Whether the error is within the tolerance; never with a number that is none."""
        return bool(self.error <= self.tolerance)

    def to_dict(self) -> dict:
        """What results.json says of it."""
        ours = [self.ours.real, self.ours.imag] if isinstance(self.ours, complex) else self.ours
        return self._asdict() | {"ours": ours, "passes": self.passes}


def half_digit(printed: str) -> float:
    """Half of the last digit of a printed number."""
    return HALF_DIGIT * 10.0 ** int(Decimal(printed).as_tuple().exponent)


def _text(number: float | complex) -> str:
    return f"{number.real:.8g}{number.imag:+.8g}j" if isinstance(number, complex) else f"{number:.8g}"


def _value(expected: str | float | complex) -> float | complex:
    """The number of an oracle."""
    if isinstance(expected, str):
        return complex(expected) if "j" in expected else float(expected)
    return expected if isinstance(expected, complex) else float(expected)


def _relative_error(ours, value) -> float:
    """Of a number, or the larger one of real and imaginary part, each relative to itself."""
    if not isinstance(value, complex):
        return abs(ours - value) / abs(value)
    parts = ((ours.real, value.real), (ours.imag, value.imag))
    return max(abs(mine - part) / (abs(part) or abs(value)) for mine, part in parts)


def _default_tolerance(expected: str | float | complex, size: float) -> float:
    """Half of the last digit of a printed number, over its size."""
    if isinstance(expected, str) and "j" not in expected:
        return max(half_digit(expected) / size, LEAST_TOLERANCE)
    return LEAST_TOLERANCE


def check(
    formula: str,
    oracle: Oracle,
    cases: Iterable[tuple[str, Any, Any]],
    *,
    unit: str = "",
    relative: float | None = None,
    absolute: float | None = None,
    floor: float = ERROR_FLOOR,
) -> list[Row]:
    """Rows of one formula against one oracle.

    Args: formula: module and name within `jaxlines.physics`, "liquids.tait_volume"; cases: (what, number of the
        oracle, ours); the number a text as printed, or a float or complex by a closed form. relative, absolute:
        the tolerance, where the default does not fit; floor: of the printed error, where rounding is larger.
    """
    rows = []
    for case, expected, ours in cases:
        value = _value(expected)
        ours = complex(ours) if isinstance(value, complex) else float(ours)
        from_zero = absolute is not None or value == 0.0
        if from_zero:
            error, tolerance = abs(ours - value), _default_tolerance(expected, 1.0) if absolute is None else absolute
        else:
            error = _relative_error(ours, value)
            tolerance = _default_tolerance(expected, abs(value)) if relative is None else relative
        text = expected if isinstance(expected, str) else _text(value)
        rows.append(Row(formula, case, unit, *oracle, text, ours, error, tolerance, from_zero, floor))
    return rows


def along(name: str, places: Iterable, printed: str, ours) -> list[tuple[str, str, Any]]:
    """Cases along one variable: `name` with the place in braces, numbers as printed in one text, ours as an array."""
    texts, places = printed.split(), list(places)
    ours = np.broadcast_to(ours, len(places))
    return [(name.format(place), text, x) for place, text, x in zip(places, texts, ours, strict=True)]
