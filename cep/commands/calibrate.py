"""``cep calibrate``: a photo, or each of a folder, to the motion in it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from cep.commands.code_options import exposure_seconds
from cep.commands.commands import in_options
from cep.commands.console import finish, part, photo_named, progress
from cep.commands.jobs import Cache, Dask, Workers, finish_folder, only_of_folders
from cep.commands.options import Force, Gamma, Json, Seed, TableFile, output_option, table_files

_ESTIMATE = {
    "motdiff": (0.07, 0.88),
    "pmp": (0.07, 0.88),
    "reference": (0.2, 0.7),
    "point": (0.35, 0.55),
    "gyro": (0.45, 0.5),
}
"""Where in the time of the command a photo's estimate begins and ends; the preview takes most of
the rest."""
_OWN_ESTIMATE = (0.2, 0.8)
_SEVERAL_END = 0.96

_WITH_GYRO = "With --method gyro"
_WITH_MOTDIFF = "With --method motdiff"


def calibrate(
    context: typer.Context,
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help=(
                "Blurred photo: PNG, TIFF, JPEG, WebP or RAW; several of one motion; or a folder,"
                " each by itself."
            ),
        ),
    ],
    output: Annotated[
        Path | None,
        output_option("Folder to write into; IMAGE_motion when omitted.", metavar="FOLDER"),
    ] = None,
    code: Annotated[
        list[str] | None,
        typer.Option(
            "--code",
            metavar="CODE",
            help=(
                "Code that the photo was taken through: bits, code.json, a published name, or"
                " open; once for each "
                "photo, in order. The path is then found with its order in time."
            ),
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            show_default="motdiff; coded with --code",
            help=(
                "motdiff (blind, diffusion model), pmp (blind, classical), reference (beside a"
                " sharp photo), "
                "point (of a small light; with --code in its order in time), gyro (from a"
                " recording), coded (with --code), "
                "or module:name of an estimator of your own."
            ),
        ),
    ] = None,
    sharp: Annotated[
        Path | None,
        typer.Option(
            "--sharp",
            metavar="PATH",
            rich_help_panel="With --method reference",
            help=(
                "A sharp photo of the same scene, needed; or a folder with one for each photo, by"
                " name."
            ),
        ),
    ] = None,
    gyro: Annotated[
        Path | None,
        typer.Option(
            "--gyro",
            metavar="FILE",
            help="Table of time and three rates (rad/s); needed.",
            rich_help_panel=_WITH_GYRO,
        ),
    ] = None,
    focal: Annotated[
        float | None,
        typer.Option(
            "--focal", metavar="PX", help="Focal length, px; needed.", rich_help_panel=_WITH_GYRO
        ),
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
        str | None,
        typer.Option(
            "--exposure",
            metavar="S",
            help="Exposure time: 1/20, 0.05, 50ms or 500us; needed.",
            rich_help_panel=_WITH_GYRO,
        ),
    ] = None,
    gyro_axes: Annotated[
        str | None,
        typer.Option(
            "--gyro-axes",
            metavar="X,Y,Z",
            show_default="right,down,forward, as a camera's",
            help=(
                "Directions of the recording's x, y and z axes, seen from behind the camera with"
                " the photo upright: "
                "right, left, up, down, forward or back. A phone held upright: right,up,back;"
                " sideways, its top to the "
                "left: up,left,back, to the right: down,right,back. Wrong axes mirror or turn the"
                " path."
            ),
            rich_help_panel=_WITH_GYRO,
        ),
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
    tables: TableFile = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Estimate the motion in one blurred photo, in each photo of a folder, or in several photos of
    one motion.

    A photo with an open shutter shows the path, but neither its order nor its direction in time.
    Several, of any scenes, show it more surely: motdiff and pmp search them together, and say how
    repeatable the motion is. Photos of the same motion through known codes (one may be open; cep
    calibration-set designs them) show its order.

    Writes trajectory.json, psf.npy, psf.mat, psf.png, map.png, preview.png and sharpened.png, the
    photo restored; of a folder, into a folder for each photo, named like it, and motions.csv.
    Finished photos are kept: stopped by Ctrl-C, the same command with --force goes on; of a photo
    that fails now, --force removes earlier files.

    Example: cep calibrate blurred.jpg -o motion

    Example: cep calibrate shots -o shots_motion --workers 4

    Example: cep calibrate run1.png run2.png run3.png -o motion

    Example: cep calibrate open.png coded.png --code open --code code.json -o motion

    Example: cep calibrate light.png --method point --code code.json -o motion
    """
    method = method or ("coded" if code else "motdiff")
    exposure_s = exposure_seconds(exposure)
    options = {
        "samples": samples,
        "sharp": sharp,
        "gyro": gyro,
        "focal_px": focal,
        "start_s": start,
        "exposure_s": exposure_s,
        "axes": gyro_axes,
        "rate_unit": gyro_unit,
        "codes": code,
    }
    image = images[0]
    if len(images) > 1 and not code and any(one.is_dir() for one in images):
        raise ValueError(
            "IMAGE: several are photos of one motion; give the photos, or one folder alone"
        )
    if code and any(one.is_dir() for one in images):
        raise ValueError("--code: is for photos of one motion; give the photos, not a folder")
    if image.is_dir():
        _calibrate_folder(
            image,
            method,
            options,
            gamma=gamma,
            seed=seed,
            workers=workers,
            dask=dask,
            cache=cache,
            output=output,
            tables=tables,
            force=force,
            as_json=as_json,
        )
        return
    only_of_folders("cep calibrate FOLDER", workers, dask, cache)
    if tables is not None:
        raise ValueError("--table: is for a folder (cep calibrate FOLDER), here is a single one")
    with progress(f"estimating the motion ({method})") as tick:
        tick(0.0, "reading the photo")
        from cep.calibration.calibrate import (
            CALIBRATION_FILES,
            check_options,
            check_several,
            check_times,
            estimate_motion,
        )
        from cep.calibration.calibrate_folder import describe_motion
        from cep.codes.sources import load_codes
        from cep.files.images import parse_gamma, read_image, read_photo
        from cep.files.outputs import claim_folder, summary_on_failure
        from motdiff.estimators.coded.codes import check_codes
        from motdiff.files.gyro_tables import read_gyro
        from motdiff.files.trajectories import trajectory_text

        check_options(method, options)
        if len(images) > 1 and not code:
            check_several(method)
        codes = load_codes(code) if code else None
        if codes is not None:
            check_codes([one.bits for one in codes], photos=len(images))
            check_times(codes)
        if gyro_unit not in (None, "rad", "deg"):
            raise ValueError(f"--gyro-unit: must be rad or deg, got {gyro_unit!r}")
        parse_gamma(gamma)
        folder = output or image.with_name(f"{image.stem}_motion")
        claim_folder(folder, CALIBRATION_FILES, force=force)
        photos = [read_photo(one, gamma=gamma) for one in images]
        sharp_photo = None if sharp is None else read_image(sharp, gamma=gamma, variable="x")
        recording = None if gyro is None else read_gyro(gyro, rate_unit=cast(Any, gyro_unit))
        started = time.perf_counter()
        begins, ends = _OWN_ESTIMATE if codes is not None else _ESTIMATE.get(method, _OWN_ESTIMATE)
        if len(images) > 1 and codes is None:
            ends = _SEVERAL_END
        tick(begins, "estimating")
        try:
            found = estimate_motion(
                [one.pixels for one in photos] if codes or len(photos) > 1 else photos[0].pixels,
                method=method,
                samples=samples,
                seed=seed,
                sharp=sharp_photo,
                gyro=recording,
                focal_px=focal,
                start_s=start,
                exposure_s=exposure_s,
                axes=gyro_axes,
                codes=codes,
                progress=part(tick, begins, ends),
            )
        except ValueError as error:
            if (
                str(error).partition(": ")[0] in options
            ):  # it is an option that is wrong, not the photo
                raise
            if len(images) > 1:
                raise ValueError(photo_named(str(error), images)) from None
            raise ValueError(f"{image}: {str(error).removeprefix('photo: ')}") from None
        seconds = time.perf_counter() - started
        tick(ends, "writing")
        source = {"image": str(image), "seed": seed}
        if codes is not None or len(images) > 1:
            source |= {"images": [str(one) for one in images]}
        if codes is not None:
            source |= {"codes": [one.bits for one in codes]}
        with summary_on_failure(trajectory_text(found.best)):
            files = found.save(
                folder, source=source, force=force, bits=min(photos[0].bits, 16), gamma=gamma
            )
        tick(1.0)
    motion = found.best
    warnings = [in_options(line, context) for line in found.warnings]
    result = describe_motion(
        found,
        files,
        seconds=seconds,
        warnings=[*(line for one in photos for line in one.warnings), *warnings],
    )
    sure = f"direction {motion.direction}; confidence {found.confidence:.2f}"
    still = found.details.get("motion_blur", True) is False
    if codes is not None and not still:
        sure = (
            f"in this order in time with probability {found.confidence:.2f}, and then exact to "
            f"{result['path_uncertainty_px']:.2g} px"
        )
    lines = [f"{found.warnings[0]}."] if still else _repeatability(motion.length_px, found.details)
    lines.append(
        f"{folder}: path of {motion.length_px:.1f} px, {motion.extent_px:.1f} px wide, {sure}; "
        f"{found.method}, {seconds:.1f} s"
    )
    if gyro is not None:
        lines.append(f"{gyro}: {found.details['columns']}; axes: {found.details['axes']}")
    finish(result, as_json=as_json, show=lambda console: console.print(*lines, sep="\n"))


