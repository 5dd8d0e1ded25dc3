"""What the docstring of a class says of each of its arguments."""

import inspect
import re

_END = r"(?=\n\s*(?:Raises|Returns|Validity|Notes?|Typical values|References?|Units?)\b|\n\n|\Z)"


def _entries(kind: type, known: str) -> list[str]:
    """The entries between semicolons, or on lines of their own, after "Args:" in a class's docstring and its bases'."""
    found = []
    for base in kind.__mro__[:-1]:
        text = inspect.cleandoc(base.__dict__.get("__doc__") or "")
        for match in re.finditer(rf"\bArgs:(.*?){_END}", text, re.DOTALL):
            found += [" ".join(entry.split()) for entry in re.split(rf";|\n\s*(?=(?:{known})\b[^;\n]*:)", match[1])]
    return found


def purpose(kind: type) -> str:
    """The first sentence of a class's docstring."""
    text = " ".join((inspect.getdoc(kind) or kind.__name__).split("\n\n")[0].split())
    return re.split(r"(?<=[.])\s", text)[0]


def _words(rest: str) -> str:
    """The text after the names of an entry: the first sentence, without the colon that leads to it."""
    text = re.sub(r"^\s*:\s*", "", rest).strip()
    return re.split(r"\.\s+(?=[A-Z])", text)[0].strip(" .,")


def argument_docs(kind: type, names) -> dict[str, str]:
    """Name -> what the docstring says of it, "" for nothing.

    Docstrings read "Args: node; flow: positive into the node, ... [m^3/s]; a, b: ends; gain_...: of each": entries
    between semicolons, each of one or more names and a text; "gain_..." stands for all names that begin so.
    """
    names, found = list(names), {}
    if not names:
        return {}
    known = "|".join([*map(re.escape, sorted(names, key=len, reverse=True)), r"\w+_\.\.\."])
    head = re.compile(rf"((?:{known})(?:(?:, and |, | and )(?:{known}))*)(?![\w.])(.*)")
    for entry in _entries(kind, known):
        match = head.match(entry)
        if match is None:
            continue
        for word in re.split(r", and |, | and ", match[1]):
            stem = word.removesuffix("...")
            for name in names:
                if name == word or (stem != word and name.startswith(stem)):
                    found.setdefault(name, _words(match[2]))
    return {name: found.get(name, "") for name in names}
