"""Restoration of a photo with the better PSF of its motion estimate, or of none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import trimmed_psf
from cep.restoration.choice import FEW_CLIPPED, choose_psf, is_possible_light, restore_chosen
from cep.restoration.result import Restoration, misfit
from motdiff.crops import clipped_mask, exposure_gain
from motdiff.estimators.base import MotionEstimate
from motdiff.psf_frame import PSF_PX

_LEAST_CONFIDENCE = 0.5  # more likely good than lost
# mean advantage of the PSF found over that of the path traced through it:
# docs/decisions/restoration.md
_PRIOR_DB = {"photo": 0.6, "path in the photo": 0.0}
_SOURCES = {"photo": "the blur kernel found in it", "path in the photo": "the path found in it"}


def sharpen(photo: ArrayLike, estimate: MotionEstimate) -> Restoration:
    """Restore a photo of an open shutter from itself, or keep it where that would not help.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    estimate : MotionEstimate
        Of its motion, as of :func:`cep.calibration.calibrate.estimate_motion`.
    """
    pixels = np.asarray(photo)
    clipped = float(clipped_mask(pixels).mean())
    confidence = _psf_confidence(estimate)

    def kept(reason: str) -> Restoration:
        point = np.zeros((PSF_PX, PSF_PX))
        point[PSF_PX // 2, PSF_PX // 2] = 1
        return Restoration(
            image=np.asarray(pixels, dtype=np.float64),
            method=None,
            psf=point,
            psf_source=None,
            psf_confidence=confidence,
            direction=None,
            direction_test=None,
            residual=0.0,
            unreliable_px=0,
            saturated_fraction=clipped,
            warnings=estimate.psf_warnings,
            summary=f"{reason}: the photo is kept as it is",
        )

    if not estimate.details.get("motion_blur", True):
        return kept(estimate.warnings[0])
    if confidence < _LEAST_CONFIDENCE:
        return kept(f"The blur could not be found with confidence ({confidence:.2f})")
    path = estimate.best
    psfs = {"photo": estimate.psf, "path in the photo": path.psf(path.frame_size(PSF_PX))}
    small_enough = {
        source: psf
        for source, psf in psfs.items()
        if 2 * len(trimmed_psf(psf)) <= min(pixels.shape[:2])
    }
    gain = exposure_gain(pixels)
    bright = pixels * gain if gain > 1 else pixels
    choice = choose_psf(bright, small_enough, prior_db=_PRIOR_DB) if small_enough else None
    if choice is None or choice.name is None:
        return kept("No restoration is sharper than the photo without ringing")
    psf = psfs[choice.name]
    image, method = restore_chosen(bright, psf)
    if not is_possible_light(image, bright, psf):
        return kept("The restored photo would have dark and bright halos")
    notes = []
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
    return Restoration(
        image=image,
        method=method,
        psf=np.asarray(psf, dtype=np.float64),
        psf_source=choice.name,
        psf_confidence=confidence,
        direction=None,
        direction_test=None,
        residual=misfit(pixels, image, psf),
        unreliable_px=len(trimmed_psf(psf)) // 2,
        saturated_fraction=clipped,
        warnings=(*estimate.psf_warnings, *notes),
        summary=(
            f"The photo was restored with {_SOURCES[choice.name]} (confidence {confidence:.2f}),"
            f" by {method}"
        ),
    )


def _psf_confidence(estimate: MotionEstimate) -> float:
    probability = estimate.details.get("psf_confidence")
    return float(probability) if isinstance(probability, int | float) else estimate.confidence
