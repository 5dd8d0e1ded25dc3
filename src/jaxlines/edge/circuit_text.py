"""A circuit as text and back: the tables [fluid] and [circuit.NAME] of a study file, in SI."""

import dataclasses
import inspect
import json
import tomllib
from typing import Any

import equinox as eqx
import numpy as np

from jaxlines.edge.building import StudyError, _signal_metadata, _snake, build_circuit
from jaxlines.edge.naming import at
from jaxlines.physics.fields import AbstractSignal, External, is_concrete
from jaxlines.simulation.circuit import Circuit


def circuit_from_toml(text: str) -> Circuit:
    """The circuit that the tables [fluid] and [circuit.NAME] of a text describe; other tables are ignored.

    Raises: StudyError, with the place, for anything that is wrong in it.
    """
    with at(""):
        try:
            tables = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise StudyError(f"not valid TOML: {error}") from error
        return build_circuit(tables.get("fluid", {}), tables.get("circuit", {}))[0]


def circuit_to_toml(circuit: Circuit) -> str:
    """The text that describes a circuit, from which `circuit_from_toml` builds one with the same numbers, bit by bit.

    What has its default is left out. Pressures are absolute.
    Raises: TypeError for numbers that JAX traces, and for what a study file cannot say.
    """
    tables = {"fluid": circuit.fluid} | {f"circuit.{_key(name)}": part for name, part in circuit.components.items()}
    lines = []
    for heading, module in tables.items():
        rows = [] if heading == "fluid" else [("type", json.dumps(type(module).__name__))]
        rows += [(key, _written(value, metadata, f"{heading}.{key}")) for key, value, metadata in _told(module)]
        lines += [f"[{heading}]", *(f"{key} = {value}" for key, value in rows), ""]
    return "\n".join(lines)


def _key(name: str) -> str:
    """A key of TOML, in quotes where it needs them."""
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else json.dumps(name, ensure_ascii=False)


def _told(module, driven: dict | None = None):
    """(name, value, metadata) of the fields that must be said; `driven` is the metadata of what a signal drives."""
    accepted = set(inspect.signature(type(module)).parameters)
    for field in dataclasses.fields(module):
        value, metadata = getattr(module, field.name), dict(field.metadata)
        if field.name not in accepted or _is_default(field, value):
            continue
        if driven is not None:
            metadata = _signal_metadata(field.name, metadata, driven)
        yield field.name, value, metadata


def _is_default(field, value) -> bool:
    """Whether a field has the value it gets when nothing is said."""
    default, converter = field.default, field.metadata.get("converter")
    if default is dataclasses.MISSING:
        return False
    default = converter(default) if converter else default
    return type(value) is type(default) and bool(eqx.tree_equal(value, default) is True)


def _written(value: Any, metadata: dict, where: str) -> str:
    """A value as TOML; `where` names it in errors."""
    if isinstance(value, External):
        return f"{{ input = {json.dumps(value.name, ensure_ascii=False)} }}"
    if isinstance(value, AbstractSignal):
        return f"{{ {_snake(type(value).__name__)} = {_table(value, where, metadata)} }}"
    if isinstance(value, eqx.Module):
        return _table(value, where)
    if isinstance(value, tuple):
        return f"[{', '.join(_written(item, {}, f'{where}.{i}') for i, item in enumerate(value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int) and "unit" not in metadata:
        return str(value)
    if "unit" in metadata and value is not None:
        return _number(value, metadata, where)
    raise TypeError(f"{where}: a study file cannot say {value!r}")


def _table(module, where: str, driven: dict | None = None) -> str:
    """An object as an inline table; its type is said unless it is a signal."""
    rows = [f"type = {json.dumps(type(module).__name__)}"] if driven is None else []
    rows += [f"{key} = {_written(value, of, f'{where}.{key}')}" for key, value, of in _told(module, driven)]
    return f"{{ {', '.join(rows)} }}" if rows else "{}"


def _number(value, metadata: dict, where: str) -> str:
    """A number with its SI unit, or a list of them."""
    if not is_concrete(value):
        raise TypeError(f"{where} is traced by JAX: write circuits as text outside of traced code")
    unit = metadata["unit"]
    suffix = "_a" if metadata.get("level") and unit == "Pa" else ""

    def one(number: float) -> str:
        return repr(number) if unit == "1" else f'"{number!r} {unit}{suffix}"'

    numbers = np.asarray(value, dtype=float).tolist()
    if isinstance(numbers, float):
        return one(numbers)

    def listed(items) -> str:
        return f"[{', '.join(listed(i) if isinstance(i, list) else one(i) for i in items)}]"

    return listed(numbers)
