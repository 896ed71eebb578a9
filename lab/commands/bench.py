"""``python -m lab bench``: the tables of published work measured again, one by one or all of
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import Page, announce, end, finish, progress
from cep.commands.options import Seed, argument, command, option, output_option
from lab.commands.tables import (
    Gyro,
    PhotoOptions,
    TableOptions,
    WorkerOptions,
    run_job,
    table_page,
)

if TYPE_CHECKING:
    from lab.bench.harness import Job, Report

_SEARCH_S = 30.0

UserCodes = Annotated[
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


@dataclass(frozen=True, kw_only=True)
class SpeedOptions(TableOptions, PhotoOptions):
    """Options of ``python -m lab bench speed``."""

    protocol: str = option(
        "--protocol",
        "NAME|FILE",
        "paper, ours, card-walks, card-gyro, or a .toml file like these.",
        "paper",
    )
    methods: str = option(
        "--methods",
        "NAME,...",
        "Estimators, as pmp,motdiff; all that take seconds when omitted. Others:"
        " selfdeblur (hours), blinddps:FOLDER of weights, network:ddpm:1000,"
        " network:ddim:10:8 (eight draws), networks:ddim:10:8 (corrected ones),"
        " network:ddim:10@FILE of other weights, module:name of an"
        " estimator of your own.",
        "",
    )
    gyro: Gyro = None
    output: Path = output_option("Folder to write into.", Path("bench-speed"), metavar="FOLDER")


@dataclass(frozen=True, kw_only=True)
class BlindOptions(SpeedOptions, WorkerOptions):
    """Options of ``python -m lab bench blind``."""

    output: Path = output_option("Folder to write into.", Path("bench-blind"), metavar="FOLDER")


@dataclass(frozen=True, kw_only=True)
class CepOptions(TableOptions, WorkerOptions, PhotoOptions):
    """Options of ``python -m lab bench cep``."""

    protocol: str = option(
        "--protocol",
        "NAME|FILE",
        "paper, ours, or a .toml file like lab/bench/coded/ours.toml, in "
        "which the restoration may be module:name of a function (photo, psf) of your own.",
        "paper",
    )
    designs: str = option(
        "--designs",
        "NAME,...",
        "Ways to choose the code, as open,dnf,both-ways; when omitted all but those that"
        " take long: "
        "calibrated-2, calibrated-4 (from so many coded photos),"
        " calibrated-point, class-snapshot.",
        "",
    )
    code: UserCodes = None
    changes: list[str] | None = option(
        "--set",
        "FIELD=VALUE",
        "Another value of the protocol's field, as motions=20, photons=[10000,100000],"
        " read_noise_e=50 or "
        "restored_by=blind; may be repeated.",
    )
    output: Path = output_option("Folder to write into.", Path("bench-cep"), metavar="FOLDER")


@dataclass(frozen=True, kw_only=True)
class CodesOptions(TableOptions, WorkerOptions):
    """Options of ``python -m lab bench codes``."""

    names: list[str] | None = argument(
        "NAME", "Published codes; Jeon's table when no code is named.", default=None
    )
    code: UserCodes = None
    time_s: float = option("--time", "S", "Time of each search, seconds.", _SEARCH_S)
    output: Path = output_option("Folder to write into.", Path("bench-codes"), metavar="FOLDER")
    seed: Seed = 0


@dataclass(frozen=True, kw_only=True)
class AllOptions(TableOptions, WorkerOptions, PhotoOptions):
    """Options of ``python -m lab bench``."""

    context: typer.Context
    gyro: Gyro = None


@command(BlindOptions)
def blind(options: BlindOptions) -> None:
    """Measure estimators where the motion is known: the paper's tables I and II.

    A folder of sharp photos, or of GoPro's layout, is blurred by simulated shakes; Levin's .mat
    files, RSBlur's pairs and Koehler's photos are taken as they are. Finished cells are kept:
    stopped by Ctrl-C, the same command with --force goes on.

    Example: python -m lab bench blind --quick -o blind
    """

    def plan() -> Job:
        from lab.bench.blind.job import blind_job

        request = options.request(
            data=options.data, quick=options.quick, workers=options.workers, dask=options.dask
        )
        return blind_job(
            request,
            protocol=options.protocol,
            methods=_names(options.methods),
            gyro=options.gyro,
        )

    run_job(plan, as_json=options.as_json)


@command(SpeedOptions)
def speed(options: SpeedOptions) -> None:
    """Measure what an estimate costs: processor time, time and memory per photo, one after the
    other on one thread.

    Cells are those of python -m lab bench blind with the same protocol, one motion per photo: a
    common --cache has them already.

    Example: python -m lab bench speed --quick -o speed
    """

    def plan() -> Job:
        from lab.bench.blind.job import speed_job

        return speed_job(
            options.request(data=options.data, quick=options.quick, workers=1),
            protocol=options.protocol,
            methods=_names(options.methods),
            gyro=options.gyro,
        )

    run_job(plan, as_json=options.as_json)


@command(CepOptions)
def cep(options: CepOptions) -> None:
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
        from lab.bench.coded.job import cep_job

        request = options.request(
            data=options.data, quick=options.quick, workers=options.workers, dask=options.dask
        )
        return cep_job(
            request,
            protocol=options.protocol,
            designs=_names(options.designs),
            codes=options.code or (),
            changes=options.changes or (),
        )

    run_job(plan, as_json=options.as_json)


@command(CodesOptions)
def codes(options: CodesOptions) -> None:
    """Search against published codes, each at its own number of chips and open chips; one code for
    both figures.

    Finished searches are kept: stopped by Ctrl-C, the same command with --force goes on.

    Example: python -m lab bench codes raskar-52 jeon-100 --time 60 -o codes
    """

    def plan() -> Job:
        from lab.bench.published_codes import codes_job

        return codes_job(
            options.request(workers=options.workers, dask=options.dask),
            names=options.names or (),
            codes=options.code or (),
            time_s=options.time_s,
            seed=options.seed,
        )

    run_job(plan, as_json=options.as_json)


def _names(text: str) -> list[str]:
    """Split names at commas; none where the text is empty."""
    return [name.strip() for name in text.split(",")] if text else []


bench = typer.Typer(
    invoke_without_command=True, no_args_is_help=True, subcommand_metavar="[TABLE [ARGS]...]"
)
bench.command("blind")(blind)
bench.command("cep")(cep)
bench.command("speed")(speed)
bench.command("codes")(codes)


@bench.callback()
@command(AllOptions)
def everything(options: AllOptions) -> None:
    """Compare with what others published: one table by its name, or with options alone all of them
    in one folder.

    Finished cells are kept: stopped by Ctrl-C, the same command with --force goes on. Exit code 1
    when a cell failed, 130 when stopped; what is finished is written either way. Costs are
    measured here, never on --dask's cluster.

    Example: python -m lab bench --quick -o bench
    """
    context = options.context
    if context.invoked_subcommand is not None:
        _refuse_options(context)
        return
    with progress("planning"):
        from lab.bench.all_jobs import INDEX, all_jobs, write_index

        request = options.request(
            data=options.data, quick=options.quick, workers=options.workers, dask=options.dask
        )
        jobs = all_jobs(request, gyro=options.gyro, search_s=_SEARCH_S)
    reports: dict[str, Report] = {}
    for name, job in jobs.items():
        with progress(name) as tick:
            reports[name] = job.run(tick)
        if reports[name].outcome.missing:
            break  # by Ctrl-C
    not_reached = [name for name in jobs if name not in reports]
    index = write_index(
        options.output,
        list(reports.values()),
        command=request.command("", {"--gyro": options.gyro and options.gyro.name}),
        missing=not_reached,
    )
    failures = {name: report.outcome.reasons for name, report in reports.items()}
    failed = sum(map(len, failures.values()))
    missing = {name: report.outcome.missing for name, report in reports.items()}
    result = {
        "folder": options.output,
        "files": [index, *(file for report in reports.values() for file in report.files.values())],
        "tables": {name: report.tables for name, report in reports.items()},
        "failures": {
            name: report.outcome.reasons
            for name, report in reports.items()
            if report.outcome.reasons
        },
        "missing": {name: count for name, count in missing.items() if count},
        "unmade": not_reached,
        "warnings": [
            f"{name}: {warning}"
            for name, report in reports.items()
            for warning in report.provenance.warnings
        ],
    }

    def page() -> Page:
        for report in reports.values():
            yield from table_page(report.shown)
        yield f"{options.output}: {INDEX}, {', '.join(jobs)}"

    finish(result, page(), as_json=options.as_json)
    if failed:
        announce(f"{failed} cells failed: {index} names them")
    end(missing=sum(missing.values()), failed=failed)


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
