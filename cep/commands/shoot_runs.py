"""Photos of ``cep shoot``: taken one after the other, for themselves or for a calibration."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cep.commands.calibrate_next import optimize_command
from cep.commands.console import FAILURE, announce, finish, progress
from cep.commands.errors import with_photo_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cep.calibration.calibrate import Calibration
    from cep.calibration.closed_loop import CalibrationStep
    from cep.commands.shoot import ShootOptions
    from cep.optics.code import ShutterCode
    from cep.shutter.rig import Shot
    from cep.shutter.shot_folder import ShotFolder
    from motdiff.types import FloatArray


def take_photos(
    options: ShootOptions, codes: list[ShutterCode], stems: list[str], *, count: int = 1
) -> ShotFolder:
    """Take the photos, each of which is on the disk before the next."""
    from cep.optics.path_limits import check_resolved
    from cep.shutter.shoot import shoot
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

        shoot(options.camera, codes, port=options.port, count=count, settings=settings, keep=keep)
    folder.drop_restored()
    return folder


def end_unless_counted(folder: ShotFolder) -> None:
    """End the command with exit code 1 where the last photo does not count."""
    if not folder.counts:
        problems = "; ".join(folder.shots[-1].record.problems)
        announce(
            f"{folder.files[-1]} does not count: {problems}; {len(folder.shots) - 1} photos before"
            " it count"
        )
        raise typer.Exit(FAILURE)


def calibrate_with_set(options: ShootOptions, folder: Path) -> None:
    """Take the photos of a calibration set, and estimate the motion from them."""
    from cep.calibration.calibrate import CALIBRATION_FILES, estimate_motion
    from cep.calibration.calibration_set import read_set
    from motdiff.files.outputs import claim_folder

    codes = read_set(folder, chip_ns=options.chip_ns)
    motion_folder = options.output / "motion"
    claim_folder(motion_folder, CALIBRATION_FILES, force=options.force)
    stems = [f"P{number}" for number in range(1, len(codes) + 1)]
    photos = take_photos(options, codes, stems)
    result: dict[str, object] = {"photos": photos.files, "counts": photos.counts}
    lines = [photos.headline]
    warnings = photos.warnings
    if photos.counts:
        with _photos_named(photos), progress("estimating the motion") as tick:
            lights = [shot.light for shot in photos.shots]
            calibration = estimate_motion(lights, codes=codes, progress=tick)
            paths = calibration.save(
                motion_folder, source=_source(photos, codes), force=options.force
            )
        result |= {"trajectory": paths["trajectory.json"], "confidence": calibration.confidence}
        warnings = [*warnings, *calibration.warnings]
        about_motion, *command = _motion_lines(calibration, paths["trajectory.json"], codes)
        lines = [about_motion, *lines, *command]
    result["warnings"] = warnings
    finish(result, lines, as_json=options.as_json)
    end_unless_counted(photos)


def _source(photos: ShotFolder, codes: Sequence[ShutterCode]) -> dict[str, object]:
    """Say in a trajectory's file what it was found in."""
    return {"images": list(map(str, photos.files)), "codes": [code.bits for code in codes]}


@contextmanager
def _photos_named(photos: ShotFolder) -> Iterator[None]:
    """Name the files in whatever ends an estimate from photos: they are there."""
    try:
        yield
    except BaseException as error:  # Ctrl-C as well
        if isinstance(error, ValueError):
            error.args = (with_photo_file(str(error), photos.files),)
        if photos.files:
            error.add_note(f"photos so far: {', '.join(map(str, photos.files))}")
        raise


def _moves(calibration: Calibration) -> bool:
    return calibration.details.get("motion_blur") is not False


def _motion_lines(
    calibration: Calibration, trajectory: Path, codes: Sequence[ShutterCode]
) -> list[str]:
    """Say what motion the photos show, and the command that searches a code for it."""
    if not _moves(calibration):
        shows = "photos show" if len(codes) > 1 else "photo shows"
        return [f"The {shows} no motion blur: there is nothing to calibrate."]
    return [
        f"{trajectory.parent}: path of {calibration.best.length_px:.1f} px from"
        f" {len(codes)} photos, in this order in time with probability"
        f" {calibration.confidence:.2f}",
        f"then: {optimize_command(trajectory, codes, o='code.json')}",
    ]


def calibrate_by_shots(options: ShootOptions) -> None:
    """Take photos of one motion, each code chosen by those before, until its order is sure."""
    from cep.calibration.calibrate import CALIBRATION_FILES
    from cep.calibration.closed_loop import MOST_PHOTOS, calibrate_in_loop
    from cep.optics.path_limits import check_resolved
    from cep.search.chip_count import STANDARD_CHIPS
    from cep.shutter.shoot import open_rig
    from cep.shutter.shot_folder import ShotFolder
    from hw.cameras.camera import CameraError
    from motdiff.files.outputs import claim_folder

    stems = [f"P{number}" for number in range(1, MOST_PHOTOS + 1)]
    folder = ShotFolder(options.output, stems, force=options.force)
    motion_folder = options.output / "motion"
    claim_folder(motion_folder, CALIBRATION_FILES, force=options.force)
    settings = options.settings()
    if settings.motion is not None:
        check_resolved(settings.motion, STANDARD_CHIPS)
    assert options.camera is not None
    with progress("calibrating") as tick, open_rig(options.camera, options.port) as rig:

        def take(code: ShutterCode) -> FloatArray:
            rig.prepare(code, settings)
            (shot,) = rig.series(1, keep=folder.keep)
            if not shot.counts:
                raise CameraError(f"{folder.files[-1]} {shot.verdict}")
            return shot.light

        if rig.controller is None:
            raise ValueError(
                f"--calibrate: camera {rig.camera.name}: each photo needs the motion anew; a video"
                " has it once"
            )
        with _photos_named(folder):
            steps, trajectory = calibrate_in_loop(
                take,
                motion_folder,
                source=lambda step: _source(folder, step.codes),
                chips=STANDARD_CHIPS,
                chip_ns=options.chip_ns or 1_000_000,
                device=rig.controller.limits,
                force=options.force,
                progress=tick,
            )
    folder.drop_others()
    last = steps[-1]
    finish(
        {
            "photos": folder.files,
            "codes": [code.bits for code in last.codes],
            "sure": last.is_sure and _moves(last.calibration),
            "trajectory": trajectory,
            "confidence": last.calibration.confidence,
            "confidences": [step.calibration.confidence for step in steps],
            "warnings": [*folder.warnings, *last.calibration.warnings],
        },
        _outcome(last, trajectory),
        as_json=options.as_json,
    )


def _outcome(step: CalibrationStep, trajectory: Path) -> list[str]:
    """Say what the photos show, and what to do with it."""
    lines = _motion_lines(step.calibration, trajectory, step.codes)
    if not step.is_sure:
        return [
            lines[0],
            f"The order in time is not sure after {len(step.photos)} photos: repeat it with more"
            " light, or with a scene of more detail.",
        ]
    return lines
