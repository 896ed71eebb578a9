"""Tables of the files' fields, made from their JSON Schemas, which the site holds under
``schemas/``.

python docs/_extensions/schema_tables.py     writes the tables into docs/files.md
"""

import re
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "files.md"
PACKAGES = {
    "motdiff.files": ("trajectory",),
    "cep.files": (
        "code",
        "camera",
        "front",
        "bench",
        "calibration-set",
        "photo",
        "program",
        "studio",
    ),
    "lab.block_proofs": ("proof",),
}
_MARKED = re.compile(r"<!-- fields of (\S+) -->\n.*?<!-- end of fields -->", re.DOTALL)
_SHORT = {
    "object": "object",
    "array": "list",
    "string": "text",
    "number": "number",
    "integer": "whole number",
}


def schema_files() -> dict[str, Path]:
    """Return the path of each schema by its name."""
    return {
        name: ROOT / package.replace(".", "/") / "schemas" / f"{name}.json"
        for package, names in PACKAGES.items()
        for name in names
    }


def fields_table(schema: Mapping[str, Any]) -> str:
    """Lay out the fields of a schema as Markdown."""
    rows = []
    for name, field, needed in _fields(schema, ""):
        meaning = field.get("description", "").replace("|", "\\|")
        rows.append(f"| `{name}` | {_kind(field)} | {meaning} | {_left_out(field, needed)} |")
    return "\n".join(["| field | value | meaning | left out |", "|---|---|---|---|", *rows])


def with_tables(page: str) -> str:
    """Return a page with the tables between its marks made anew."""
    import json

    def table(match: re.Match[str]) -> str:
        name, _, part = match[1].partition("#")
        schema = json.loads(schema_files()[name].read_text(encoding="utf-8"))
        made = fields_table(schema["$defs"][part] if part else schema)
        return f"<!-- fields of {match[1]} -->\n{made}\n<!-- end of fields -->"

    return _MARKED.sub(table, page)


def _fields(
    schema: Mapping[str, Any], prefix: str
) -> Iterator[tuple[str, Mapping[str, Any], bool]]:
    for name, field in schema.get("properties", {}).items():
        yield f"{prefix}{name}", field, name in schema.get("required", ())
        yield from _fields(field, f"{prefix}{name}.")
        if isinstance(items := field.get("items"), dict):
            yield from _fields(items, f"{prefix}{name}[].")


def _kind(field: Mapping[str, Any]) -> str:
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return " or ".join(f"`{one}`" for one in field["enum"])
    types = field.get("type", ())
    names = [_SHORT.get(kind, kind) for kind in ([types] if isinstance(types, str) else types)]
    if isinstance(items := field.get("items"), dict) and (inner := items.get("type")) in _SHORT:
        names = [f"list of {_SHORT[inner]}s{_range(items)}"]
    return " or ".join(names) + _range(field)


def _range(field: Mapping[str, Any]) -> str:
    low, high = field.get("minimum"), field.get("maximum")
    if low is not None and high is not None and high < 1e18:
        return f", {low:g}..{high:g}"
    above = field.get("exclusiveMinimum")
    return (
        f", {low:g} or more"
        if low is not None
        else f", above {above:g}"
        if above is not None
        else ""
    )


def _left_out(field: Mapping[str, Any], needed: bool) -> str:
    if needed:
        return "needed"
    default = field.get("default")
    return "" if default in (None, "", {}, []) else f"`{default}`"


def _publish(app: Any, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        folder = Path(app.outdir) / "schemas"
        folder.mkdir(exist_ok=True)
        for path in schema_files().values():
            shutil.copyfile(path, folder / path.name)


def setup(app: Any) -> dict[str, bool]:
    """Copy the schemas into the site."""
    app.connect("build-finished", _publish)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
