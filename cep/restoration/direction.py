"""Test of the direction of motion in a coded photo: the code makes the PSFs of the two directions differ.

Two clues are weighed. Frequencies that the code passes along one direction and stops along the other show in the
photo's power spectrum (its likelihood under each PSF). And the wrong PSF leaves ringing, so the restored scene has more
and weaker gradients: the ratio of their L1 to their L2 norm, which a straight path's equal MTFs do not hide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.noise import fit_spectrum
from cep.restoration.spectral import channels_first, trimmed_psf
from cep.restoration.wiener import wiener
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory

__all__ = ["DirectionResult", "compare_psfs", "detect_direction"]

FloatArray = NDArray[np.float64]
_LARGEST_CROP_PX = 512
_ONE_PSF_MNC = 0.9995  # both PSFs are computed, not estimated: small differences count
_FEATURELESS = 1e-6
# log odds = sum of weight * tanh(clue / scale), a logistic fit on 340 simulated photos; saturating, since an unusual
# scene can make either clue large and wrong (benchmarks/direction.py)
_WEIGHTS = (1.25, 3.0)
_SCALES = (0.003, 0.01)
_SMOOTHER = 4.0  # the sparsity clue is clearest with more regularisation than restores best


@dataclass(frozen=True)
class DirectionResult:
    """Outcome of the two-direction test.

    Attributes
    ----------
    direction : {"forward", "reverse", "undecidable"}
        "undecidable" when the two PSFs are practically the same, or the photo is flat.
    confidence : float
        Estimated probability that the direction is right, 0.5..1; 0.5 when undecidable.
    likelihoods : (2,) tuple of float
        Mean negative log-likelihood per frequency, forward and reverse; the smaller fits better.
    residuals : (2,) tuple of float
        L1 over L2 norm of the restored scene's gradients, per square root of their number, forward and reverse; the
        smaller is the sparser, less ringing one.
    psf : (S, S) float ndarray
        Light-true PSF of the chosen direction; the forward one when undecidable.
    """

    direction: Literal["forward", "reverse", "undecidable"]
    confidence: float
    likelihoods: tuple[float, float]
    residuals: tuple[float, float]
    psf: FloatArray


def detect_direction(  # a test of directions, not a test
    photo: ArrayLike,
    trajectory: Trajectory,
    code: ShutterCode,
    *,
    size: int = PSF_PX,
) -> DirectionResult:
    """Test whether a coded ``photo`` was taken along ``trajectory`` or along its reverse.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    trajectory : Trajectory
    code : ShutterCode
    size : int
        PSF frame, px; larger when the path needs it.

    Raises
    ------
    ValueError
        If the photo is malformed.

    Examples
    --------
    >>> from cep.optics.capture import capture
    >>> rng = np.random.default_rng(0)
    >>> scene = np.kron(rng.random((12, 12)), np.ones((8, 8)))
    >>> path, code = Trajectory.from_samples([[0, 0], [8, 1], [12, 9]]), ShutterCode("1101000101101111")
    >>> detect_direction(capture(scene, path.reversed(), code, rng=rng), path, code).direction
    'reverse'
    """
    frame = max(size, trajectory.frame_size(), trajectory.reversed().frame_size())
    forward, reverse = (coded_psf(path, code, frame) for path in (trajectory, trajectory.reversed()))
    return compare_psfs(photo, forward, reverse)


def compare_psfs(photo: ArrayLike, forward: ArrayLike, reverse: ArrayLike) -> DirectionResult:
    """Test which of two PSFs a photo was blurred by.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    forward, reverse : (S, S) array_like
        Light-true PSFs, zero displacement at index ``size // 2``.

    Raises
    ------
    ValueError
        If an argument is malformed.
    """
    kernels = (trimmed_psf(forward), trimmed_psf(reverse))
    image = _middle(channels_first(photo).mean(axis=0))
    spectra = [fit_spectrum(image, kernel, shaped=True) for kernel in kernels]
    noise = min(spectrum.noise for spectrum in spectra)
    reach = min(max(kernel.shape[0] // 2 for kernel in kernels), min(image.shape) // 4)
    ringing = [_gradient_spread(wiener(image, kernel, noise_variance=_SMOOTHER * noise), reach) for kernel in kernels]
    likelihoods = (spectra[0].cost, spectra[1].cost)
    residuals = (ringing[0], ringing[1])
    clues = (likelihoods[1] - likelihoods[0], (residuals[1] - residuals[0]) / (sum(residuals) or 1.0))
    log_odds = sum(w * np.tanh(c / scale) for w, c, scale in zip(_WEIGHTS, clues, _SCALES, strict=True))
    if np.ptp(image) < _FEATURELESS or mnc_subpixel(*kernels) > _ONE_PSF_MNC or log_odds == 0:
        return DirectionResult("undecidable", 0.5, likelihoods, residuals, np.asarray(forward, dtype=np.float64))
    confidence = float(1 / (1 + np.exp(-abs(log_odds))))
    direction: Literal["forward", "reverse"] = "forward" if log_odds > 0 else "reverse"
    psf = np.asarray(forward if direction == "forward" else reverse, dtype=np.float64)
    return DirectionResult(direction, confidence, likelihoods, residuals, psf)


def _middle(image: FloatArray) -> FloatArray:
    """Return the middle of the photo: enough to decide, and quick on large photos."""
    height, width = (min(side, _LARGEST_CROP_PX) for side in image.shape)
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    return np.ascontiguousarray(image[top : top + height, left : left + width])


def _gradient_spread(image: FloatArray, border_px: int) -> float:
    inside = image[border_px : image.shape[0] - border_px, border_px : image.shape[1] - border_px]
    gradients = np.concatenate([np.diff(inside, axis=0).ravel(), np.diff(inside, axis=1).ravel()])
    rms = float(np.sqrt(np.mean(gradients**2)))
    return float(np.mean(np.abs(gradients))) / rms if rms > 0 else 0.0
