"""Published codes against searched ones of the same length and open chips: smallest |P| and
deconvolution noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cep.codes import published as registry
from cep.files.tables import Sheet, csv_lines, latex, markdown_table
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from cep.search.annealing.anneal import anneal
from cep.search.problem import SearchProblem
from lab.bench.harness import (
    TABLE_ENDINGS,
    Job,
    Progress,
    Report,
    Request,
    in_code_span,
    outcome_warnings,
    warning_lines,
)
from lab.bench.table_io import Provenance, machines_markdown, made_json
from lab.bench.tables import TextTable
from lab.bench.user_codes import load_user_codes, user_code_options
from lab.jobs.cells import Cell, Figure
from lab.jobs.engine import Outcome
from lab.jobs.fingerprint import source_version

CODE_FILES = tuple(f"codes{ending}" for ending in TABLE_ENDINGS)
CODE_HEAD = (
    "code",
    "open",
    "its min |P|",
    "its noise, dB",
    "our min |P|",
    "our noise, dB",
    "better on both",
)

# a decibel of noise is harder to gain than one of the minimum
_MIX = (("min-mtf", 0.1), ("noise", 1.0))


def chip_noise_db(code: ShutterCode) -> float:
    """Noise gain ``10 log10 mean 1/|P|^2`` over the unit circle, on 512 points a chip.

    A zero on the circle makes it infinite; a grid near one gives a finite figure that proves
    nothing: see :func:`~cep.proofs.certify.minimum.min_chip`.
    """
    size = 512 * code.chips
    power = np.abs(np.fft.rfft(code.array, size)) ** 2  # half of the circle: P is real
    weight = np.full(power.size, 2.0)
    weight[[0, -1]] = 1.0  # frequencies that are their own mirror
    with np.errstate(divide="ignore"):
        return float(10 * np.log10(weight @ (1 / power) / size))


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
    search = anneal(problem, rng=rng, steps=None, time_s=time_s, threads=threads)
    if search.stopped == "interrupted":
        raise KeyboardInterrupt
    return {
        "bits": search.code.bits,
        "minimum": min_chip(code),
        "noise_db": _noise_db(code),
        "our_minimum": min_chip(search.code),
        "our_noise_db": _noise_db(search.code),
        "seconds": search.seconds,
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


def codes_report(
    rows: Sequence[CodeRow], provenance: Provenance, outcome: Outcome, *, time_s: float
) -> Report:
    """Lay out the table; ``time_s`` is that of each search."""
    lines = code_lines(rows)
    better = sum(row.better for row in rows)
    markdown = [
        "# Published codes",
        "",
        f"Made by {in_code_span(provenance.command)}, seed {provenance.seed}, on",
        "",
        machines_markdown(provenance.machines) or "- no machine",
        "",
        (
            "Straight uniform motion: the smallest |P| over the unit circle, in chips, and the"
            f" noise of deconvolution relative to DC. Ours is searched for {time_s:g} s at the"
            " same number of chips, as many of them open, one code for both."
        ),
        *warning_lines(provenance.warnings),
        "",
        markdown_table(CODE_HEAD, lines),
        f"\nBetter on both: {better} of {len(rows)}.\n",
    ]
    texts = (
        "\n".join(markdown),
        latex([Sheet("Published codes", CODE_HEAD, lines)]),
        _csv(rows),
        made_json({"codes": codes_table(rows)}, provenance),
    )
    text_table = TextTable(
        f"smallest |P|, and noise relative to DC; {time_s:g} s each",
        CODE_HEAD,
        lines,
        f"better on both: {better} of {len(rows)}",
    )
    return Report(
        "Published codes",
        provenance,
        outcome,
        {"codes": codes_table(rows)},
        [text_table],
        markdown_table(CODE_HEAD, lines),
        dict(zip(TABLE_ENDINGS, texts, strict=True)),
    )


def codes_job(
    request: Request,
    *,
    names: Sequence[str] = (),
    codes: Sequence[str] = (),
    time_s: float,
    seed: int,
) -> Job:
    """Plan the comparison of published codes with searched ones.

    Parameters
    ----------
    request : Request
    names : sequence of str
        Published codes; Jeon's table when no code is named.
    codes : sequence of str
        User-defined codes, each ``NAME=SOURCE``.
    time_s : float
        Of each search.
    seed : int

    Raises
    ------
    ValueError
        If a file is in the way, or an option is not valid.
    """
    request.claim(CODE_FILES)
    if not 0 < time_s < 1e6:
        raise ValueError(f"time_s: must be above 0 seconds, got {time_s:g}")
    user_codes = load_user_codes(codes)
    family = [] if user_codes else [name for name in registry.names() if name.startswith("jeon")]
    compared = {name: registry.published(name).code for name in dict.fromkeys(names or family)}
    if twice := sorted(user_codes.keys() & compared.keys()):
        raise ValueError(
            f"code: {twice[0]} is the name of a published code that is compared too, take another"
        )
    compared |= user_codes
    cells = code_cells(list(compared.items()), time_s=time_s, seed=seed)
    arguments = f"{' '.join(names)} {user_code_options(codes, user_codes)}".strip()
    command = request.command("codes", {"": arguments, "--time": f"{time_s:g}", "--seed": seed})

    def measure(progress: Progress) -> Report:
        outcome = request.engine.run(cells, progress=progress)
        rows = [
            code_row(name, compared[name], figures)
            for (name,), figures in outcome.figures.items()
            if figures
        ]
        provenance = Provenance(command, seed, outcome.machines, outcome_warnings(outcome))
        return codes_report(rows, provenance, outcome, time_s=time_s)

    return Job(request, CODE_FILES, {"folder": request.output, "seed": seed}, measure)


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
