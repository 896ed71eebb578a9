"""``cep demo``: the whole chain, to one HTML report."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.code_options import Device, Exposure, exposure_seconds
from cep.commands.console import finish, part, progress
from cep.commands.options import (
    CameraFile,
    Force,
    Gamma,
    Json,
    Photons,
    ReadNoise,
    Seed,
    load_camera,
    output_option,
)

if TYPE_CHECKING:
    from rich.console import Console

_CHAIN = (0.09, 0.85)  # where in the time of the command the chain begins and ends


def demo(
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path(
        "demo"
    ),
    photo: Annotated[
        Path | None,
        typer.Option("--photo", metavar="FILE", help="A blurred photo of your own, instead."),
    ] = None,
    gamma: Gamma = "srgb",
    exposure: Exposure = None,
    chips: Annotated[
        int | None,
        typer.Option(
            "--chips",
            "-n",
            metavar="N",
            min=2,
            help=(
                "Number of chips; one for each px of the path when omitted, with --device as many"
                " as pay."
            ),
        ),
    ] = None,
    device: Device = None,
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Say whether to code an exposure, and show it: everything on one photo, to
    OUTPUT/report.html.

    The bundled photo is a public-domain picture blurred by a simulated hand shake, and taken with
    8-bit video when no camera is named. With --photo the motion is estimated from your own blurred
    photo, and what other exposures would have taken is simulated on its restoration. A code is
    written only where no plainer exposure is as good.

    Fields of --json that need a word:

    - choice, gains_db: as of cep advise, expected.
    - psnr_db: of the simulated and restored photos; snapshot is the best single exposure, coded
      the best code.
    - bits: of the code, or null where none is advised.

    Example: cep demo -o demo

    Example: cep demo --camera sony-imx250 --exposure 1/50
    """
    with progress("starting") as tick:
        tick(0.0, "loading")
        import numpy as np

        from cep.files.images import parse_gamma, read_photo
        from cep.report.demo import DEMO_FILES, write_demo
        from cep.report.demo_chain import EXPOSURE_S, STANDARD_CAMERA, run_chain
        from cep.report.demo_scene import bundled_scene, own_photo
        from hw.device import load_profile
        from motdiff.files.outputs import claim_folder

        parse_gamma(gamma)
        if camera is None and photo is None:
            camera = STANDARD_CAMERA
        seen_by = load_camera(camera, photons=photons, read_noise=read_noise)
        exposure_s = exposure_seconds(exposure) or EXPOSURE_S
        profile = None if device is None else load_profile(device)
        claim_folder(output, DEMO_FILES, force=force)
        started = time.perf_counter()
        if photo is None:
            scene = bundled_scene(seen_by, rng=np.random.default_rng(seed))
        else:
            taken = read_photo(photo, gamma=gamma)
            unnamed = (_UNNAMED,) if camera is None else ()
            scene = own_photo(str(photo), taken.pixels, warnings=(*taken.warnings, *unnamed))
        chain = run_chain(
            scene,
            seen_by,
            exposure_s=exposure_s,
            device=profile,
            chips=chips,
            seed=seed,
            tell=part(tick, *_CHAIN),
        )
        tick(_CHAIN[1], "writing the report")
        figures = write_demo(
            output, chain, options=_options(camera, photons, read_noise, device), force=force
        )
        tick(1.0)
    result = {**figures, "seconds": time.perf_counter() - started}

    def show(console: Console) -> None:
        console.print(chain.advice.here.sentence)
        for shot in chain.shots:
            console.print(
                f"{shot.kind:9} {shot.way.code.duty:5.0%} of the light, restored to"
                f" {shot.psnr_db:.2f} dB"
            )
        console.print(f"The report is {figures['report']} ({result['seconds']:.0f} s)")

    finish(result, as_json=as_json, show=show)


_UNNAMED = (
    "No camera was named (--camera): the figures are those of a camera with 10,000 photo-electrons"
    " at full scale and 5 e⁻ of read noise. Yours may be another case."
)


def _options(
    camera: str | None, photons: float | None, read_noise: float | None, device: str | None
) -> str:
    """Say on a command line what was said on this one of the camera and the device."""
    import shlex

    given = {
        "--device": device,
        "--camera": camera,
        "--photons": photons,
        "--read-noise": read_noise,
    }
    texts = {
        name: value if isinstance(value, str) else f"{value:g}"
        for name, value in given.items()
        if value is not None
    }
    return shlex.join(part for item in texts.items() for part in item)
