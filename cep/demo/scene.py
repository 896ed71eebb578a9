"""What the demo starts from: a bundled photo with a simulated shake, or a blurred photo of one's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cep.camera import Camera, capture
from motdiff.motions import quadratic
from motdiff.simulate import to_linear
from motdiff.trajectory import Trajectory

__all__ = ["Scene", "bundled_scene", "own_photo"]

FloatArray = NDArray[np.float64]

_LENGTH_PX = (24.0, 28.0)
_BEND = 1.5


@dataclass(frozen=True)
class Scene:
    """Where the demo starts.

    Attributes
    ----------
    name : str
        What the photo shows, and where it comes from.
    photo : (H, W) or (H, W, 3) float
        The blurred calibration photo, linear light 0..1.
    sharp : float ndarray, optional
        The scene without blur, wider than the photo; unknown for one's own photo.
    motion : Trajectory, optional
        The motion that blurred it; unknown for one's own photo.
    warnings : tuple of str
    """

    name: str
    photo: FloatArray
    sharp: FloatArray | None = None
    motion: Trajectory | None = None
    warnings: tuple[str, ...] = ()


def bundled_scene(camera: Camera, *, rng: np.random.Generator) -> Scene:
    """Take a photo of a public-domain picture that scikit-image carries, with a shaking hand.

    Parameters
    ----------
    camera : Camera
    rng : numpy Generator
    """
    from skimage import data

    sharp = to_linear(data.astronaut() / 255)
    # a hand accelerates over a short exposure: a bent path that is slower at one end
    motion = quadratic(rng, min_length_px=_LENGTH_PX[0], max_length_px=_LENGTH_PX[1], max_bend=_BEND)
    photo = capture(sharp, motion.psf(motion.frame_size() | 1), camera, rng=rng)
    name = "Astronaut Eileen Collins (NASA, public domain; skimage.data.astronaut), blurred by a simulated hand shake"
    return Scene(name, photo, sharp, motion)


def own_photo(name: str, photo: FloatArray, *, warnings: tuple[str, ...] = ()) -> Scene:
    """Start from a blurred photo (H, W) or (H, W, 3), linear light 0..1, whose motion nobody knows."""
    return Scene(name, photo, warnings=warnings)
