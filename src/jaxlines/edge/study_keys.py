"""The keys of study files, each with type, unit, default, range and meaning, as texts and tables for readers.

Everything is read from the classes that study files describe, so that a new component or key needs nothing here.
"""

import dataclasses
import functools
import inspect
import json
import math
import typing

import numpy as np
from pydantic import BaseModel

from jaxlines.edge import tables
from jaxlines.edge.building import StudyError, _kinds, _snake, suggest
from jaxlines.edge.class_docs import argument_docs, purpose
from jaxlines.edge.key_docs import KEY_DOCS
from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.fields import AbstractSignal, family_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.sensors import AbstractSensor


class Key(typing.NamedTuple):
    """A key of a table. Fields: name; type, unit, default and range as texts; required; text: what it is."""

    name: str
    type: str
    unit: str
    default: str
    range: str
    required: bool
    text: str


def _number(value: float) -> str:
    """A number as it is written."""
    return f"{value:g}"


def _default(field) -> tuple[str, bool]:
    """A default as a text, and whether the key must be given."""
    if field.default is not dataclasses.MISSING:
        value = field.default
    elif field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
    else:
        return "", True
    if value is None:
        return "none", False
    if isinstance(value, bool | str):
        return json.dumps(value), False
    if isinstance(value, int | float | np.ndarray) and np.ndim(value) == 0:
        return _number(float(value)), False
    return type(value).__name__, False


def _range(metadata) -> str:
    """A legal range as a text; "" for all numbers."""
    low, high = metadata.get("low", -math.inf), metadata.get("high", math.inf)
    if math.isinf(low) and math.isinf(high):
        return ""
    if math.isinf(high):
        return f"from {_number(low)}"
    return f"up to {_number(high)}" if math.isinf(low) else f"{_number(low)} to {_number(high)}"


def fields_of(kind: type) -> list:
    """The fields of a class that a study file can give."""
    accepted = inspect.signature(kind).parameters
    return [field for field in dataclasses.fields(kind) if field.name in accepted]


def _type_of(field, hint) -> str:
    """What a key takes, in words."""
    metadata = field.metadata
    if "port" in metadata:
        return f"name of a {metadata['port']} node"
    if metadata.get("driven"):
        return "number with unit, input or signal"
    if "unit" in metadata:
        return "number" if metadata["unit"] == "1" else "number with unit"
    family = family_of(hint)
    if family is not None:
        many = "list of tables" if typing.get_origin(hint) is tuple else "name or table"
        return f"{many}: {', '.join(_kinds(family))}"
    plain = [kind.__name__ for kind in (hint, *typing.get_args(hint)) if kind in (int, float, bool, str)]
    return " or ".join(plain) or "text"


@functools.cache
def keys_of_class(kind: type) -> tuple[Key, ...]:
    """The keys of the table of a component, fluid, container, law or signal."""
    fields, hints = fields_of(kind), typing.get_type_hints(kind)
    texts, found = argument_docs(kind, [field.name for field in fields]), []
    for field in fields:
        default, required = _default(field)
        unit = field.metadata.get("unit", "")
        unit = f"{unit} (absolute or gauge)" if field.metadata.get("level") else unit
        if field.metadata.get("optional"):
            required, default = False, "none"
        hint = hints.get(field.name)
        text = texts[field.name] or field.name.replace("_", " ")
        found.append(Key(field.name, _type_of(field, hint), unit, default, _range(field.metadata), required, text))
    return tuple(found)


def table_models() -> dict[str, type[BaseModel]]:
    """Name of each table of a study file, dotted, -> its layout."""
    return {".".join(place): model for place, model in tables._TABLES.items()}


def _pydantic_type(name: str, schema: dict) -> str:
    """What a key of a table takes, in words."""
    if "enum" in schema:
        return " or ".join(json.dumps(word) for word in schema["enum"])
    if "anyOf" in schema:
        return " or ".join(
            dict.fromkeys(_pydantic_type(name, one) for one in schema["anyOf"] if one.get("type") != "null")
        )
    if "$ref" in schema or schema.get("type") == "object":
        return "table"
    if schema.get("type") == "array":
        inner = schema.get("items", {})
        return f"list of {_pydantic_type(name, inner)}s" if inner else "list"
    return {"string": "text", "integer": "whole number", "boolean": "true or false"}.get(
        schema.get("type", ""), "number"
    )


