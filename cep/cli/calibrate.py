"""``cep calibrate``: a photo, or each of a folder, to the motion in it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from cep.cli.console import finish, part, progress
from cep.cli.jobs import (
    NOT_REACHED,
    Cache,
    Dask,
    Workers,
    discard,
    finish_folder,
    only_of_folders,
    run_folder,
    summary_csv,
)
from cep.cli.options import Force, Gamma, Json, Seed, output_option

if TYPE_CHECKING:
    from cep.jobs.cells import Figure, Result
    from motdiff.estimators.base import MotionEstimate

__all__ = ["calibrate", "calibrate_folder"]


_ESTIMATE = {
    "motdiff": (0.07, 0.88), "pmp": (0.07, 0.88), "reference": (0.2, 0.7), "point": (0.35, 0.55), "gyro": (0.45, 0.5),
}  # fmt: skip
"""Where in the time of the command a photo's estimate begins and ends; the preview takes most of the rest."""
_OWN_ESTIMATE = (0.2, 0.8)

_WITH_GYRO, _WITH_MOTDIFF = "With --method gyro", "With --method motdiff"


def calibrate(
    image: Annotated[
        Path, typer.Argument(metavar="IMAGE", help="Blurred photo: PNG, TIFF, JPEG, WebP or RAW; or a folder of such.")
    ],
    output: Annotated[
        Path | None, output_option("Folder to write into; IMAGE_motion when omitted.", metavar="FOLDER")
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="NAME",
            help="motdiff (blind, diffusion model), pmp (blind, classical), reference (beside a sharp photo), "
            "point (of a small light), gyro (from a recording), or module:name of an estimator of your own.",
        ),
    ] = "motdiff",
    sharp: Annotated[
        Path | None,
        typer.Option(
            "--sharp",
            metavar="PATH",
            rich_help_panel="With --method reference",
            help="A sharp photo of the same scene, needed; or a folder with one for each photo, by name.",
        ),
    ] = None,
    gyro: Annotated[
        Path | None,
        typer.Option(
            "--gyro", metavar="FILE", help="Table of time and three rates (rad/s); needed.", rich_help_panel=_WITH_GYRO
        ),
    ] = None,
    focal: Annotated[
        float | None,
        typer.Option("--focal", metavar="PX", help="Focal length, px; needed.", rich_help_panel=_WITH_GYRO),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(
            "--start",
            metavar="S",
            help="Opening of the shutter on the recording's clock, s; needed.",
            rich_help_panel=_WITH_GYRO,
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option("--exposure", metavar="S", help="Exposure time, s; needed.", rich_help_panel=_WITH_GYRO),
    ] = None,
    gyro_unit: Annotated[
        str | None,
        typer.Option(
            "--gyro-unit",
            metavar="UNIT",
            help="rad or deg, of the rates; as the header says when omitted, else rad.",
            rich_help_panel=_WITH_GYRO,
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples",
            metavar="K",
            min=1,
            rich_help_panel=_WITH_MOTDIFF,
            help="Motions to draw; 8 when omitted, more add next to nothing.",
        ),
    ] = None,
    gamma: Gamma = "srgb",
    workers: Workers = None,
    dask: Dask = None,
    cache: Cache = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Estimate the motion in one blurred photo, or in each photo of a folder.

    Writes trajectory.json, psf.npy, psf.mat, psf.png, map.png and preview.png; of a folder, into a folder for each
    photo, named like it, and motions.csv. Finished photos are kept: stopped by Ctrl-C, the same command with --force
    goes on; of a photo that fails now, --force removes earlier files.

    Example: cep calibrate blurred.jpg -o motion

    Example: cep calibrate shots -o shots_motion --workers 4
    """
    options = {
        "samples": samples, "sharp": sharp, "gyro": gyro, "focal_px": focal,
        "start_s": start, "exposure_s": exposure, "rate_unit": gyro_unit,
    }  # fmt: skip
    if image.is_dir():
        calibrate_folder(
            image, method, options, gamma=gamma, seed=seed, workers=workers, dask=dask, cache=cache, output=output,
            force=force, as_json=as_json,
        )  # fmt: skip
        return
    only_of_folders("cep calibrate FOLDER", workers, dask, cache)
    with progress(f"estimating the motion ({method})") as tick:
        tick(0.0, "reading the photo")
        from cep.io.images import parse_gamma, read_image, read_photo
        from cep.io.outputs import claim_folder
        from cep.workflows.calibrate import (
            CALIBRATION_FILES,
            check_options,
            estimate_motion,
        )
        from motdiff.io.gyro_tables import read_gyro

        check_options(method, options)
        if gyro_unit not in (None, "rad", "deg"):
            raise ValueError(f"--gyro-unit: must be rad or deg, got {gyro_unit!r}")
        parse_gamma(gamma)
        folder = output or image.with_name(f"{image.stem}_motion")
        claim_folder(folder, CALIBRATION_FILES, force=force)
        photo = read_photo(image, gamma=gamma)
        sharp_photo = None if sharp is None else read_image(sharp, gamma=gamma, variable="x")
        recording = None if gyro is None else read_gyro(gyro, rate_unit=cast(Any, gyro_unit))
        started = time.perf_counter()
        begins, ends = _ESTIMATE.get(method, _OWN_ESTIMATE)
        tick(begins, "estimating")
        try:
            found = estimate_motion(
                photo.pixels,
                method=method,
                samples=samples,
                seed=seed,
                sharp=sharp_photo,
                gyro=recording,
                focal_px=focal,
                start_s=start,
                exposure_s=exposure,
                progress=part(tick, begins, ends),
            )
        except ValueError as error:
            if str(error).partition(": ")[0] in options:  # it is an option that is wrong, not the photo
                raise
            raise ValueError(f"{image}: {error}") from None
        seconds = time.perf_counter() - started
        tick(ends, "writing")
        files = found.save(folder, source={"image": str(image), "seed": seed}, force=force)
        tick(1.0)
    motion = found.best
    result = _described(found, files, seconds=seconds, warnings=[*photo.warnings, *found.warnings])
    finish(result, as_json=as_json, show=lambda console: console.print(
        f"{folder}: path of {motion.length_px:.1f} px, {motion.extent_px:.1f} px wide, direction {motion.direction}; "
        f"confidence {found.confidence:.2f}; {found.method}, {seconds:.1f} s"
    ))  # fmt: skip


_SUMMARY = "motions.csv"
_COLUMNS = {
    "photo": "photo",
    "length_px": "long, px",
    "extent_px": "wide, px",
    "direction": "direction",
    "confidence": "confidence",
    "seconds": "s",
}
_MORE = ("method", "warnings", "failure")


def calibrate_folder(
    folder: Path,
    method: str,
    options: Mapping[str, Any],
    *,
    gamma: str,
    seed: int,
    workers: int | None,
    dask: str | None,
    cache: Path | None,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Estimate, write and print the motion in each photo, one by one; a failure is reported, the others are kept.

    Parameters
    ----------
    folder : Path
    method : str
    options : mapping
        Of the method, as of :func:`cep.workflows.calibrate.check_options`.
    gamma, seed, workers, dask, cache, output, force, as_json
        As the command's options.

    Raises
    ------
    ValueError
        If there are no photos, an output is in the way, or the options suit no folder.
    """
    with progress(f"estimating the motion ({method})") as tick:
        from cep.io.images import parse_gamma, read_image
        from cep.io.outputs import claim_folder, write_text
        from cep.jobs.cells import Cell
        from cep.workflows.calibrate import CALIBRATION_FILES, check_options
        from cep.workflows.calibrate_folder import estimate_photo, estimator_version, photos_in, sharp_of, unreadable

        check_options(method, options)
        if method == "gyro":
            raise ValueError(
                "--method gyro: --start is the opening of one photo; give the photos of a folder one by one"
            )
        parse_gamma(gamma)
        sharp = options["sharp"]
        photos = photos_in(folder, but=sharp)
        sharps = {} if sharp is None else sharp_of(photos, sharp)
        if sharp is not None and not sharp.is_dir():
            read_image(sharp, gamma=gamma, variable="x")  # what is wrong with it is wrong with every photo
        named = folder if folder.name not in ("", "..") else folder.resolve()  # as "." has no name of its own
        target = output or named.with_name(f"{named.name}_motion")
        claim_folder(target, [_SUMMARY], force=force)
        for photo in photos:
            claim_folder(target / photo.stem, CALIBRATION_FILES, force=force)
        failures = {_label(photo): reason for photo in photos if (reason := unreadable(photo))}
        by_label = {_label(photo): photo for photo in photos}
        version = estimator_version(method)
        cells = [
            Cell(
                (label,),
                estimate_photo,
                {
                    "photo": photo, "method": method, "samples": options["samples"],
                    "gamma": gamma, "seed": seed, "sharp": sharps.get(photo),
                },
                version,
            )
            for label, photo in by_label.items()
            if label not in failures
        ]  # fmt: skip
        motions: dict[str, dict[str, Any]] = {}

        def write(result: Result) -> None:
            (label,) = result.cell.name
            try:
                motions[label] = _written(
                    by_label[label], result, target / by_label[label].stem, gamma=gamma, seed=seed, force=force
                )
            except _GoneError as error:
                failures[label] = str(error)

        outcome = run_folder(
            cells,
            tick,
            noun="photos",
            cache=cache or target / "cells",
            workers=workers,
            dask=dask,
            write=write,
        )
        motions = {label: motions[label] for label in by_label if label in motions}
        failures |= {label: reason for (label,), reason in outcome.failures.items()}
        if force:
            for label in failures:
                discard(target / by_label[label].stem, CALIBRATION_FILES)
        rows = [
            {
                "photo": label,
                **motions.get(label, {}),
                "failure": failures.get(label, "" if label in motions else NOT_REACHED),
            }
            for label in by_label
        ]
        spelt = [{**row, "warnings": "; ".join(row.get("warnings", ()))} for row in rows]
        target.mkdir(parents=True, exist_ok=True)  # nothing is in it where every photo failed
        write_text(target / _SUMMARY, summary_csv((*_COLUMNS, *_MORE), spelt))
    finish_folder(
        {"folder": target, "summary": target / _SUMMARY, "method": method, "photos": motions, "seed": seed},
        _COLUMNS,
        rows,
        title="the motion in each photo",
        noun="photos",
        missing=outcome.missing,
        warnings=[
            *outcome.warnings,
            *(f"{label}: {line}" for label, one in motions.items() for line in one["warnings"]),
        ],
        as_json=as_json,
    )


class _GoneError(Exception):
    """A photo is not what it was when its motion was estimated."""


def _written(photo: Path, result: Result, folder: Path, *, gamma: str, seed: int, force: bool) -> dict[str, Any]:
    """Write what was found in a photo as ``cep calibrate PHOTO`` does, and say it for the table."""
    from cep.io.images import read_image
    from cep.workflows.calibrate import write_calibration
    from cep.workflows.calibrate_folder import estimate_from_figures

    try:
        pixels = read_image(photo, gamma=gamma)
    except (ValueError, OSError) as error:  # it was there when its motion was estimated, maybe hours ago
        raise _GoneError(f"has changed since: {error}") from None
    figures = result.finished.figures
    found, warnings = estimate_from_figures(figures)
    files = write_calibration(folder, found, pixels, source={"image": str(photo), "seed": seed}, force=force)
    return _described(found, files, seconds=figures["seconds"], warnings=warnings)


def _described(
    found: MotionEstimate, files: Mapping[str, Path], *, seconds: Figure, warnings: Sequence[str]
) -> dict[str, Any]:
    """Describe a calibration as the JSON of a photo and of a folder has it."""
    motion = found.best
    return {
        "method": found.method,
        "trajectory": files["trajectory.json"],
        "psf": files["psf.npy"],
        "length_px": motion.length_px,
        "extent_px": motion.extent_px,
        "direction": motion.direction,
        "confidence": found.confidence,
        "seconds": seconds,
        "warnings": warnings,
        "files": list(files.values()),
        "details": found.details,
    }


def _label(photo: Path) -> str:
    """Return the photo's name as it can be printed, whatever bytes it has."""
    return photo.name.encode("utf-8", "backslashreplace").decode()
