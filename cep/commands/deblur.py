"""``cep deblur``: restore a photo along a trajectory, with a PSF, or from the photo alone."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import finish, part, progress
from cep.commands.options import (
    MOTION,
    CameraFile,
    Force,
    Gamma,
    Json,
    Linear,
    Photons,
    ReadNoise,
    Seed,
    TrajectoryFile,
    load_camera,
    load_motion,
    output_option,
)
from cep.restoration.registry import METHODS, find_method

if TYPE_CHECKING:
    from cep.restoration.sharpen import Sharpened


def deblur(
    image: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGE", help="Blurred photo, coded or not: PNG, TIFF, JPEG, WebP or RAW."
        ),
    ],
    trajectory: TrajectoryFile = None,
    linear: Linear = None,
    code: Annotated[
        str | None,
        typer.Option(
            "--code",
            metavar="CODE",
            help="Code of the exposure: bits, code.json or a name; the open shutter when omitted.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    psf: Annotated[
        Path | None,
        typer.Option(
            "--psf",
            metavar="FILE",
            help="Instead of --trajectory, --linear and --code: a PSF as .npy, .mat or .png.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="NAME",
            help=(
                ", ".join(f"{method.name} ({method.about})" for method in METHODS.values())
                + ", or module:name; auto is wiener, and of a photo alone what suits it."
            ),
        ),
    ] = "auto",
    gamma: Gamma = "srgb",
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    output: Annotated[
        Path | None, output_option("Restored photo; IMAGE_sharp.png when omitted.")
    ] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Restore a photo along a trajectory, with a PSF, or with neither: the PSF is then searched in
    the photo itself.

    Of an ordinary photo alone the blur is estimated, and the photo restored with what suits it; a
    photo without motion blur, or one that no restoration improves, is written as it was, and the
    first line says so.

    Along a trajectory of unknown direction the orders in time that it may have had are tested, and
    it is said which fits: forward, reverse, or reordered where loops were run the other way round.
    --linear is a straight and uniform motion along the rows. A single photo without a trajectory
    shows its PSF, but seldom the order in time; give --code for its light.

    The camera's figures are for the methods wiener and pnp.

    Example: cep deblur photo.jpg

    Example: cep deblur coded.png --trajectory trajectory.json --code code.json -o sharp.png

    Example: cep deblur coded.png --linear 40 --code code.json -o sharp.png

    Example: cep deblur coded.png --code code.json -o sharp.png
    """
    with progress("restoring") as tick:
        tick(0.0, "reading the photo")
        from cep.codes.sources import load_code
        from cep.files.images import check_image_name, parse_gamma, read_photo, write_image
        from motdiff.files.outputs import claim

        parse_gamma(gamma)
        shutter = None if code is None else load_code(code)
        target = output or image.with_name(f"{image.stem}_sharp.png")
        check_image_name(target)
        outputs = claim([target], force=force, inputs=[image])

        from cep.calibration.calibrate import check_photo, check_texture, estimate_motion
        from cep.files.files import load_psf
        from cep.optics.path_limits import check_resolved
        from cep.restoration.methods import restore

        alone = method == "auto" and all(
            one is None for one in (trajectory, linear, psf, code, camera, photons, read_noise)
        )  # what suits the photo is chosen
        method = "wiener" if method == "auto" else method
        find_method(method)
        if sum(one is not None for one in (trajectory, linear, psf)) > 1:
            raise ValueError(
                "--trajectory FILE, --linear PX and --psf FILE: give one of them at most"
            )
        if psf is not None and code is not None:
            raise ValueError("--code: not valid with --psf, whose file already holds the code")
        options = {}
        if camera is not None or photons is not None or read_noise is not None:
            using = [each.name for each in METHODS.values() if each.uses_camera]
            if method not in using:
                first = (
                    "--camera"
                    if camera is not None
                    else "--photons"
                    if photons is not None
                    else "--read-noise"
                )
                raise ValueError(
                    f"{first}: not valid with --method {method}; {_listed(using)} use the camera"
                )
            options["camera"] = load_camera(camera, photons=photons, read_noise=read_noise)
        stated = trajectory is not None or linear is not None
        motion = load_motion(trajectory, linear).trajectory if stated else None
        if motion is not None and shutter is not None:
            check_resolved(motion, shutter.chips)
        kernel, doubts = (None, ()) if psf is None else load_psf(psf)
        photo = read_photo(image, gamma=gamma)
        blind = motion is None and kernel is None
        try:
            if blind:
                check_photo(photo.pixels, "motdiff" if alone else "pmp")
            else:
                check_texture(photo.pixels)
        except ValueError as error:
            raise ValueError(f"{image}: {str(error).removeprefix('photo: ')}") from None
        tick(0.05, "searching the PSF" if blind else "restoring")
        if alone:
            from cep.restoration.sharpen import sharpen

            started = time.perf_counter()
            estimate = estimate_motion(photo.pixels, seed=seed, progress=part(tick, 0.05, 0.75))
            tick(0.75, "restoring")
            sharpened = sharpen(photo.pixels, estimate)
            with outputs.written() as made:
                write_image(made[target], sharpened.image, bits=photo.bits, gamma=gamma)
            seconds = time.perf_counter() - started
        else:
            restored = restore(
                photo.pixels,
                kernel,
                trajectory=motion,
                code=shutter,
                method=method,
                progress=part(tick, 0.05, 0.98),
                **options,
            )
            with outputs.written() as made:
                restored.save(made[target], bits=photo.bits, gamma=gamma)
        tick(1.0)
    if alone:
        _finish_alone(
            sharpened, target, seconds=seconds, seed=seed, warnings=photo.warnings, as_json=as_json
        )
        return
    direction = restored.direction or ("unknown" if blind else "given by the PSF")
    test = restored.direction_test
    result = {
        "image": target,
        "method": method,
        "psf_source": "photo" if blind else "trajectory" if psf is None else "file",
        "psf_confidence": restored.psf_confidence,
        "direction": direction,
        "direction_confidence": None if test is None else test.confidence,
        "direction_likelihoods": None if test is None else test.likelihoods,
        "residual": restored.residual,
        "unreliable_px": restored.unreliable_px,
        "seconds": restored.seconds,
        "seed": seed,
        "warnings": [*photo.warnings, *doubts, *restored.warnings],
    }
    if restored.psf_confidence is None:
        sure = "" if test is None else f" (confidence {test.confidence:.2f})"
        motion_line = f"{target}: {method}, direction {direction}{sure}"
    else:
        motion_line = (
            f"{target}: restored with the PSF found in this photo alone, which is good with"
            f" probability {restored.psf_confidence:.2f}; its order in time is not known; {method}"
        )
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{motion_line}, residual {restored.residual:.3g} of full scale; "
            f"the outer {restored.unreliable_px} px lean on a guess"
        ),
    )


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _finish_alone(
    sharpened: Sharpened,
    target: Path,
    *,
    seconds: float,
    seed: int,
    warnings: Sequence[str],
    as_json: bool,
) -> None:
    """Report a photo that was restored with what was found in it."""
    result = {
        "image": target,
        "summary": sharpened.summary,
        "kept": sharpened.kept,
        "method": sharpened.method,
        "psf_source": (
            {"psf": "photo", "trajectory": "path in the photo"}.get(sharpened.psf_source or "")
        ),
        "psf_confidence": sharpened.psf_confidence,
        "direction": "unknown",
        "direction_confidence": None,
        "direction_likelihoods": None,
        "residual": sharpened.residual,
        "unreliable_px": sharpened.unreliable_px,
        "seconds": seconds,
        "seed": seed,
        "warnings": [*warnings, *sharpened.warnings],
    }
    figures = (
        ""
        if sharpened.kept
        else (
            f"; residual {sharpened.residual:.3g} of full scale, the outer"
            f" {sharpened.unreliable_px} px lean on a guess"
        )
    )
    lines = (f"{sharpened.summary}.", f"{target}{figures}")
    finish(result, as_json=as_json, show=lambda console: console.print(*lines, sep="\n"))
