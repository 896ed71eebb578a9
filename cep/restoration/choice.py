"""Choice of the PSF and the method of a restoration, tried on a crop, without the sharp photo.

Two things give a wrong PSF away. It leaves a residual, however the photo is restored. And its
ringing dips below black or rises above full scale, where there can be no light. A restoration with
less sparse gradients than its photo is no better. The same evidence gives away that a file was
read on the wrong curve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import Blur, channels_first, channels_last
from cep.restoration.clipping import FEW_CLIPPED, fill_clipped, lights_cut
from cep.restoration.noise import fit_spectrum
from cep.restoration.plug_and_play import pnp
from cep.restoration.result import misfit
from cep.restoration.tv import gradient_sparsity, tv
from cep.restoration.wiener import wiener
from motdiff.crops import pick_crops
from motdiff.photo_noise import LEAST_SIGMA, noise_sigma
from motdiff.photo_values import clipped_mask, luminance, to_display
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

LARGEST_ESTIMATED_PX = 4_000_000
"""Photos of more pixels whose PSF is estimated are restored by the Wiener filter: others would
take a minute."""

LARGEST_PNP_PX = 16_000_000
"""Photos of more pixels are restored by the Wiener filter: pnp would take minutes and 4 GB."""

LITTLE_IMPOSSIBLE = 0.05
"""RMS of impossible light that a right PSF leaves, of the photo's standard deviation."""

MOST_IMPOSSIBLE = 0.15
"""Of it more is seen as halos."""

_CROP_PX = 384
# in dB of PSNR that a factor of e in the residual, and a full scale of impossible light (rms),
# cost on simulated photos
_RESIDUAL_DB = 0.3
_IMPOSSIBLE_DB = 88.0
_NO_SPARSER = 0.95  # of the photo's own gradients
_MOST_IMPOSSIBLE_BESIDE_LIGHTS = 0.075
# an estimated PSF errs by more than the noise: factor of its variance for the Wiener filter
_WRONG_PSF = 20.0
# Residual of TV, in standard deviations of the noise, beyond which the PSF's error is what rings;
# a PSF that is rather known than estimated gets more credit. On simulated photos:
# docs/decisions/restoration.md
_WRONG = 2.0
_CREDIT_RESIDUAL = 1.25
_CREDIT_IMPOSSIBLE = 2.0
_WRONG_TV = 3.0  # factor of TV's weight
_TV_WEIGHT = 1e-3  # the default weight, good up to this noise; above it grows as the noise's power
_TV_SIGMA = 0.007
# Logarithm of the ratio of what two readings of a file leave unexplained. On 27 simulated photos
# along motions known to 0 to 0.5 px those in sRGB had 0.02 at most, and 20 linear ones more than
# this: docs/decisions/restoration.md
_CLEARLY = 0.15


@dataclass(frozen=True)
class Evidence:
    """What a PSF leaves of a crop that TV restores with it, beside the crop's own figures.

    Attributes
    ----------
    residual, impossible : float
        RMS of what the PSF does not explain, and of light below 0 and above 1.
    noise, contrast : float
        Standard deviations of the crop's noise, and of the crop.
    sparsity : float
        Of the restored gradients, see :func:`cep.restoration.tv.gradient_sparsity`.
    """

    residual: float
    impossible: float
    noise: float
    contrast: float
    sparsity: float

    def explains(self, *, trusted: bool) -> bool:
        """Whether both are as little as a right PSF leaves; of one rather known, with credit."""
        residual = self.residual / self.noise
        impossible = self.impossible / self.contrast
        if trusted:
            residual /= _CREDIT_RESIDUAL
            impossible /= _CREDIT_IMPOSSIBLE
        return residual <= _WRONG and impossible <= LITTLE_IMPOSSIBLE

    @property
    def unexplained(self) -> float:
        """Both together, as a share of the contrast."""
        return (self.residual + self.impossible) / self.contrast


