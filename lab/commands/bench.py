"""``python -m lab bench``: comparisons with what others published, run again here, one by one or
all of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import complain, finish, progress
from cep.commands.jobs import Cache, Dask, Workers, end
from cep.commands.options import Force, Json, Seed, output_option
from lab.commands.tables import Data, Gyro, Quick, run_job, show_tables

if TYPE_CHECKING:
    from rich.console import Console

    from lab.bench.job import Job, Part


Methods = Annotated[
    str,
    typer.Option(
        "--methods",
        metavar="NAME,...",
        help=(
            "Estimators, as pmp,motdiff; all that take seconds when omitted. Others: selfdeblur"
            " (hours), blinddps:FOLDER of weights, network:ddpm:1000, network:ddim:10:8 (eight"
            " draws), networks:ddim:10:8 (corrected ones), motdiff@FILE and network:ddim:10@FILE"
            " of other weights, module:name of an estimator of your own."
        ),
    ),
]
ProtocolName = Annotated[
    str,
    typer.Option(
        "--protocol",
        metavar="NAME|FILE",
        help="paper, ours, card-walks, card-gyro, or a .toml file like these.",
    ),
]


def blind(
    data: Data = None,
    protocol: ProtocolName = "paper",
    methods: Methods = "",
    gyro: Gyro = None,
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path(
        "bench-blind"
    ),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure estimators where the motion is known: the paper's tables I and II.

    A folder of sharp photos, or of GoPro's layout, is blurred by simulated shakes; Levin's .mat
    files, RSBlur's pairs and Koehler's photos are taken as they are. Finished cells are kept:
    stopped by Ctrl-C, the same command with --force goes on.

    Example: python -m lab bench blind --quick -o blind
    """

    def plan() -> Job:
        from cep.jobs.engine import Engine
        from lab.bench.blind.job import blind_job

        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        return blind_job(
            output,
            engine,
            data=data,
            protocol=protocol,
            methods=_names(methods),
            gyro=gyro,
            quick=quick,
            force=force,
        )

    run_job(plan, as_json=as_json)


