"""``cep calibrate``: a photo, or each of a folder, to the motion in it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from cep.cli.bench_options import Cache, Dask, Workers
from cep.cli.calibrate_folder import calibrate_folder
from cep.cli.console import finish, progress
from cep.cli.folders import only_of_folders
from cep.cli.options import Force, Gamma, Json, Seed, output_option

__all__ = ["calibrate"]

_WITH_GYRO, _WITH_MOTDIFF = "With --method gyro", "With --method motdiff"


def calibrate(
    image: Annotated[
        Path, typer.Argument(metavar="IMAGE", help="Blurred photo: PNG, TIFF, JPEG or RAW; or a folder of such.")
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
            "point (of a small light), or gyro (from a recording).",
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
    quick: Annotated[
        bool,
        typer.Option("--quick", help="In three quarters of the time, less exact.", rich_help_panel=_WITH_MOTDIFF),
    ] = False,
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
    from cep.calibrate import CALIBRATION_FILES, check_options, check_texture, make_estimator, write_calibration
    from cep.images import parse_gamma, read_image, read_photo
    from cep.outputs import claim_folder
    from motdiff.gyro_tables import read_gyro

    options = {
        "samples": samples, "quick": quick or None, "sharp": sharp, "gyro": gyro, "focal_px": focal,
        "start_s": start, "exposure_s": exposure, "rate_unit": gyro_unit,
    }  # fmt: skip
    if image.is_dir():
        calibrate_folder(
            image, method, options, gamma=gamma, seed=seed, workers=workers, dask=dask, cache=cache, output=output,
            force=force, as_json=as_json,
        )  # fmt: skip
        return
    only_of_folders("cep calibrate FOLDER", workers, dask, cache)
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
    try:
        check_texture(photo.pixels)  # before anything slow is loaded
        with progress(f"estimating the motion ({method})") as tick:
            estimator = make_estimator(
                method,
                samples=samples,
                quick=quick or None,
                seed=seed,
                sharp=sharp_photo,
                gyro=recording,
                focal_px=focal,
                start_s=start,
                exposure_s=exposure,
                progress=tick,
            )
            found = estimator.estimate(photo.pixels)
    except ValueError as error:
        if str(error).partition(": ")[0] in options:  # it is an option that is wrong, not the photo
            raise
        raise ValueError(f"{image}: {error}") from None
    seconds = time.perf_counter() - started
    files = write_calibration(folder, found, photo.pixels, source={"image": str(image), "seed": seed}, force=force)
    motion = found.trajectories[0]
    warnings = [*photo.warnings, *found.warnings]
    result = {
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
    finish(result, as_json=as_json, show=lambda console: console.print(
        f"{folder}: path of {motion.length_px:.1f} px, {motion.extent_px:.1f} px wide, direction {motion.direction}; "
        f"confidence {found.confidence:.2f}; {found.method}, {seconds:.1f} s"
    ))  # fmt: skip
