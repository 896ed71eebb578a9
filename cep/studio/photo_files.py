"""Files beside a photo of the studio: what the page shows of it, and the motion found in it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cep.studio.fields import FieldError
from motdiff.estimators.base import MotionEstimate
from motdiff.files.json_files import json_text
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

PREVIEW_PX = 1600
"""Longest side of what the page shows of a photo."""


def beside(photo: Path, ending: str) -> Path:
    """Return the file ``STEM_ENDING`` beside a photo's."""
    return photo.with_name(f"{photo.stem}_{ending}")


def write_preview(photo: Path, name: str, image: FloatArray) -> None:
    """Write every n-th pixel of an image as ``STEM_NAME.jpg`` beside a photo's file.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float, linear light
        Values outside 0..1 are clipped.
    """
    from cep.files.images import encode_image
    from motdiff.files.outputs import write_bytes

    step = max(1, -(-max(image.shape[:2]) // PREVIEW_PX))
    write_bytes(beside(photo, f"{name}.jpg"), encode_image(image[::step, ::step], ".jpg"))


def write_motion(photo: Path, motion: MotionEstimate) -> None:
    """Keep what a restoration of the whole photo needs of the motion found in its part."""
    about = {name: getattr(motion, name) for name in ("confidence", "warnings", "psf_warnings")}
    about["details"] = {
        name: motion.details[name]
        for name in ("psf_confidence", "motion_blur")
        if name in motion.details
    }
    path = motion.best
    np.savez(
        beside(photo, "motion.npz"),
        psf=motion.psf,
        t=path.t,
        xy=path.xy,
        direction=np.array(path.direction),
        about=np.array(json_text(about)),
    )


def read_motion(photo: Path) -> MotionEstimate:
    """Read the motion that was found in a photo; FieldError where none was."""
    source = beside(photo, "motion.npz")
    if not source.is_file():
        raise FieldError("photo", "its motion has not been found yet")
    with np.load(source, allow_pickle=False) as arrays:
        about = json.loads(str(arrays["about"]))
        about |= {name: tuple(about[name]) for name in ("warnings", "psf_warnings")}
        path = Trajectory.from_samples(
            arrays["xy"],
            t=arrays["t"],
            direction=str(arrays["direction"]),  # type: ignore[arg-type]
        )
        return MotionEstimate("motdiff", (path,), (1.0,), arrays["psf"], **about)
