"""The keys of study files: a JSON schema for editors, and tables of type, unit, default and range for readers.

Everything is read from the classes that study files describe, so that a new component or key needs nothing here.
"""

import dataclasses
import functools
import inspect
import json
import math
import typing
from typing import Any

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

SCHEMA = "https://json-schema.org/draft/2020-12/schema"


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


def _fields(kind: type) -> list:
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
    fields, hints = _fields(kind), typing.get_type_hints(kind)
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


def _by_name() -> dict[str, type]:
    """Every class that a study file can name."""
    return {name: kind for kinds in classes_in_studies().values() for name, kind in kinds.items()}


# ---- JSON schema --------------------------------------------------------------------------------------------------


def _quantity_schema(field) -> dict:
    """A number with its unit."""
    unit = field.metadata["unit"]
    text = {"type": "string", "pattern": r"^\s*[-+]?(inf|(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)"}
    one: dict[str, Any] = {"anyOf": [{"type": "number"}, text]} if unit == "1" else dict(text)
    if unit == "1":
        low, high = field.metadata.get("low", -math.inf), field.metadata.get("high", math.inf)
        one["anyOf"][0] |= {} if math.isinf(low) else {"minimum": low}
        one["anyOf"][0] |= {} if math.isinf(high) else {"maximum": high}
    if not field.metadata.get("driven"):
        return {"anyOf": [one, {"type": "array", "items": {}}]} if unit == "1" else {"anyOf": [one, {"type": "array"}]}
    signals = {"input": {"type": "string", "description": "name of an input or of a controller"}}
    for name in _kinds(AbstractSignal):
        signals[_snake(name)] = {"$ref": f"#/$defs/{name}"}
    driven = {
        "type": "object",
        "properties": signals,
        "additionalProperties": False,
        "maxProperties": 1,
        "minProperties": 1,
    }
    return {"anyOf": [one, driven]}


def _field_schema(field, hint) -> dict:
    """One key of a class."""
    metadata = field.metadata
    if "unit" in metadata:
        return _quantity_schema(field)
    family = family_of(hint)
    if family is not None:
        names = list(_kinds(family))
        choice = {"anyOf": [{"enum": names}, *({"$ref": f"#/$defs/{name}"} for name in names)]}
        if typing.get_origin(hint) is tuple:
            tables_only = {"anyOf": [{"$ref": f"#/$defs/{name}"} for name in names]}
            return {"anyOf": [{"type": "array", "items": tables_only}, tables_only]}
        return choice
    kinds = {int: "integer", float: "number", bool: "boolean", str: "string"}
    plain = [kinds[kind] for kind in (hint, *typing.get_args(hint)) if kind in kinds]
    return {"type": plain[0] if len(plain) == 1 else plain} if plain else {"type": "string"}


def _class_schema(name: str, kind: type, *, typed: bool) -> dict:
    """The table of a class; `typed` where the key `type` names it."""
    hints, texts = typing.get_type_hints(kind), {key.name: key for key in keys_of_class(kind)}
    properties: dict[str, Any] = {"type": {"const": name}} if typed else {}
    for field in _fields(kind):
        key = texts[field.name]
        details = [key.text, f"[{key.unit}]" * bool(key.unit), f"default {key.default}" * bool(key.default)]
        details += [f"range {key.range}"] if key.range else []
        words = "; ".join(word for word in details if word)
        properties[field.name] = {**_field_schema(field, hints.get(field.name)), "description": words}
    required = [key.name for key in texts.values() if key.required] + (["type"] if typed else [])
    return {
        "type": "object",
        "description": purpose(kind),
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _loosen(schema: dict) -> None:
    """What is changed before a table is checked: one path instead of a list, dotted names without quotes."""
    definitions = schema["$defs"]
    path = definitions["FreeTable"]["properties"]["path"]
    definitions["FreeTable"]["properties"]["path"] = {
        "description": path["description"],
        "anyOf": [{"type": "string"}, path],
    }
    recording = definitions["RecordingTable"]["properties"]
    for content in (recording["channels"], recording["noise"], schema["properties"]["initial"]):
        content["additionalProperties"] = {"anyOf": [content.get("additionalProperties", {}), {"type": "object"}]}


def study_schema() -> dict:
    """The JSON schema of study files (draft 2020-12)."""
    schema = tables.StudyTable.model_json_schema()
    for place, model in table_models().items():
        target = schema if place == "" else schema["$defs"].get(model.__name__)
        for key in keys_of_table(place) if target else ():
            target["properties"][key.name].setdefault("description", key.text)
    _loosen(schema)
    definitions = schema.setdefault("$defs", {})
    signals = set(_kinds(AbstractSignal))
    for name, kind in _by_name().items():
        definitions[name] = _class_schema(name, kind, typed=name not in signals and name != "Oil")
    definitions["Oil"]["properties"]["type"] = {"const": "Oil"}
    parts = [{"$ref": f"#/$defs/{name}"} for name in (*_kinds(AbstractComponent), *_kinds(AbstractSensor))]
    schema["properties"]["fluid"] = {"$ref": "#/$defs/Oil", "description": KEY_DOCS["fluid"]}
    circuit = {"type": "object", "minProperties": 1, "description": KEY_DOCS["circuit"]}
    schema["properties"]["circuit"] = circuit | {"additionalProperties": {"anyOf": parts}}
    return {"$schema": SCHEMA, **schema, "title": "jaxlines study"}


def study_schema_text() -> str:
    """The JSON schema of study files as a text."""
    return json.dumps(study_schema(), indent=2, ensure_ascii=False)


# ---- tables for readers -------------------------------------------------------------------------------------------


def _rows(keys: tuple[Key, ...]) -> list[str]:
    """Keys as rows of a Markdown table."""
    lines = ["| key | type | unit | default | range | meaning |", "|---|---|---|---|---|---|"]
    for key in keys:
        default = "**required**" if key.required else f"`{key.default}`" * bool(key.default)
        cells = (f"`{key.name}`", key.type, key.unit.replace("|", "/"), default, key.range, key.text)
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return lines


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
        heading = f"`[[{place}]]`" if place in ("fit.free", "fit.known") else heading
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
    models, classes = table_models(), _by_name()
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
