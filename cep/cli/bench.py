"""``cep bench``: comparisons with what others published, run again here, one by one or all of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.console import complain, finish, progress, table
from cep.cli.jobs import (
    Cache,
    Dask,
    Data,
    Engine,
    Gyro,
    Job,
    Quick,
    Workers,
    end,
    figures_of,
    run_job,
    show_tables,
    spelled,
    summary,
)
from cep.cli.options import Force, Json, Seed, output_option

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rich.console import Console

    from cep.bench.blind.run import Plan
    from cep.bench.coded.protocol import CodedProtocol
    from cep.bench.index_page import Part
    from cep.bench.tables import Table
    from cep.cli.console import Tick
    from cep.jobs.engine import Outcome
    from cep.optics.code import ShutterCode

__all__ = ["SEARCH_S", "bench", "blind", "blind_job", "cep", "cep_job", "codes", "codes_job", "speed", "speed_job"]


Methods = Annotated[
    str,
    typer.Option(
        "--methods",
        metavar="NAME,...",
        help="Estimators, as pmp,motdiff; all that take seconds when omitted. Others: selfdeblur (hours), "
        "blinddps:FOLDER of weights, network:ddpm:1000, motdiff@FILE and network:ddim:10@FILE of other weights, "
        "module:name of an estimator of your own.",
    ),
]
ProtocolName = Annotated[
    str,
    typer.Option(
        "--protocol", metavar="NAME|FILE", help="paper, ours, card-walks, card-gyro, or a .toml file like these."
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
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("bench-blind"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure estimators where the motion is known: the paper's tables I and II.

    A folder of sharp photos, or of GoPro's layout, is blurred by simulated shakes; Levin's .mat files, RSBlur's pairs
    and Koehler's photos are taken as they are. Finished cells are kept: stopped by Ctrl-C, the same command with
    --force goes on.

    Example: cep bench blind --quick -o blind
    """

    def plan() -> Job:
        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        return blind_job(
            output, engine, data=data, protocol=protocol, methods=methods, gyro=gyro, quick=quick, force=force
        )

    run_job(plan, as_json=as_json)


