"""The work of one cell of the coded-exposure table: a stage, on a scene that is read from its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cep.bench.coded.calibrated import estimate_motion
from cep.bench.coded.taken import Taken, photographed, take_photo
from cep.bench.scenes import Cut, sharp_scene

__all__ = ["motion_of", "photo_of", "pictures_of"]


def motion_of(photo: Path, cut: Cut, **arguments: Any) -> dict[str, float | str]:
    """Estimate a motion, as :func:`cep.bench.coded.calibrated.estimate_motion` does."""
    return estimate_motion(sharp_scene(photo, cut), **arguments)


def photo_of(photo: Path, cut: Cut, **arguments: Any) -> dict[str, float]:
    """Take and compare a photo, as :func:`cep.bench.coded.taken.take_photo` does."""
    return take_photo(sharp_scene(photo, cut), **arguments)


def pictures_of(photo: Path, cut: Cut, **arguments: Any) -> Taken:
    """Take the same photo as :func:`photo_of`, to look at."""
    return photographed(sharp_scene(photo, cut), **arguments)
