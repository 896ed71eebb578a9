"""Restoration of a photo with the better PSF of its motion estimate, or of none.

Which one is tried on a crop, without the sharp photo. Two things give a wrong PSF away. It leaves
a residual, however it is restored. And its ringing dips below black or rises above full scale,
where there can be no light. A restoration with less sparse gradients than its photo is no better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blind import LEAST_CONFIDENCE
from cep.restoration.blur import Blur, channels_first, channels_last, trimmed_psf
from cep.restoration.clipping import fill_clipped, lights_cut
from cep.restoration.noise import fit_spectrum
from cep.restoration.result import Restoration, misfit
from cep.restoration.tv import gradient_sparsity, tv
from cep.restoration.wiener import wiener
from motdiff.crops import clipped_mask, exposure_gain, luminance, pick_crops
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.kernel_score import noise_sigma
from motdiff.psf_frame import PSF_PX
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

LARGE_PX = 4_000_000
"""Photos of more pixels are restored by the Wiener filter: TV would take a minute."""

FEW_CLIPPED = 1e-3
"""Share of clipped pixels up to which they are specks of noise or glints, no lights."""

_CROP_PX = 384
_LEAST_SIGMA = 1e-3  # of the noise: a quarter of a step of 8 bit
# in dB of PSNR that a factor of e in the residual, and a full scale of impossible light (rms),
# cost on simulated photos
_RESIDUAL_DB = 0.3
_IMPOSSIBLE_DB = 88.0
_NO_SPARSER = 0.95  # of the photo's own gradients
_MOST_IMPOSSIBLE = 0.15  # rms, of the photo's standard deviation
_MOST_IMPOSSIBLE_BESIDE_LIGHTS = 0.075
# an estimated PSF errs by more than the noise: factor of its variance for the Wiener filter
_WRONG_PSF = 20.0
_TV_WEIGHT = 1e-3  # the default weight, good up to this noise; above it grows as the noise's power
_TV_SIGMA = 0.007
# mean advantage of the PSF found over that of the path traced through it:
# docs/decisions/restoration.md
_PRIOR_DB = {"photo": 0.6, "path in the photo": 0.0}
_SOURCES = {"photo": "the blur kernel found in it", "path in the photo": "the path found in it"}


@dataclass(frozen=True)
class PsfChoice:
    """The PSF chosen for a photo.

    Attributes
    ----------
    name : str or None
        Of the PSF; None where no restoration is better than the photo.
    scores_db : dict from name to float
        Of each PSF; differences stand for expected differences of PSNR.
    sparsity : dict from name to float
        L1 over L2 norm of the restored gradients, over that of the photo's: below 1
        where it is sharper and does not ring.
    """

    name: str | None
    scores_db: dict[str, float]
    sparsity: dict[str, float]


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
    confidence = estimate.confidence
    psf_confidence = estimate.details.get("psf_confidence")
    if isinstance(psf_confidence, int | float):
        confidence = float(psf_confidence)

    def kept(reason: str) -> Restoration:
        point = np.zeros((PSF_PX, PSF_PX))
        point[PSF_PX // 2, PSF_PX // 2] = 1
        return Restoration(
            image=np.asarray(pixels, dtype=np.float64),
            psf=point,
            psf_confidence=confidence,
            saturated_fraction=clipped,
            warnings=estimate.psf_warnings,
            summary=f"{reason}: the photo is kept as it is",
        )

    if not estimate.details.get("motion_blur", True):
        return kept(estimate.warnings[0])
    if confidence < LEAST_CONFIDENCE:
        return kept(f"The blur could not be found with confidence ({confidence:.2f})")
    path = estimate.best
    psfs = {"photo": estimate.psf, "path in the photo": path.psf(path.frame_size(PSF_PX))}
    small_enough = {
        source: psf
        for source, psf in psfs.items()
        if 2 * len(trimmed_psf(psf)) <= min(pixels.shape[:2])
    }
    gain = exposure_gain(pixels)
    bright = pixels * gain
    choice = choose_psf(bright, small_enough, prior_db=_PRIOR_DB)
    if choice.name is None:
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
        residual=misfit(pixels, image, psf),
        unreliable_px=len(trimmed_psf(psf)) // 2,
        saturated_fraction=clipped,
        warnings=(*estimate.psf_warnings, *notes),
        summary=(
            f"The photo was restored with {_SOURCES[choice.name]} (confidence {confidence:.2f}),"
            f" by {method}"
        ),
    )


def choose_psf(
    photo: ArrayLike, psfs: Mapping[str, ArrayLike], *, prior_db: Mapping[str, float]
) -> PsfChoice:
    """Choose among PSFs by restorations of a textured crop of the photo.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psfs : mapping from a name to a (S, S) array_like, sum 1
    prior_db : mapping from a name to float
        How much better one kind of PSF is than another where nothing else is known.

    Raises
    ------
    ValueError
        If an argument is malformed.
    """
    grey = luminance(photo)
    side = min(_CROP_PX, *grey.shape)
    row, column = pick_crops(grey, size=side, count=1)[0]
    crop = np.ascontiguousarray(grey[row : row + side, column : column + side])
    clipped = clipped_mask(photo)[row : row + side, column : column + side]
    sigma = max(noise_sigma(crop), _LEAST_SIGMA)
    photo_sparsity = gradient_sparsity(crop) or 1.0
    scores = {}
    sparsity = {}
    for name, psf in psfs.items():
        restored = tv(fill_clipped(crop, psf, clipped=clipped), psf, weight=_tv_weight(sigma))
        residual = max(misfit(crop, restored, psf, clipped=clipped), sigma)
        restored = lights_cut(restored, clipped, psf)
        scores[name] = float(
            prior_db[name]
            - _RESIDUAL_DB * np.log(residual / sigma)
            - _IMPOSSIBLE_DB * _impossible(restored)
        )
        sparsity[name] = (gradient_sparsity(restored) or 1.0) / photo_sparsity
    sharper = [name for name in scores if sparsity[name] < _NO_SPARSER]
    return PsfChoice(max(sharper, key=scores.__getitem__, default=None), scores, sparsity)


def restore_chosen(photo: ArrayLike, psf: ArrayLike) -> tuple[FloatArray, str]:
    """Restore a whole photo: by TV with a weight for its noise, a large one by the Wiener filter.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psf : (S, S) array_like
        Light-true.

    Returns
    -------
    float64 like ``photo``, not clipped, and the name of the method
    """
    channels = channels_first(fill_clipped(photo, psf))
    if channels[0].size <= LARGE_PX:
        # TV divides the photo by the light that came in, and its noise with it
        weight = _tv_weight(noise_sigma(channels.mean(axis=0)) / float(np.sum(psf)))
        jobs = [partial(tv, channel, psf, weight=weight) for channel in channels]
        return channels_last(np.stack(side_by_side(jobs))), "tv"
    side = 2 * _CROP_PX
    row, column = pick_crops(channels.mean(axis=0), size=side, count=1)[0]
    jobs = []
    for channel in channels:
        # a crop's spectra stand for the photo's, and its border is a strip: seconds instead of
        # minutes
        crop = channel[row : row + side, column : column + side]
        spectrum = fit_spectrum(crop, Blur(psf, crop.shape, "periodic"))
        jobs.append(
            partial(
                wiener,
                channel,
                psf,
                noise_variance=_WRONG_PSF * spectrum.noise,
                scene_strength=spectrum.scene,
                border_rounds=0,
            )
        )
    return channels_last(np.stack(side_by_side(jobs))), "wiener"


def is_possible_light(restored: ArrayLike, photo: ArrayLike, psf: ArrayLike) -> bool:
    """Whether a restoration stays within 0..1, but for a small share of the contrast of its photo.

    Lights that clipped the photo may be brighter than 1. Their ringing shows only where it is
    dark, so less is allowed.

    Parameters
    ----------
    restored, photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        What it was restored with.
    """
    clipped = clipped_mask(photo)
    limit = _MOST_IMPOSSIBLE
    if clipped.mean() > FEW_CLIPPED:
        limit = _MOST_IMPOSSIBLE_BESIDE_LIGHTS
    contrast = float(np.std(luminance(photo)))
    return _impossible(lights_cut(restored, clipped, psf)) <= limit * contrast


def _impossible(restored: FloatArray) -> float:
    """RMS of the light below 0 and above 1."""
    return float(np.sqrt(np.mean((restored - np.clip(restored, 0, 1)) ** 2)))


def _tv_weight(sigma: float) -> float:
    return float(_TV_WEIGHT * max(1.0, sigma / _TV_SIGMA) ** 2)
