"""All tables of ``python -m lab bench`` in one folder, planned before any is measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cep.jobs.engine import Engine
from lab.bench.blind.job import blind_job, speed_job
from lab.bench.blind.report import outputs
from lab.bench.coded.job import cep_job
from lab.bench.coded.report import OUTPUTS
from lab.bench.codes import CODE_FILES
from lab.bench.codes_job import codes_job
from lab.bench.index_page import INDEX
from lab.bench.job import Job
from motdiff.files.outputs import claim_folder

_PROTOCOLS = ("paper", "ours")
_QUICK_CODES = ("jeon-50", "jeon-60", "jeon-100")
_QUICK_SEARCH_S = 1.0


def all_jobs(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    gyro: Path | None,
    search_s: float,
    quick: bool,
    force: bool,
) -> dict[str, Job]:
    """Plan all tables, each in a folder of its own name; they share their cells.

    Parameters
    ----------
    output : Path
        Folder to write into, with the page that leads to the tables.
    engine : Engine
        Costs are measured by one worker, never on its cluster.
    data, gyro, quick, force
        As of :func:`lab.bench.blind.job.blind_job`.
    search_s : float
        Of each search against a published code, at full size.

    Raises
    ------
    ValueError
        If a file is in the way, before any photo is read; or what a table's plan raises.
    """
    claim_folder(output, [INDEX], force=force)
    for name, files in _files().items():
        claim_folder(output / name, files, force=force)
    return _jobs(output, engine, data=data, gyro=gyro, search_s=search_s, quick=quick, force=force)


def _files() -> dict[str, Sequence[str]]:
    """Files of each table of :func:`_jobs`."""
    files: dict[str, Sequence[str]] = {"codes": CODE_FILES, "speed": outputs("speed")}
    for protocol in _PROTOCOLS:
        files |= {f"blind-{protocol}": outputs("blind"), f"cep-{protocol}": OUTPUTS}
    return files


def _jobs(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    gyro: Path | None,
    search_s: float,
    quick: bool,
    force: bool,
) -> dict[str, Job]:
    names, time_s = (_QUICK_CODES, _QUICK_SEARCH_S) if quick else ((), search_s)
    jobs = {
        "codes": codes_job(
            output / "codes", engine, names=names, time_s=time_s, seed=0, force=force
        ),
        # before the blind table, whose cells these are, and here: a cost is measured while nothing
        # else runs
        "speed": speed_job(
            output / "speed",
            Engine(engine.cache, 1, None),
            data=data,
            protocol="paper",
            methods=(),
            gyro=None,
            quick=quick,
            force=force,
        ),
    }
    for protocol in _PROTOCOLS:
        name = f"blind-{protocol}"
        jobs[name] = blind_job(
            output / name,
            engine,
            data=data,
            protocol=protocol,
            methods=(),
            gyro=gyro if protocol == "ours" else None,
            quick=quick,
            force=force,
        )
    for protocol in _PROTOCOLS:
        name = f"cep-{protocol}"
        jobs[name] = cep_job(
            output / name,
            engine,
            data=data,
            protocol=protocol,
            designs=(),
            quick=quick,
            force=force,
        )
    return jobs
