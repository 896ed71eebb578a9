"""Table of the export formats, made from their registry.

python docs/_extensions/export_formats.py     writes the table into docs/hardware.md
"""

import re
from pathlib import Path

from hw.export import EXPORTERS

PAGE = Path(__file__).resolve().parents[1] / "hardware.md"
_MARKED = re.compile(r"(<!-- export formats -->\n).*?(<!-- end of export formats -->)", re.DOTALL)


def with_table(page: str) -> str:
    """Return a page with the table between its marks made anew."""
    rows = ["| format | file | for | ticks | after |", "|---|---|---|---|---|"]
    for name, exporter in EXPORTERS.items():
        rows.append(
            f"| `{name}` | {exporter.summary} | {exporter.needs} | {exporter.tick_ns} ns |"
            f" {exporter.manual} |"
        )
    table = "\n".join(rows)
    return _MARKED.sub(lambda marks: f"{marks[1]}\n{table}\n\n{marks[2]}", page)


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