def speed(
    data: Data = None,
    protocol: ProtocolName = "paper",
    methods: Methods = "",
    gyro: Gyro = None,
    quick: Quick = False,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path(
        "bench-speed"
    ),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure what an estimate costs: processor time, time and memory per photo, one after the
    other on one thread.

    Cells are those of python -m lab bench blind with the same protocol, one motion per photo: a
    common --cache has them already.

    Example: python -m lab bench speed --quick -o speed
    """

    def plan() -> Job:
        from cep.jobs.engine import Engine
        from lab.bench.blind.job import speed_job

        engine = Engine.of(output, cache=cache, workers=1, dask=None)
        return speed_job(
            output,
            engine,
            data=data,
            protocol=protocol,
            methods=_names(methods),
            gyro=gyro,
            quick=quick,
            force=force,
        )

    run_job(plan, as_json=as_json)


def _names(text: str) -> list[str]:
    """Split names that a comma parts; none where nothing is given."""
    return [name.strip() for name in text.split(",")] if text else []


OwnCodes = Annotated[
    list[str] | None,
    typer.Option(
        "--code",
        metavar="NAME=SOURCE",
        help=(
            "Also a code of your own: bits, code.json, a name or module:name, as my=1011; may be"
            " repeated."
        ),
    ),
]


def cep(
    data: Data = None,
    protocol: Annotated[
        str,
        typer.Option(
            "--protocol",
            metavar="NAME|FILE",
            help="paper, ours, or a .toml file like lab/bench/coded/ours.toml, in "
            "which the restoration may be module:name of a function (photo, psf) of your own.",
        ),
    ] = "paper",
    designs: Annotated[
        str,
        typer.Option(
            "--designs",
            metavar="NAME,...",
            help=(
                "Ways to choose the code, as open,dnf,both-ways; when omitted all but those that"
                " take long: "
                "calibrated-1, calibrated-2, calibrated-4 (from so many coded photos),"
                " calibrated-point, class-snapshot."
            ),
        ),
    ] = "",
    code: OwnCodes = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="FIELD=VALUE",
            help=(
                "Another value of the protocol's field, as motions=20, photons=[10000,100000],"
                " read_noise_e=50 or "
                "restored_by=blind; may be repeated."
            ),
        ),
    ] = None,
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path(
        "bench-cep"
    ),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare codes by the photos they give: the paper's table III, and ours with real borders,
    light and directions.

    Every row takes the same sharp photos along the same motions, and every search has the same
    budget. Finished cells are kept: stopped by Ctrl-C, the same command with --force goes on.

    Example: python -m lab bench cep --quick --protocol ours -o coded

    Example: python -m lab bench cep --quick --designs open,both-ways --code my=101100111000

    Example: python -m lab bench cep --designs dce,oracle,calibrated-4 --set photos=2 --set
    motions=6
    """

    def plan() -> Job:
        from cep.jobs.engine import Engine
        from lab.bench.coded.job import cep_job

        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        return cep_job(
            output,
            engine,
            data=data,
            protocol=protocol,
            designs=_names(designs),
            codes=code or (),
            changes=changes or (),
            quick=quick,
            force=force,
        )

    run_job(plan, as_json=as_json)


_SEARCH_S = 30.0


def codes(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME", help="Published codes; Jeon's table when no code is named."
        ),
    ] = None,
    code: OwnCodes = None,
    time_s: Annotated[
        float, typer.Option("--time", metavar="S", help="Time of each search, seconds.")
    ] = _SEARCH_S,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path(
        "bench-codes"
    ),
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search against published codes, each at its own number of chips and open chips; one code for
    both figures.

    Finished searches are kept: stopped by Ctrl-C, the same command with --force goes on.

    Example: python -m lab bench codes raskar-52 jeon-100 --time 60 -o codes
    """

    def plan() -> Job:
        from cep.jobs.engine import Engine
        from lab.bench.codes_job import codes_job

        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        return codes_job(
            output,
            engine,
            names=names or (),
            codes=code or (),
            time_s=time_s,
            seed=seed,
            force=force,
        )

    run_job(plan, as_json=as_json)


bench = typer.Typer(
    invoke_without_command=True, no_args_is_help=True, subcommand_metavar="[TABLE [ARGS]...]"
)
bench.command("blind")(blind)
bench.command("cep")(cep)
bench.command("speed")(speed)
bench.command("codes")(codes)


@bench.callback()
def everything(
    context: typer.Context,
    data: Data = None,
    gyro: Gyro = None,
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path(
        "bench"
    ),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare with what others published: one table by its name, or with options alone all of them
    in one folder.

    Finished cells are kept: stopped by Ctrl-C, the same command with --force goes on. Exit code 1
    when a cell failed, 130 when stopped; what is finished is written either way. Costs are
    measured here, never on --dask's cluster.

    Example: python -m lab bench --quick -o bench
    """
    if context.invoked_subcommand is not None:
        _refuse_options(context)
        return
    with progress("planning"):
        from cep.jobs.engine import Engine
        from lab.bench.all_jobs import all_jobs
        from lab.bench.index_page import INDEX, write_index
        from lab.bench.job import spelled

        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        jobs = all_jobs(
            output, engine, data=data, gyro=gyro, search_s=_SEARCH_S, quick=quick, force=force
        )
    parts: dict[str, Part] = {}
    for name, job in jobs.items():
        with progress(name) as tick:
            parts[name] = job.run(tick)
        if parts[name].missing:
            break  # by Ctrl-C
    command = spelled(
        "", {"--data": data and data.resolve().name, "--gyro": gyro and gyro.name}, quick=quick
    )
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
        for part in parts.values():
            show_tables(console, part.shown)
        console.print(f"{output}: {INDEX}, {', '.join(jobs)}")

    finish(result, as_json=as_json, show=page)
    if failed:
        complain(f"{failed} cells failed: {index} names them")
    end(missing=sum(part.missing for part in parts.values()), failed=failed)


def _refuse_options(context: typer.Context) -> None:
    """Refuse options before the name of a table: they would be read for all tables, and lost."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE":
            option = parameter.opts[0]
            table = context.invoked_subcommand
            raise ValueError(
                f"{option}: belongs after the table's name: python -m lab bench {table} {option}"
            )
