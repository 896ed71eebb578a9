"""``cep deblur``: restore a photo along a trajectory or with a PSF."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from cep.cli.console import finish, progress
from cep.cli.options import (
    MOTION,
    CameraFile,
    Force,
    Gamma,
    Json,
    Photons,
    ReadNoise,
    Seed,
    TrajectoryFile,
    load_camera,
    load_code,
    load_motion,
    output_option,
)

__all__ = ["deblur"]

_FULL_LIGHT = 1.001  # 1, but for rounding


def deblur(
    image: Annotated[
        Path, typer.Argument(metavar="IMAGE", help="Blurred photo, coded or not: PNG, TIFF, JPEG or RAW.")
    ],
    trajectory: TrajectoryFile = None,
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
            help="Instead of --trajectory and --code: a PSF as .npy, .mat or .png.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option("--method", metavar="NAME", help="wiener, inverse, tv, l0, tv-ring, or pnp (a trained denoiser)."),
    ] = "wiener",
    gamma: Gamma = "srgb",
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    output: Annotated[Path | None, output_option("Restored photo; IMAGE_sharp.png when omitted.")] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Restore a photo; when the direction of the motion is unknown both are tried, and it is said which fits.

    The camera's figures are for the methods wiener and pnp.

    Example: cep deblur coded.png --trajectory trajectory.json --code code.json -o sharp.png
    """
    from cep.io.images import check_image_name, parse_gamma, read_photo, write_image
    from cep.io.outputs import claim
    from cep.optics.code import ShutterCode

    parse_gamma(gamma)
    shutter = ShutterCode("1") if code is None else load_code(code).code
    target = output or image.with_name(f"{image.stem}_sharp.png")
    check_image_name(target)
    claim([target], force=force, inputs=[image])

    from cep.io.files import read_psf
    from cep.optics.exposure import coded_psf
    from cep.restoration import METHODS, restore
    from cep.restoration.direction import detect_direction
    from cep.restoration.spectral import trimmed_psf
    from cep.workflows.calibrate import check_texture
    from cep.workflows.compare import check_resolved
    from motdiff.psf_frame import PSF_PX

    if method not in METHODS:
        raise ValueError(f"--method: must be one of {', '.join(METHODS)}, got {method!r}")
    if (trajectory is None) == (psf is None):
        raise ValueError("--trajectory FILE or --psf FILE: exactly one of them is needed")
    if psf is not None and code is not None:
        raise ValueError("--code: goes with --trajectory; a --psf file already holds the code")
    options = {}
    if camera is not None or photons is not None or read_noise is not None:
        if method not in ("wiener", "pnp"):
            first = "--camera" if camera is not None else "--photons" if photons is not None else "--read-noise"
            raise ValueError(f"{first}: not valid with --method {method}; wiener and pnp use the camera")
        options["camera"] = load_camera(camera, photons=photons, read_noise=read_noise)
    motion = None if trajectory is None else load_motion(trajectory, None).trajectory
    if motion is not None:
        check_resolved(motion, shutter.chips)
    kernel = None if psf is None else read_psf(psf)
    photo = read_photo(image, gamma=gamma)
    try:
        check_texture(photo.pixels)
    except ValueError as error:
        raise ValueError(f"{image}: {error}") from None
    side = min(photo.pixels.shape[:2])
    if motion is not None:
        reach = motion.frame_size()
    else:
        assert kernel is not None
        reach = len(trimmed_psf(kernel))
    if reach > side:
        raise ValueError(
            f"{trajectory or psf}: the motion spans {reach} px around its zero, "
            f"the photo {image} is only {side} px on its shorter side"
        )
    direction, test = "given by the PSF", None
    started = time.perf_counter()
    with progress("restoring"):
        if motion is not None:
            kernel = coded_psf(motion, shutter, size=motion.frame_size(PSF_PX))
            direction = motion.direction
            if motion.direction == "unknown" and code is not None:
                test = detect_direction(photo.pixels, motion, shutter)
                direction, kernel = test.direction, test.psf
        assert kernel is not None
        restored = restore(photo.pixels, kernel, method=method, **options)
    write_image(target, restored.image, bits=photo.bits, gamma=gamma)
    warnings = [*photo.warnings, *restored.warnings]
    if psf is not None and kernel.sum() > _FULL_LIGHT:
        warnings.append(
            f"{psf}: the PSF sums to {kernel.sum():.4g}, a light-true one to the open share of the exposure, "
            "at most 1; the photo comes out darker by that factor"
        )
    if direction == "undecidable":
        warnings.append("the photo does not tell the direction of the motion; forward was taken")
    result = {
        "image": target,
        "method": method,
        "direction": direction,
        "direction_confidence": None if test is None else test.confidence,
        "direction_likelihoods": None if test is None else test.likelihoods,
        "residual": restored.residual,
        "unreliable_px": restored.unreliable_px,
        "seconds": time.perf_counter() - started,
        "seed": seed,
        "warnings": warnings,
    }
    sure = "" if test is None else f" (confidence {test.confidence:.2f})"
    finish(result, as_json=as_json, show=lambda console: console.print(
        f"{target}: {method}, direction {direction}{sure}, residual {restored.residual:.3g} of full scale; "
        f"the outer {restored.unreliable_px} px lean on a guess"
    ))  # fmt: skip
