"""JSON files: the reader's checks against the package jsonschema, the lines of its refusals, and
strict text.
"""

import itertools
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from motdiff.files.json_files import fault, json_text, plain, read_versioned, stated_schema

VALUES = (
    None,
    True,
    False,
    0,
    1,
    1.0,
    2.5,
    -3,
    17,
    "",
    "10",
    "102",
    [],
    [1],
    [1, 2.5],
    [1, "1"],
    {},
    {"bits": "10"},
    {"bits": "12"},
    {"bits": "10", "note": 3},
    {"note": True},
)
SCHEMAS = (
    {"type": "boolean"},
    {"type": "number"},
    {"type": "integer"},
    {"type": ["string", "null"]},
    {"const": 1},
    {"const": False},
    {"enum": [1, "10", None]},
    {"type": "integer", "minimum": 1, "maximum": 16},
    {"exclusiveMinimum": 0, "exclusiveMaximum": 17},
    {"type": "string", "pattern": "^[01]+$"},
    {"type": "array", "minItems": 1},
    {"type": "array", "items": {"type": "integer"}},
    {"items": {"anyOf": [{"type": "string"}, {"maximum": 2}]}},
    {"anyOf": [{"type": "null"}, {"type": "string", "pattern": "1"}]},
    {"required": ["bits"]},
    {"type": "object", "properties": {"bits": {"pattern": "^[01]*$"}}},
    {"properties": {"bits": {}}, "additionalProperties": False},
    {"properties": {"bits": {}}, "additionalProperties": {"type": "integer"}},
)


@pytest.mark.parametrize("schema", SCHEMAS, ids=json.dumps)
def test_a_document_is_valid_where_jsonschema_says_so(schema):
    validator = Draft202012Validator(schema)
    verdicts = [fault(value, schema) is None for value in VALUES]
    assert verdicts == [validator.is_valid(value) for value in VALUES]
    assert len(set(verdicts)) == 2


def test_a_pattern_ends_where_the_text_ends():
    """As in JSON Schema; jsonschema takes Python's ``$``, which a last line feed may follow."""
    schema = {"pattern": "^[01]+$"}
    assert fault("10", schema) is None
    assert fault("10\n", schema) is not None


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_number_is_finite(value):
    line = fault({"gain": value}, {"properties": {"gain": {"type": "number"}}})
    assert line.startswith("gain: must be a finite number, got ")


@pytest.mark.parametrize(
    ("value", "schema", "line"),
    [
        (0, {"type": "number", "exclusiveMinimum": 0}, "must be a number above 0, got 0"),
        (1, {"type": "string", "title": "bits as 1011"}, "must be bits as 1011, got 1"),
        ([], {"type": "array", "minItems": 2}, "must be a list of at least 2, got a list of 0"),
        ({}, {"const": "cep.code/1"}, 'must be "cep.code/1", got an object'),
        (3, {"enum": [1, 2]}, "must be 1 or 2, got 3"),
        (-1, {"type": "integer", "minimum": 0}, "must be a whole number of 0 or more, got -1"),
        (
            9,
            {"type": "number", "minimum": 0, "exclusiveMaximum": 9},
            "must be a number of 0 or more and below 9, got 9",
        ),
        # limits of a double are named only to numbers beyond them
        (
            -1,
            {"type": "number", "minimum": 0, "exclusiveMaximum": 1e300},
            "must be a number of 0 or more, got -1",
        ),
        (
            1e300,
            {"type": "number", "minimum": 0, "exclusiveMaximum": 1e300},
            "must be a number below 1e+300, got 1e+300",
        ),
        (10**5000, {"type": "string"}, "must be a string, got a number of thousands of digits"),
    ],
    ids=itertools.count(),
)
def test_a_refusal_says_what_would_be_right(value, schema, line):
    assert fault(value, schema, where="field") == f"field: {line}"


def test_a_fault_is_named_by_its_place():
    schema = {
        "required": ["shots"],
        "properties": {
            "shots": {
                "items": {
                    "required": ["code"],
                    "properties": {"code": {"type": "string"}},
                    "additionalProperties": False,
                }
            }
        },
    }
    for document, line in (
        ({}, 'field "shots" is missing'),
        ({"shots": [{"code": "1"}, {}]}, 'field "shots[1].code" is missing'),
        ({"shots": [{"code": 1}]}, "shots[0].code: must be a string, got 1"),
        ({"shots": [{"code": "1", "x": 1}]}, "unknown field 'shots[0].x'; there are code"),
        ({"shots": [{"code": "1"}]}, None),
    ):
        assert fault(document, schema) == line


def test_a_file_states_its_schema(tmp_path):
    path = tmp_path / "code.json"
    path.write_text('{"schema": "cep.code/1", "bits": "10"}')
    assert stated_schema(path) == "cep.code/1"
    assert read_versioned(path, "cep.code/1")["bits"] == "10"
    with pytest.raises(ValueError, match=r'wanted schema "cep\.code/2", found'):
        read_versioned(path, "cep.code/2")
    for text in ("[]", "{}", '{"schema": 1}', "no JSON"):
        path.write_text(text)
        assert stated_schema(path) is None
        with pytest.raises(ValueError, match=r"code\.json"):
            read_versioned(path, "cep.code/1")


@dataclass
class Figures:
    gain_db: float
    path: Path


def test_text_is_strict_whatever_the_values():
    value = {
        1: Figures(float("-inf"), Path("a.png")),
        "array": np.array([[1.5, np.nan]]),
        "count": np.int64(3),
        "yes": np.True_,
        "name": "a\udcff",
        "pair": (1, None),
    }
    text = json_text(value)
    assert text.endswith("}\n")
    assert json.loads(text, parse_constant=pytest.fail) == {
        "1": {"gain_db": None, "path": "a.png"},
        "array": [[1.5, None]],
        "count": 3,
        "yes": True,
        "name": "a\udcff",
        "pair": [1, None],
    }
    assert plain(value)["yes"] is True
    assert json_text("µ") == '"µ"\n'
    assert json_text("µ", ascii_only=True) == '"\\u00b5"\n'
