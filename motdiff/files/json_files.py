"""JSON files: strict text of what is written, and JSON Schemas of what is read.

The schemas are those that are published, of JSON Schema 2020-12. Of its keywords the ones in
:data:`KEYWORDS` are used.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, is_dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from motdiff.files.inputs import one_line, read_json

_NOTES = {"$schema", "$id", "title", "description", "default", "$defs"}
KEYWORDS = _NOTES | {
    "type",
    "const",
    "enum",
    "required",
    "properties",
    "additionalProperties",
    "items",
    "minItems",
    "pattern",
    "minimum",
    "maximum",
    "exclusiveMinimum",
    "exclusiveMaximum",
    "anyOf",
}
"""Keywords that :func:`fault` knows; others would be passed over, so :func:`load_schema` refuses
them."""

_LARGEST = 1e300
"""Limits from here on keep numbers within a double, and are named only where a number exceeds
them."""

_END = re.compile(r"\$$")  # in Python also before a last line feed, unlike in JSON Schema

_PYTHON_TYPES: dict[str, type | tuple[type, ...]] = {
    "object": dict,
    "array": list,
    "string": str,
    "number": (int, float),
    "integer": (int, float),  # 2.0 is an integer to JSON
    "boolean": bool,
    "null": type(None),
}
_NAMES = {
    "object": "an object",
    "array": "a list",
    "string": "a string",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "null": "null",
}


def plain(value: object) -> Any:
    """Turn arrays, dataclasses, paths and numbers into types of JSON; NaN becomes null.

    Infinities become null as well.

    Examples
    --------
    >>> plain({"gain_db": float("inf"), "size": np.int64(3)})
    {'gain_db': None, 'size': 3}
    """
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None  # JSON has no such numbers
    if value is None or isinstance(value, str | int | float):
        return value
    return str(value)


def json_text(value: object, *, ascii_only: bool = False) -> str:
    r"""Format ``value`` as strict JSON with a closing newline.

    Bytes of a file's name that are no UTF-8 are lone surrogates in Python; JSON has them as
    escapes, ``\udcff``. With ``ascii_only``, for an output that is not UTF-8, it has all others
    but ASCII as escapes too.
    """
    text = json.dumps(plain(value), indent=1, allow_nan=False, ensure_ascii=ascii_only) + "\n"
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


# -- schemas --------------------------------------------------------------------------------------


def stated_schema(path: Path | str) -> str | None:
    """Return the schema that a JSON file states; None where it states none, or is no JSON file.

    OSError if the file cannot be read.
    """
    try:
        schema = read_json(path)["schema"]
    except (ValueError, LookupError, TypeError):
        return None
    if isinstance(schema, str):
        return schema
    return None


def read_versioned(path: Path | str, schema: str) -> dict[str, Any]:
    """Read a JSON object that states this schema; :func:`fault` checks its fields.

    Raises
    ------
    ValueError
        If the file is not JSON, or states another schema; the line names the file.
    OSError
        If the file cannot be read.
    """
    document = read_json(path)
    version: object = type(document).__name__
    if isinstance(document, dict):
        version = document.get("schema")
        if version == schema:
            return document
    raise ValueError(f'{path}: wanted schema "{schema}", found {one_line(repr(version))}')


@cache
def load_schema(package: str, name: str) -> Mapping[str, Any]:
    """Load ``schemas/NAME.json`` of a package.

    ValueError if it has a keyword that readers would pass over.
    """
    text = (resources.files(package) / "schemas" / f"{name}.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    for subschema in _parts(schema):
        if unknown := subschema.keys() - KEYWORDS:
            raise ValueError(f"{name}.json: unknown keyword {min(unknown)!r}")
    return schema


def fault(value: object, schema: Mapping[str, Any], *, where: str = "") -> str | None:
    """Say the first thing that is wrong with a document; None where it is valid.

    Parameters
    ----------
    value : object
        As read from JSON.
    where : str
        Name of the value, with which the line begins.

    Examples
    --------
    >>> bits = {"type": "integer", "minimum": 1, "maximum": 16}
    >>> fault({"bits": 17}, {"properties": {"bits": bits}})
    'bits: must be a whole number within 1..16, got 17'
    """
    choices = schema.get("anyOf")
    if not _holds(value, schema) or (choices and all(fault(value, choice) for choice in choices)):
        return f"{where or 'the document'}: must be {_wanted(value, schema)}, got {_shown(value)}"
    if isinstance(value, dict):
        return _object_fault(value, schema, where)
    if isinstance(value, list):
        return _list_fault(value, schema, where)
    return None


def _object_fault(value: Mapping[str, Any], schema: Mapping[str, Any], where: str) -> str | None:
    inside = where and f"{where}."
    for name in schema.get("required", ()):
        if name not in value:
            return f'field "{inside}{name}" is missing'
    fields: Mapping[str, Any] = schema.get("properties", {})
    extra = schema.get("additionalProperties", {})  # a schema without keywords holds for all
    for name, item in value.items():
        if name not in fields and extra is False:
            return (
                f"unknown field {one_line(repr(inside + name))}; there are"
                f" {', '.join(sorted(fields))}"
            )
        wrong = fault(item, fields.get(name, extra), where=inside + one_line(name))
        if wrong is not None:
            return wrong
    return None


def _list_fault(value: list[Any], schema: Mapping[str, Any], where: str) -> str | None:
    items: Mapping[str, Any] = schema.get("items", {})
    numbers = items.get("type") in ("number", "integer")
    for index, item in enumerate(value):
        if numbers and _holds(item, items):  # a quick check: there may be a hundred thousand
            continue
        if wrong := fault(item, items, where=f"{where}[{index}]"):
            return wrong
    return None


def _holds(value: object, schema: Mapping[str, Any]) -> bool:
    """Whether a value itself is as the schema says, whatever is inside."""
    types = _types(schema)
    if types and not any(_is(value, kind) for kind in types):
        return False
    if "const" in schema and not _same(value, schema["const"]):
        return False
    if "enum" in schema and not any(_same(value, choice) for choice in schema["enum"]):
        return False
    if isinstance(value, str):
        return re.search(_END.sub(r"\\Z", schema.get("pattern", "")), value) is not None
    if isinstance(value, list):
        return len(value) >= int(schema.get("minItems", 0))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return bool(
            schema.get("minimum", -math.inf) <= value <= schema.get("maximum", math.inf)
            and ("exclusiveMinimum" not in schema or value > schema["exclusiveMinimum"])
            and ("exclusiveMaximum" not in schema or value < schema["exclusiveMaximum"])
        )
    return True


def _types(schema: Mapping[str, Any]) -> list[str]:
    """Types of which a value must have one; empty where any is valid."""
    types = schema.get("type", [])
    return [types] if isinstance(types, str) else types


def _is(value: object, kind: str) -> bool:
    if not isinstance(value, _PYTHON_TYPES[kind]):
        return False
    if isinstance(value, bool):  # an int to Python
        return kind == "boolean"
    if isinstance(value, float):
        return math.isfinite(value) and (kind == "number" or value.is_integer())
    return True


def _same(value: object, constant: object) -> bool:
    return value == constant and isinstance(value, bool) == isinstance(constant, bool)


def _shown(value: object) -> str:
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "an object"
    try:
        return one_line(json.dumps(value, default=str))
    except ValueError:  # Python writes no whole number of thousands of digits
        return "a number of thousands of digits"


def _wanted(value: object, schema: Mapping[str, Any]) -> str:
    """Say what a schema asks for; its title where it has one."""
    if "title" in schema:
        return str(schema["title"])
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " or ".join(json.dumps(choice) for choice in schema["enum"])
    names = [_NAMES[kind] for kind in _types(schema)]
    if isinstance(value, float) and not math.isfinite(value):
        names = [name.replace("a number", "a finite number") for name in names]
    if "minItems" in schema:
        names[0] = f"a list of at least {schema['minItems']}"
    return " or ".join(names) + _range(value, schema)


def _range(value: object, schema: Mapping[str, Any]) -> str:
    low = schema.get("minimum")
    high = schema.get("maximum")
    above = schema.get("exclusiveMinimum")
    below = schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f" within {low:g}..{high:g}"
    limits = {
        " of {:g} or more": low,
        " above {:g}": above,
        " up to {:g}": high,
        " below {:g}": below,
    }
    too_large = isinstance(value, int | float) and value >= _LARGEST
    return " and".join(
        text.format(limit)
        for text, limit in limits.items()
        if limit is not None and (abs(limit) >= _LARGEST) == too_large
    )


def _parts(schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield a schema and all schemas within it."""
    yield schema
    for name in ("properties", "$defs"):
        for inner in schema.get(name, {}).values():
            yield from _parts(inner)
    for name in ("items", "additionalProperties"):
        if isinstance(schema.get(name), dict):
            yield from _parts(schema[name])
    for inner in schema.get("anyOf", ()):
        yield from _parts(inner)