def keys_of_table(table: str) -> tuple[Key, ...]:
    """The keys of a table of a study file, such as "fit.free"; "" for the top of the file."""
    model = table_models()[table]
    schema, found = model.model_json_schema(), []
    for name, content in schema["properties"].items():
        low, high = (
            content.get("minimum", content.get("exclusiveMinimum")),
            content.get("maximum", content.get("exclusiveMaximum")),
        )
        bounds = "" if low is None else (f"from {low:g}" if high is None else f"{low:g} to {high:g}")
        default, required = content.get("default"), name in schema.get("required", [])
        text = content.get("description") or KEY_DOCS.get(f"{table}.{name}" if table else name, "")
        shown = "" if required or default is None else json.dumps(default, ensure_ascii=False)
        shown = "" if shown in ("{}", "[]", '""') or len(shown) > 40 else shown
        found.append(Key(name, _pydantic_type(name, content), "", shown, bounds, required, text))
    return tuple(found)


def classes_in_studies() -> dict[str, dict[str, type]]:
    """Heading -> name -> class, of everything that a study file can describe."""
    groups = {"Fluid": {"Oil": Oil}, "Components": _kinds(AbstractComponent), "Sensors": _kinds(AbstractSensor)}
    families: dict[str, type] = {}
    for kind in [cls for group in groups.values() for cls in group.values()]:
        for hint in typing.get_type_hints(kind).values():
            family = family_of(hint)
            if family is not None:
                families[family.__name__] = family
    for name, family in sorted(families.items()):
        label = _snake(name.removeprefix("Abstract")).replace("_", " ")
        groups[f"Laws and parts: {label}"] = _kinds(family)
    groups["Signals"] = _kinds(AbstractSignal)
    return {heading: dict(sorted(kinds.items())) for heading, kinds in groups.items() if kinds}


def classes_by_name() -> dict[str, type]:
    """Every class that a study file can name."""
    return {name: kind for kinds in classes_in_studies().values() for name, kind in kinds.items()}


def _rows(keys: tuple[Key, ...]) -> list[str]:
    """Keys as rows of a Markdown table."""
    lines = ["| key | type | unit | default | range | meaning |", "|---|---|---|---|---|---|"]
    for key in keys:
        default = "**required**" if key.required else f"`{key.default}`" * bool(key.default)
        cells = (f"`{key.name}`", key.type, key.unit.replace("|", "/"), default, key.range, key.text)
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return lines


def _is_array(place: str) -> bool:
    """Whether a table stands several times in a file, as [[place]]."""
    parent, _, name = place.rpartition(".")
    return bool(parent) and typing.get_origin(table_models()[parent].model_fields[name].annotation) is list


def keys_as_markdown() -> str:
    """Every key of study files as a page: tables of the file first, then everything that a table can describe."""
    lines = ["# Keys of study files", ""]
    lines += [
        'Generated from code. Numbers carry their unit in the text, such as `"12.8 mm"`; any unit of the same kind '
        "will do. Pressures that are levels say absolute (`bar_a`) or gauge (`bar_g`).",
        "",
    ]
    for place in table_models():
        heading = f"`[{place}]`" if place else "Top of the file"
        heading = f"`[[{place}]]`" if _is_array(place) else heading
        lines += [f"## {heading}", "", *_rows(keys_of_table(place)), ""]
    for heading, kinds in classes_in_studies().items():
        lines += [f"## {heading}", ""]
        for name, kind in kinds.items():
            lines += [f"### {name}", "", purpose(kind), "", *_rows(keys_of_class(kind)), ""]
    return "\n".join(lines)


def keys_as_text(which: str = "") -> str:
    """The keys of one table or class in plain lines; the names of all without one.

    Raises: StudyError that suggests a near name.
    """
    models, classes = table_models(), classes_by_name()
    if not which:
        names = [f"[{place}]" for place in models if place]
        return "\n".join(
            ["tables: " + ", ".join(names), "types: " + ", ".join(classes), "one of them: jaxlines keys NAME"]
        )
    wanted = {"fluid": "Oil"}.get(which, which.strip("[]"))
    if wanted not in models and wanted not in classes:
        raise StudyError(f"no table or type of a study is called {which!r}, {suggest(which, [*models, *classes])}")
    keys = keys_of_table(wanted) if wanted in models else keys_of_class(classes[wanted])
    lines = []
    for key in keys:
        facts = [key.type, key.unit, "required" if key.required else f"default {key.default}" * bool(key.default)]
        facts += [f"range {key.range}"] if key.range else []
        lines.append(f"{key.name}: {key.text} ({'; '.join(fact for fact in facts if fact)})")
    return "\n".join(lines)
