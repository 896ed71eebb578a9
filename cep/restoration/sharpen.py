"""Restoration of a photo with the better PSF of its motion estimate, or of none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import trimmed_psf
from cep.restoration.choice import (
    LITTLE_IMPOSSIBLE,
    MOST_IMPOSSIBLE,
    choose_method,
    choose_psf,
    is_possible_light,
    restore_with_estimate,
)
from cep.restoration.clipping import clipped_warnings
from cep.restoration.result import Restoration, misfit
from motdiff.estimators.base import MotionEstimate
from motdiff.photo_values import clipped_mask, exposure_gain
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

LEAST_CONFIDENCE = 0.5
"""Of a PSF that is more likely good than lost."""

# Below it a photo is kept. Up to the least confidence the restoration shows whether the blur is
# right: of 42 simulated photos all seven that it lets pass were improved
_HOPELESS = 1 / 3
# mean advantage of the PSF found over that of the path traced through it:
# docs/decisions/restoration.md
_PRIOR_DB = {"photo": 0.6, "path in the photo": 0.0}
_SOURCES = {"photo": "the blur kernel found in it", "path in the photo": "the path found in it"}
_NO_SHARPER = "No restoration is sharper than the photo without ringing"
_HALOS = "The restored photo would have dark and bright halos"


def sharpen(photo: ArrayLike, estimate: MotionEstimate, *, anyway: bool = False) -> Restoration:
    """Restore a photo of an open shutter from itself, or keep it where that would not help.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    estimate : MotionEstimate
        Of its motion, as of :func:`cep.calibration.calibrate.estimate_motion`.
    anyway : bool
        Whether a photo that would be kept is restored all the same; the summary says why it would
        have been kept. One that is smaller than its blur is kept.
    """
    pixels = np.asarray(photo)
    doubt = _doubt_of_blur(estimate)
    if doubt and not anyway:
        return _kept(pixels, estimate, doubt)
    psfs = _psfs_within(min(pixels.shape[:2]), estimate)
    gain = exposure_gain(pixels)
    bright = pixels * gain
    source, scores_db, evidence = choose_psf(bright, psfs, prior_db=_PRIOR_DB)
    if source is None:
        doubt = doubt or _NO_SHARPER
        if not (anyway and psfs):
            return _kept(pixels, estimate, doubt)
        source = max(psfs, key=scores_db.__getitem__)
    psf = psfs[source]
    confidence = _psf_confidence(estimate)
    method, _reason = choose_method(bright, psf, evidence=evidence[source])
    image = restore_with_estimate(bright, psf, method)
    # a doubtful blur must leave little of what a wrong one leaves
    is_doubtful = confidence < LEAST_CONFIDENCE
    limit = LITTLE_IMPOSSIBLE if is_doubtful else MOST_IMPOSSIBLE
    if not is_possible_light(image, bright, psf, limit=limit):
        doubt = doubt or (_lost(confidence) if is_doubtful else _HALOS)
        if not anyway:
            return _kept(pixels, estimate, doubt)
    image = image / gain
    notes = []
    if doubt:
        summary = f"{doubt}: the photo was restored anyway, with {_SOURCES[source]}, by {method}"
    else:
        summary = (
            f"The photo was restored with {_SOURCES[source]} (confidence {confidence:.2f}), by"
            f" {method}"
        )
        if is_doubtful:
            notes.append(
                f"the blur found is doubtful (confidence {confidence:.2f}): compare the restored"
                " photo with the one taken"
            )
    if method == "wiener":
        notes.append(
            "the photo is large: it was restored by the Wiener filter, which is fast; --method tv"
            " takes longer"
        )
    clipped = float(clipped_mask(pixels).mean())
    return Restoration(
        image=image,
        method=method,
        psf=np.asarray(psf, dtype=np.float64),
        psf_source=source,
        psf_confidence=confidence,
        residual=misfit(pixels, image, psf),
        unreliable_px=len(trimmed_psf(psf)) // 2,
        saturated_fraction=clipped,
        warnings=(*estimate.psf_warnings, *notes, *clipped_warnings(clipped)),
        summary=summary,
    )


def _psf_confidence(estimate: MotionEstimate) -> float:
    confidence = estimate.details.get("psf_confidence")
    return float(confidence) if isinstance(confidence, int | float) else estimate.confidence


def _lost(confidence: float) -> str:
    return f"The blur could not be found with confidence ({confidence:.2f})"


def _doubt_of_blur(estimate: MotionEstimate) -> str | None:
    """Say why a photo is kept before a restoration is tried."""
    if not estimate.details.get("motion_blur", True):
        return estimate.warnings[0]
    confidence = _psf_confidence(estimate)
    return _lost(confidence) if confidence < _HOPELESS else None


def _psfs_within(side_px: int, estimate: MotionEstimate) -> dict[str, FloatArray]:
    """PSFs by their source, without those that reach too far for a photo of this shorter side."""
    path = estimate.best
    psfs = {"photo": estimate.psf, "path in the photo": path.psf(path.frame_size(PSF_PX))}
    return {source: psf for source, psf in psfs.items() if 2 * len(trimmed_psf(psf)) <= side_px}


def _kept(photo: FloatArray, estimate: MotionEstimate, reason: str) -> Restoration:
    point = np.zeros((PSF_PX, PSF_PX))
    point[PSF_PX // 2, PSF_PX // 2] = 1
    return Restoration(
        image=np.asarray(photo, dtype=np.float64),
        psf=point,
        psf_confidence=_psf_confidence(estimate),
        saturated_fraction=float(clipped_mask(photo).mean()),
        warnings=estimate.psf_warnings,
        summary=f"{reason}: the photo is kept as it is",
    )
