"""JSON files: strict text of what is written, and the JSON Schemas by which readers refuse a file.

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
    """Turn arrays, dataclasses, paths and NumPy numbers into types of JSON; NaN and infinities
    become null.

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
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int | bool):
        return value
    return str(value)


def json_text(value: object, *, ascii_only: bool = False) -> str:
    r"""Format ``value`` as strict JSON with a closing newline.

    Bytes of a file's name that are no UTF-8 are lone surrogates in Python; JSON has them as
    escapes, ``\udcff``.

    Parameters
    ----------
    value : object
    ascii_only : bool
        Whether all other characters are escapes too, for an output that is not UTF-8.
    """
    text = json.dumps(plain(value), indent=1, allow_nan=False, ensure_ascii=ascii_only) + "\n"
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


# -- schemas --------------------------------------------------------------------------------------


def stated_schema(path: Path | str) -> str | None:
    """Return the schema that a JSON file states; None where it states none, or is no JSON file.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    try:
        document = read_json(path)
    except ValueError:
        return None
    schema = document.get("schema") if isinstance(document, dict) else None
    return schema if isinstance(schema, str) else None


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
    version = document.get("schema") if isinstance(document, dict) else type(document).__name__
    if not isinstance(document, dict) or version != schema:
        raise ValueError(f'{path}: wanted schema "{schema}", found {one_line(repr(version))}')
    return document


@cache
def load_schema(package: str, name: str) -> Mapping[str, Any]:
    """Load ``schemas/NAME.json`` of a package.

    Raises
    ------
    ValueError
        If it has a keyword that readers would pass over.
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
    schema : mapping
    where : str
        Name of the value.

    Returns
    -------
    str or None
        One line, as ``weight: must be a number within 0..1, got 3``.

    Examples
    --------
    >>> bits = {"type": "integer", "minimum": 1, "maximum": 16}
    >>> fault({"bits": 17}, {"properties": {"bits": bits}})
    'bits: must be a whole number within 1..16, got 17'
    """
    if "anyOf" in schema and all(
        fault(value, choice, where=where) is not None for choice in schema["anyOf"]
    ):
        return _refusal(value, schema, where)
    if not _holds(value, schema):
        return _refusal(value, schema, where)
    if isinstance(value, dict):
        return _object_fault(value, schema, where)
    if isinstance(value, list):
        return _list_fault(value, schema, where)
    return None


def _object_fault(value: Mapping[str, Any], schema: Mapping[str, Any], where: str) -> str | None:
    inside = f"{where}." if where else ""
    for name in schema.get("required", ()):
        if name not in value:
            return f'field "{inside}{name}" is missing'
    fields: Mapping[str, Any] = schema.get("properties", {})
    extra = schema.get("additionalProperties", True)
    for name, item in value.items():
        if name in fields:
            wrong = fault(item, fields[name], where=f"{inside}{name}")
        elif extra is False:
            return (
                f"unknown field {one_line(repr(inside + name))}; there are"
                f" {', '.join(sorted(fields))}"
            )
        else:
            wrong = (
                None if extra is True else fault(item, extra, where=f"{inside}{one_line(name)}")
            )
        if wrong is not None:
            return wrong
    return None


def _list_fault(value: list[Any], schema: Mapping[str, Any], where: str) -> str | None:
    items = schema.get("items")
    if items is None:
        return None
    if items.get("type") in ("number", "integer"):  # may be a hundred thousand of them
        wrong_at = next(
            (index for index, item in enumerate(value) if not _holds(item, items)), None
        )
        return (
            None if wrong_at is None else _refusal(value[wrong_at], items, f"{where}[{wrong_at}]")
        )
    faults = (fault(item, items, where=f"{where}[{index}]") for index, item in enumerate(value))
    return next((wrong for wrong in faults if wrong is not None), None)


def _holds(value: object, schema: Mapping[str, Any]) -> bool:
    """Whether a value itself is as the schema says, whatever is inside."""
    types = schema.get("type", ())
    if types and not any(
        _is(value, kind) for kind in ([types] if isinstance(types, str) else types)
    ):
        return False
    if "const" in schema and not _same(value, schema["const"]):
        return False
    if "enum" in schema and not any(_same(value, choice) for choice in schema["enum"]):
        return False
    if isinstance(value, str):
        return (
            "pattern" not in schema
            or re.search(_END.sub(r"\\Z", schema["pattern"]), value) is not None
        )
    if isinstance(value, list):
        return len(value) >= int(schema.get("minItems", 0))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return bool(
            schema.get("minimum", -math.inf) <= value <= schema.get("maximum", math.inf)
            and ("exclusiveMinimum" not in schema or value > schema["exclusiveMinimum"])
            and ("exclusiveMaximum" not in schema or value < schema["exclusiveMaximum"])
        )
    return True


def _is(value: object, kind: str) -> bool:
    if kind in ("number", "integer"):
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        if isinstance(value, int):
            return True
        return math.isfinite(value) and (kind == "number" or value.is_integer())
    kinds: dict[str, type | tuple[type, ...]] = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "null": type(None),
    }
    return isinstance(value, kinds[kind])


def _same(value: object, constant: object) -> bool:
    return value == constant and isinstance(value, bool) == isinstance(constant, bool)


def _refusal(value: object, schema: Mapping[str, Any], where: str) -> str:
    return f"{where or 'the document'}: must be {_wanted(value, schema)}, got {_shown(value)}"


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
    types = schema.get("type", [])
    names = [_NAMES[kind] for kind in ([types] if isinstance(types, str) else types)]
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