class PsfChoice(NamedTuple):
    """PSF that suits a photo, by name; of each PSF its score, and the evidence behind it."""

    name: str | None
    scores_db: dict[str, float]
    evidence: dict[str, Evidence]


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

    Returns
    -------
    name : str or None
        Of the PSF; None where no restoration is sharper than the photo, by the sparsity of its
        gradients.
    scores_db : dict from name to float
        Of each PSF; differences stand for expected differences of PSNR.
    evidence : dict from name to Evidence
    """
    crop = _textured_crop(photo)
    sigma = max(noise_sigma(luminance(crop)), LEAST_SIGMA)
    photo_sparsity = gradient_sparsity(luminance(crop)) or 1.0
    evidence = {name: _evidence(crop, psf) for name, psf in psfs.items()}
    scores = {
        name: float(
            prior_db[name]
            - _RESIDUAL_DB * np.log(max(trial.residual, sigma) / sigma)
            - _IMPOSSIBLE_DB * trial.impossible
        )
        for name, trial in evidence.items()
    }
    sharper = [
        name
        for name, trial in evidence.items()
        if (trial.sparsity or 1.0) < _NO_SPARSER * photo_sparsity
    ]
    return PsfChoice(max(sharper, key=scores.__getitem__, default=None), scores, evidence)


class MethodChoice(NamedTuple):
    """Method that suits a photo and its PSF, and the reason in a few words."""

    method: str
    reason: str


def choose_method(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    coded_motion: bool = False,
    trusted: bool = False,
    evidence: Evidence | None = None,
) -> MethodChoice:
    """Choose the method of a photo for which none is named: what ``auto`` means.

    Of a coded photo along its motion it is pnp. Of any other a textured crop is restored by TV
    with a weight for its noise. A PSF that leaves much more than the noise, or impossible light,
    is wrong: TV rings less. With any other pnp is the best. A large photo is restored by Wiener's
    filter.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psf : (S, S) array_like
        Light-true.
    coded_motion : bool
        Whether the photo was taken through a code, along a motion that was given.
    trusted : bool
        Whether the PSF is rather known than estimated. The photo must then speak more clearly
        against it.
    evidence : Evidence, optional
        What :func:`choose_psf` has of this PSF.
    """
    size_px = channels_first(photo)[0].size
    if coded_motion:
        # ahead in every row of our tables with a known motion: docs/decisions/restoration.md
        fits = trusted = True
        reason = "the photo is coded"
    else:
        evidence = evidence or _evidence(_textured_crop(photo), psf)
        fits = evidence.explains(trusted=trusted)
        reason = "the motion fits the photo"
    if fits and size_px <= (LARGEST_PNP_PX if trusted else LARGEST_ESTIMATED_PX):
        return MethodChoice("pnp", reason)
    if not fits and size_px <= LARGEST_ESTIMATED_PX:
        return MethodChoice("tv", "the motion fits the photo badly")
    return MethodChoice("wiener", "the photo is large")


def restore_with_estimate(
    photo: ArrayLike,
    psf: ArrayLike,
    method: str,
    *,
    progress: Callable[[float], None] = lambda _share: None,
) -> FloatArray:
    """Restore a whole photo by a method of :func:`choose_method`; the result is not clipped.

    The PSF may be wrong: TV has a weight at which it then rings less.
    """
    channels = channels_first(fill_clipped(photo, psf))
    if method == "pnp":
        return pnp(channels_last(channels), psf, progress=progress)
    if method == "tv":
        # TV divides the photo by the light that came in, and its noise with it
        sigma = noise_sigma(channels.mean(axis=0)) / float(np.sum(psf))
        weight = _WRONG_TV * _tv_weight(sigma)
        jobs = [partial(tv, channel, psf, weight=weight) for channel in channels]
        return channels_last(np.stack(side_by_side(jobs)))
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
    return channels_last(np.stack(side_by_side(jobs)))


def looks_linear(photo: ArrayLike, psf: ArrayLike) -> bool:
    """Whether a file that was read as sRGB fits its blur better if its code values are light.

    Blur adds up light. Read on the wrong curve a photo is no blurred scene any more: its
    restoration leaves more of a residual, and more impossible light.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
        As it was read.
    psf : (S, S) array_like
        Light-true.

    Examples
    --------
    >>> from motdiff.photo_values import to_linear
    >>> from motdiff.simulate import blur_valid
    >>> scene = np.kron(np.random.default_rng(0).random((16, 16)), np.ones((10, 10)))
    >>> kernel = np.pad(np.full((1, 9), 1 / 9), ((4, 4), (0, 0)))
    >>> light = blur_valid(scene, kernel)
    >>> looks_linear(light, kernel), looks_linear(to_linear(light), kernel)
    (False, True)
    """
    as_light = _evidence(_textured_crop(to_display(np.clip(photo, 0, 1))), psf)
    as_read = _evidence(_textured_crop(photo), psf)
    # a wrong PSF fits neither
    is_clear = as_read.unexplained > np.exp(_CLEARLY) * as_light.unexplained
    return as_light.explains(trusted=True) and bool(is_clear)


def _evidence(crop: FloatArray, psf: ArrayLike) -> Evidence:
    clipped = clipped_mask(crop)
    light = float(np.sum(psf))
    # each colour is filled by itself: where one is clipped the grey is not at full scale
    filled = luminance(fill_clipped(crop, psf))
    sigma = max(noise_sigma(filled), LEAST_SIGMA)
    restored = tv(filled, psf, weight=_tv_weight(sigma / light))
    residual = misfit(filled, restored, psf, clipped=clipped)
    restored = lights_cut(restored, clipped, psf)
    return Evidence(
        residual=residual,
        impossible=light * _impossible(restored),
        noise=sigma,
        contrast=max(float(np.std(filled)), LEAST_SIGMA),
        sparsity=gradient_sparsity(restored),
    )


def _textured_crop(photo: ArrayLike) -> FloatArray:
    """Crop of a photo with most texture, in its colours."""
    grey = luminance(photo)
    side = min(_CROP_PX, *grey.shape)
    row, column = pick_crops(grey, size=side, count=1)[0]
    return np.ascontiguousarray(
        np.asarray(photo, dtype=np.float64)[row : row + side, column : column + side]
    )


def is_possible_light(
    restored: ArrayLike, photo: ArrayLike, psf: ArrayLike, *, limit: float = MOST_IMPOSSIBLE
) -> bool:
    """Whether a restoration stays within 0..1, but for a small share of the contrast of its photo.

    Lights that clipped the photo may be brighter than 1. Their ringing shows only where it is
    dark, so less is allowed.

    Parameters
    ----------
    restored, photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        What it was restored with.
    limit : float
        That share, rms, of the photo's standard deviation.
    """
    clipped = clipped_mask(photo)
    if clipped.mean() > FEW_CLIPPED:
        limit = min(limit, _MOST_IMPOSSIBLE_BESIDE_LIGHTS)
    # of the grey: deep colours have hardly any light in one channel, and its ringing is not seen
    contrast = float(np.std(luminance(photo)))
    grey = luminance(lights_cut(np.asarray(restored, dtype=np.float64), clipped, psf))
    return _impossible(grey) <= limit * contrast


def _impossible(restored: FloatArray) -> float:
    """RMS of the light below 0 and above 1."""
    return float(np.sqrt(np.mean((restored - np.clip(restored, 0, 1)) ** 2)))


def _tv_weight(sigma: float) -> float:
    return float(_TV_WEIGHT * max(1.0, sigma / _TV_SIGMA) ** 2)
