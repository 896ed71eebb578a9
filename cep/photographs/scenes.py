"""Twelve photographs of free licence, in linear light (see pictures/README.md)."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import cv2
import numpy as np

from motdiff.photo_values import to_linear
from motdiff.types import FloatArray

NAMES = (
    "camera",
    "raccoon",
    "gravel",
    "cat",
    "portrait",
    "tissue",
    "astronaut",
    "coffee",
    "grass",
    "rocket",
    "coins",
    "brick",
)
"""The photographs; the first three, and the first six, have about the mean spectrum of all."""


@lru_cache(maxsize=1)
def photographs() -> tuple[FloatArray, ...]:
    """Return the photographs by :data:`NAMES`, (256, 256) in linear light 0..1; read-only."""
    folder = resources.files("cep.photographs") / "pictures"
    scenes = []
    for name in NAMES:
        data = np.frombuffer((folder / f"{name}.jpg").read_bytes(), np.uint8)
        scene = to_linear(np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)) / 255)
        scene.setflags(write=False)
        scenes.append(scene)
    return tuple(scenes)
