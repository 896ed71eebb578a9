"""``cep bench blind`` and ``cep bench speed``: estimators of motion from one blurred photo, side by side."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.bench_options import (
    Cache,
    Dask,
    Data,
    Engine,
    Gyro,
    Job,
    Quick,
    Workers,
    figures_of,
    run_job,
    show_tables,
    spelled,
    told,
)
from cep.cli.options import Force, Json, output_option

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rich.console import Console

    from cep.bench.blind.run import Plan
    from cep.bench.engine import Outcome
    from cep.bench.index import Part
    from cep.bench.tables import Table
    from cep.cli.console import Tick

__all__ = ["blind", "blind_job", "speed", "speed_job"]

Methods = Annotated[
    str,
    typer.Option(
        "--methods",
        metavar="NAME,...",
        help="Estimators, as pmp,motdiff; all that take seconds when omitted. Others: selfdeblur (hours), "
        "blinddps:FOLDER of weights, network:ddpm:1000.",
    ),
]
ProtocolName = Annotated[
    str, typer.Option("--protocol", metavar="NAME|FILE", help="paper, ours, or a .toml file like these.")
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
    engine = Engine.of(output, cache=cache, workers=workers, dask=dask)
    job = blind_job(output, engine, data=data, protocol=protocol, methods=methods, gyro=gyro, quick=quick, force=force)
    run_job(job, as_json=as_json)


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
    engine = Engine.of(output, cache=cache, workers=1, dask=None)
    job = speed_job(output, engine, data=data, protocol=protocol, methods=methods, gyro=gyro, quick=quick, force=force)
    run_job(job, as_json=as_json)


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
    from cep.bench.blind.report import outputs, write_report
    from cep.bench.blind.tables import blind_tables
    from cep.bench.blind.work import CEILINGS
    from cep.outputs import claim_folder

    claim_folder(output, outputs("blind"), force=force)
    names, plan = _plan(data, protocol, methods, gyro, quick)
    title = f"Blind, {plan.protocol.name}"
    command = _command("blind", data, protocol, methods, gyro, quick)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        outcome = _run(plan, engine, tick)
        warnings = [*plan.warnings, *told(outcome)]
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
    from cep.bench.blind.report import outputs, write_report
    from cep.bench.blind.run import one_each
    from cep.bench.blind.tables import speed_tables
    from cep.outputs import claim_folder

    claim_folder(output, outputs("speed"), force=force)
    names, whole = _plan(data, protocol, methods, gyro, quick)
    plan = one_each(whole)
    title = f"One estimate from a photo of {plan.protocol.crop_px} px, {plan.protocol.name}"
    command = _command("speed", data, protocol, methods, gyro, quick)

    def run(tick: Tick) -> tuple[Part, Callable[[Console], None]]:
        outcome = _run(plan, engine, tick)
        warnings = [*plan.warnings, *told(outcome)]
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
    from cep.bench.blind.methods import chosen, label_of
    from cep.bench.blind.protocol import Protocol
    from cep.bench.blind.run import planned
    from motdiff.gyro_tables import read_gyro

    loaded = Protocol.load(protocol, quick=quick)
    if gyro is not None and loaded.motion.gyro == 0:
        raise ValueError(f"--gyro: the protocol {loaded.name} has no hand shake, it would change nothing")
    trace = None if gyro is None else read_gyro(gyro)
    names, warnings = chosen([name.strip() for name in methods.split(",")] if methods else [])
    plan = planned(loaded, names, folder=data, trace=trace)
    return tuple(map(label_of, names)), replace(plan, warnings=(*warnings, *plan.warnings))


def _run(plan: Plan, engine: Engine, tick: Tick) -> Outcome:
    from cep.bench.engine import run_cells

    return run_cells(plan.cells, cache=engine.cache, workers=engine.workers, dask=engine.dask, progress=tick)


def _part(
    title: str, command: str, tables: Sequence[Table], files: Mapping[str, Path], outcome: Outcome, warnings: list[str]
) -> tuple[Part, Callable[[Console], None]]:
    from cep.bench.index import Part, first_table

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