def speed(
    data: Data = None,
    protocol: ProtocolName = "paper",
    methods: Methods = "",
    gyro: Gyro = None,
    quick: Quick = False,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("bench-speed"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure what an estimate costs: processor time, time and memory per photo, one after the other on one thread.

    Cells are those of cep bench blind with the same protocol, one motion per photo: a common --cache has them already.

    Example: cep bench speed --quick -o speed
    """

    def plan() -> Job:
        engine = Engine.of(output, cache=cache, workers=1, dask=None)
        return speed_job(
            output, engine, data=data, protocol=protocol, methods=methods, gyro=gyro, quick=quick, force=force
        )

    run_job(plan, as_json=as_json)


def blind_job(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    methods: str,
    gyro: Path | None,
    quick: bool,
    force: bool,
) -> Job:
    """Plan the blind table; the parameters are the options of :func:`blind`."""
    from cep.bench.blind.methods import UNUSUAL
    from cep.bench.blind.report import blind_tables, outputs, write_report
    from cep.bench.blind.work import CEILINGS
    from cep.io.outputs import claim_folder

    claim_folder(output, outputs("blind"), force=force)
    names, plan = _plan(data, protocol, methods, gyro, quick)
    title = f"Blind, {plan.protocol.name}"
    command = _command("blind", data, protocol, methods, gyro, quick)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        outcome = _run(plan, engine, tick)
        warnings = [*plan.warnings, *summary(outcome)]
        tables = blind_tables(outcome.figures, plan.lights, title=title, seed=plan.protocol.seed)
        last = [name for name in CEILINGS[-1:] if any(cell.name[0] == name for cell in plan.cells)]
        files = write_report(
            output, "blind", tables, plan=plan, outcome=outcome, command=command, warnings=warnings,
            pictured=(*names, *last), unmeasured={} if methods else UNUSUAL, force=force,
        )  # fmt: skip
        return _part(title, command, tables, files, outcome, warnings)

    about = {"folder": output, "protocol": plan.protocol, "methods": names}
    return Job(about, run)


def speed_job(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    methods: str,
    gyro: Path | None,
    quick: bool,
    force: bool,
) -> Job:
    """Plan the speed table; the parameters are the options of :func:`speed`."""
    from cep.bench.blind.methods import UNUSUAL
    from cep.bench.blind.report import outputs, speed_tables, write_report
    from cep.bench.blind.run import one_cell_each
    from cep.io.outputs import claim_folder

    claim_folder(output, outputs("speed"), force=force)
    names, whole = _plan(data, protocol, methods, gyro, quick)
    plan = one_cell_each(whole)
    title = f"One estimate from a photo of {plan.protocol.crop_px} px, {plan.protocol.name}"
    command = _command("speed", data, protocol, methods, gyro, quick)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        outcome = _run(plan, engine, tick)
        warnings = [*plan.warnings, *summary(outcome)]
        tables = speed_tables(outcome.figures, title=title, seed=plan.protocol.seed)
        files = write_report(
            output, "speed", tables, plan=plan, outcome=outcome, command=command, warnings=warnings,
            unmeasured={} if methods else UNUSUAL, force=force,
        )  # fmt: skip
        return _part(title, command, tables, files, outcome, warnings)

    about = {"folder": output, "protocol": plan.protocol, "methods": names}
    return Job(about, run)


def _plan(
    data: Path | None, protocol: str, methods: str, gyro: Path | None, quick: bool
) -> tuple[tuple[str, ...], Plan]:
    from cep.bench.blind.methods import label_of, select_methods
    from cep.bench.blind.protocol import Protocol
    from cep.bench.blind.run import blind_plan
    from motdiff.io.gyro_tables import read_gyro

    loaded = Protocol.load(protocol, quick=quick)
    if gyro is not None and loaded.motion.gyro == 0:
        raise ValueError(f"--gyro: the protocol {loaded.name} has no hand shake, it would change nothing")
    trace = None if gyro is None else read_gyro(gyro)
    names, warnings = select_methods([name.strip() for name in methods.split(",")] if methods else [])
    plan = blind_plan(loaded, names, folder=data, trace=trace)
    return tuple(map(label_of, names)), replace(plan, warnings=(*warnings, *plan.warnings))


def _run(plan: Plan, engine: Engine, tick: Tick) -> Outcome:
    from cep.jobs.engine import run_cells

    return run_cells(plan.cells, cache=engine.cache, workers=engine.workers, dask=engine.dask, progress=tick)


def _part(
    title: str, command: str, tables: Sequence[Table], files: Mapping[str, Path], outcome: Outcome, warnings: list[str]
) -> tuple[Part, Callable[[Console], None]]:
    from cep.bench.index_page import Part, first_table

    failures = {"/".join(name): reason for name, reason in outcome.failures.items()}
    part = Part(
        title, command, first_table(tables), figures_of(tables), files, failures, outcome.missing, warnings,
        outcome.machines,
    )  # fmt: skip
    return part, lambda console: show_tables(console, tables)


def _command(name: str, data: Path | None, protocol: str, methods: str, gyro: Path | None, quick: bool) -> str:
    """Spell the command without anybody's folders."""
    from cep.bench.blind.methods import label_of

    given = {
        "--data": data and data.resolve().name,
        "--protocol": Path(protocol).name,
        "--methods": ",".join(label_of(name.strip()) for name in methods.split(",")),
        "--gyro": gyro and gyro.name,
    }
    return spelled(name, given, quick=quick)


OwnCodes = Annotated[
    list[str] | None,
    typer.Option(
        "--code", metavar="NAME=SOURCE",
        help="Also a code of your own: bits, code.json, a name or module:name, as my=1011; may be repeated.",
    ),
]  # fmt: skip


def _own_codes(given: Sequence[str]) -> dict[str, ShutterCode]:
    """Read the codes of ``--code``, by their names."""
    from cep.bench.coded.run import check_names
    from cep.codes.sources import load_code

    found: dict[str, ShutterCode] = {}
    for text in given:
        name, equals, source = text.partition("=")
        if not equals:
            raise ValueError(f"--code: must be NAME=SOURCE, as my=1011, got {text[:40]!r}")
        check_names([name])
        if name in found:
            raise ValueError(f"--code: every name must come once, {name} comes twice")
        try:
            found[name] = load_code(source)
        except ValueError as error:
            raise ValueError(f"--code: {name}: {error}") from None
    return found


def _own_spelled(given: Sequence[str], codes: Mapping[str, ShutterCode]) -> str:
    """Spell the options ``--code`` without anybody's folders."""
    from cep.codes.sources import code_file

    sources = (text.partition("=")[2] for text in given)
    named = (file.name if (file := code_file(source)) else source for source in sources)
    return " ".join(f"--code {name}={source}" for name, source in zip(codes, named, strict=True))


def cep(
    data: Data = None,
    protocol: Annotated[
        str,
        typer.Option(
            "--protocol",
            metavar="NAME|FILE",
            help="paper, ours, or a .toml file like cep/bench/coded/ours.toml, in "
            "which the restoration may be module:name of a function (photo, psf) of your own.",
        ),
    ] = "paper",
    designs: Annotated[
        str,
        typer.Option(
            "--designs", metavar="NAME,...", help="Ways to choose the code, as open,dnf,both-ways; all when omitted."
        ),
    ] = "",
    code: OwnCodes = None,
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("bench-cep"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Compare codes by the photos they give: the paper's table III, and ours with real borders, light and directions.

    Every row takes the same sharp photos along the same motions, and every search has the same budget. Finished cells
    are kept: stopped by Ctrl-C, the same command with --force goes on.

    Example: cep bench cep --quick --protocol ours -o coded

    Example: cep bench cep --quick --designs open,both-ways --code my=101100111000
    """

    def plan() -> Job:
        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        return cep_job(
            output, engine, data=data, protocol=protocol, designs=designs, codes=code or (), quick=quick, force=force
        )

    run_job(plan, as_json=as_json)


def cep_job(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    designs: str,
    codes: Sequence[str] = (),
    quick: bool,
    force: bool,
) -> Job:
    """Plan the coded-exposure table; the parameters are the options of :func:`cep`."""
    from cep.bench.coded.designs import DESIGNS
    from cep.bench.coded.protocol import coded_protocol
    from cep.bench.coded.report import OUTPUTS, write_coded_report
    from cep.bench.coded.run import measure_coded
    from cep.bench.coded.tables import coded_tables
    from cep.bench.index_page import Part, first_table
    from cep.io.outputs import claim_folder

    claim_folder(output, OUTPUTS, force=force)
    chosen = coded_protocol(protocol)
    chosen = chosen.quick if quick else chosen
    names = [name.strip() for name in designs.split(",")] if designs else list(DESIGNS)
    own = _own_codes(codes)
    photos, warnings = _photos(data, chosen)
    given = {
        "--data": data and data.resolve().name, "--protocol": Path(protocol).name, "--designs": designs,
        "": _own_spelled(codes, own),
    }  # fmt: skip
    command = spelled("cep", given, quick=quick)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        measured = measure_coded(
            chosen, photos, cache=engine.cache, designs=names, codes=own, workers=engine.workers, dask=engine.dask,
            progress=tick,
        )  # fmt: skip
        all_warnings = [*warnings, *measured.warnings]
        if measured.failures:
            name, reason = next(iter(measured.failures.items()))
            all_warnings.append(f"{len(measured.failures)} cells failed, the first: {name}: {reason}")
        if measured.missing:
            all_warnings.append("stopped early: cells are left out; the same command with --force goes on")
        tables = coded_tables(measured)
        files = write_coded_report(output, tables, measured, command=command, warnings=all_warnings, force=force)
        part = Part(
            f"Coded exposure, {chosen.name}", command, first_table(tables), figures_of(tables), files,
            measured.failures, measured.missing, all_warnings, measured.machines,
        )  # fmt: skip
        return part, lambda console: show_tables(console, tables)

    about = {
        "folder": output, "protocol": chosen.name, "designs": names,
        "codes": {name: one.bits for name, one in own.items()},
    }  # fmt: skip
    return Job(about, run)


def _photos(data: Path | None, protocol: CodedProtocol) -> tuple[dict[str, Path], list[str]]:
    """Pick the sharp photos, and say what keeps them from being what the protocol asks for."""
    from cep.bench.coded.run import scene_px
    from cep.bench.datasets import BUNDLED_WARNING, bundled_photos, labels_of, photo_folder, pick

    paths = bundled_photos() if data is None else photo_folder(data)
    picked = pick(paths, protocol.photos, least_px=scene_px(protocol))
    warnings = []
    if data is None:
        warnings.append(BUNDLED_WARNING)
    if len(picked) < protocol.photos:
        warnings.append(f"{len(picked)} photos are large enough, the protocol asks for {protocol.photos}")
    return dict(zip(labels_of(picked), picked, strict=True)), warnings


SEARCH_S = 30.0
"""Time of each search when none is given, s."""

_FAMILY = "jeon"


def codes(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME", help="Published codes; Jeon's table when no code is named.")
    ] = None,
    code: OwnCodes = None,
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

    def plan() -> Job:
        engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
        return codes_job(output, engine, names=names or (), codes=code or (), time_s=time_s, seed=seed, force=force)

    run_job(plan, as_json=as_json)


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
    """Plan the comparison; the parameters are the options of :func:`codes`."""
    from cep.bench.codes import CODE_FILES, CODE_HEAD, code_cells, code_lines, code_row, codes_table, write_codes_report
    from cep.bench.index_page import Part
    from cep.bench.table_io import markdown_table
    from cep.codes import published as registry
    from cep.io.outputs import claim_folder
    from cep.jobs.engine import run_cells

    claim_folder(output, CODE_FILES, force=force)
    if not 0 < time_s < 1e6:
        raise ValueError(f"--time: must be above 0 seconds, got {time_s:g}")
    own = _own_codes(codes)
    family = [] if own else [name for name in registry.names() if name.startswith(_FAMILY)]
    known = {name: registry.published(name).code for name in dict.fromkeys(names or family)}
    if twice := sorted(own.keys() & known.keys()):
        raise ValueError(f"--code: {twice[0]} is the name of a published code that is compared too, take another")
    known |= own
    cells = code_cells(list(known.items()), time_s=time_s, seed=seed)
    given = {"": f"{' '.join(names)} {_own_spelled(codes, own)}".strip(), "--time": f"{time_s:g}", "--seed": seed}
    command = spelled("codes", given, quick=False)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        outcome = run_cells(cells, cache=engine.cache, workers=engine.workers, dask=engine.dask, progress=tick)
        rows = [code_row(name, known[name], figures) for (name,), figures in outcome.figures.items() if figures]
        warnings = summary(outcome)
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


bench = typer.Typer(invoke_without_command=True, no_args_is_help=True, subcommand_metavar="[TABLE [ARGS]...]")
bench.command("blind")(blind)
bench.command("cep")(cep)
bench.command("speed")(speed)
bench.command("codes")(codes)

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
    if context.invoked_subcommand is not None:
        _refuse_options(context)
        return
    with progress("planning"):
        from cep.bench.index_page import INDEX, write_index
        from cep.io.outputs import claim_folder

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
    from cep.bench.codes import CODE_FILES

    files: dict[str, Sequence[str]] = {"codes": CODE_FILES, "speed": outputs("speed")}
    for protocol in _PROTOCOLS:
        files |= {f"blind-{protocol}": outputs("blind"), f"cep-{protocol}": OUTPUTS}
    return files


def _jobs(
    output: Path, engine: Engine, *, data: Path | None, gyro: Path | None, quick: bool, force: bool
) -> dict[str, Job]:
    """Plan all tables, each in a folder of its own name; they share their cells."""
    names, time_s = (_QUICK_CODES, _QUICK_SEARCH_S) if quick else ((), SEARCH_S)
    jobs = {
        "codes": codes_job(
            output / "codes", engine, names=names, time_s=time_s, seed=0, force=force
        ),
        # before the blind table, whose cells these are, and here: a cost is measured while nothing else runs
        "speed": speed_job(
            output / "speed", Engine(engine.cache, 1, None), data=data, protocol="paper", methods="", gyro=None,
            quick=quick, force=force,
        ),
    }  # fmt: skip
    for protocol in _PROTOCOLS:
        name = f"blind-{protocol}"
        jobs[name] = blind_job(
            output / name, engine, data=data, protocol=protocol, methods="",
            gyro=gyro if protocol == "ours" else None, quick=quick, force=force,
        )  # fmt: skip
    for protocol in _PROTOCOLS:
        name = f"cep-{protocol}"
        jobs[name] = cep_job(output / name, engine, data=data, protocol=protocol, designs="", quick=quick, force=force)
    return jobs


def _refuse_options(context: typer.Context) -> None:
    """Refuse options before the name of a table: they would be read for all tables, and lost."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE":
            option, table = parameter.opts[0], context.invoked_subcommand
            raise ValueError(f"{option}: belongs after the table's name: cep bench {table} {option}")
