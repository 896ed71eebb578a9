"""Scene that codes are designed for: power spectrum and light of photographs, fitted to 580."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.band import BandSamples
from cep.optics.camera import Camera
from motdiff.types import FloatArray

_LOWEST_CY_PX = 1 / 256  # the power law stops here, or its variance would be infinite
_LEVEL_AT_CY_PX = 0.1


@dataclass(frozen=True)
class Scene:
    """Mean power spectrum of scenes, in decibels, and their mean light.

    ``S(f) = L ((f^2 + f0^2) / 0.1^2)^(-g / 2) (1 + f^2 / fk^2)^-h``, with f0 = 1/256 cycles/px.

    Attributes
    ----------
    exponent : float
        g.
    knee_cy_px : float
        fk, above which the spectrum falls faster: the lens's and the pixels' blur.
    fall : float
        h.
    level_db : float
        ``10 log10 L``. White noise of variance v has the level ``10 log10 v``.
    spread_db : float
        Standard deviation of the level from scene to scene.
    mean : float
        Mean linear light of an all-open exposure, of full scale.
    name : str
        What the scenes are, as a plural or the name of a file.
    """

    exponent: float
    knee_cy_px: float
    fall: float
    level_db: float
    spread_db: float
    mean: float
    name: str = "photographs"

    def counted(self, count: int) -> str:
        """Say how many pictures of such scenes there are."""
        if self.name == PHOTO.name:
            return f"{count} photograph{'s' if count > 1 else ''}"
        return f"{count} part{'s' if count > 1 else ''} of {self.name}"

    def power(self, radius2: ArrayLike) -> FloatArray:
        """Power spectrum at (...) squared frequencies, (cycles/px)^2."""
        f2 = np.asarray(radius2, dtype=np.float64)
        law = ((f2 + _LOWEST_CY_PX**2) / _LEVEL_AT_CY_PX**2) ** (-self.exponent / 2)
        knee = (1 + f2 / self.knee_cy_px**2) ** -self.fall
        return np.asarray(10 ** (self.level_db / 10) * law * knee, dtype=np.float64)


# python -m lab.studies.scene, of BSDS500, Sun-Hays and Urban100: docs/decisions/search.md
PHOTO = Scene(exponent=2.16, knee_cy_px=0.25, fall=0.43, level_db=-12.5, spread_db=4.6, mean=0.23)
"""Photographs in linear light."""

# python -m lab.studies.named_scenes: docs/decisions/search.md
SCENES = {
    "photo": PHOTO,
    "text": Scene(
        exponent=0.40,
        knee_cy_px=0.25,
        fall=3.27,
        level_db=-6.4,
        spread_db=1.8,
        mean=0.61,
        name="text",
    ),
    "texture": Scene(
        exponent=1.49,
        knee_cy_px=0.25,
        fall=2.19,
        level_db=-10.1,
        spread_db=1.9,
        mean=0.21,
        name="textures",
    ),
    "flat-part": Scene(
        exponent=1.93,
        knee_cy_px=0.25,
        fall=0.45,
        level_db=-25.4,
        spread_db=12.8,
        mean=0.21,
        name="flat parts of photographs",
    ),
}
"""Scenes by their names."""


def inverse_scene(samples: BandSamples, *, scene: Scene = PHOTO) -> FloatArray:
    """1 / S, (F, Q): the scene's inverse power spectrum at the samples."""
    return 1 / scene.power(samples.radius2)


def wiener_mse(
    power: FloatArray, samples: BandSamples, noise: float, *, scene: Scene = PHOTO
) -> float:
    r"""Least mean square error of a linear restoration: band mean of ``S N / (S |H|^2 + N)``.

    ``power`` (F,) is |H|^2 at the samples, ``noise`` the variance N per pixel, and S the spectrum
    of the scene.
    """
    # S N / (S |H|^2 + N) = 1 / (|H|^2 / N + 1 / S)
    per_noise = power[:, None] / noise + inverse_scene(samples, scene=scene)
    return float(samples.weight @ (samples.radius2_weight / per_noise).sum(axis=1))


def noise_variance(
    camera: Camera,
    duty: ArrayLike,
    *,
    integration_s: ArrayLike = 0.0,
    scene: Scene = PHOTO,
) -> FloatArray:
    """Variance per pixel of photos of the scene, open for (...) ``duty``.

    Dark current counts for ``integration_s``, as :meth:`cep.optics.camera.Camera.noise_variance`
    has it.
    """
    return camera.noise_variance(
        scene.mean * np.asarray(duty, dtype=np.float64), integration_s=integration_s
    )
