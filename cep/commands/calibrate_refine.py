"""``cep calibrate --trajectory``: a calibrated path improved by coded photos of its motion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.commands.console import finish, part, progress
from cep.commands.errors import with_photo_file

if TYPE_CHECKING:
    from cep.calibration.refine import Refinement
    from cep.commands.calibrate import CalibrateOptions


def refine(
    options: CalibrateOptions,
    trajectory: Path,
    method_options: Mapping[str, Any],
    sources: list[str],
) -> None:
    """Improve a calibrated path by photos of its motion through codes."""
    images = options.images
    if not sources:
        raise ValueError("--code: needed, once for each photo")
    unused = {"method": options.method, **method_options}
    for name in [name for name, value in unused.items() if value is not None]:
        raise ValueError(f"{name}: not valid with --trajectory")
    with progress("refining the motion") as tick:
        tick(0.0, "reading the photos")
        from cep.codes.sources import code_file, load_codes
        from cep.files.images import parse_gamma
        from cep.files.shot_files import read_light
        from motdiff.estimators.coded.codes import check_codes
        from motdiff.files.outputs import claim
        from motdiff.files.trajectories import (
            StoredMotion,
            read_motion,
            stated_uncertainty_px,
            trajectory_text,
            write_motion,
        )

        parse_gamma(options.gamma)
        codes = load_codes(sources)
        check_codes([code.bits for code in codes], photos=len(images))
        target = options.output or trajectory.with_name(f"{trajectory.stem}_refined.json")
        code_files = filter(None, map(code_file, sources))
        outputs = claim([target], force=options.force, inputs=[trajectory, *images, *code_files])
        stored = read_motion(trajectory)
        stated_px = stated_uncertainty_px(stored, trajectory)
        photos = [read_light(image, gamma=options.gamma) for image in images]
        tick(0.03, "loading the search")

        from cep.calibration.refine import USUAL_UNCERTAINTY_PX, refine_motion

        try:
            refinement = refine_motion(
                [photo.pixels for photo in photos],
                codes,
                stored.trajectory,
                uncertainty_px=stated_px or USUAL_UNCERTAINTY_PX,
                progress=part(tick, 0.03, 0.99),
            )
        except ValueError as error:
            raise ValueError(with_photo_file(str(error), images)) from None
        source = {
            "method": "refined",
            "trajectory": str(trajectory),
            "images": list(map(str, images)),
            "codes": [code.bits for code in codes],
            "path_uncertainty_px": refinement.uncertainty_px,
        }
        with outputs.written(summary=trajectory_text(refinement.trajectory)) as staged:
            write_motion(staged[target], StoredMotion(refinement.trajectory, source=source))
        tick(1.0)
    motion = refinement.trajectory
    warnings = [line for photo in photos for line in photo.warnings]
    result = {
        "method": "refined",
        "trajectory": target,
        "kept": refinement.kept,
        "confidence": refinement.confidence,
        "moved_px": refinement.moved_px,
        "path_uncertainty_px": refinement.uncertainty_px,
        "given_misfit": refinement.given_misfit,
        "misfit": refinement.misfit,
        "length_px": motion.length_px,
        "extent_px": motion.extent_px,
        "direction": motion.direction,
        "seconds": refinement.seconds,
        "warnings": [*warnings, *refinement.warnings],
    }
    outcome = _outcome(refinement, given_direction=stored.trajectory.direction)
    finish(
        result,
        [
            f"{target}: {outcome}; direction {motion.direction}, error about"
            f" {refinement.uncertainty_px:.2g} px"
        ],
        as_json=options.as_json,
    )


def _outcome(refinement: Refinement, *, given_direction: str) -> str:
    """Say in words whether the given path is kept, and why."""
    if refinement.kept == "given":
        outcome = "the given path is kept, as the photos show no better one"
        if refinement.trajectory.direction != given_direction:
            outcome += ", in the order in time that they show"
        return outcome
    change = f"refined by {refinement.moved_px:.2g} px rms"
    if refinement.confidence is not None:
        return (
            f"{change}; it explains the photos better with probability {refinement.confidence:.2f}"
        )
    return (
        f"{change}; the photos' misfit fell from {refinement.given_misfit:.2f} to"
        f" {refinement.misfit:.2f} times the noise"
    )
