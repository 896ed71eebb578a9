"""Repeatability of photos that were taken alike: brightness, place and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motdiff.types import FloatArray


@dataclass(frozen=True)
class Repeatability:
    """How alike photos of one scene and motion are.

    Attributes
    ----------
    brightness_spread : float
        Standard deviation of the photos' mean light, over its mean.
    shift_px : float
        Largest displacement of a photo from the first, px.
    noise : float
        Standard deviation of a pixel from photo to photo, rms over the pixels, of white.
    """

    brightness_spread: float
    shift_px: float
    noise: float

    def __str__(self) -> str:
        return (
            f"brightness repeats within {self.brightness_spread:.2%}, the image within"
            f" {self.shift_px:.2f} px, a pixel within {self.noise:.2%} of white"
        )


def repeatability(photos: Sequence[FloatArray]) -> Repeatability:
    """Compare (N >= 2) photos, (H, W) or (H, W, 3) in linear light."""
    import cv2

    stack = np.stack([np.atleast_3d(photo).mean(axis=2) for photo in photos])
    means = stack.mean(axis=(1, 2))
    window = cv2.createHanningWindow(stack.shape[:0:-1], cv2.CV_64F)
    shifts = [cv2.phaseCorrelate(stack[0], photo, window)[0] for photo in stack[1:]]
    return Repeatability(
        brightness_spread=float(means.std(ddof=1) / max(means.mean(), np.finfo(float).tiny)),
        shift_px=float(np.hypot(*np.array(shifts).T).max()),
        noise=float(np.sqrt(stack.var(axis=0, ddof=1).mean())),
    )
