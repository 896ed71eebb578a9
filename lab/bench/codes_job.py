"""The table of ``python -m lab bench codes``: planned, then measured and written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from cep.codes import published as registry
from cep.files.tables import markdown_table
from cep.jobs.engine import Engine
from lab.bench.codes import (
    CODE_FILES,
    CODE_HEAD,
    code_cells,
    code_lines,
    code_row,
    codes_table,
    write_codes_report,
)
from lab.bench.job import Job, Part, outcome_warnings, spelled
from lab.bench.own_codes import load_own_codes, spelled_own_codes
from lab.bench.tables import TextTable
from motdiff.files.outputs import claim_folder

_FAMILY = "jeon"


def codes_job(
    output: Path,
    engine: Engine,
    *,
    names: Sequence[str],
    codes: Sequence[str] = (),
    time_s: float,
    seed: int,
    force: bool,
) -> Job:
    """Plan the comparison of published codes with searched ones.

    Parameters
    ----------
    output : Path
        Folder to write into.
    engine : Engine
    names : sequence of str
        Published codes; Jeon's table when no code is named.
    codes : sequence of str
        Codes of the user's own, each ``NAME=SOURCE``.
    time_s : float
        Of each search.
    seed : int
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    ValueError
        If a file is in the way, or an option is not valid.
    """
    claim_folder(output, CODE_FILES, force=force)
    if not 0 < time_s < 1e6:
        raise ValueError(f"time_s: must be above 0 seconds, got {time_s:g}")
    own = load_own_codes(codes)
    family = [] if own else [name for name in registry.names() if name.startswith(_FAMILY)]
    known = {name: registry.published(name).code for name in dict.fromkeys(names or family)}
    if twice := sorted(own.keys() & known.keys()):
        raise ValueError(
            f"code: {twice[0]} is the name of a published code that is compared too, take another"
        )
    known |= own
    cells = code_cells(list(known.items()), time_s=time_s, seed=seed)
    given = {
        "": f"{' '.join(names)} {spelled_own_codes(codes, own)}".strip(),
        "--time": f"{time_s:g}",
        "--seed": seed,
    }
    command = spelled("codes", given, quick=False)

    def run(progress: Callable[[float, str], None]) -> Part:
        outcome = engine.run(cells, progress=progress)
        rows = [
            code_row(name, known[name], figures)
            for (name,), figures in outcome.figures.items()
            if figures
        ]
        warnings = outcome_warnings(outcome)
        files = write_codes_report(
            output,
            rows,
            command=command,
            seed=seed,
            time_s=time_s,
            machines=outcome.machines,
            warnings=warnings,
            force=force,
        )
        lines = code_lines(rows)
        shown = TextTable(
            f"smallest |P|, and noise relative to DC; {time_s:g} s each",
            CODE_HEAD,
            lines,
            f"better on both: {sum(row.better for row in rows)} of {len(rows)}",
        )
        failures = {"/".join(name): reason for name, reason in outcome.failures.items()}
        return Part(
            "Published codes",
            command,
            markdown_table(CODE_HEAD, lines),
            {"codes": codes_table(rows)},
            [shown],
            files,
            failures,
            outcome.missing,
            warnings,
            outcome.machines,
        )

    return Job({"folder": output, "seed": seed}, run)
