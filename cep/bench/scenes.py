"""Sharp scenes that photos are taken of: told by file, size and seed, and read where they are needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.bench.photos import crop
from motdiff.crops import luminance

__all__ = ["Cut", "labels_of", "sharp_scene"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Cut:
    """Which square of a photo a scene is.

    Attributes
    ----------
    size_px : int, px
    gamma : {"linear", "srgb"}
        Whether code values are taken for light, or turned into it.
    seed : tuple of int
        Of the place.
    """

    size_px: int
    gamma: Literal["linear", "srgb"]
    seed: tuple[int, ...]


def sharp_scene(photo: Path, cut: Cut) -> FloatArray:
    """Cut the scene's luminance, (size, size) linear light 0..1, read-only.

    Raises
    ------
    ValueError
        If the file is no photo, or too small.
    OSError
        If there is none.
    """
    status = photo.stat()
    return _read(photo, cut, (status.st_mtime_ns, status.st_size))


@lru_cache(maxsize=16)
def _read(photo: Path, cut: Cut, _state: tuple[int, int]) -> FloatArray:
    # kept from cell to cell: a camera's photo of 24 megapixels takes longer to read than its crop to restore
    scene = luminance(crop(photo, cut.size_px, np.random.default_rng(cut.seed), gamma=cut.gamma))
    scene.flags.writeable = False
    return scene


def labels_of(photos: Sequence[Path]) -> tuple[str, ...]:
    """Name photos: by their stems where these differ, otherwise by their paths below the folder they share."""
    stems = [path.stem for path in photos]
    if len(set(stems)) == len(stems):
        return tuple(stems)
    parts = [path.absolute().parts for path in photos]
    shared = next(i for i, level in enumerate(zip(*parts, strict=False)) if len(set(level)) > 1)
    return tuple("/".join(part[shared:]) for part in parts)
