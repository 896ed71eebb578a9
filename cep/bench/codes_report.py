"""What the comparison with published codes leaves behind: a table for people and for programs."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cep.bench.codes import CodeRow
from cep.bench.layout import machines_markdown, made_json, markdown_table
from cep.outputs import new_folder

__all__ = ["CODE_FILES", "CODE_HEAD", "code_lines", "codes_table", "write_codes_report"]

CODE_FILES = ("codes.md", "codes.csv", "codes.json")
"""Files of the table."""

CODE_HEAD = ("code", "open", "its min |P|", "its noise, dB", "our min |P|", "our noise, dB", "better on both")


def code_lines(rows: Sequence[CodeRow]) -> list[tuple[str, ...]]:
    """Lay out rows below :data:`CODE_HEAD`."""
    return [
        (
            row.name,
            str(row.published.open_chips),
            f"{row.minima[0]:.4f}",
            f"{row.noise_db[0]:.2f}",
            f"{row.minima[1]:.4f}",
            f"{row.noise_db[1]:.2f}",
            "yes" if row.better else "no",
        )
        for row in rows
    ]


def codes_table(rows: Sequence[CodeRow]) -> list[dict[str, Any]]:
    """Lay out rows for JSON."""
    return [
        {
            "name": row.name,
            "chips": row.published.chips,
            "open": row.published.open_chips,
            "bits": row.ours.bits,
            "min_chip": {"published": row.minima[0], "ours": row.minima[1]},
            "noise_db": {"published": row.noise_db[0], "ours": row.noise_db[1]},
            "better": row.better,
            "seconds": row.seconds,
        }
        for row in rows
    ]


def write_codes_report(
    folder: Path,
    rows: Sequence[CodeRow],
    *,
    command: str,
    seed: int,
    time_s: float,
    machines: Sequence[Mapping[str, Any]],
    warnings: Sequence[str],
    force: bool = False,
) -> dict[str, Path]:
    """Write :data:`CODE_FILES`, all or nothing.

    Parameters
    ----------
    folder : Path, made where it is missing
    rows : sequence of CodeRow
    command : str
        What makes them again.
    seed : int
    time_s : float
        Of each search.
    machines : sequence of mapping
    warnings : sequence of str
    force : bool
        Whether existing files may be replaced.

    Returns
    -------
    dict from a file's name to its path
    """
    head = [
        "# Published codes",
        "",
        f"Made by `{command}`, seed {seed}, on",
        "",
        machines_markdown(machines) or "- no machine",
        "",
        "Straight uniform motion: the smallest |P| over the unit circle, in chips, and the noise of deconvolution "
        f"relative to DC. Ours is searched for {time_s:g} s at the same number of chips, as many of them open, one "
        "code for both.",
        *(f"\n- {warning}" for warning in warnings),
        "",
    ]
    count = f"\nBetter on both: {sum(row.better for row in rows)} of {len(rows)}.\n"
    with new_folder(folder, CODE_FILES, force=force) as made:
        texts = {
            "codes.md": "\n".join(head) + f"\n{markdown_table(CODE_HEAD, code_lines(rows))}\n{count}",
            "codes.csv": _csv(rows),
            "codes.json": made_json(
                {"codes": codes_table(rows)}, command=command, seed=seed, machines=machines, warnings=warnings
            ),
        }
        for name, content in texts.items():
            (made / name).write_text(content, encoding="utf-8", newline="")
    return {name: folder / name for name in CODE_FILES}


def _csv(rows: Sequence[CodeRow]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = ("min_chip", "noise_db", "our_min_chip", "our_noise_db")
    writer.writerow(("name", "chips", "open", *names, "better", "seconds", "bits", "our_bits"))
    for row in rows:
        figures = (row.minima[0], row.noise_db[0], row.minima[1], row.noise_db[1])
        writer.writerow(
            (
                row.name,
                row.published.chips,
                row.published.open_chips,
                *(f"{figure:.6g}" for figure in figures),
                "yes" if row.better else "no",
                f"{row.seconds:.3g}",
                row.published.bits,
                row.ours.bits,
            )
        )
    return stream.getvalue()
