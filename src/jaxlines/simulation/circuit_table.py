"""A circuit as a table in plain text: components, their types, nodes and main numbers in SI."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

from jaxlines.physics.fields import External
from jaxlines.physics.fluids import Oil

_WIDEST = 100


def circuit_table(fluid: Oil, components: Mapping) -> str:
    """The table of a circuit, a row for the fluid and one for each component; numbers that have their default are left
    out, numbers that JAX traces are shown as such."""
    rows = [("name", "type", "nodes", "numbers"), ("fluid", type(fluid).__name__, "", _numbers(fluid))]
    rows += [(name, type(part).__name__, _nodes(part), _numbers(part)) for name, part in components.items()]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    lines = []
    for *cells, numbers in rows:
        first = "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
        for i, part in enumerate(_broken(numbers)):
            lines.append(((first if i == 0 else " " * len(first)) + "  " + part).rstrip())
    return "\n".join(lines)


def _broken(text: str) -> list[str]:
    """A text in lines that are not too long, broken after commas."""
    lines = [""]
    for piece in text.split(", "):
        longer = f"{lines[-1]}, {piece}" if lines[-1] else piece
        lines = (
            [*lines[:-1], longer] if len(longer) <= _WIDEST or not lines[-1] else [*lines[:-1], lines[-1] + ",", piece]
        )
    return lines


def _nodes(part) -> str:
    """Nodes at the ports, with the port's name where there are several."""
    ports = {f.name: getattr(part, f.name) for f in dataclasses.fields(part) if "port" in f.metadata}
    attached = {port: node for port, node in ports.items() if node is not None}
    return " ".join(node if len(attached) == 1 else f"{port}={node}" for port, node in attached.items())


def _numbers(module) -> str:
    """Fields that differ from their defaults, with units."""
    said = []
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if "port" in field.metadata or _is_default(field, value):
            continue
        said.append(f"{field.name} {_shown(value, field.metadata.get('unit', ''))}")
    return ", ".join(said)


def _is_default(field, value) -> bool:
    """Whether a field has the value that it has when nothing is said."""
    if field.default is dataclasses.MISSING:
        return False
    default, converter = field.default, field.metadata.get("converter")
    return bool(eqx.tree_equal(value, converter(default) if converter else default) is True)


def _shown(value: Any, unit: str) -> str:
    """One value in a few characters."""
    unit = "" if unit in ("", "1") else f" {unit}"
    if isinstance(value, External):
        return f"<- {value.name}"
    if isinstance(value, eqx.Module):
        inner = _numbers(value)
        return f"{type(value).__name__}({inner})" if inner else type(value).__name__
    if isinstance(value, tuple):
        return "[" + ", ".join(_shown(item, "") for item in value) + "]"
    if isinstance(value, str | int) or value is None:
        return str(value)
    try:
        numbers = np.asarray(value, dtype=float)
    except Exception:  # a tracer, a shape without value, a placeholder: each raises a kind of its own
        return "traced"
    if numbers.ndim == 0:
        return f"{numbers:.6g}{unit}"
    return f"{numbers.size} values {np.min(numbers):.4g}..{np.max(numbers):.4g}{unit}"
