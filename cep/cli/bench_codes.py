"""``cep bench codes``: published codes against the search, at equal length and light."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.bench_options import Cache, Dask, Engine, Job, Workers, run_job, spelled, told
from cep.cli.console import table
from cep.cli.options import Force, Json, Seed, output_option

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from cep.bench.index import Part
    from cep.cli.console import Tick

__all__ = ["SEARCH_S", "codes", "codes_job"]

SEARCH_S = 30.0
"""Time of each search when none is given, s."""

_FAMILY = "jeon"


def codes(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME", help="Published codes; Jeon's table when none is named.")
    ] = None,
    time_s: Annotated[float, typer.Option("--time", metavar="S", help="Time of each search, seconds.")] = SEARCH_S,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("bench-codes"),
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search against published codes, each at its own number of chips and open chips; one code for both figures.

    Finished searches are kept: stopped by Ctrl-C, the same command with --force goes on.

    Example: cep bench codes raskar-52 jeon-100 --time 60 -o codes
    """
    engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
    job = codes_job(output, engine, names=names or (), time_s=time_s, seed=seed, force=force)
    run_job(job, as_json=as_json)


def codes_job(output: Path, engine: Engine, *, names: Sequence[str], time_s: float, seed: int, force: bool) -> Job:
    """Plan the comparison; the parameters are the options of :func:`codes`."""
    from cep.baselines import published as registry
    from cep.bench.codes import code_cells, code_row
    from cep.bench.codes_report import CODE_FILES, CODE_HEAD, code_lines, codes_table, write_codes_report
    from cep.bench.engine import run_cells
    from cep.bench.index import Part
    from cep.bench.layout import markdown_table
    from cep.outputs import claim_folder

    claim_folder(output, CODE_FILES, force=force)
    if not 0 < time_s < 1e6:
        raise ValueError(f"--time: must be above 0 seconds, got {time_s:g}")
    chosen = dict.fromkeys(names or [name for name in registry.names() if name.startswith(_FAMILY)])
    known = {name: registry.published(name).code for name in chosen}
    cells = code_cells(list(known.items()), time_s=time_s, seed=seed)
    given = {"": " ".join(names), "--time": f"{time_s:g}", "--seed": seed}
    command = spelled("codes", given, quick=False)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        outcome = run_cells(cells, cache=engine.cache, workers=engine.workers, dask=engine.dask, progress=tick)
        rows = [code_row(name, known[name], figures) for (name,), figures in outcome.figures.items() if figures]
        warnings = told(outcome)
        files = write_codes_report(
            output, rows, command=command, seed=seed, time_s=time_s, machines=outcome.machines, warnings=warnings,
            force=force,
        )  # fmt: skip
        failures = {"/".join(name): reason for name, reason in outcome.failures.items()}
        part = Part(
            "Published codes", command, markdown_table(CODE_HEAD, code_lines(rows)), {"codes": codes_table(rows)},
            files, failures, outcome.missing, warnings, outcome.machines,
        )  # fmt: skip

        def show(console: Console) -> None:
            title = f"smallest |P|, and noise relative to DC; {time_s:g} s each"
            console.print(table(title, CODE_HEAD, code_lines(rows)))
            console.print(f"better on both: {sum(row.better for row in rows)} of {len(rows)}")

        return part, show

    return Job({"folder": output, "seed": seed}, run)
