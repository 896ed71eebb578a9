"""Test of the order in time of a motion in a coded photo.

A path may have been run forward, in reverse, or, where it meets itself, with some of its loops the
other way round. Through a code the PSFs of these orders differ. Two clues are weighed. Frequencies
that the code passes along one order and stops along another show in the photo's power spectrum
(its likelihood under each PSF). And a wrong PSF leaves ringing, so the restored scene has more and
weaker gradients: the ratio of their L1 to their L2 norm, which a straight path's equal MTFs do not
hide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.blur import Blur, channels_first
from cep.restoration.noise import fit_spectrum
from cep.restoration.tv import gradient_sparsity
from cep.restoration.wiener import wiener
from motdiff.crops import centre_crop
from motdiff.estimators.coded.starts import orders
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

Direction = Literal["forward", "reverse", "reordered", "undecidable"]

DIRECTIONS: tuple[Direction, ...] = ("forward", "reverse", "reordered")
LARGEST_CROP_PX = 512
_ONE_PSF_MNC = 0.9995  # both PSFs are computed, not estimated: small differences count
_FEATURELESS = 1e-6  # range of a photo that holds rounding errors alone
# log odds = sum of weight * tanh(clue / scale), a logistic fit on 340 simulated photos;
# saturating, since an unusual scene can make either clue large and wrong
# (lab/studies/direction.py)
_WEIGHTS = (1.25, 3.0)
_SCALES = (0.003, 0.01)
_SAME_RESTORATION_MNC = 0.97  # PSFs that nearer restore a photo alike
_ORDER_KNOTS = 201
_MOST_ORDERS = 24  # each costs a fit of the spectrum and a restoration
# log odds against an order with loops reversed, for lack of which rough paths lose: docs/decisions
_REORDERED = 2.0
_SMOOTHER = 4.0  # the sparsity clue is clearest with more regularisation than restores best


@dataclass(frozen=True)
class DirectionResult:
    """Outcome of the test of orders in time.

    Attributes
    ----------
    direction : {"forward", "reverse", "reordered", "undecidable"}
        "reordered" when loops within the path were run the other way round; "undecidable" when all
        PSFs are practically the same, or the photo is flat.
    confidence : float
        Estimated probability that the chosen order, or one of practically its PSF, is right, where
        one of those tested is; 0.5 when undecidable.
    likelihoods : tuple of float
        Mean negative log-likelihood per frequency, of forward, reverse and the other orders; the
        smallest fits best.
    residuals : tuple of float
        L1 over L2 norm of the restored scene's gradients, per square root of their number, in the
        same order; the smallest is the sparsest, least ringing one.
    psf : (S, S) float ndarray
        Light-true PSF of the chosen order; the forward one when undecidable.
    trajectory : Trajectory or None
        The path in the chosen order; None where PSFs were compared.
    """

    direction: Direction
    confidence: float
    likelihoods: tuple[float, ...]
    residuals: tuple[float, ...]
    psf: FloatArray
    trajectory: Trajectory | None = None


def detect_direction(
    photo: ArrayLike, trajectory: Trajectory, code: ShutterCode
) -> DirectionResult:
    """Test in which order in time a coded ``photo`` was taken along ``trajectory``.

    The orders are forward, reverse, and those with loops of the path reversed.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    trajectory : Trajectory
    code : ShutterCode

    Raises
    ------
    ValueError
        If the photo is malformed.

    Examples
    --------
    >>> from cep.optics.capture import capture
    >>> rng = np.random.default_rng(0)
    >>> scene = np.kron(rng.random((12, 12)), np.ones((8, 8)))
    >>> path = Trajectory.from_samples([[0, 0], [8, 1], [12, 9]])
    >>> code = ShutterCode("1101000101101111")
    >>> detect_direction(capture(scene, path.reversed(), code, rng=rng), path, code).direction
    'reverse'
    """
    paths = orders_in_time(trajectory)
    frame = max(PSF_PX, *(path.frame_size() for path in paths))
    result, chosen = _compared(photo, [coded_psf(path, code, frame) for path in paths])
    return replace(result, trajectory=paths[chosen])


def compare_psfs(photo: ArrayLike, forward: ArrayLike, reverse: ArrayLike) -> DirectionResult:
    """Test which of two PSFs a photo was blurred by; ValueError if an argument is malformed.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    forward, reverse : (S, S) array_like
        Light-true PSFs, zero displacement at index ``size // 2``.
    """
    return _compared(photo, [np.asarray(psf, dtype=np.float64) for psf in (forward, reverse)])[0]


def orders_in_time(trajectory: Trajectory) -> list[Trajectory]:
    """Orders in time of a path: as given, reversed, then those with loops reversed, if it has any.

    Examples
    --------
    >>> len(orders_in_time(Trajectory.from_samples([[0, 0], [8, 1], [12, 9]])))
    2
    """
    loop_orders = orders(trajectory, knots=_ORDER_KNOTS, count=_MOST_ORDERS)[2:]
    reordered = [Trajectory.from_samples(xy, direction=trajectory.direction) for xy in loop_orders]
    return [trajectory, trajectory.reversed(), *reordered]


def _compared(photo: ArrayLike, psfs: Sequence[FloatArray]) -> tuple[DirectionResult, int]:
    """Return the result and the index of the chosen PSF; repeated PSFs are not tested."""
    grey = channels_first(photo).mean(axis=0)
    # the middle is enough to decide, and quick on large photos
    image = centre_crop(grey, LARGEST_CROP_PX, LARGEST_CROP_PX)
    blurs = [Blur(psf, image.shape, "periodic") for psf in psfs]
    kernels = [blur.psf for blur in blurs]
    spectra = [fit_spectrum(image, blur, shaped=True) for blur in blurs]
    noise = min(spectrum.noise for spectrum in spectra)
    reach = min(max(blur.reach_px for blur in blurs), min(image.shape) // 4)
    ringing = [
        gradient_sparsity(
            _without_border(wiener(image, kernel, noise_variance=_SMOOTHER * noise), reach)
        )
        for kernel in kernels
    ]
    likelihoods = tuple(spectrum.cost for spectrum in spectra)
    residuals = tuple(ringing)
    undecidable = DirectionResult("undecidable", 0.5, likelihoods, residuals, psfs[0])
    tested = _distinct(kernels)
    if len(tested) == 1 or np.ptp(image) < _FEATURELESS:
        return undecidable, 0
    log_odds = _log_odds(np.array(likelihoods)[tested], np.array(ringing)[tested])
    prior = np.where(np.array(tested) < 2, 0.0, -_REORDERED)
    odds = np.exp(prior - prior[:, None] - log_odds)  # of the others against each
    best = int(odds.sum(axis=1).argmin())
    if (odds == 1).all():
        return undecidable, 0
    chosen = tested[best]
    # of two, the question is which, however alike; of many, those that restore alike count as one
    same = [
        i == chosen
        or (len(tested) > 2 and mnc_subpixel(kernels[chosen], kernels[i]) > _SAME_RESTORATION_MNC)
        for i in tested
    ]
    confidence = float(odds[best, same].sum() / odds[best].sum())
    direction = DIRECTIONS[min(chosen, 2)]
    return DirectionResult(direction, confidence, likelihoods, residuals, psfs[chosen]), chosen


def _distinct(kernels: Sequence[FloatArray]) -> list[int]:
    """List the kernels, by index, that no earlier one equals."""
    distinct: list[int] = []
    for i, kernel in enumerate(kernels):
        if all(mnc_subpixel(kernels[j], kernel) <= _ONE_PSF_MNC for j in distinct):
            distinct.append(i)
    return distinct


def _log_odds(likelihoods: FloatArray, ringing: FloatArray) -> FloatArray:
    """Log odds (N, N) of each PSF against each other."""
    total = ringing[:, None] + ringing
    clues = (
        likelihoods - likelihoods[:, None],
        (ringing - ringing[:, None]) / np.where(total > 0, total, 1.0),
    )
    weighed = [
        w * np.tanh(clue / scale) for w, clue, scale in zip(_WEIGHTS, clues, _SCALES, strict=True)
    ]
    return np.asarray(sum(weighed), dtype=np.float64)


def _without_border(image: FloatArray, border_px: int) -> FloatArray:
    return image[border_px : image.shape[0] - border_px, border_px : image.shape[1] - border_px]
