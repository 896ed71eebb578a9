"""The tables of ``cep bench blind`` and ``cep bench speed``: planned, then measured and written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from cep.bench.blind.methods import UNUSUAL, label_of, select_methods
from cep.bench.blind.protocol import Protocol
from cep.bench.blind.report import blind_tables, outputs, speed_tables, write_report
from cep.bench.blind.run import Plan, blind_plan, one_cell_each
from cep.bench.blind.work import CEILINGS
from cep.bench.job import Job, Part, outcome_warnings, part_of_tables, spelled
from cep.bench.tables import Table
from cep.io.outputs import claim_folder
from cep.jobs.engine import Engine, Outcome
from motdiff.io.gyro_tables import read_gyro

__all__ = ["blind_job", "speed_job"]


def blind_job(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    methods: Sequence[str],
    gyro: Path | None,
    quick: bool,
    force: bool,
) -> Job:
    """Plan the table of estimators where the motion is known.

    Parameters
    ----------
    output : Path
        Folder to write into.
    engine : Engine
    data : Path, optional
        Folder of photos; those that scikit-image carries when None.
    protocol : str
        As of :meth:`cep.bench.blind.protocol.Protocol.load`.
    methods : sequence of str
        Estimators; those of every table when empty, as of :func:`cep.bench.blind.methods.select_methods`.
    gyro : Path, optional
        Recording of a gyroscope for the hand shake.
    quick : bool
        The protocol's small size.
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    ValueError
        If a file is in the way, an option is not valid, or the folder holds no usable photo.
    OSError
        If a file cannot be read.
    """
    claim_folder(output, outputs("blind"), force=force)
    names, plan = _plan(data, protocol, methods, gyro, quick)
    title = f"Blind, {plan.protocol.name}"
    command = _command("blind", data, protocol, methods, gyro, quick)

    def run(progress: Callable[[float, str], None]) -> Part:
        outcome = engine.run(plan.cells, progress=progress)
        warnings = [*plan.warnings, *outcome_warnings(outcome)]
        tables = blind_tables(outcome.figures, plan.lights, title=title, seed=plan.protocol.seed)
        last = [name for name in CEILINGS[-1:] if any(cell.name[0] == name for cell in plan.cells)]
        files = write_report(
            output, "blind", tables, plan=plan, outcome=outcome, command=command, warnings=warnings,
            pictured=(*names, *last), unmeasured={} if methods else UNUSUAL, force=force,
        )  # fmt: skip
        return _part(title, command, tables, files, outcome, warnings)

    return Job({"folder": output, "protocol": plan.protocol, "methods": names}, run)


def speed_job(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    methods: Sequence[str],
    gyro: Path | None,
    quick: bool,
    force: bool,
) -> Job:
    """Plan the table of what an estimate costs; parameters and errors are those of :func:`blind_job`.

    Cells that run beside others take longer: the engine should have one worker and no cluster.
    """
    claim_folder(output, outputs("speed"), force=force)
    names, whole = _plan(data, protocol, methods, gyro, quick)
    plan = one_cell_each(whole)
    title = f"One estimate from a photo of {plan.protocol.crop_px} px, {plan.protocol.name}"
    command = _command("speed", data, protocol, methods, gyro, quick)

    def run(progress: Callable[[float, str], None]) -> Part:
        outcome = engine.run(plan.cells, progress=progress)
        warnings = [*plan.warnings, *outcome_warnings(outcome)]
        tables = speed_tables(outcome.figures, title=title, seed=plan.protocol.seed)
        files = write_report(
            output, "speed", tables, plan=plan, outcome=outcome, command=command, warnings=warnings,
            unmeasured={} if methods else UNUSUAL, force=force,
        )  # fmt: skip
        return _part(title, command, tables, files, outcome, warnings)

    return Job({"folder": output, "protocol": plan.protocol, "methods": names}, run)


def _plan(
    data: Path | None, protocol: str, methods: Sequence[str], gyro: Path | None, quick: bool
) -> tuple[tuple[str, ...], Plan]:
    loaded = Protocol.load(protocol, quick=quick)
    if gyro is not None and loaded.motion.gyro == 0:
        raise ValueError(f"gyro: the protocol {loaded.name} has no hand shake, it would change nothing")
    trace = None if gyro is None else read_gyro(gyro)
    names, warnings = select_methods(methods)
    plan = blind_plan(loaded, names, folder=data, trace=trace)
    return tuple(map(label_of, names)), replace(plan, warnings=(*warnings, *plan.warnings))


def _part(
    title: str, command: str, tables: Sequence[Table], files: dict[str, Path], outcome: Outcome, warnings: list[str]
) -> Part:
    return part_of_tables(
        title, command, tables, files, failures={"/".join(name): reason for name, reason in outcome.failures.items()},
        missing=outcome.missing, warnings=warnings, machines=outcome.machines,
    )  # fmt: skip


def _command(
    name: str, data: Path | None, protocol: str, methods: Sequence[str], gyro: Path | None, quick: bool
) -> str:
    given = {
        "--data": data and data.resolve().name,
        "--protocol": Path(protocol).name,
        "--methods": ",".join(map(label_of, methods)),
        "--gyro": gyro and gyro.name,
    }
    return spelled(name, given, quick=quick)
