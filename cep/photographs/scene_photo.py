"""Scene of a photo of the user's own: its spectrum, and the parts on which gains are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cep.files.images import read_photo
from cep.optics.scene import Scene
from cep.photographs.spectra import fitted_scene
from cep.photographs.trial import JUDGED_PX, needed_px
from motdiff.crops import clipped_mask, luminance
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
        """Read a photo.

        Raises
        ------
        ValueError
            If it is no photo, too small, flat, or more than 20 % of it are clipped.
        OSError
            If it cannot be read.
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
        """Fit the scene of a (H, W) photo in linear light.

        Raises
        ------
        ValueError
            If it is flat.
        """
        side = min(*light.shape, _WINDOW_PX)
        # neighbours overlap by half
        counts = [min(_WINDOWS, 1 + 2 * (length - side) // side) for length in light.shape]
        return cls(light, fitted_scene(windows(light, (side, side), counts), name=name))

    def crops(self, paths: Sequence[Trajectory]) -> tuple[FloatArray, ...]:
        """Cut parts as large as photos along the paths need, at most 12, in a random order.

        They are disjoint where four fit.

        Raises
        ------
        ValueError
            If the photo is smaller than one.
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
