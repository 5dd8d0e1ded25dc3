"""The page of the verification: Markdown from rows, differences of the published moduli, and docstrings."""

import ast
import importlib
import inspect
import re
from collections import Counter
from collections.abc import Iterable
from itertools import groupby, pairwise

import numpy as np
from verify_data import FILES
from verify_published import COMPARED_PRESSURES, EQUAL, REASONS, Difference
from verify_rows import KINDS, Row

MODULES = (
    *("article", "liquids", "viscosity", "fluids", "air", "solubility", "published_moduli", "walls", "containers"),
    *("accumulators", "nitrogen", "friction", "resistances", "weighting", "distributed", "validity"),
)
"""The modules of `jaxlines.physics` that hold formulas of fluids and lines."""
NO_FORMULAS = {"walls.check_restraint", "distributed.two_port", "resistances.passed"}
UNVERIFIED = "unverified"

INTRODUCTION = (
    "Every formula of fluids, containers and lines in `jaxlines.physics`, evaluated and held against a number that "
    "this package did not produce. The page is written by `experiments/verify_physics.py --docs`, and a test "
    "keeps it equal to what the code computes.\n"
)
LEGEND = (
    "Errors are relative unless marked `abs`; those of complex numbers are the larger of the real and the imaginary "
    "part's, each relative to itself. Where nothing else is known of an oracle, `within` is half of its last printed "
    "digit. Kinds of oracle: *independent arithmetic* (the formula evaluated elsewhere, by other code), *closed form* "
    "(a limit, an identity or an exact solution), *other program* (results of another simulator or property "
    "package), *published chart*. Pressures are absolute unless called gauge; ours is rounded to eight digits.\n"
)


MEMORY = (
    "## Quoted from memory\n\nFormulas of which a coefficient, a range or the reference could not be compared with the "
    "publication, in the words of their docstrings. The numbers above show that they are evaluated as written, not "
    "that they are written as published. For named oils see `jaxlines.catalogue.oils`.\n"
)


def public(module_name: str) -> dict[str, object]:
    """Qualified name -> public function or concrete class that a module of `jaxlines.physics` defines."""
    module = importlib.import_module(f"jaxlines.physics.{module_name}")
    found = {}
    for name, thing in vars(module).items():
        own = getattr(thing, "__module__", None) == module.__name__ and not name.startswith("_")
        if own and (inspect.isfunction(thing) or inspect.isclass(thing)):
            found[f"{module_name}.{name}"] = thing
    return found


def named(rows: Iterable[Row]) -> set[str]:
    """Functions and classes that rows evaluate, methods counted with their class."""
    return {".".join(row.formula.split(".")[:2]) for row in rows}


def uncovered(rows: Iterable[Row]) -> list[str]:
    """Formulas of `MODULES` that no row evaluates."""
    covered = named(rows)
    names = [name for module in MODULES for name, thing in public(module).items() if not inspect.isabstract(thing)]
    return [name for name in names if name not in covered | NO_FORMULAS]


_SECTIONS = r"(?=\b(?:Args|Raises|Validity|Typical values|Reference|Source|Error of W[^:]*):)"


def _clauses(text: str) -> str:
    """The sections of a docstring in which something is called unverified."""
    sections = re.split(_SECTIONS, " ".join(text.split()))
    return " ".join(section.strip() for section in sections if UNVERIFIED in section)


