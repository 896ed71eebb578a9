"""Power spectra of pictures, and the scene that is fitted to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cep.optics.scene import PHOTO, Scene
from motdiff.types import FloatArray

BANDS = np.geomspace(1 / 64, 0.5, 14)
"""Ends of the bands, cycles/px."""

_FREQ = np.sqrt(BANDS[1:] * BANDS[:-1])
_PRIOR_STD = (1.0, 0.5)  # of exponent and fall about those of photographs, where a band is 1 dB
_BOUNDS = ((-100.0, 0.0, 0.0, -140.0), (50.0, 5.0, 6.0, 30.0))
_WHITE_DB = 6.0  # a spectrum that falls by less has noise alone


def band_levels(grey: FloatArray) -> FloatArray:
    """``10 log10`` of the mean periodogram in each band of a (H, W) picture, (13,)."""
    window = np.outer(*(np.hanning(side + 2)[1:-1] for side in grey.shape))
    mean = float((grey * window).sum() / window.sum())
    density = np.abs(np.fft.fft2((grey - mean) * window)) ** 2 / (window**2).sum()
    f = np.hypot(*np.meshgrid(*(np.fft.fftfreq(side) for side in grey.shape), indexing="ij"))
    band = np.digitize(f, BANDS)
    return np.array([10 * np.log10(density[band == i].mean()) for i in range(1, BANDS.size)])


def fitted_levels(scene: Scene, *, noise_db: float = -np.inf) -> FloatArray:
    """Level of a scene in the middle of each band, with white noise of so many decibels, (13,)."""
    return np.asarray(10 * np.log10(scene.power(_FREQ**2) + 10 ** (noise_db / 10)))


def fitted_scene(pictures: Sequence[FloatArray], *, name: str) -> Scene:
    """Fit a scene to the mean band levels of pictures, with white noise that is no part of it.

    Exponent and fall are drawn weakly to those of photographs, the knee is theirs.

    Parameters
    ----------
    pictures : sequence of (H, W) float ndarrays, linear light
        Of at least 64 px a side.
    name : str

    Raises
    ------
    ValueError
        If the pictures show noise alone.
    """
    from scipy.optimize import least_squares

    pictures = [picture for picture in pictures if np.ptp(picture) > 0]
    if not pictures:
        raise ValueError("is flat: no detail to design for")
    levels = np.array([band_levels(picture) for picture in pictures])
    mean_db = levels.mean(axis=0)
    if mean_db[:3].mean() - mean_db[-3:].mean() < _WHITE_DB:
        raise ValueError("is flat: it shows noise alone, no detail to design for")

    def scene_of(parameters: FloatArray) -> Scene:
        level_db, exponent, fall, _ = map(float, parameters)
        return Scene(
            exponent=exponent,
            knee_cy_px=PHOTO.knee_cy_px,
            fall=fall,
            level_db=level_db,
            spread_db=float(levels.mean(axis=1).std()),
            mean=float(np.mean([picture.mean() for picture in pictures])),
            name=name,
        )

    def misfit(parameters: FloatArray) -> FloatArray:
        scene = scene_of(parameters)
        prior = np.subtract([scene.exponent, scene.fall], [PHOTO.exponent, PHOTO.fall])
        levels_db = fitted_levels(scene, noise_db=parameters[3])
        return np.concatenate([levels_db - mean_db, prior / _PRIOR_STD])

    level_db = float(np.interp(0.1, _FREQ, mean_db))
    start = (level_db, PHOTO.exponent, PHOTO.fall, float(mean_db.min()) - 3)
    return scene_of(least_squares(misfit, start, bounds=_BOUNDS).x)
