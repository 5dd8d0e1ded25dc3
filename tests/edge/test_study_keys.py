"""Keys of study files: positions of mistakes, the JSON schema, a text for every key."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import typer
from test_mistakes import IN_STUDY, TEXT
from typer.testing import CliRunner

import jaxlines
from jaxlines.edge.building import StudyError
from jaxlines.edge.class_docs import argument_docs, purpose
from jaxlines.edge.key_docs import KEY_DOCS
from jaxlines.edge.new_commands import add_commands
from jaxlines.edge.study_keys import (
    classes_in_studies,
    keys_as_markdown,
    keys_as_text,
    keys_of_class,
    keys_of_table,
    table_models,
)
from jaxlines.edge.study_positions import position_of, positions, with_positions
from jaxlines.edge.study_schema import study_schema, study_schema_text
from jaxlines.physics.fluids import Oil
from jaxlines.physics.lines import Line

LINES = TEXT.splitlines()


def line_of(words: str) -> int:
    return next(i for i, line in enumerate(LINES, 1) if words in line)


def test_positions_of_keys():
    known = positions(TEXT)
    assert known["fluid"] == (line_of("[fluid]"), 1)
    assert known["circuit.leak.conductance"] == (line_of("conductance ="), 1)
    assert known["fit.free.1.path"] == (line_of("fluid.air_fraction"), 1)
    assert known["recording.channels"][0] == line_of("channels =")


@pytest.mark.parametrize(
    ("old", "message"),
    [
        ("conductance =", "circuit.leak: unknown key 'conductance', did you mean 'x'?"),
        ("bulk_modulus =", "fluid: unknown key 'bulk_modulus', did you mean 'x'?"),
        ('"FlowSource"', "circuit.valve: unknown type 'FlowSource', did you mean 'x'?"),
        ("parts =", "circuit.line.parts.0.length: 20.83 has no unit: write it as a text"),
        ('path = "initial.A.pressure"', "fit.free.3 (numbers in Pa): initial.A.pressure: start 1.5e+06 is outside"),
        ('start = "1.5 bar_a"', "fit.free.3.start: 'bar' does not say from where it counts: write bar_a (absolute)"),
        ("[simulate]", "simulate: 'begin' is missing"),
        ("channels =", "recording.channels: no output or input is called 'x', did you mean 'A.pressure'?"),
    ],
)
def test_position_of_a_message(old, message):
    at = position_of(message, TEXT)
    wanted = line_of(old)
    # A message about a whole table of [[fit.free]] or a missing key points at its heading.
    assert at is not None and (at[0] == wanted or (at[0] == wanted - 1 and LINES[at[0] - 1].startswith("[")))
    assert position_of("nothing that stands there: at all", TEXT) is None


def test_errors_end_with_the_position():
    with (
        pytest.raises(StudyError, match=rf"'x'\? \(at line {line_of('conductance =')}, column 1\)$"),
        with_positions(TEXT),
    ):
        raise StudyError("circuit.leak: unknown key 'conductance', did you mean 'x'?")
    with pytest.raises(StudyError, match=r"^gone$"), with_positions(TEXT):
        raise StudyError("gone")


def test_most_mistakes_have_a_position():
    placed = 0
    for (old, new), words in IN_STUDY:
        text = TEXT.replace(old, new, 1)
        placed += position_of(words, text) is not None
    assert placed >= 0.6 * len(IN_STUDY)


def test_every_key_of_a_table_is_described():
    for table in table_models():
        missing = [key.name for key in keys_of_table(table) if not key.text]
        assert not missing, f"{table}: describe {missing} in key_docs.py"
    known = {f"{table}.{key.name}".strip(".") for table in table_models() for key in keys_of_table(table)}
    assert set(KEY_DOCS) <= known


def test_every_key_of_a_class_has_type_text_and_unit():
    for kinds in classes_in_studies().values():
        for kind in kinds.values():
            assert purpose(kind)
            for key in keys_of_class(kind):
                assert key.type and key.text
                assert key.required or key.default
                assert key.unit or not key.type.startswith("number")


def test_texts_come_from_docstrings():
    texts = argument_docs(Line, ["node", "parts", "path_length"])
    assert texts["parts"].startswith("the containers it is made of") and "[m]" in texts["path_length"]
    described = [
        key for kinds in classes_in_studies().values() for kind in kinds.values() for key in keys_of_class(kind)
    ]
    assert sum(key.text != key.name.replace("_", " ") for key in described) > 0.75 * len(described)
    modulus = next(key for key in keys_of_class(Oil) if key.name == "bulk_modulus")
    assert (modulus.unit, modulus.range, modulus.required) == ("Pa", "1e+08 to 1e+11", True)


JSON_TYPES = {
    "object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "boolean": bool,
    "null": type(None),
}  # fmt: skip


def resolve(schema, root):
    return root["$defs"][schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


def fits(value, schema, root) -> bool:  # noqa: C901
    """A small validator of the keywords that the schema uses."""
    schema = resolve(schema, root)
    if "anyOf" in schema and not any(fits(value, one, root) for one in schema["anyOf"]):
        return False
    if value not in schema.get("enum", [value]) or value != schema.get("const", value):
        return False
    names = [schema["type"]] if isinstance(schema.get("type"), str) else schema.get("type", [])
    if names and not any(isinstance(value, JSON_TYPES[name]) for name in names):
        return False
    if isinstance(value, str) and "pattern" in schema and not re.search(schema["pattern"], value):
        return False
    if isinstance(value, list) and "items" in schema and not all(fits(item, schema["items"], root) for item in value):
        return False
    if not isinstance(value, dict):
        return True
    known, rest = schema.get("properties", {}), schema.get("additionalProperties", True)
    if any(key not in value for key in schema.get("required", [])):
        return False
    for key, inner in value.items():
        if key in known:
            if not fits(inner, known[key], root):
                return False
        elif rest is False or (isinstance(rest, dict) and not fits(inner, rest, root)):
            return False
    return True


def test_the_schema_accepts_the_example_and_refuses_slips():
    schema, study = study_schema(), tomllib.loads(TEXT)
    assert json.loads(study_schema_text()) == json.loads(json.dumps(schema))
    assert fits(study, schema, schema)
    for old, new in [
        ("conductance =", "conductanse ="),
        ('"Line"', '"Hose"'),
        ("derived =", "derivd ="),
        ("knots =", "knot ="),
        ('"2.2 GPa"', "2.2"),
    ]:
        assert not fits(tomllib.loads(TEXT.replace(old, new, 1)), schema, schema), new
    assert study["fluid"].keys() <= schema["$defs"]["Oil"]["properties"].keys()


def test_pages_and_lines():
    page = keys_as_markdown()
    assert (
        "### Servovalve" in page
        and "| `bulk_modulus` | number with unit | Pa | **required** | 1e+08 to 1e+11 |" in page
    )
    widths = {line.count("|") for line in page.splitlines() if line.startswith("|")}
    assert widths == {7}
    assert keys_as_text("fit.known").startswith("path: the number (")
    assert "types: Oil, " in keys_as_text()
    with pytest.raises(StudyError, match="no table or type of a study is called 'Lin', did you mean 'Line'"):
        keys_as_text("Lin")


def test_commands(tmp_path):
    import contextlib

    app = typer.Typer()
    add_commands(app, lambda place: contextlib.nullcontext())
    run = CliRunner().invoke
    assert run(app, ["keys", "fluid"]).stdout.startswith("bulk_modulus: ")
    done = run(app, ["schema", "--out", str(tmp_path / "study.schema.json")])
    assert done.exit_code == 0 and json.loads((tmp_path / "study.schema.json").read_text())["title"] == "jaxlines study"
    assert Path(jaxlines.__file__).exists()