def _repeatability(length_px: float, details: Mapping[str, Any]) -> list[str]:
    """Say how alike several photos of one motion show it; nothing of one photo."""
    if "seen_in" not in details:
        return []
    seen = details["seen_in"]
    photos = details["photos"]
    if seen < 2:
        alone = f"no two of {photos} photos alone show it alike"
        return [f"One motion of {length_px:.0f} px; {alone}: whether it repeats is not known."]
    squares = sum(distance**2 for distance in details["repeatability_px"] if distance is not None)
    apart_px = (
        squares / (seen - 1)
    ) ** 0.5  # one of the paths may be the one that they are compared with
    return [
        f"One motion of {length_px:.0f} px, seen alike in {seen} of {photos} photos: their paths"
        f" differ by {apart_px:.2g} px."
    ]


_COLUMNS = {
    "photo": "photo",
    "length_px": "long, px",
    "extent_px": "wide, px",
    "direction": "direction",
    "confidence": "confidence",
    "seconds": "s",
}
"""Heads of the table of a folder."""


def _calibrate_folder(
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
    tables: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    with progress(f"estimating the motion ({method})") as tick:
        from cep.calibration.calibrate import check_options
        from cep.calibration.calibrate_folder import calibrate_folder
        from cep.files.outputs import claim

        check_options(method, options)
        outputs = claim(table_files(tables), force=force)
        found = calibrate_folder(
            folder,
            output,
            method=method,
            samples=options["samples"],
            sharp=options["sharp"],
            gamma=gamma,
            seed=seed,
            cache=cache,
            workers=workers,
            dask=dask,
            force=force,
            progress=tick,
        )
    finish_folder(
        {
            "folder": found.folder,
            "summary": found.summary,
            "method": method,
            "photos": found.found,
            "seed": seed,
        },
        _COLUMNS,
        found,
        title="the motion in each photo",
        noun="photos",
        as_json=as_json,
        outputs=outputs,
        tables=tables,
    )
