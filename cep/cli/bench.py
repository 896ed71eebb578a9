"""``cep bench``: comparisons with what others published, run again here, one by one or all of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli import bench_blind, bench_cep, bench_codes
from cep.cli.bench_options import Cache, Dask, Data, Engine, Gyro, Job, Quick, Workers, spelled
from cep.cli.console import complain, finish, progress
from cep.cli.folders import end
from cep.cli.options import Force, Json, output_option

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from cep.bench.index import Part

__all__ = ["bench"]

bench = typer.Typer(invoke_without_command=True, no_args_is_help=True, subcommand_metavar="[TABLE [ARGS]...]")
bench.command("blind")(bench_blind.blind)
bench.command("cep")(bench_cep.cep)
bench.command("speed")(bench_blind.speed)
bench.command("codes")(bench_codes.codes)

_PROTOCOLS = ("paper", "ours")
_QUICK_CODES, _QUICK_SEARCH_S = ("jeon-50", "jeon-60", "jeon-100"), 1.0


@bench.callback()
def everything(
    context: typer.Context,
    data: Data = None,
    gyro: Gyro = None,
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("bench"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare with what others published: one table by its name, or with options alone all of them in one folder.

    Finished cells are kept: stopped by Ctrl-C, the same command with --force goes on. Exit code 1 when a cell failed,
    130 when stopped; what is finished is written either way. Costs are measured here, never on --dask's cluster.

    Example: cep bench --quick -o bench
    """
    from cep.bench.index import INDEX, write_index
    from cep.outputs import claim_folder

    if context.invoked_subcommand is not None:
        _refuse_options(context)
        return
    engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
    claim_folder(output, [INDEX], force=force)
    for name, files in _files().items():  # before any photo is read
        claim_folder(output / name, files, force=force)
    jobs = _jobs(output, engine, data=data, gyro=gyro, quick=quick, force=force)
    parts: dict[str, Part] = {}
    shows: list[Callable[[Console], None]] = []
    for name, job in jobs.items():
        with progress(name) as tick:
            parts[name], show = job.run(tick)
        shows.append(show)
        if parts[name].missing:
            break  # by Ctrl-C
    command = spelled("", {"--data": data and data.resolve().name, "--gyro": gyro and gyro.name}, quick=quick)
    unmade = [name for name in jobs if name not in parts]
    index = write_index(output, list(parts.values()), command=command, unmade=unmade)
    failed = sum(len(part.failures) for part in parts.values())
    warnings = [f"{name}: {warning}" for name, part in parts.items() for warning in part.warnings]
    result = {
        "folder": output,
        "files": [index, *(file for part in parts.values() for file in part.files.values())],
        "tables": {name: part.tables for name, part in parts.items()},
        "failures": {name: part.failures for name, part in parts.items() if part.failures},
        "missing": {name: part.missing for name, part in parts.items() if part.missing},
        "unmade": unmade,
        "warnings": warnings,
    }

    def page(console: Console) -> None:
        for show in shows:
            show(console)
        console.print(f"{output}: {INDEX}, {', '.join(jobs)}")

    finish(result, as_json=as_json, show=page)
    if failed:
        complain(f"{failed} cells failed: {index} names them")
    end(missing=sum(part.missing for part in parts.values()), failed=failed)


def _files() -> dict[str, Sequence[str]]:
    """Files of each table of :func:`_jobs`."""
    from cep.bench.blind.report import outputs
    from cep.bench.coded.report import OUTPUTS
    from cep.bench.codes_report import CODE_FILES

    files: dict[str, Sequence[str]] = {"codes": CODE_FILES, "speed": outputs("speed")}
    for protocol in _PROTOCOLS:
        files |= {f"blind-{protocol}": outputs("blind"), f"cep-{protocol}": OUTPUTS}
    return files


def _jobs(
    output: Path, engine: Engine, *, data: Path | None, gyro: Path | None, quick: bool, force: bool
) -> dict[str, Job]:
    """Plan all tables, each in a folder of its own name; they share their cells."""
    names, time_s = (_QUICK_CODES, _QUICK_SEARCH_S) if quick else ((), bench_codes.SEARCH_S)
    jobs = {
        "codes": bench_codes.codes_job(
            output / "codes", engine, names=names, time_s=time_s, seed=0, force=force
        ),
        # before the blind table, whose cells these are, and here: a cost is measured while nothing else runs
        "speed": bench_blind.speed_job(
            output / "speed", Engine(engine.cache, 1, None), data=data, protocol="paper", methods="", gyro=None,
            quick=quick, force=force,
        ),
    }  # fmt: skip
    for protocol in _PROTOCOLS:
        name = f"blind-{protocol}"
        jobs[name] = bench_blind.blind_job(
            output / name, engine, data=data, protocol=protocol, methods="",
            gyro=gyro if protocol == "ours" else None, quick=quick, force=force,
        )  # fmt: skip
    for protocol in _PROTOCOLS:
        name = f"cep-{protocol}"
        jobs[name] = bench_cep.cep_job(
            output / name, engine, data=data, protocol=protocol, designs="", quick=quick, force=force
        )
    return jobs


def _refuse_options(context: typer.Context) -> None:
    """Refuse options before the name of a table: they would be read for all tables, and lost."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE":
            option, table = parameter.opts[0], context.invoked_subcommand
            raise ValueError(f"{option}: belongs after the table's name: cep bench {table} {option}")
