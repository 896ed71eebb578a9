"""Photographs of a folder, on which gains are measured."""

from __future__ import annotations

from pathlib import Path

from motdiff.crops import centre_crop
from motdiff.photo_values import luminance, to_linear
from motdiff.training.photos import load_photos
from motdiff.types import FloatArray


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
