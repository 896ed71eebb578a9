"""Published codes against searched ones of the same length and open chips: smallest |P| and
deconvolution noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cep.files.foreign_text import in_code_span, markdown_text
from cep.files.tables import Sheet, csv_lines, latex, markdown_table
from cep.jobs.cells import Cell, Figure
from cep.jobs.fingerprint import source_version
from cep.optics.code import ShutterCode
from cep.optics.mtf import chip_noise_db
from cep.proofs.certify.minimum import min_chip
from cep.search.annealing.anneal import anneal
from cep.search.problem import SearchProblem
from lab.bench.table_io import machines_markdown, made_json
from motdiff.files.outputs import new_folder

_MIX = (
    ("min-mtf", 0.1),
    ("noise", 1.0),
)  # a decibel of noise is harder to gain than one of the minimum


@dataclass(frozen=True)
class CodeRow:
    """One comparison, straight uniform motion in chip units.

    Attributes
    ----------
    name : str
    published, ours : ShutterCode
        Of the same number of chips, as many of them open.
    minima : (float, float)
        Smallest |P| over the unit circle, chips: theirs, ours.
    noise_db : (float, float)
        ``10 log10 mean 1/|P|^2``, relative to DC: theirs, ours.
    seconds : float
        Of the search.
    """

    name: str
    published: ShutterCode
    ours: ShutterCode
    minima: tuple[float, float]
    noise_db: tuple[float, float]
    seconds: float

    @property
    def better(self) -> bool:
        """Whether ours is better on both figures."""
        return self.minima[1] > self.minima[0] and self.noise_db[1] < self.noise_db[0]


def measure_code(
    *, bits: str, time_s: float, seed: Sequence[int], threads: int | None = 1
) -> dict[str, Figure]:
    """Search against a code; the code itself is no starting point.

    Parameters
    ----------
    bits : str
        Of the published code.
    time_s : float
        Of the search.
    seed : sequence of int
    threads : int, optional
        One where other cells run beside; as many as there are cores when None.

    Returns
    -------
    dict with ``bits`` found, ``minimum`` and ``noise_db`` of the published code, ``our_minimum``
    and ``our_noise_db``, and ``seconds`` of the search

    Raises
    ------
    KeyboardInterrupt
        When stopped: an interrupted search is no comparison.
    """
    code = ShutterCode(bits)
    problem = SearchProblem.along(
        chips=code.chips, open_range=(code.open_chips, code.open_chips), objective=_MIX
    )
    rng = np.random.default_rng(list(seed))
    found = anneal(problem, rng=rng, steps=None, time_s=time_s, threads=threads)
    if found.stopped == "interrupted":
        raise KeyboardInterrupt
    return {
        "bits": found.code.bits,
        "minimum": min_chip(code),
        "noise_db": _noise_db(code),
        "our_minimum": min_chip(found.code),
        "our_noise_db": _noise_db(found.code),
        "seconds": found.seconds,
    }


def code_cells(
    codes: Sequence[tuple[str, ShutterCode]], *, time_s: float, seed: int
) -> list[Cell]:
    """List the cells of the table; the figures of a code do not depend on the others.

    Parameters
    ----------
    codes : sequence of (name, ShutterCode)
        Each name once.
    time_s : float
        Of each search.
    seed : int
    """
    version = source_version(
        ["cep.search.annealing.anneal", "cep.proofs.certify.minimum"], alone=[__name__]
    )
    return [
        Cell(
            (name,),
            measure_code,
            {"bits": code.bits, "time_s": time_s, "seed": _seed(seed, name)},
            version=version,
        )
        for name, code in codes
    ]


def code_row(name: str, code: ShutterCode, figures: Mapping[str, Figure]) -> CodeRow:
    """Read the figures of :func:`measure_code`."""
    theirs, ours, their_db, our_db, seconds = (
        float(figures[key] or 0.0)
        for key in ("minimum", "our_minimum", "noise_db", "our_noise_db", "seconds")
    )
    return CodeRow(
        name, code, ShutterCode(str(figures["bits"])), (theirs, ours), (their_db, our_db), seconds
    )


def code_rows(
    codes: Sequence[tuple[str, ShutterCode]], *, time_s: float, seed: int = 0
) -> list[CodeRow]:
    """Search against every code for ``time_s`` on all cores, one after the other; nothing is kept
    on disk.

    Parameters
    ----------
    codes : sequence of (name, ShutterCode)
    time_s : float
        Per code.
    seed : int

    Returns
    -------
    list of CodeRow; after Ctrl-C those so far
    """
    rows: list[CodeRow] = []
    for name, code in codes:
        try:
            figures = measure_code(
                bits=code.bits, time_s=time_s, seed=_seed(seed, name), threads=None
            )
        except KeyboardInterrupt:
            break
        rows.append(code_row(name, code, figures))
    return rows


def _seed(seed: int, name: str) -> tuple[int, ...]:
    return (seed, *name.encode())


def _noise_db(code: ShutterCode) -> float:
    noise_db = chip_noise_db(code) + 20 * math.log10(code.open_chips)
    return float(noise_db)


CODE_FILES = ("codes.md", "codes.tex", "codes.csv", "codes.json")
"""Files of the table."""

CODE_HEAD = (
    "code",
    "open",
    "its min |P|",
    "its noise, dB",
    "our min |P|",
    "our noise, dB",
    "better on both",
)


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
        Command that reproduces them.
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
        f"Made by {in_code_span(command)}, seed {seed}, on",
        "",
        machines_markdown(machines) or "- no machine",
        "",
        (
            "Straight uniform motion: the smallest |P| over the unit circle, in chips, and the"
            f" noise of deconvolution relative to DC. Ours is searched for {time_s:g} s at the"
            " same number of chips, as many of them open, one code for both."
        ),
        *(f"\n- {markdown_text(warning)}" for warning in warnings),
        "",
    ]
    count = f"\nBetter on both: {sum(row.better for row in rows)} of {len(rows)}.\n"
    lines = code_lines(rows)
    with new_folder(folder, CODE_FILES, force=force) as made:
        texts = {
            "codes.md": "\n".join(head) + f"\n{markdown_table(CODE_HEAD, lines)}\n{count}",
            "codes.tex": latex([Sheet("Published codes", CODE_HEAD, lines)]),
            "codes.csv": _csv(rows),
            "codes.json": made_json(
                {"codes": codes_table(rows)},
                command=command,
                seed=seed,
                machines=machines,
                warnings=warnings,
            ),
        }
        for name, content in texts.items():
            (made / name).write_text(content, encoding="utf-8", newline="")
    return {name: folder / name for name in CODE_FILES}


def _csv(rows: Sequence[CodeRow]) -> str:
    names = ("min_chip", "noise_db", "our_min_chip", "our_noise_db")
    lines: list[tuple[object, ...]] = [
        ("name", "chips", "open", *names, "better", "seconds", "bits", "our_bits")
    ]
    for row in rows:
        figures = (row.minima[0], row.noise_db[0], row.minima[1], row.noise_db[1])
        lines.append(
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
    return csv_lines(lines)
