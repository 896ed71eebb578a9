"""Photos of ``cep shoot``: taken one after the other, and what is said of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cep.commands.console import complain, progress

if TYPE_CHECKING:
    from cep.commands.shoot import ShootOptions
    from cep.optics.code import ShutterCode
    from cep.shutter.rig import Shot


def taken(
    options: ShootOptions, codes: list[ShutterCode], stems: list[str], *, count: int = 1
) -> tuple[list[Shot], list[Path], Path | None]:
    """Take the photos, each of which is on the disk before the next; restore the first."""
    from cep.optics.path_limits import check_resolved
    from cep.shutter.shoot import shoot as take
    from cep.shutter.shot_folder import ShotFolder

    folder = ShotFolder(options.output, stems, force=options.force)
    settings = options.settings()
    if settings.motion is not None:
        check_resolved(settings.motion, codes[0].chips)
    assert options.camera is not None
    with progress("taking photos") as tick:

        def keep(shot: Shot) -> None:
            folder.keep(shot)
            tick(len(folder.files) / len(stems), str(folder.files[-1]))

        shots = list(
            take(
                options.camera,
                codes,
                port=options.port,
                count=count,
                settings=settings,
                keep=keep,
            )
        )
    if settings.motion is None or not shots[0].counts or len(codes) > 1:
        folder.drop_restored()
        return shots, folder.files, None
    with progress("restoring") as tick:
        warnings = folder.restore(shots[0], tick)
    shots[0] = replace(shots[0], warnings=(*shots[0].warnings, *warnings))
    return shots, folder.files, folder.restored


def headline(files: list[Path], shots: list[Shot]) -> str:
    """Say what was taken, and whether it counts."""
    photos = f"{files[-1]}" if len(files) == 1 else f"{files[0]} to {files[-1].name}"
    if not shots[-1].counts:
        return f"{photos}: the last does not count"
    return f"{photos}: {shots[-1].verdict}"


def doubts(shots: list[Shot]) -> list[str]:
    """Warnings of all photos, each once; none where one does not count, which is said instead."""
    if not shots[-1].counts:
        return []
    return [*dict.fromkeys(text for shot in shots for text in shot.warnings)]


def end_unless_counted(files: list[Path], shots: list[Shot]) -> None:
    """End the command with exit code 1 where the last photo does not count."""
    if not shots[-1].counts:
        problems = "; ".join(shots[-1].record.problems)
        complain(
            f"{files[-1]} does not count: {problems}; {len(shots) - 1} photos before it count"
        )
        raise typer.Exit(1)
