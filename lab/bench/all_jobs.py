"""All tables of ``python -m lab bench`` in one folder: planned together, with an index page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cep.files.foreign_text import markdown_text
from lab.bench.blind.job import BLIND_FILES, SPEED_FILES, blind_job, speed_job
from lab.bench.coded.job import cep_job
from lab.bench.coded.report import OUTPUTS
from lab.bench.harness import Job, Report, Request, in_code_span
from lab.bench.published_codes import CODE_FILES, codes_job
from lab.bench.table_io import machines_markdown
from lab.jobs.engine import Engine
from motdiff.files.outputs import write_text

INDEX = "README.md"
"""The page; one of this name is shown where folders are browsed."""

_PROTOCOLS = ("paper", "ours")
_QUICK_CODES = ("jeon-50", "jeon-60", "jeon-100")
_QUICK_SEARCH_S = 1.0
_FILES: Mapping[str, Sequence[str]] = {
    "codes": CODE_FILES,
    "speed": SPEED_FILES,
    **{f"blind-{protocol}": BLIND_FILES for protocol in _PROTOCOLS},
    **{f"cep-{protocol}": OUTPUTS for protocol in _PROTOCOLS},
}


def all_jobs(request: Request, *, gyro: Path | None, search_s: float) -> dict[str, Job]:
    """Plan all tables, each in a folder of its own name; they share their cells.

    Parameters
    ----------
    request : Request
        Costs are measured by one worker, never on its cluster.
    gyro : Path, optional
        Recording of a gyroscope for the hand shake.
    search_s : float
        Of each search against a published code, at full size.

    Raises
    ------
    ValueError
        If a file is in the way, before any photo is read; or what a table's plan raises.
    """
    request.claim([INDEX])
    for name, files in _FILES.items():
        _in_folder(request, name).claim(files)
    return _jobs(request, gyro=gyro, search_s=search_s)


def _jobs(request: Request, *, gyro: Path | None, search_s: float) -> dict[str, Job]:
    names: Sequence[str] = ()
    time_s = search_s
    if request.quick:
        names = _QUICK_CODES
        time_s = _QUICK_SEARCH_S
    speed_request = replace(_in_folder(request, "speed"), engine=Engine(request.engine.cache))
    # its command has neither --data nor --quick
    codes = replace(_in_folder(request, "codes"), data=None, quick=False)
    jobs = {
        "codes": codes_job(codes, names=names, time_s=time_s, seed=0),
        # before the blind table, whose cells these are: a cost is measured while nothing else runs
        "speed": speed_job(speed_request),
    }
    for protocol in _PROTOCOLS:
        name = f"blind-{protocol}"
        trace = gyro if protocol == "ours" else None
        jobs[name] = blind_job(_in_folder(request, name), protocol=protocol, gyro=trace)
    for protocol in _PROTOCOLS:
        name = f"cep-{protocol}"
        jobs[name] = cep_job(_in_folder(request, name), protocol=protocol)
    return jobs


def _in_folder(request: Request, name: str) -> Request:
    return replace(request, output=request.output / name)


def write_index(
    folder: Path, reports: Sequence[Report], *, command: str, missing: Sequence[str] = ()
) -> Path:
    """Write :data:`INDEX`: commands, machines, and for each table its first figures, its picture
    and links to its files.

    Parameters
    ----------
    folder : Path
        Above the tables' folders.
    reports : sequence of Report
    command : str
        Command that makes all of them again.
    missing : sequence of str
        Tables not reached, after Ctrl-C.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    machines: list[Mapping[str, Any]] = []
    for report in reports:
        machines += [machine for machine in report.provenance.machines if machine not in machines]
    head = [
        "# The paper's tables",
        "",
        f"Made by {in_code_span(command)} on",
        "",
        machines_markdown(machines) or "- no machine",
        "",
        *(
            f"**{name} is not measured: stopped early; the same command with --force goes on.**\n"
            for name in missing
        ),
    ]
    sections = [f"\n{_section(folder, report)}" for report in reports]
    path = folder / INDEX
    write_text(path, "\n".join(head) + "".join(sections))
    return path


def _section(folder: Path, report: Report) -> str:
    places = {name: file.relative_to(folder).as_posix() for name, file in report.files.items()}
    notes = [
        *report.provenance.warnings,
        *(f"failed: {label}: {reason}" for label, reason in report.outcome.reasons.items()),
    ]
    blocks = [f"## {report.title}", in_code_span(report.provenance.command)]
    if notes:
        blocks.append("\n".join(f"- {markdown_text(note)}" for note in notes))
    blocks.append(report.summary.rstrip("\n"))
    blocks += [
        f"![{report.title}]({place})" for name, place in places.items() if name.endswith(".png")
    ]
    links = ", ".join(f"[{name}]({place})" for name, place in places.items())
    blocks.append(f"All of it: {links}.")
    return "\n\n".join(blocks) + "\n"
