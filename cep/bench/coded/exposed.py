"""The camera of the coded-exposure table: a scene blurred, with its borders and its noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.camera import Camera
from motdiff.simulate import blur_symmetric, blur_valid

__all__ = ["exposed"]

FloatArray = NDArray[np.float64]


def exposed(scene: ArrayLike, psf: FloatArray, *, borders: str, camera: Camera, rng: np.random.Generator) -> FloatArray:
    """Blur a scene with the ``psf``, whose sum is the share of the light, and take it with the camera.

    Parameters
    ----------
    scene : (H, W) array_like, linear light 0..1
    psf : (S, S) float
    borders : {"real", "symmetric"}
        Light comes from beyond the frame, or the scene is mirrored there.
    camera : Camera
    rng : numpy Generator
    """
    blur = blur_symmetric if borders == "symmetric" else blur_valid
    light = np.maximum(blur(scene, psf), 0.0)
    return camera.expose(light, rng=rng)
