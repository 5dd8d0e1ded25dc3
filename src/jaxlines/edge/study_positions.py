"""Where in a study file a mistake is: the line and column of the key that a message names."""

import contextlib
import re

from jaxlines.edge.building import StudyError

_HEADING = re.compile(r"\s*\[(\[)?\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?")
_KEY = re.compile(r"""\s*((?:[\w.-]+|"[^"]*"|'[^']*')+)\s*=""")
_PLACE = re.compile(r"(?:^|: )((?:[\w-]+\.)*[\w-]+)(?: \([^)]*\))?(?=: )")
_NAMED = re.compile(r"unknown key '([^']+)'|unknown type '([^']+)'|'([^']+)' is missing")


def _plain(key: str) -> str:
    """A dotted key without quotes and spaces."""
    return ".".join(part.strip().strip("\"'") for part in re.split(r"\.(?=(?:[^\"]*\"[^\"]*\")*[^\"]*$)", key))


def positions(text: str) -> dict[str, tuple[int, int]]:
    """Dotted path of every table and key of a TOML text -> (line, column), from 1; arrays of tables are numbered.

    Keys inside inline tables are not listed: they stand on the line of the key that holds them.
    """
    found: dict[str, tuple[int, int]] = {}
    counts: dict[str, int] = {}
    table = ""
    for number, line in enumerate(text.splitlines(), 1):
        heading = _HEADING.fullmatch(line)
        if heading and "=" not in heading[2]:
            name = _plain(heading[2])
            if heading[1]:
                counts[name] = counts.get(name, -1) + 1
                found.setdefault(name, (number, line.index("[") + 1))
                name = f"{name}.{counts[name]}"
            table = name
            found.setdefault(table, (number, line.index("[") + 1))
            continue
        key = _KEY.match(line)
        if key:
            path = f"{table}.{_plain(key[1])}" if table else _plain(key[1])
            found.setdefault(path, (number, line.index(key[1]) + 1))
    return found


def _candidates(message: str) -> list[str]:
    """Paths that a message may mean, the most precise first."""
    places = [match[1] for match in _PLACE.finditer(message)]
    named = _NAMED.search(message)
    found = []
    for place in reversed(["", *places]):
        if named:
            word = next(word for word in named.groups() if word)
            key = "type" if named[2] else word
            found.append(f"{place}.{key}".strip("."))
        found.append(place)
    return [path for path in found if path]


def position_of(message: str, text: str) -> tuple[int, int] | None:
    """Line and column of what a message about a study names, or None.

    Args: message: such as "circuit.leak: unknown key 'conductanse', did you mean ..."; text: of the file.
    A place inside an inline table is that of the nearest key or table that holds it.
    """
    known = positions(text)
    for path in _candidates(message):
        words = path.split(".")
        for length in range(len(words), 0, -1):
            at = known.get(".".join(words[:length]))
            if at is not None:
                return at
    return None


@contextlib.contextmanager
def with_positions(text: str):
    """StudyErrors raised inside end with the line and column in the text, "(at line 24, column 1)"."""
    try:
        yield
    except StudyError as error:
        message = str(error)
        at = None if "(at line " in message else position_of(message, text)
        if at is None:
            raise
        raise StudyError(f"{message} (at line {at[0]}, column {at[1]})") from error
