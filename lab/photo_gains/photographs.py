"""Twelve photographs of free licence, on which gains are measured (see pictures/README.md)."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import cv2
import numpy as np

from motdiff.simulate import to_linear
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
