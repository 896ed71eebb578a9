"""``cep demo``: the whole chain, to one HTML report."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from cep.commands.code_options import STANDARD_CHIPS_HELP, Device, ExposureTime, exposure_seconds
from cep.commands.console import finish, part, progress
from cep.commands.options import (
    CameraOptions,
    CommonOptions,
    Gamma,
    command,
    option,
    output_option,
)

_UNNAMED = (
    "No camera was named (--camera): the figures are those of a camera with 10,000 photo-electrons"
    " at full scale and 5 e⁻ of read noise. Yours may be another case."
)
_CHAIN = (0.09, 0.85)  # where in the time of the command the chain begins and ends


@dataclass(frozen=True, kw_only=True)
class DemoOptions(CameraOptions, CommonOptions):
    """Options of ``cep demo``."""

    output: Path = output_option("Folder to write into.", Path("demo"), metavar="FOLDER")
    photo: Path | None = option("--photo", "FILE", "A blurred photo of your own, instead.")
    gamma: Gamma = "srgb"
    exposure: ExposureTime = None
    chips: int | None = option("--chips", "N", STANDARD_CHIPS_HELP, short="-n", min=2)
    device: Device = None


@command(DemoOptions)
def demo(options: DemoOptions) -> None:
    """Say whether to code an exposure, and show it on one photo, to OUTPUT/report.html.

    The bundled photo is a public-domain picture blurred by a simulated hand shake, and taken with
    8-bit video when no camera is named. With --photo your own blurred photo is sharpened first;
    what other exposures along its motion would have taken is simulated on its restoration. A code
    is written only where no plainer exposure is as good.

    Fields of --json that need a word:

    - choice, gains_db: as of cep advise, expected.
    - sharpened: what was done with your own photo; sharpened.png where it was restored.
    - psnr_db: of the simulated and restored photos; snapshot is the best single exposure, coded
      the best code.
    - bits: of the code, or null where none is advised.

    Example: cep demo -o demo

    Example: cep demo --camera sony-imx250 --exposure 1/50
    """
    with progress("starting") as tick:
        tick(0.0, "loading")
        import shlex

        import numpy as np

        from cep.files.formatting import option_words
        from cep.files.images import parse_gamma, read_photo
        from cep.report.chain import EXPOSURE_S, STANDARD_CAMERA, run_chain
        from cep.report.page import DEMO_FILES, write_demo
        from cep.report.scene import Scene, bundled_scene
        from hw.device import load_profile
        from motdiff.files.outputs import claim_folder

        parse_gamma(options.gamma)
        if options.camera is None and options.photo is None:
            # the bundled case is to show a code that pays; a photo of one's own is not
            options = replace(options, camera=STANDARD_CAMERA)
        camera = options.load_camera()
        exposure_s = exposure_seconds(options.exposure) or EXPOSURE_S
        profile = None
        if options.device is not None:
            profile = load_profile(options.device)
        claim_folder(options.output, DEMO_FILES, force=options.force)
        started = time.perf_counter()
        if options.photo is None:
            scene = bundled_scene(camera, rng=np.random.default_rng(options.seed))
        else:
            photo = read_photo(options.photo, gamma=options.gamma)
            warnings = photo.warnings
            if options.camera is None:
                warnings += (_UNNAMED,)
            scene = Scene(str(options.photo), photo.pixels, warnings=warnings)
        chain = run_chain(
            scene,
            camera,
            exposure_s=exposure_s,
            device=profile,
            chips=options.chips,
            seed=options.seed,
            progress=part(tick, *_CHAIN),
        )
        tick(_CHAIN[1], "writing the report")
        camera_options = {
            "--device": options.device,
            "--camera": options.camera,
            "--photons": options.photons,
            "--read-noise": options.read_noise,
        }
        figures = write_demo(
            options.output,
            chain,
            options=shlex.join(option_words(camera_options)),
            force=options.force,
        )
        tick(1.0)
    seconds = time.perf_counter() - started
    shots = [
        f"{shot.kind:9} {shot.exposure.code.duty:5.0%} of the light, restored to"
        f" {shot.psnr_db:.2f} dB"
        for shot in chain.shots
    ]
    photo_lines = []
    if chain.sharpened is not None:
        photo_lines = [f"{chain.sharpened.summary}."]
        if not chain.sharpened.kept:
            photo_lines.append(f"{options.output / 'sharpened.png'}")
    finish(
        {**figures, "seconds": seconds},
        [
            *photo_lines,
            chain.verdict,
            *shots,
            f"The report is {figures['report']} ({seconds:.0f} s)",
        ],
        as_json=options.as_json,
    )
