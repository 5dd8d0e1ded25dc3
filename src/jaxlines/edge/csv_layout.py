"""How a text file of columns is laid out: encoding, delimiter, decimal sign, headings, a row of units."""

import csv
import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from jaxlines.edge.unit_words import unit_of

SAMPLE_LINES = 5000
SAMPLE_BYTES = 1_000_000
WHITESPACE = r"\s+"
_DELIMITERS = (";", "\t", "|", ",")
_NUMBER = re.compile(r"[+-]?(\d[\d.,' ]*|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_STAMP = re.compile(
    r"(\d{1,4}[-./]\d{1,2}[-./]\d{1,4})?[T ]*\d{1,2}:\d{2}(:\d{2}([.,:]\d+)?)?( ?[AaPp][Mm])?([Z+-].*)?"
)
_COMMA_DECIMAL = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_POINT_DECIMAL = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")
_COMMA_AFTER_POINTS = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")
_STAMP_WORDS = ("hh:mm:ss", "hh:mm:ss.fff", "date", "datetime", "timestamp")
_MAYBE_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")


class Layout(NamedTuple):
    """Layout of a text file.

    Fields: encoding; delimiter, or a pattern for white space; decimal: "." or ","; thousands: the sign between
    thousands, or None; first_row: the line of the first numbers, from 0; names: headings as written, one a column;
    units: those of a row of units, "" where there is none; notes: what was unusual, in words.
    """

    encoding: str
    delimiter: str
    decimal: str
    thousands: str | None
    first_row: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]


def _decoded(path: Path) -> tuple[list[str], str, list[str]]:
    """The first lines of a file, their encoding and what is to be said about it."""
    with path.open("rb") as file:
        raw = file.read(SAMPLE_BYTES)
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif b"\0" in raw:
        raise ValueError(f"{path}: is not a text file, although its name ends like one")
    else:
        encodings = ["utf-8-sig", "cp1252"]
    for encoding in encodings:
        try:
            # The sample may end within a character or a line: the last line is left out then.
            text = raw.decode(encoding, errors="strict" if len(raw) < SAMPLE_BYTES else "ignore")
        except UnicodeDecodeError:
            continue
        lines = text.splitlines()[: SAMPLE_LINES + 1]
        complete = lines if len(raw) < SAMPLE_BYTES and len(lines) <= SAMPLE_LINES else lines[:-1]
        return complete, encoding, [] if encoding != "cp1252" else ["the text is not UTF-8: read as Windows-1252"]
    raise ValueError(f"{path}: cannot be read as text: save it as UTF-8")


def _split(lines: list[str], delimiter: str) -> list[list[str]]:
    """The cells of lines."""
    if delimiter == WHITESPACE:
        return [line.split() for line in lines]
    return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter)]


def _delimiter(lines: list[str]) -> str:
    """The first of the known delimiters that cuts most lines into equally many cells; "," where none does."""
    filled = [line for line in lines if line.strip()]
    for delimiter in _DELIMITERS:
        counts = Counter(len(row) for row in _split(filled[len(filled) // 2 :], delimiter))
        width, number = counts.most_common(1)[0] if counts else (0, 0)
        if width > 1 and number >= 0.8 * counts.total():
            return delimiter
    counts = Counter(len(line.split()) for line in filled[len(filled) // 2 :])
    numeric = all(_is_value(cell) for line in filled[-3:] for cell in line.split())
    return WHITESPACE if counts and counts.most_common(1)[0][0] > 1 and numeric else ","


def _is_value(cell: str) -> bool:
    """Whether a cell looks like a number or a time stamp."""
    return bool(_NUMBER.fullmatch(cell) or _STAMP.fullmatch(cell))


def _first_data(rows: list[list[str]]) -> int:
    """The first row that is mostly values; the row after the first where there is none."""
    width = Counter(len(row) for row in rows[len(rows) // 2 :]).most_common(1)[0][0] if rows else 0
    for i, row in enumerate(rows):
        values = sum(_is_value(cell) for cell in row)
        if len(row) == width and values and values >= sum(bool(cell) for cell in row) - values:
            return i
    return min(1, len(rows))


def _looks_like_unit(cell: str) -> bool:
    """Whether a cell of a second row of headings is a unit, or empty."""
    return not cell or unit_of(cell) is not None or cell.lower() in _STAMP_WORDS


def _headings(rows: list[list[str]], first: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Headings and units of the columns, from the rows above the first values."""
    width = len(rows[first]) if first < len(rows) else len(rows[-1])
    above = first
    while above > 0 and len(rows[above - 1]) == width and any(rows[above - 1]):
        above -= 1
    block = rows[above:first]
    units = ("",) * width
    if len(block) >= 2 and any(block[-1]) and all(map(_looks_like_unit, block[-1])):
        units = tuple(unit_of(cell) or "" for cell in block[-1])
        block = block[:-1]
    names = block[-1] if block else [f"column {i + 1}" for i in range(width)]
    return tuple(names), units


def _decimals(rows: list[list[str]], delimiter: str) -> tuple[str, str | None, list[str]]:
    """Decimal sign, sign between thousands, and what is doubtful about them."""
    cells = [cell for row in rows for cell in row if cell]
    if any(map(_COMMA_AFTER_POINTS.fullmatch, cells)):
        return ",", ".", []
    commas = [cell for cell in cells if _COMMA_DECIMAL.fullmatch(cell)]
    # Single commas of a file that is cut at commas come from quoted cells; a few of them are slips, not a style.
    if not commas or (delimiter == "," and len(commas) < 0.5 * len(cells)):
        return ".", None, []
    if any(map(_POINT_DECIMAL.fullmatch, cells)):
        return ".", "," if all(map(_MAYBE_THOUSANDS.fullmatch, commas)) else None, []
    if all(map(_MAYBE_THOUSANDS.fullmatch, commas)):
        return ",", None, [f"commas are read as decimal signs ({commas[0]!r}): do they stand between thousands?"]
    return ",", None, []


def find_layout(path: Path) -> Layout:
    """The layout of a text file of columns, from its first lines.

    Returns: delimiter (; tab | , or white space), decimal sign, headings, a row of units below them, and where the
        numbers begin; lines of description above the headings are passed over.
    Raises: ValueError for a file that is no text or has nothing in it.
    """
    lines, encoding, notes = _decoded(path)
    if not any(line.strip() for line in lines):
        raise ValueError(f"{path}: cannot be read as csv (there is nothing but empty lines in it)")
    delimiter = _delimiter(lines)
    rows = _split(lines, delimiter)
    first = _first_data(rows)
    names, units = _headings(rows, first)
    decimal, thousands, doubts = _decimals(rows[first:], delimiter)
    return Layout(encoding, delimiter, decimal, thousands, first, names, units, (*notes, *doubts))
