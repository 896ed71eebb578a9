"""The user's own photo, sharpened: restored with what suits it of the motion found in it, or kept
as it was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import trimmed_psf
from cep.restoration.choice import FEW_CLIPPED, choose_psf, is_possible_light, restore_chosen
from cep.restoration.methods import misfit
from motdiff.crops import clipped_mask, exposure_gain
from motdiff.estimators.base import MotionEstimate
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

_LEAST_CONFIDENCE = 0.5  # more likely good than not
_PRIOR_DB = {"psf": 0.6, "trajectory": 0.0}
"""Mean advantage of the PSF found over that of the path traced through it:
docs/decisions/restoration.md."""


@dataclass(frozen=True)
class Sharpened:
    """A photo restored with what was found in it, or the photo itself where that is no better.

    Attributes
    ----------
    image : float ndarray like the photo
        Not clipped; the photo itself where it was kept.
    summary : str
        What was done, in one sentence.
    kept : bool
        Whether ``image`` is the photo as it was.
    psf_source : {"psf", "trajectory"} or None
        Whether the PSF found was used or that of the path traced through it; None where the photo
        was kept.
    method : {"tv", "wiener"} or None
    psf : (S, S) float ndarray
        What the photo was restored with; a point where it was kept.
    estimate : MotionEstimate
    residual : float
        RMS of the reblurred result against the photo, full-scale units.
    unreliable_px : int
        Width of the border strip that leans on a guess of the scene outside the frame.
    saturated_fraction : float
        Share of the photo's pixels that are clipped.
    warnings : tuple of str
    """

    image: FloatArray
    summary: str
    kept: bool
    psf_source: str | None
    method: str | None
    psf: FloatArray
    estimate: MotionEstimate
    residual: float
    unreliable_px: int
    saturated_fraction: float
    warnings: tuple[str, ...]

    @property
    def psf_confidence(self) -> float:
        """Probability that the PSF is good."""
        return _psf_confidence(self.estimate)


def sharpen(photo: ArrayLike, estimate: MotionEstimate) -> Sharpened:
    """Restore a photo taken with an open shutter from the photo alone, or keep it where that would
    not help.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    estimate : MotionEstimate
        Of its motion, as of :func:`cep.calibration.calibrate.estimate_motion`.
    """
    pixels = np.asarray(photo)
    clipped = float(clipped_mask(pixels).mean())
    notes = []

    def kept(summary: str) -> Sharpened:
        point = np.zeros((PSF_PX, PSF_PX))
        point[PSF_PX // 2, PSF_PX // 2] = 1
        return Sharpened(
            np.asarray(pixels, dtype=np.float64),
            summary,
            True,
            None,
            None,
            point,
            estimate,
            0.0,
            0,
            clipped,
            estimate.psf_warnings,
        )

    if not estimate.details.get("motion_blur", True):
        return kept(f"{estimate.warnings[0]}: the photo is kept as it is")
    if _psf_confidence(estimate) < _LEAST_CONFIDENCE:
        return kept(
            f"The blur could not be found with confidence ({_psf_confidence(estimate):.2f}): the"
            " photo is kept as it is"
        )
    path = estimate.best
    psfs = {"psf": estimate.psf, "trajectory": path.psf(path.frame_size(PSF_PX))}
    fitting = {
        name: psf
        for name, psf in psfs.items()
        if 2 * len(trimmed_psf(psf)) <= min(pixels.shape[:2])
    }
    gain = exposure_gain(pixels)
    bright = pixels * gain if gain > 1 else pixels
    choice = choose_psf(bright, fitting, prior_db=_PRIOR_DB) if fitting else None
    if choice is None or choice.name is None:
        return kept(
            "No restoration is sharper than the photo without ringing: the photo is kept as it is"
        )
    psf = psfs[choice.name]
    image, method = restore_chosen(bright, psf)
    if not is_possible_light(image, bright, psf):
        return kept(
            "The restored photo would have dark and bright halos: the photo is kept as it is"
        )
    if method == "wiener":
        notes.append(
            "the photo is large: it was restored by the Wiener filter, which is fast; --method tv"
            " takes longer"
        )
    if clipped > FEW_CLIPPED:
        notes.append(
            f"{100 * clipped:.1f} % of the pixels are clipped: their light was inferred from the"
            " other pixels"
        )
    image = image / gain
    reach = trimmed_psf(psf).shape[0] // 2
    found = "the blur kernel found in it" if choice.name == "psf" else "the path found in it"
    return Sharpened(
        image,
        f"The photo was restored with {found} (confidence {_psf_confidence(estimate):.2f}), by"
        f" {method}",
        False,
        choice.name,
        method,
        np.asarray(psf, dtype=np.float64),
        estimate,
        misfit(pixels, image, psf),
        reach,
        clipped,
        (*estimate.psf_warnings, *notes),
    )


def _psf_confidence(estimate: MotionEstimate) -> float:
    stated = estimate.details.get("psf_confidence", estimate.confidence)
    return float(stated) if isinstance(stated, (int, float)) else estimate.confidence
