"""``cep simulate``: the photo that a coded or open exposure would take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cep.commands.console import finish, progress
from cep.commands.options import (
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


def simulate(
    sharp: Annotated[
        Path,
        typer.Argument(
            metavar="SHARP", help="Sharp photo of the scene: PNG, TIFF, JPEG, WebP or RAW."
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
        ),
    ] = None,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    gamma: Gamma = "srgb",
    output: Annotated[
        Path | None, output_option("Photo to write; SHARP_coded.png when omitted.")
    ] = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Simulate the photo: motion, code, real borders, photon and read noise, quantisation.

    The photo is smaller than SHARP by the reach of the motion: its borders are real. The PSF is
    written beside it.

    Example: cep simulate sharp.png --trajectory trajectory.json --code code.json --photons 2000 -o
    coded.png
    """
    with progress("exposing"):
        import numpy as np

        from cep.codes.sources import load_code
        from cep.files.files import PSF_SUFFIXES, write_psf
        from cep.files.images import check_image_name, parse_gamma, read_photo, write_image
        from cep.files.outputs import claim, new_folder
        from cep.optics.capture import capture
        from cep.optics.code import ShutterCode
        from cep.optics.exposure import coded_psf
        from cep.optics.path_limits import check_resolved
        from motdiff.psf_frame import PSF_PX

        parse_gamma(gamma)
        motion = load_motion(trajectory, linear).trajectory
        shutter = ShutterCode("1") if code is None else load_code(code)
        check_resolved(motion, shutter.chips)
        noise = load_camera(camera, photons=photons, read_noise=read_noise)
        target = output or sharp.with_name(
            f"{sharp.stem}_{'open' if code is None else 'coded'}.png"
        )
        check_image_name(target)
        stem = f"{target.stem}_psf"
        names = [target.name, *(stem + suffix for suffix in PSF_SUFFIXES)]
        claim([target.with_name(name) for name in names], force=force, inputs=[sharp])
        photo = read_photo(sharp, gamma=gamma, variable="x")
        taken = capture(photo.pixels, motion, shutter, noise, rng=np.random.default_rng(seed))
        psf = coded_psf(motion, shutter, size=motion.frame_size(PSF_PX))
        with new_folder(target.parent, names, force=force) as made:
            write_image(made / target.name, taken, bits=16, gamma=gamma)
            write_psf(made, psf, stem=stem)
    psf_file = target.with_name(names[1])
    result = {
        "image": target,
        "psf": psf_file,
        "duty": shutter.duty,
        "size_px": [taken.shape[1], taken.shape[0]],
        "camera": noise.to_dict(),
        "seed": seed,
        "warnings": list(photo.warnings),
    }
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{target}: {taken.shape[1]} x {taken.shape[0]} px, {shutter.duty:.0%} of the light;"
            f" PSF in {psf_file}"
        ),
    )
