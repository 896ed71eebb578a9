"""``cep refine``: a calibration improved by coded photos of its motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cep.commands.console import finish, part, photo_named, progress
from cep.commands.options import Force, Gamma, Json, output_option


def refine(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="Photos of the calibrated motion, each through a known code; not all open.",
        ),
    ],
    code: Annotated[
        list[str] | None,
        typer.Option(
            "--code",
            metavar="CODE",
            help=(
                "Code of the photo: bits, code.json, a published name, or open; once for each"
                " photo, in order."
            ),
        ),
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            "--trajectory", metavar="FILE", help="The calibration, a trajectory.json; needed."
        ),
    ] = None,
    uncertainty: Annotated[
        float | None,
        typer.Option(
            "--uncertainty",
            metavar="PX",
            help=(
                "Expected error of the calibration, px rms over time; what its file says when"
                " omitted, else 1."
            ),
        ),
    ] = None,
    gamma: Gamma = "srgb",
    output: Annotated[
        Path | None,
        output_option("Trajectory to write; FILE with _refined in its name when omitted."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Improve a calibrated path by coded photos of that motion; the given path is kept where they
    show no better one.

    Two or more photos of one scene show the order in time too, and the path to a tenth of a pixel.
    From a single photo the gain is smaller, and in some photos there is none.

    Example: cep refine coded.png --code code.json --trajectory motion/trajectory.json -o
    better.json

    Example: cep refine one.png two.png --code one.json --code two.json --trajectory
    trajectory.json -o better.json
    """
    with progress("refining the motion") as tick:
        tick(0.0, "reading the photos")
        from cep.calibration.calibrate import check_times
        from cep.codes.sources import code_file, load_codes
        from cep.files.images import parse_gamma, read_photo
        from cep.files.outputs import claim
        from motdiff.estimators.coded.codes import check_codes
        from motdiff.files.trajectories import (
            StoredMotion,
            read_motion,
            stated_uncertainty_px,
            trajectory_text,
            write_motion,
        )

        parse_gamma(gamma)
        if trajectory is None:
            raise ValueError("--trajectory: needed, the calibration to be refined")
        if not code:
            raise ValueError("--code: needed, once for each photo")
        codes = load_codes(code)
        check_codes([one.bits for one in codes], photos=len(images))
        check_times(codes)
        target = output or trajectory.with_name(f"{trajectory.stem}_refined.json")
        code_files = [file for file in map(code_file, code) if file is not None]
        outputs = claim([target], force=force, inputs=[trajectory, *images, *code_files])
        stored = read_motion(trajectory)
        stated = stated_uncertainty_px(stored, trajectory)
        photos = [read_photo(one, gamma=gamma) for one in images]
        tick(0.03, "loading the search")

        from cep.calibration.refine import USUAL_UNCERTAINTY_PX, refine_motion

        usual = USUAL_UNCERTAINTY_PX if stated is None else stated
        try:
            found = refine_motion(
                [one.pixels for one in photos],
                codes,
                stored.trajectory,
                uncertainty_px=usual if uncertainty is None else uncertainty,
                progress=part(tick, 0.03, 0.99),
            )
        except ValueError as error:
            raise ValueError(photo_named(str(error), images)) from None
        source = {
            "method": "refined",
            "trajectory": str(trajectory),
            "images": [str(one) for one in images],
            "codes": [one.bits for one in codes],
            "path_uncertainty_px": found.uncertainty_px,
        }
        with outputs.written(summary=trajectory_text(found.trajectory)) as made:
            write_motion(made[target], StoredMotion(found.trajectory, source=source))
        tick(1.0)
    motion = found.trajectory
    result = {
        "method": "refined",
        "trajectory": target,
        "kept": found.kept,
        "confidence": found.confidence,
        "moved_px": found.moved_px,
        "path_uncertainty_px": found.uncertainty_px,
        "given_misfit": found.given_misfit,
        "misfit": found.misfit,
        "length_px": motion.length_px,
        "extent_px": motion.extent_px,
        "direction": motion.direction,
        "seconds": found.seconds,
        "warnings": [*(line for one in photos for line in one.warnings), *found.warnings],
    }
    if found.kept == "given":
        found_order = motion.direction != stored.trajectory.direction
        order = ", in the order in time that they show" if found_order else ""
        said = f"the given path is kept, as the photos show no better one{order}"
    elif found.confidence is not None:
        said = (
            f"refined by {found.moved_px:.2g} px rms; it explains the photos better with"
            f" probability {found.confidence:.2f}"
        )
    else:
        said = (
            f"refined by {found.moved_px:.2g} px rms; the photos' misfit fell from"
            f" {found.given_misfit:.2f} to {found.misfit:.2f} times the noise"
        )
    finish(
        result,
        as_json=as_json,
        show=lambda console: console.print(
            f"{target}: {said}; direction {motion.direction}, error about"
            f" {found.uncertainty_px:.2g} px"
        ),
    )
