"""The shutter code for each motion of a folder: ``cep optimize --each FOLDER``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cep.files.files import write_code
from cep.jobs.cells import Cell, Figure
from cep.jobs.engine import Engine
from cep.jobs.fingerprint import source_version
from cep.jobs.folders import FolderResults, NotWrittenError, is_spelled, run_folder
from cep.search.optimize import Search, code_from_figures, optimize_motion
from cep.search.playable import unplayable
from cep.search.search_options import Task
from hw.device import DeviceProfile
from motdiff.files.outputs import claim_folder, new_files
from motdiff.files.trajectories import StoredMotion, read_motion
from motdiff.trajectory import LONGEST_PX, Trajectory

_SUMMARY = "codes.csv"
_CODE = "code.json"
_MOTION = "trajectory.json"
_COLUMNS = ("motion", "open", "min_mtf", "min_chip", "noise_gain_db", "mse_db", "seconds")
_MORE = (
    "chips",
    "duty",
    "bound",
    "gap",
    "steps",
    "stopped",
    "proven",
    "bits",
    "warnings",
    "failure",
)
_RESOLVED_PX = LONGEST_PX  # tells apart as many chips as can be told apart at all


def optimize_folder(
    folder: Path,
    task: Callable[[StoredMotion, Path], Task],
    how: Search,
    output: Path | None = None,
    *,
    figures: Sequence[str] = (),
    profile: DeviceProfile | None = None,
    cache: Path | None = None,
    workers: int | None = None,
    dask: str | None = None,
    force: bool = False,
    progress: Callable[[float, str], None] = lambda _fraction, _note: None,
) -> FolderResults:
    """Search and write a code for each motion, one by one; one that fails costs no other.

    Parameters
    ----------
    folder : Path
        As ``cep calibrate FOLDER`` writes it.
    task : callable
        Makes the search along a motion from a file.
    how : Search
    output : Path, optional
        Folder to write into, with a folder for each motion and ``codes.csv``; ``folder`` when
        omitted.
    figures : sequence of str
        Figures of merit of the user's own, each ``module:name``.
    profile : DeviceProfile, optional
        That must be able to play every code.
    cache : Path, optional
        Folder of finished codes; ``cells`` in the output when omitted.
    workers : int, optional
        Processes; as many as cores when omitted.
    dask : str, optional
        Scheduler of a cluster to run on.
    force : bool
        Whether existing files may be replaced.
    progress : callable, optional
        Called with the fraction done and a note.

    Returns
    -------
    FolderResults
        After Ctrl-C with the codes finished until then.

    Raises
    ------
    ValueError
        If there are no motions, a file is in the way, or the options suit none of them.
    """
    motions = motions_in(folder)
    tasks, failures = _tasks(
        folder, motions, task
    )  # first: it tells what is wrong with the options
    target = output or folder
    claim_folder(target, [_SUMMARY], force=force)
    for name in motions:
        claim_folder(target / name, [_CODE], force=force)
    version = source_version(
        ["cep.search.optimize", *(name.partition(":")[0] for name in figures)]
    )
    own = {"figures": list(figures)} if figures else {}
    cells = [
        Cell(
            (name,),
            optimize_motion,
            {"problem": one.problem, "along": one.along, "how": how, **own},
            version,
        )
        for name, one in tasks.items()
    ]

    def write(name: str, measured: Mapping[str, Figure]) -> dict[str, Any]:
        described, stored = code_from_figures(measured, tasks[name].described)
        if reason := unplayable(stored.code.bits, profile, stored.code.chip_ns):
            raise NotWrittenError(reason)
        file = target / name / _CODE
        file.parent.mkdir(parents=True, exist_ok=True)
        with new_files([file], force=force) as made:
            write_code(made[file], stored)
        return {"file": file, **described}

    return run_folder(
        target,
        {name: target / name for name in motions},
        cells,
        noun="codes",
        files=[_CODE],
        summary=_SUMMARY,
        columns=(*_COLUMNS, *figures, *_MORE),
        failures=failures,
        write=write,
        engine=Engine.of(target, cache=cache, workers=workers, dask=dask),
        force=force,
        progress=progress,
    )


def motions_in(folder: Path | str) -> dict[str, Path]:
    """List the motions that ``cep calibrate FOLDER`` wrote, ``FOLDER/NAME/trajectory.json``, by
    name, sorted.

    Raises
    ------
    ValueError
        If there is no such folder, or it holds no motions.
    """
    root = Path(folder)
    if not root.is_dir():
        raise ValueError(
            f"{root}:"
            f" {'is a file, a folder of motions is needed' if root.exists() else 'no such folder'}"
        )
    found = {
        path.parent.name: path for path in sorted(root.glob(f"*/{_MOTION}")) if not path.is_dir()
    }
    if not found:
        single = root / _MOTION
        hint = f"; for a single motion give --trajectory {single}" if single.is_file() else ""
        raise ValueError(
            f"{root}: holds no */{_MOTION}, as cep calibrate FOLDER writes them{hint}"
        )
    if odd := [name for name in found if not is_spelled(name)]:
        raise ValueError(f"{root}: the name {odd[0]!a} is no UTF-8, rename it")
    return found


def _tasks(
    folder: Path, motions: dict[str, Path], task: Callable[[StoredMotion, Path], Task]
) -> tuple[dict[str, Task], dict[str, str]]:
    """Make every search, or tell why not; what suits no motion whatever is wrong with the options,
    and raised.
    """
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
