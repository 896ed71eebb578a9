"""The tables of ``python -m lab bench blind`` and ``python -m lab bench speed``, planned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from lab.bench.blind.cells import CEILINGS
from lab.bench.blind.methods import UNUSUAL, label_of, select_methods
from lab.bench.blind.plan import Plan, blind_plan, one_cell_each
from lab.bench.blind.protocol import Protocol
from lab.bench.blind.report import CELLS, blind_report, blind_tables, speed_tables
from lab.bench.harness import Job, Progress, Report, Request, file_names, outcome_warnings
from lab.bench.table_io import Provenance
from lab.jobs.engine import Outcome
from motdiff.files.gyro_tables import read_gyro

BLIND_FILES = file_names("blind", CELLS)
SPEED_FILES = file_names("speed", CELLS)


def blind_job(
    request: Request,
    *,
    protocol: str = "paper",
    methods: Sequence[str] = (),
    gyro: Path | None = None,
) -> Job:
    """Plan the table of estimators where the motion is known.

    Parameters
    ----------
    request : Request
    protocol : str
        As of :meth:`lab.bench.blind.protocol.Protocol.load`.
    methods : sequence of str
        Estimators; those of every table when empty, as of
        :func:`lab.bench.blind.methods.select_methods`.
    gyro : Path, optional
        Recording of a gyroscope for the hand shake.

    Raises
    ------
    ValueError
        If a file is in the way, an option is not valid, or the folder holds no usable photo.
    OSError
        If a file cannot be read.
    """
    request.claim(BLIND_FILES)
    names, plan = _plan(request, protocol, methods, gyro)
    title = f"Blind, {plan.protocol.name}"
    truth = [name for name in CEILINGS[-1:] if any(cell.name[0] == name for cell in plan.cells)]

    def report(outcome: Outcome, provenance: Provenance) -> Report:
        return blind_report(
            "blind",
            title,
            blind_tables(outcome.figures, plan.lights, title=title, seed=plan.protocol.seed),
            plan=plan,
            outcome=outcome,
            provenance=provenance,
            pictured=(*names, *truth),
            unmeasured={} if methods else UNUSUAL,
        )

    command = _command("blind", request, protocol, methods, gyro)
    return _job(request, BLIND_FILES, names, plan, command, report)


def speed_job(
    request: Request,
    *,
    protocol: str = "paper",
    methods: Sequence[str] = (),
    gyro: Path | None = None,
) -> Job:
    """Plan the table of an estimate's cost; parameters and errors are those of :func:`blind_job`.

    Cells that run beside others take longer: the engine should have one worker and no cluster.
    """
    request.claim(SPEED_FILES)
    names, plan = _plan(request, protocol, methods, gyro)
    plan = one_cell_each(plan)
    title = f"One estimate from a photo of {plan.protocol.crop_px} px, {plan.protocol.name}"

    def report(outcome: Outcome, provenance: Provenance) -> Report:
        return blind_report(
            "speed",
            title,
            speed_tables(outcome.figures, title=title, seed=plan.protocol.seed),
            plan=plan,
            outcome=outcome,
            provenance=provenance,
            unmeasured={} if methods else UNUSUAL,
        )

    command = _command("speed", request, protocol, methods, gyro)
    return _job(request, SPEED_FILES, names, plan, command, report)


def _job(
    request: Request,
    files: tuple[str, ...],
    methods: Sequence[str],
    plan: Plan,
    command: str,
    report: Callable[[Outcome, Provenance], Report],
) -> Job:
    def measure(progress: Progress) -> Report:
        outcome = request.engine.run(plan.cells, progress=progress)
        warnings = [*plan.warnings, *outcome_warnings(outcome)]
        provenance = Provenance(command, plan.protocol.seed, outcome.machines, warnings)
        return report(outcome, provenance)

    about = {"folder": request.output, "protocol": plan.protocol, "methods": methods}
    return Job(request, files, about, measure)


def _plan(
    request: Request, protocol: str, methods: Sequence[str], gyro: Path | None
) -> tuple[tuple[str, ...], Plan]:
    loaded = Protocol.load(protocol, quick=request.quick)
    if gyro is not None and loaded.motion.gyro == 0:
        raise ValueError(
            f"gyro: the protocol {loaded.name} has no hand shake, it would change nothing"
        )
    trace = None if gyro is None else read_gyro(gyro)
    names, warnings = select_methods(methods)
    plan = blind_plan(loaded, names, folder=request.data, trace=trace)
    return tuple(map(label_of, names)), replace(plan, warnings=(*warnings, *plan.warnings))


def _command(
    table: str, request: Request, protocol: str, methods: Sequence[str], gyro: Path | None
) -> str:
    options = {
        "--protocol": Path(protocol).name,
        "--methods": ",".join(map(label_of, methods)),
        "--gyro": gyro and gyro.name,
    }
    return request.command(table, options)