def unverified() -> dict[str, str]:
    """Qualified name -> what its docstring calls unverified; constants by the text below them."""
    found = {}
    for module_name in MODULES:
        texts = {name: inspect.getdoc(thing) for name, thing in public(module_name).items()}
        module = importlib.import_module(f"jaxlines.physics.{module_name}")
        body = ast.parse(inspect.getsource(module)).body
        for before, after in pairwise(body):
            if isinstance(before, ast.Assign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                texts[f"{module_name}.{ast.unparse(before.targets[0])}"] = str(after.value.value)
        found |= {name: _clauses(text) for name, text in texts.items() if text and UNVERIFIED in text}
    return found


def _error(row: Row) -> str:
    """One digit, which is the same on every processor."""
    text = f"{row.error:.0e}" if row.error >= row.floor else f"<{row.floor:.0e}"
    return text + " abs" * row.absolute


def _ours(number: float | complex) -> str:
    """Eight digits."""
    return f"{number.real:.8g}{number.imag:+.8g}j" if isinstance(number, complex) else f"{number:.8g}"


def _table(rows: Iterable[Row]) -> str:
    """Rows that share a source."""
    lines = ["| formula | case | oracle | ours | unit | error | within | |", "|---|---|---|---|---|---|---|---|"]
    for row in rows:
        name, mark = f"`{row.formula}`", "pass" if row.passes else "**FAIL**"
        numbers = f"{row.expected} | {_ours(row.ours)} | {row.unit} | {_error(row)} | {row.tolerance:.0e}"
        lines.append(f"| {name} | {row.case.replace('|', chr(92) + '|')} | {numbers} | {mark} |")
    return "\n".join(lines) + "\n"


def _topic(name: str, rows: list[Row]) -> str:
    """A topic with a table for each source, in the order of the rows."""
    sources = dict.fromkeys((row.kind, row.source) for row in rows)
    parts = [f"## {name}\n\n{sum(row.passes for row in rows)} of {len(rows)} rows pass.\n"]
    for kind, source in sources:
        shared = [row for row in rows if (row.kind, row.source) == (kind, source)]
        parts.append(f"*{kind}*" + f": {source}" * (source != kind) + f"\n\n{_table(shared)}")
    return "\n".join(parts)


def _percent(difference: float) -> str:
    """Two digits; equal where only rounding is left."""
    if abs(difference) < EQUAL:
        return "0"
    return f"{float(f'{100.0 * difference:.1e}'):+g}"


def _largest(cases: Iterable[Difference]) -> str:
    """By how much a modulus differs at most, and where."""
    worst = max(cases, key=lambda case: np.max(np.abs(case.differences)))
    place = int(np.argmax(np.abs(worst.differences)))
    if abs(worst.differences[place]) < EQUAL:
        return "equal"
    where = f"{COMPARED_PRESSURES[place]:g} MPa with air {worst.air_fraction:g} and n {worst.polytropic_index:g}"
    return f"{_percent(worst.differences[place])} % at {where}"


def differences_section(found: list[Difference]) -> str:
    """Where the published moduli differ from the reference law, and by how much."""
    lines = [
        "## Where the published bulk moduli differ\n",
        "Modulus of each of `published_moduli.PUBLISHED` over that of the reference law (`fluids.Oil` with free air), "
        "less 1, in percent. Liquid of 1.5 GPa; air as fraction of the mixture at p0; n the polytropic index.\n",
        "| name | largest difference | why |\n|---|---|---|",
    ]
    by_name = {name: [case for case in found if case.name == name] for name in dict.fromkeys(c.name for c in found)}
    lines += [f"| {name} | {_largest(cases)} | {REASONS[name]} |" for name, cases in by_name.items()]
    headings = " | ".join(f"{p:g} MPa" for p in COMPARED_PRESSURES)
    for index, cases in groupby(found, key=lambda case: case.polytropic_index):
        lines.append(f"\nn {index:g}, in percent; those that are equal throughout are left out:\n")
        lines.append(f"| name | air | {headings} |\n|---|---|{'---|' * len(COMPARED_PRESSURES)}")
        for case in cases:
            if np.max(np.abs(case.differences)) >= EQUAL:
                numbers = " | ".join(_percent(x) for x in case.differences)
                lines.append(f"| {case.name} | {case.air_fraction:g} | {numbers} |")
    return "\n".join(lines) + "\n"


def summary(rows: list[Row]) -> str:
    """How many rows pass, by kind of oracle."""
    count = Counter(row.kind for row in rows if row.passes)
    parts = ", ".join(f"{count[kind]} by {kind}" for kind in KINDS)
    return f"{sum(count.values())} of {len(rows)} rows pass: {parts}"


def overview(topics: dict[str, list[Row]]) -> str:
    """A line for each topic."""
    lines = ["| topic | formulas | rows | pass |", "|---|---|---|---|"]
    for name, rows in topics.items():
        lines.append(f"| {name} | {len(named(rows))} | {len(rows)} | {sum(row.passes for row in rows)} |")
    return "\n".join(lines) + "\n"


def page(topics: dict[str, list[Row]], found: list[Difference], skipped: list[str]) -> str:
    """The whole page."""
    rows = [row for group in topics.values() for row in group]
    parts = [
        "# Formulas against independent numbers\n",
        INTRODUCTION,
        f"**{summary(rows)}; {len(named(rows))} formulas.**\n",
        LEGEND,
        overview(topics),
        *(_topic(name, group) for name, group in topics.items()),
        differences_section(found),
    ]
    if skipped:
        files = "; ".join(f"`{name}` ({FILES[name]})" for name in skipped)
        parts.append(f"## Skipped\n\nNeeds files that are not part of the project, see `--data`: {files}.\n")
    doubts = "\n".join(f"- `{name}`: {text}" for name, text in sorted(unverified().items()))
    return "\n".join([*parts, MEMORY, doubts, ""])
