"""Light of clipped pixels, inferred from the other pixels of a photo and the PSF.

Where a photo is clipped, ``A x = y`` does not hold, and every restoration rings. With these pixels
replaced it does, so any method can follow.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from cep.restoration.blur import Blur, channels_first, channels_last, gradient_power, trimmed_psf
from cep.restoration.tv import divergence, forward_differences
from motdiff.photo_values import CLIPPED_LEVEL
from motdiff.threads import side_by_side
from motdiff.types import BoolArray, FloatArray

FEW_CLIPPED = 1e-3
"""Share of clipped pixels up to which they are specks of noise or glints, no lights."""

# memory for a large photo; a tile is cut to the neighbourhood of its clipped pixels
_TILE_PX = 512
_ROUNDS = 40  # docs/decisions/restoration.md
_TV_WEIGHT = 1e-3  # as the default of :func:`cep.restoration.tv.tv`
# of ADMM, for A x, D x and x >= 0: they set how quickly it converges, not what to
_BLUR_PENALTY = 0.03
_GRADIENT_PENALTY = 1e-2
_LIGHT_PENALTY = 3e-3


def fill_clipped(photo: ArrayLike, psf: ArrayLike) -> NDArray[np.floating]:
    """Replace the clipped pixels of a photo by the blurred light of the likeliest scene.

    The scene x minimises ``|M (A x - y)|^2 / 2 + 1e-3 (|Dx x|_1 + |Dy x|_1)``, M being 1 on the
    photo's other pixels, with ``x >= 0`` and with ``A x`` at
    :data:`motdiff.photo_values.CLIPPED_LEVEL` or more where the photo is clipped. ADMM
    splits ``A x``, so that the mask is applied pixel by pixel and x is solved for in the Fourier
    domain. Light from beyond the border is unknown in the same way.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psf : (S, S) array_like
        Zero displacement at index ``size // 2``; its sum does not matter.

    Returns
    -------
    float ndarray like ``photo``
        Its other pixels are unchanged, and it does not depend on the values of the clipped ones.
        A photo with nothing clipped is returned as it is.

    References
    ----------
    Almeida and Figueiredo, "Deconvolving images with unknown boundaries using the alternating
    direction method of multipliers", IEEE TIP 2013: mask decoupling. Whyte, Sivic, Zisserman,
    "Deblurring shaken and partially saturated images", IJCV 2014: clipped pixels as a limit on the
    model.
    """
    channels = channels_first(photo)
    kernel = trimmed_psf(psf)
    masks = channels >= CLIPPED_LEVEL
    if not masks.any():
        return np.asarray(photo)
    kernel = kernel / kernel.sum()
    # the pixels whose light comes from where a clipped pixel's does
    margin = 2 * (kernel.shape[0] // 2)
    filled = channels.copy()
    jobs = []
    places = []
    for number, (channel, mask) in enumerate(zip(channels, masks, strict=True)):
        for tile in _tiles(mask):
            window = tuple(slice(max(0, s.start - margin), s.stop + margin) for s in tile)
            jobs.append(partial(_blurred_light, channel[window], mask[window], kernel))
            places.append((number, window, tile))
    for (number, window, tile), light in zip(places, side_by_side(jobs), strict=True):
        inner = tuple(
            slice(t.start - w.start, t.stop - w.start) for t, w in zip(tile, window, strict=True)
        )
        place = (number, *tile)
        filled[place] = np.where(masks[number][tile], light[inner], filled[place])
    return channels_last(filled)


def clipped_warnings(share: float, *, is_filled: bool = True) -> list[str]:
    """Warn of clipped pixels, where they are more than specks of noise or glints."""
    if share <= FEW_CLIPPED:
        return []
    meaning = "expect ringing around them"
    if is_filled:
        meaning = "their light was inferred from the other pixels"
    return [f"{100 * share:.1f} % of the pixels are clipped: {meaning}"]


def lights_cut(restored: ArrayLike, clipped: ArrayLike, psf: ArrayLike) -> FloatArray:
    """Cut a restored photo to full scale wherever its light may have clipped the photo.

    Parameters
    ----------
    restored : (H, W) or (H, W, 3) array_like
    clipped : (H, W) array_like of bool
        Clipped pixels of the photo.
    psf : (S, S) array_like
        What it was restored with: its reach around the clipped pixels is cut.
    """
    image = np.asarray(restored, dtype=np.float64)
    if not np.any(clipped):
        return image
    size = len(trimmed_psf(psf))
    neighbourhood = ndimage.maximum_filter(np.asarray(clipped, dtype=np.uint8), size) > 0
    if image.ndim == 3:
        neighbourhood = neighbourhood[..., None]
    return np.where(neighbourhood, np.minimum(image, 1), image)


def _tiles(mask: BoolArray) -> list[tuple[slice, slice]]:
    """Rectangles of at most a tile's size that hold all pixels of the mask."""
    rows, columns = (np.arange(0, n, _TILE_PX) for n in mask.shape)
    tiles = []
    for row in rows:
        for column in columns:
            y, x = np.nonzero(mask[row : row + _TILE_PX, column : column + _TILE_PX])
            if len(y):
                down = slice(int(row + y.min()), int(row + y.max() + 1))
                tiles.append((down, slice(int(column + x.min()), int(column + x.max() + 1))))
    return tiles


def _blurred_light(photo: FloatArray, clipped: BoolArray, kernel: FloatArray) -> FloatArray:
    """Light (H, W) of the most likely scene through the kernel, see :func:`fill_clipped`."""
    blur = Blur(kernel, photo.shape)
    shape = blur.grid_shape
    measured, limited = np.zeros((2, *shape), dtype=bool)
    blur.crop(measured)[:] = ~clipped
    blur.crop(limited)[:] = clipped
    start = blur.extend(np.where(clipped, 1.0, photo))
    H_adjoint = _BLUR_PENALTY * np.conj(blur.H)
    divisor = (
        _BLUR_PENALTY * blur.power + _GRADIENT_PENALTY * gradient_power(shape) + _LIGHT_PENALTY
    )
    across, down = forward_differences(start)
    blurred = start
    light = np.maximum(start, 0)
    # scaled multipliers of the blurred scene, its gradients and its sign
    of_blur, of_across, of_down, of_light = np.zeros((4, *shape))
    limit = _TV_WEIGHT / _GRADIENT_PENALTY
    for _ in range(_ROUNDS):
        plain = _GRADIENT_PENALTY * divergence(
            across - of_across, down - of_down
        ) + _LIGHT_PENALTY * (light - of_light)
        data = H_adjoint * blur.spectrum(blurred - of_blur)
        spectrum = (data + blur.spectrum(plain)) / divisor
        scene = blur.image(spectrum)
        reblurred = blur.image(blur.H * spectrum)
        # each variable moves to its multiplier's sum within its own limits
        target = reblurred + of_blur
        fitted = (start + _BLUR_PENALTY * target) / (1 + _BLUR_PENALTY)
        blurred = np.where(measured, fitted, target)
        blurred = np.where(limited, np.maximum(target, CLIPPED_LEVEL), blurred)
        of_blur = target - blurred
        steps_across, steps_down = forward_differences(scene)
        target_across = steps_across + of_across
        target_down = steps_down + of_down
        # the part of a gradient that soft thresholding takes away is the multiplier's next value
        of_across = np.clip(target_across, -limit, limit)
        of_down = np.clip(target_down, -limit, limit)
        across = target_across - of_across
        down = target_down - of_down
        target = scene + of_light
        light = np.maximum(target, 0)
        of_light = target - light
    return blur.crop(reblurred)
