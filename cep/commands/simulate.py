"""``cep simulate``: the photo that a coded or open exposure would take."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cep.commands.console import finish, progress
from cep.commands.options import (
    CameraOptions,
    CommonOptions,
    Gamma,
    MotionOptions,
    argument,
    command,
    option,
    output_option,
)


@dataclass(frozen=True, kw_only=True)
class SimulateOptions(MotionOptions, CameraOptions, CommonOptions):
    """Options of ``cep simulate``."""

    sharp: Path = argument("SHARP", "Sharp photo of the scene: PNG, TIFF, JPEG, WebP or RAW.")
    code: str | None = option(
        "--code",
        "CODE",
        "Code of the exposure: bits, code.json or a name; the open shutter when omitted.",
    )
    gamma: Gamma = "srgb"
    output: Path | None = output_option("Photo to write; SHARP_coded.png when omitted.")


@command(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """Simulate the photo: motion, code, real borders, photon and read noise, quantisation.

    The photo is smaller than SHARP by the reach of the motion: its borders are real. The PSF is
    written beside it.

    Example: cep simulate sharp.png --trajectory trajectory.json --code code.json --photons 2000 -o
    coded.png
    """
    with progress("exposing"):
        import numpy as np

        from cep.codes.sources import load_code
        from cep.files.images import check_image_name, parse_gamma, read_photo, write_image
        from cep.files.psf_files import PSF_SUFFIXES, write_psf
        from cep.optics.capture import capture
        from cep.optics.code import ShutterCode
        from cep.optics.exposure import coded_psf
        from cep.optics.path_limits import check_resolved
        from motdiff.files.outputs import claim, new_folder
        from motdiff.psf_frame import PSF_PX

        parse_gamma(options.gamma)
        motion = options.load_motion().trajectory
        shutter = ShutterCode("1")
        kind = "open"
        if options.code is not None:
            shutter = load_code(options.code)
            kind = "coded"
        check_resolved(motion, shutter.chips)
        camera = options.load_camera()
        target = options.output or options.sharp.with_name(f"{options.sharp.stem}_{kind}.png")
        check_image_name(target)
        stem = f"{target.stem}_psf"
        names = [target.name, *(stem + suffix for suffix in PSF_SUFFIXES)]
        claim(
            [target.with_name(name) for name in names], force=options.force, inputs=[options.sharp]
        )
        # of Levin's .mat files x is the sharp image, y the blurred one
        photo = read_photo(options.sharp, gamma=options.gamma, variable="x")
        rng = np.random.default_rng(options.seed)
        coded = capture(photo.pixels, motion, shutter, camera, rng=rng)
        psf = coded_psf(motion, shutter, size=motion.frame_size(PSF_PX))
        with new_folder(target.parent, names, force=options.force) as folder:
            # 16 bits, so that the gamma curve adds no rounding to the camera's
            write_image(folder / target.name, coded, bits=16, gamma=options.gamma)
            write_psf(folder, psf, stem=stem)
    psf_file = target.with_name(names[1])
    result = {
        "image": target,
        "psf": psf_file,
        "duty": shutter.duty,
        "size_px": [coded.shape[1], coded.shape[0]],
        "camera": camera.to_dict(),
        "seed": options.seed,
        "warnings": list(photo.warnings),
    }
    line = (
        f"{target}: {coded.shape[1]} x {coded.shape[0]} px, {shutter.duty:.0%} of the light;"
        f" PSF in {psf_file}"
    )
    finish(result, [line], as_json=options.as_json)
