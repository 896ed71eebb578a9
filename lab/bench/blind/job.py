"""The tables of ``python -m lab bench blind`` and ``python -m lab bench speed``: planned, then
measured and written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from cep.jobs.engine import Engine, Outcome
from lab.bench.blind.methods import UNUSUAL, label_of, select_methods
from lab.bench.blind.protocol import Protocol
from lab.bench.blind.report import blind_tables, outputs, speed_tables, write_report
from lab.bench.blind.run import Plan, blind_plan, one_cell_each
from lab.bench.blind.work import CEILINGS
from lab.bench.job import Job, Part, outcome_warnings, part_of_tables, spelled
from lab.bench.tables import Table
from motdiff.files.gyro_tables import read_gyro
from motdiff.files.outputs import claim_folder


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
        As of :meth:`lab.bench.blind.protocol.Protocol.load`.
    methods : sequence of str
        Estimators; those of every table when empty, as of
        :func:`lab.bench.blind.methods.select_methods`.
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
    return _job(
        "blind",
        "Blind, {protocol}",
        output,
        engine,
        data=data,
        protocol=protocol,
        methods=methods,
        gyro=gyro,
        quick=quick,
        force=force,
        laid_out=_blind_tables,
    )


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
    """Plan the table of what an estimate costs; parameters and errors are those of
    :func:`blind_job`.

    Cells that run beside others take longer: the engine should have one worker and no cluster.
    """
    return _job(
        "speed",
        "One estimate from a photo of {crop_px} px, {protocol}",
        output,
        engine,
        data=data,
        protocol=protocol,
        methods=methods,
        gyro=gyro,
        quick=quick,
        force=force,
        laid_out=_speed_tables,
        narrowed=one_cell_each,
    )


_LaidOut = Callable[[Plan, Outcome, str], Sequence[Table]]


def _blind_tables(plan: Plan, outcome: Outcome, title: str) -> Sequence[Table]:
    return blind_tables(outcome.figures, plan.lights, title=title, seed=plan.protocol.seed)


def _speed_tables(plan: Plan, outcome: Outcome, title: str) -> Sequence[Table]:
    return speed_tables(outcome.figures, title=title, seed=plan.protocol.seed)


def _job(
    name: Literal["blind", "speed"],
    title: str,
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    methods: Sequence[str],
    gyro: Path | None,
    quick: bool,
    force: bool,
    laid_out: _LaidOut,
    narrowed: Callable[[Plan], Plan] = lambda plan: plan,
) -> Job:
    """Plan a table of estimators: :func:`blind_job`, with what its title and tables are and which
    cells it has.
    """
    claim_folder(output, outputs(name), force=force)
    names, whole = _plan(data, protocol, methods, gyro, quick)
    plan = narrowed(whole)
    headed = title.format(protocol=plan.protocol.name, crop_px=plan.protocol.crop_px)
    command = _command(name, data, protocol, methods, gyro, quick)

    def run(progress: Callable[[float, str], None]) -> Part:
        outcome = engine.run(plan.cells, progress=progress)
        warnings = [*plan.warnings, *outcome_warnings(outcome)]
        tables = laid_out(plan, outcome, headed)
        last = [one for one in CEILINGS[-1:] if any(cell.name[0] == one for cell in plan.cells)]
        files = write_report(
            output,
            name,
            tables,
            plan=plan,
            outcome=outcome,
            command=command,
            warnings=warnings,
            pictured=(*names, *last) if name == "blind" else (),
            unmeasured={} if methods else UNUSUAL,
            force=force,
        )
        return part_of_tables(
            headed,
            command,
            tables,
            files,
            failures={"/".join(cell): reason for cell, reason in outcome.failures.items()},
            missing=outcome.missing,
            warnings=warnings,
            machines=outcome.machines,
        )

    return Job({"folder": output, "protocol": plan.protocol, "methods": names}, run)


def _plan(
    data: Path | None, protocol: str, methods: Sequence[str], gyro: Path | None, quick: bool
) -> tuple[tuple[str, ...], Plan]:
    loaded = Protocol.load(protocol, quick=quick)
    if gyro is not None and loaded.motion.gyro == 0:
        raise ValueError(
            f"gyro: the protocol {loaded.name} has no hand shake, it would change nothing"
        )
    trace = None if gyro is None else read_gyro(gyro)
    names, warnings = select_methods(methods)
    plan = blind_plan(loaded, names, folder=data, trace=trace)
    return tuple(map(label_of, names)), replace(plan, warnings=(*warnings, *plan.warnings))


def _command(
    name: str,
    data: Path | None,
    protocol: str,
    methods: Sequence[str],
    gyro: Path | None,
    quick: bool,
) -> str:
    given = {
        "--data": data and data.resolve().name,
        "--protocol": Path(protocol).name,
        "--methods": ",".join(map(label_of, methods)),
        "--gyro": gyro and gyro.name,
    }
    return spelled(name, given, quick=quick)
