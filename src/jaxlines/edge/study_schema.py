"""A JSON schema of study files, by which editors complete and check keys as one types.

Everything is read from the classes that study files describe, so that a new component or key needs nothing here.
"""

import json
import math
import typing
from typing import Any

from jaxlines.edge import tables
from jaxlines.edge.building import _kinds, _snake
from jaxlines.edge.class_docs import purpose
from jaxlines.edge.key_docs import KEY_DOCS
from jaxlines.edge.study_keys import classes_by_name, fields_of, keys_of_class, keys_of_table, table_models
from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.fields import AbstractSignal, family_of
from jaxlines.physics.sensors import AbstractSensor

SCHEMA = "https://json-schema.org/draft/2020-12/schema"


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
    for field in fields_of(kind):
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
    for table, key in (("FreeTable", "path"), ("UncertainTable", "path"), ("DesignTable", "target")):
        keys = definitions[table]["properties"]
        keys[key] = {"description": keys[key]["description"], "anyOf": [{"type": "string"}, keys[key]]}
    recording, designed = (definitions[table]["properties"] for table in ("RecordingTable", "DesignTable"))
    columns = definitions["CasesTable"]["properties"]["columns"]
    by_name = [recording["channels"], recording["noise"], schema["properties"]["initial"], columns]
    for content in (*by_name, designed["noise"], designed["limits"]):
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
    for name, kind in classes_by_name().items():
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
