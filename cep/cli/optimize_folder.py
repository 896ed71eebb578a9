"""``cep optimize --each``: a code for each motion of a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.cli.folders import NOT_REACHED, discard, finish_folder, run_folder, summary_csv
from cep.cli.searching import Task, unplayable, warnings_of

if TYPE_CHECKING:
    from cep.bench.engine import Outcome
    from cep.optimize import Search
    from hw.device import DeviceProfile
    from motdiff.files import StoredMotion

__all__ = ["optimize_folder"]

_SUMMARY, _CODE = "codes.csv", "code.json"
_COLUMNS = {
    "motion": "motion",
    "open": "open",
    "min_mtf": "min MTF",
    "min_chip": "min |P|",
    "noise_gain_db": "noise, dB",
    "mse_db": "MSE, dB",
    "seconds": "s",
}
_RESOLVED_PX = 1e4  # a path that tells any chips apart
_MORE = ("chips", "duty", "bound", "gap", "steps", "stopped", "proven", "bits", "warnings", "failure")


def optimize_folder(
    folder: Path,
    task: Callable[[StoredMotion, Path], Task],
    how: Search,
    *,
    profile: DeviceProfile | None,
    chip_ns: int,
    workers: int | None,
    dask: str | None,
    cache: Path | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Search, write and print a code for each motion; one that fails is told of, the others are kept.

    Parameters
    ----------
    folder : Path
        As ``cep calibrate FOLDER`` writes it.
    task : callable
        Makes the search along a motion from a file.
    how : Search
    profile : DeviceProfile, optional
        That must be able to play every code.
    chip_ns, workers, dask, cache, output, force, as_json
        As the command's options.

    Raises
    ------
    ValueError
        If there are no motions, an output is in the way, or the options suit none of them.
    """
    from cep.bench.cells import Cell
    from cep.bench.sources import source_version
    from cep.calibrate_folder import motions_in
    from cep.optimize import optimize_motion
    from cep.outputs import claim_folder, write_text

    motions = motions_in(folder)
    tasks, failures = _tasks(folder, motions, task)  # first: it tells what is wrong with the options
    target = output or folder
    claim_folder(target, [_SUMMARY], force=force)
    for name in motions:
        claim_folder(target / name, [_CODE], force=force)
    version = source_version(["cep.optimize"])
    cells = [
        Cell(
            (name,),
            optimize_motion,
            {
                "problem": one.problem, "searched": one.searched, "along": one.along, "chip_ns": chip_ns, "how": how,
            },
            version,
        )
        for name, one in tasks.items()
    ]  # fmt: skip
    outcome = run_folder(
        cells, task="searching", noun="codes", cache=cache or target / "cells", workers=workers, dask=dask
    )
    failures |= {name: reason for (name,), reason in outcome.failures.items()}
    codes = _written(outcome, tasks, how, target=target, profile=profile, failures=failures)
    if force:
        for name in failures:
            discard(target / name, [_CODE])
    rows = [
        {"motion": name, **codes.get(name, {}), "failure": failures.get(name, "" if name in codes else NOT_REACHED)}
        for name in motions
    ]
    spelt = [{**row, "warnings": "; ".join(row.get("warnings", ()))} for row in rows]
    target.mkdir(parents=True, exist_ok=True)  # nothing is in it where every motion failed
    write_text(target / _SUMMARY, summary_csv((*_COLUMNS, *_MORE), spelt))
    finish_folder(
        {"folder": target, "summary": target / _SUMMARY, "codes": codes, "seed": how.seed},
        _COLUMNS,
        rows,
        title="a code for each motion (worse direction where unknown)",
        noun="motions",
        missing=outcome.missing,
        warnings=[*outcome.warnings, *(f"{name}: {line}" for name, one in codes.items() for line in one["warnings"])],
        as_json=as_json,
    )


def _tasks(
    folder: Path, motions: dict[str, Path], task: Callable[[StoredMotion, Path], Task]
) -> tuple[dict[str, Task], dict[str, str]]:
    """Make every search, or tell why not; what suits no motion whatever is wrong with the options, and raised."""
    from motdiff.files import StoredMotion, read_motion
    from motdiff.trajectory import Trajectory

    stored: dict[str, StoredMotion] = {}
    failures: dict[str, str] = {}
    for name, path in motions.items():
        try:
            stored[name] = read_motion(path)
        except (ValueError, OSError) as error:
            reason = error.strerror if isinstance(error, OSError) else None
            failures[name] = reason or str(error).removeprefix(f"{path}: ")
    tasks: dict[str, Task] = {}
    for name, motion in stored.items():
        try:
            tasks[name] = task(motion, motions[name])
        except ValueError as error:
            failures[name] = str(error)
    if stored and not tasks:
        try:
            task(StoredMotion(Trajectory.straight(_RESOLVED_PX)), folder)
        except ValueError as error:
            if all(failures[name] == str(error) for name in stored):
                raise
    return tasks, failures


def _written(
    outcome: Outcome,
    tasks: dict[str, Task],
    how: Search,
    *,
    target: Path,
    profile: DeviceProfile | None,
    failures: dict[str, str],
) -> dict[str, dict[str, Any]]:
    """Write the codes that were found; those that the device cannot play are added to the failures."""
    from cep.files import write_code
    from cep.optimize import code_from_figures

    codes: dict[str, dict[str, Any]] = {}
    for (name,), figures in outcome.figures.items():
        if not figures:
            continue
        told, stored = code_from_figures(figures, tasks[name].described)
        if reason := unplayable(stored.code.bits, profile, stored.code.chip_ns):
            failures[name] = reason
            continue
        file = target / name / _CODE
        file.parent.mkdir(parents=True, exist_ok=True)
        write_code(file, stored)
        warnings = warnings_of(tasks[name], how, stopped=told["stopped"], baselines=told["baselines"])
        codes[name] = {"file": file, **told, "warnings": warnings}
    return codes
