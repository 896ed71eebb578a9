"""Scene of a photo of the user's own: the fit to its power spectrum, and the parts on which gains
are measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cep.files.images import read_photo
from cep.optics.scene import PHOTO, Scene
from cep.photographs.trial import JUDGED_PX, needed_px
from motdiff.photo_values import clipped_mask, luminance
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

LEAST_PX = 64
"""Least side of a photo whose spectrum is fitted."""

MOST_CROPS = 12
_FEW_CROPS = 4  # disjoint parts; fewer are taken with an overlap
_STEP_PX = JUDGED_PX // 2  # from one part to the next where they overlap
_WINDOW_PX = 256  # of the spectrum
_WINDOWS = 8  # along each side, at most
_MOST_CLIPPED = 0.2

BANDS = np.geomspace(1 / 64, 0.5, 14)
"""Ends of the bands, cycles/px."""

_FREQ = np.sqrt(BANDS[1:] * BANDS[:-1])
_PRIOR_STD = (1.0, 0.5)  # of exponent and fall about those of photographs, where a band is 1 dB
_BOUNDS = ((-100.0, 0.0, 0.0, -140.0), (50.0, 5.0, 6.0, 30.0))
_WHITE_DB = 6.0  # a spectrum that falls by less has noise alone


@dataclass(frozen=True)
class ScenePhoto:
    """Sharp photo of the scene that codes are searched for.

    Parameters
    ----------
    light : (H, W) float ndarray
        Linear light, 0..1.
    scene : Scene
        Fitted to windows all over it, with the name of its file.
    """

    light: FloatArray
    scene: Scene

    @classmethod
    def read(cls, path: Path | str) -> ScenePhoto:
        """Read a photo; OSError if that fails.

        ValueError if it is no photo, too small, flat, or more than 20 % of it are clipped.
        """
        pixels = read_photo(path, min_side_px=LEAST_PX).pixels
        clipped = float(clipped_mask(pixels).mean())
        if clipped > _MOST_CLIPPED:
            raise ValueError(
                f"{path}: {100 * clipped:.0f} % of it are at white; give a photo with at most"
                f" {100 * _MOST_CLIPPED:.0f} %"
            )
        try:
            return cls.of(luminance(pixels), name=Path(path).name)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    @classmethod
    def of(cls, light: FloatArray, *, name: str) -> ScenePhoto:
        """Fit the scene of a (H, W) photo in linear light; ValueError if it is flat."""
        side = min(*light.shape, _WINDOW_PX)
        # neighbours overlap by half
        counts = [min(_WINDOWS, 1 + 2 * (length - side) // side) for length in light.shape]
        return cls(light, fitted_scene(windows(light, (side, side), counts), name=name))

    def crops(self, paths: Sequence[Trajectory]) -> tuple[FloatArray, ...]:
        """Cut parts as large as photos along the paths need, at most 12, in a random order.

        They are disjoint where four fit. ValueError if the photo is smaller than one.
        """
        height, width = needed_px(paths)
        rows, columns = self.light.shape
        if rows < height or columns < width:
            raise ValueError(
                f"{self.scene.name}: {columns} x {rows} px is too small for this motion; at least"
                f" {width} x {height} px are needed"
            )
        counts = [rows // height, columns // width]
        limit = MOST_CROPS
        if counts[0] * counts[1] < _FEW_CROPS:
            counts = [1 + (rows - height) // _STEP_PX, 1 + (columns - width) // _STEP_PX]
            limit = _FEW_CROPS
        crops = windows(self.light, (height, width), counts)
        order = np.random.default_rng(0).permutation(len(crops))[:limit]
        return tuple(crops[i] for i in order)


def windows(image: FloatArray, shape: tuple[int, int], counts: Sequence[int]) -> list[FloatArray]:
    """Cut views of a shape from an image, so many down and across, evenly spread over it."""
    starts = [
        np.linspace(0, length - side, count).astype(int).tolist()
        for length, side, count in zip(image.shape, shape, counts, strict=True)
    ]
    height, width = shape
    return [
        image[row : row + height, column : column + width]
        for row in starts[0]
        for column in starts[1]
    ]


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

    Exponent and fall are drawn weakly to those of photographs, the knee is theirs. The pictures
    (H, W), in linear light, have 64 px a side or more. ValueError if they show noise alone.
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
