"""Clipped pixels of a photo, replaced by the light that its other pixels and the PSF make likely
there.

Where a photo is clipped, ``blur * scene = photo`` does not hold, and every restoration rings. With
these pixels replaced it does, so any method can follow.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, ndimage

from cep.restoration.borders import extended_shape, membrane_extension
from cep.restoration.spectral import (
    channels_first,
    channels_last,
    gradient_power,
    otf_on_grid,
    trimmed_psf,
)
from cep.restoration.tv import divergence, shrink_gradients
from motdiff.crops import CLIPPED_LEVEL, clipped_mask
from motdiff.threads import side_by_side
from motdiff.types import BoolArray, FloatArray

_TILE_PX = (
    512  # memory for a large photo; a tile is cut to the neighbourhood of its clipped pixels
)
_ROUNDS = 40
_TV_WEIGHT = 1e-3  # docs/decisions/restoration.md
_BLUR_PENALTY = 0.03
_GRADIENT_PENALTY = 1e-2
_LIGHT_PENALTY = 3e-3


def fill_clipped(
    photo: ArrayLike, psf: ArrayLike, *, clipped: ArrayLike | None = None
) -> NDArray[np.floating]:
    r"""Replace the clipped pixels of a photo by the blurred light of the scene that the other
    pixels show.

    The scene x minimises ``|M (K x - y)|^2 / 2 + 1e-3 (|Dx x|_1 + |Dy x|_1)``, M being 1 on the
    photo's other pixels, with ``x >= 0`` and with ``K x`` at :data:`motdiff.crops.CLIPPED_LEVEL`
    or more where the photo is clipped. ADMM splits ``K x``, so that the mask is applied pixel by
    pixel and x is solved for in the Fourier domain. Light from beyond the border is unknown in the
    same way.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psf : (S, S) array_like
        Zero displacement at index ``size // 2``; its sum does not matter.
    clipped : (H, W) array_like of bool, optional
        Which pixels are; those of each channel at the clipped level when omitted.

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
    masks = [
        clipped_mask(channel) if clipped is None else np.asarray(clipped, dtype=bool)
        for channel in channels
    ]
    if not any(mask.any() for mask in masks):
        return np.asarray(photo)
    kernel = kernel / kernel.sum()
    margin = 2 * (
        kernel.shape[0] // 2
    )  # of the pixels whose light comes from where a clipped pixel's does
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
        here = (number, *tile)
        filled[here] = np.where(masks[number][tile], light[inner], filled[here])
    return channels_last(filled)


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
    near = (
        ndimage.maximum_filter(np.asarray(clipped, dtype=np.uint8), trimmed_psf(psf).shape[0]) > 0
    )
    return np.where(near if image.ndim == 2 else near[..., None], np.minimum(image, 1), image)


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
    shape = extended_shape((photo.shape[0], photo.shape[1]), kernel.shape[0])
    frame = (slice(0, photo.shape[0]), slice(0, photo.shape[1]))
    seen, limited = np.zeros((2, *shape), dtype=bool)
    seen[frame], limited[frame] = ~clipped, clipped
    start = membrane_extension(np.where(clipped, 1.0, photo), shape)
    transfer = otf_on_grid(kernel, shape)
    back = _BLUR_PENALTY * np.conj(transfer)
    divisor = (
        _BLUR_PENALTY * np.abs(transfer) ** 2
        + _GRADIENT_PENALTY * gradient_power(shape)
        + _LIGHT_PENALTY
    )
    across, down = shrink_gradients(start, 0.0)
    blurred = start
    light = np.maximum(start, 0)
    # scaled multipliers of the blurred scene, its gradients and its sign
    of_blur, of_across, of_down, of_light = np.zeros((4, *shape))
    for _ in range(_ROUNDS):
        plain = _GRADIENT_PENALTY * divergence(
            across - of_across, down - of_down
        ) + _LIGHT_PENALTY * (light - of_light)
        spectrum = (back * fft.rfft2(blurred - of_blur) + fft.rfft2(plain)) / divisor
        scene = fft.irfft2(spectrum, shape)
        through = fft.irfft2(transfer * spectrum, shape)
        wanted = through + of_blur
        blurred = np.where(seen, (start + _BLUR_PENALTY * wanted) / (1 + _BLUR_PENALTY), wanted)
        blurred = np.where(limited, np.maximum(wanted, CLIPPED_LEVEL), blurred)
        of_blur = wanted - blurred
        steps = shrink_gradients(scene, 0.0)
        wanted_across = steps[0] + of_across
        wanted_down = steps[1] + of_down
        limit = _TV_WEIGHT / _GRADIENT_PENALTY
        of_across, of_down = (
            np.clip(step, -limit, limit) for step in (wanted_across, wanted_down)
        )
        across = wanted_across - of_across
        down = wanted_down - of_down
        wanted = scene + of_light
        light = np.maximum(wanted, 0)
        of_light = wanted - light
    return np.asarray(through[frame], dtype=np.float64)
