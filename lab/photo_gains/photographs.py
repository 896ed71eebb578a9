"""Twelve photographs of free licence, on which gains are measured (see pictures/README.md)."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from pathlib import Path

import cv2
import numpy as np

from motdiff.crops import centre_crop, luminance
from motdiff.simulate import to_linear
from motdiff.training.photos import load_photos
from motdiff.types import FloatArray


@lru_cache(maxsize=1)
def photographs() -> tuple[FloatArray, ...]:
    """Return the photographs by their names, (300, 300) float64 in linear light; read-only."""
    folder = resources.files("lab.photo_gains") / "pictures"
    scenes = []
    for file in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".png"):
            data = np.frombuffer(file.read_bytes(), np.uint8)
            scene = to_linear(np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)) / 255)
            scene.setflags(write=False)
            scenes.append(scene)
    return tuple(scenes)


def load_scenes(folder: Path, *, side_px: int, count: int | None = None) -> tuple[FloatArray, ...]:
    """Return the middle of a folder's photos, (side_px, side_px) grey in linear light.

    Parameters
    ----------
    folder : Path
    side_px : int
        Smaller photos are left out.
    count : int, optional
        At most so many, evenly through the folder; all when omitted.
    """
    photos = load_photos(folder, least_px=side_px, most_px=4096)
    if count is not None:
        photos = photos[:: max(1, len(photos) // count)][:count]
    grey = (luminance(to_linear(photo.numpy().transpose(1, 2, 0) / 255)) for photo in photos)
    return tuple(centre_crop(scene, side_px, side_px) for scene in grey)
