"""``cep bench blind`` and ``cep bench speed``: estimators of motion from one blurred photo, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.bench_options import Cache, Dask, Data, Quick, Workers, finish_bench, spelled, told
from cep.cli.console import progress
from cep.cli.options import Force, Json

if TYPE_CHECKING:
    from cep.bench.blind.run import Plan
    from cep.bench.engine import Outcome

__all__ = ["blind", "speed"]

Methods = Annotated[
    str,
    typer.Option(
        "--methods",
        help="Estimators, as pmp,motdiff; all that take seconds when omitted. Others: selfdeblur (hours), "
        "blinddps:FOLDER of weights, network:ddpm:1000.",
    ),
]
ProtocolName = Annotated[str, typer.Option("--protocol", help="paper, ours, or a .toml file like these.")]
Gyro = Annotated[Path | None, typer.Option("--gyro", help="Recording of a gyroscope, for the hand shake of ours.")]


def blind(
    data: Data = None,
    protocol: ProtocolName = "paper",
    methods: Methods = "",
    gyro: Gyro = None,
    quick: Quick = False,
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write into.")] = Path("bench-blind"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure estimators where the motion is known: the paper's tables I and II.

    A folder of sharp photos, or of GoPro's layout, is blurred by simulated shakes; Levin's .mat files, RSBlur's pairs
    and Koehler's photos are taken as they are. Finished cells are kept: stopped by Ctrl-C, the same command goes on.

    Example: cep bench blind --quick -o blind
    """
    from cep.bench.blind.methods import UNUSUAL
    from cep.bench.blind.report import outputs, write_report
    from cep.bench.blind.tables import blind_tables
    from cep.bench.blind.work import CEILINGS
    from cep.bench.machine import machine
    from cep.outputs import claim_folder

    claim_folder(output, outputs("blind"), force=force)
    names, plan, warnings = _plan(data, protocol, methods, gyro, quick)
    outcome = _run(plan, cache or output / "cells", workers or machine()["cores"] or 1, dask)
    warnings += told(outcome)
    title = f"Blind, {plan.protocol.name}"
    tables = blind_tables(outcome.figures, plan.lights, title=title, seed=plan.protocol.seed)
    last = [name for name in CEILINGS[-1:] if any(cell.name[0] == name for cell in plan.cells)]
    files = write_report(
        output,
        "blind",
        tables,
        plan=plan,
        outcome=outcome,
        command=_command("blind", data, protocol, methods, gyro, quick),
        warnings=warnings,
        pictured=(*names, *last),
        unmeasured={} if methods else UNUSUAL,
        force=force,
    )
    about = {"folder": output, "protocol": plan.protocol, "methods": names}
    failures = {"/".join(name): reason for name, reason in outcome.failures.items()}
    finish_bench(about, tables, files, failures=failures, missing=outcome.missing, warnings=warnings, as_json=as_json)


def speed(
    data: Data = None,
    protocol: ProtocolName = "paper",
    methods: Methods = "",
    gyro: Gyro = None,
    quick: Quick = False,
    dask: Dask = None,
    cache: Cache = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write into.")] = Path("bench-speed"),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure what an estimate costs: processor time, time and memory per photo, one after the other.

    Cells are those of cep bench blind with the same protocol, one motion per photo: a common --cache has them already.

    Example: cep bench speed --quick -o speed
    """
    from cep.bench.blind.report import outputs, write_report
    from cep.bench.blind.run import one_each
    from cep.bench.blind.tables import speed_tables
    from cep.outputs import claim_folder

    claim_folder(output, outputs("speed"), force=force)
    names, whole, warnings = _plan(data, protocol, methods, gyro, quick)
    plan = one_each(whole)
    outcome = _run(plan, cache or output / "cells", 1, dask)
    warnings += told(outcome)
    title = f"One estimate from a photo of {plan.protocol.crop_px} px, {plan.protocol.name}"
    tables = speed_tables(outcome.figures, title=title, seed=plan.protocol.seed)
    command = _command("speed", data, protocol, methods, gyro, quick)
    files = write_report(
        output, "speed", tables, plan=plan, outcome=outcome, command=command, warnings=warnings, force=force
    )
    about = {"folder": output, "protocol": plan.protocol, "methods": names}
    failures = {"/".join(name): reason for name, reason in outcome.failures.items()}
    finish_bench(about, tables, files, failures=failures, missing=outcome.missing, warnings=warnings, as_json=as_json)


def _plan(
    data: Path | None, protocol: str, methods: str, gyro: Path | None, quick: bool
) -> tuple[tuple[str, ...], Plan, list[str]]:
    from cep.bench.blind.methods import chosen, label_of
    from cep.bench.blind.protocol import Protocol
    from cep.bench.blind.run import planned
    from motdiff.gyro import read_gyro

    loaded = Protocol.load(protocol, quick=quick)
    if gyro is not None and loaded.motion.gyro == 0:
        raise ValueError(f"--gyro: the protocol {loaded.name} has no hand shake, it would change nothing")
    trace = None if gyro is None else read_gyro(gyro)
    names, warnings = chosen([name.strip() for name in methods.split(",")] if methods else [])
    plan = planned(loaded, names, folder=data, trace=trace)
    return tuple(map(label_of, names)), plan, [*warnings, *plan.warnings]


def _run(plan: Plan, cache: Path, workers: int, dask: str | None) -> Outcome:
    from cep.bench.engine import run_cells

    with progress("measuring") as tick:
        return run_cells(plan.cells, cache=cache, workers=workers, dask=dask, progress=tick)


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
