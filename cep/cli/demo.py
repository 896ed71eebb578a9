"""``cep demo``: the whole chain, to one HTML report."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.cli.console import finish, part, progress
from cep.cli.options import CameraFile, Force, Gamma, Json, Photons, ReadNoise, Seed, load_camera, output_option

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["demo"]

_CHAIN = (0.09, 0.77)  # where in the time of the command the chain begins and ends


def demo(
    output: Annotated[Path, output_option("Folder to write into.", metavar="FOLDER")] = Path("demo"),
    photo: Annotated[
        Path | None, typer.Option("--photo", metavar="FILE", help="A blurred photo of your own, instead.")
    ] = None,
    gamma: Gamma = "srgb",
    camera: CameraFile = None,
    photons: Photons = None,
    read_noise: ReadNoise = None,
    force: Force = False,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Calibrate, optimise, export, expose, restore: everything on one photo, to OUTPUT/report.html.

    The bundled photo is a public-domain picture blurred by a simulated hand shake. With --photo the motion is estimated
    from your own blurred photo, and the coded photo is simulated on its restoration.

    Example: cep demo -o demo
    """
    with progress("starting") as tick:
        tick(0.0, "loading")
        import numpy as np

        from cep.io.images import parse_gamma, read_photo
        from cep.io.outputs import claim_folder
        from cep.workflows.demo import DEMO_FILES, write_demo
        from cep.workflows.demo_chain import bundled_scene, own_photo, run_chain

        parse_gamma(gamma)
        noise = load_camera(camera, photons=photons, read_noise=read_noise)
        claim_folder(output, DEMO_FILES, force=force)
        started = time.perf_counter()
        if photo is None:
            scene = bundled_scene(noise, rng=np.random.default_rng(seed))
        else:
            taken = read_photo(photo, gamma=gamma)
            scene = own_photo(str(photo), taken.pixels, warnings=taken.warnings)
        try:
            chain = run_chain(scene, noise, seed=seed, tell=part(tick, *_CHAIN))
        except ValueError as error:
            raise ValueError(f"{scene.name}: {error}") from None
        tick(_CHAIN[1], "writing the report")
        figures = write_demo(output, chain, force=force)
        tick(1.0)
    result = {**figures, "seconds": time.perf_counter() - started}

    def show(console: Console) -> None:
        for shot in chain.shots:
            console.print(f"{shot.name:28} {shot.code.duty:5.0%} of the light, restored to {shot.psnr_db:.2f} dB")
        console.print(f"The report is {figures['report']} ({result['seconds']:.0f} s)")

    finish(result, as_json=as_json, show=show)
