"""The PSF of a photo, found in the photo alone.

A coded photo's own kernel restores better than the PSF of a path that is fitted to it along the
code: one photo seldom tells the order in time, and a wrong order has a wrong PSF
(docs/decisions/restoration.md). Where the blur outgrows the search, though, the photo is made
smaller, and the PSF is that of a path drawn through the small kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from motdiff.types import FloatArray

LEAST_CONFIDENCE = 0.5  # more likely good than lost


@dataclass(frozen=True)
class BlindPsf:
    """A PSF that was found in a photo.

    Attributes
    ----------
    psf : (S, S) float ndarray
        Light-true, zero displacement at index ``S // 2``. The kernel found; where the photo was
        made smaller for the search, which a warning says, the PSF of the path traced through that
        kernel, at full size.
    confidence : float
        Probability that it is near the true one (MNC of 0.7 or more).
    warnings : tuple of str
    """

    psf: FloatArray
    confidence: float
    warnings: tuple[str, ...]


def find_psf(
    photo: ArrayLike,
    code: ShutterCode | None = None,
    *,
    progress: Callable[[float], None] | None = None,
) -> BlindPsf:
    """Find the PSF of a photo blindly; of the code it needs the open share of the time.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    code : ShutterCode, optional
        Of the exposure; the open shutter when omitted.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises
    ------
    ValueError
        If the photo is malformed, too small or without texture.
    """
    from motdiff.estimators.pmp.estimator import PmpEstimator

    duty = (code or ShutterCode("1")).duty
    estimate = PmpEstimator(progress=progress).estimate(photo)
    warnings = list(estimate.psf_warnings)
    if estimate.confidence < LEAST_CONFIDENCE:
        warnings.insert(
            0,
            f"the PSF is probably lost (confidence {estimate.confidence:.2f}), and the restored"
            " photo may be worse than the one given: calibrate the motion, and give its"
            " trajectory",
        )
    return BlindPsf(duty * estimate.psf, estimate.confidence, tuple(warnings))
