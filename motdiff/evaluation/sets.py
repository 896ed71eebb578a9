"""Blurred photos whose motion is known: simulated shakes of sharp photos, and Levin's real ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from motdiff.crops import CROP_PX
from motdiff.io.gyro_tables import read_gyro
from motdiff.io.mat_files import levin_psf, read_mat
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import border_px, photograph, visible
from motdiff.trajectory import Trajectory

if TYPE_CHECKING:
    from motdiff.training.motion_bank import MotionMix

__all__ = [
    "RECIPES",
    "Borders",
    "Case",
    "Recipe",
    "levin",
    "levin_photo",
    "load_scenes",
    "simulated",
]

FloatArray = NDArray[np.float64]
Borders = Literal["real", "symmetric"]

_STREAM = 0x6576616C  # keeps these motions apart from those that a training run of the same seed has drawn


@dataclass(frozen=True)
class Case:
    """A blurred photo with its true kernel and, where known, the sharp photo and the motion.

    Attributes
    ----------
    name : str
        Unlike any other's within its set.
    photo : (H, W) or (H, W, 3) float, linear light 0..1
    psf : (S, S) float
        The true kernel: sum 1, zero displacement at index ``S // 2``.
    sharp : (H, W) or (H, W, 3) float, optional
        The photo without blur, up to a shift of a few pixels.
    trajectory : Trajectory, optional
        The true motion.
    """

    name: str
    photo: FloatArray
    psf: FloatArray
    sharp: FloatArray | None = None
    trajectory: Trajectory | None = None


@dataclass(frozen=True)
class Recipe:
    """Recipe of a simulated set.

    Attributes
    ----------
    motion : {"boracchi-foi", "gyro"}
        Random walks of 60 px, or hand shake of 50-500 ms enlarged to 12-36 px.
    borders : {"real", "symmetric"}
        Light comes from beyond the frame, or the scene is mirrored there.
    sigma : float
        Standard deviation of the noise, full scale 1.
    """

    motion: Literal["boracchi-foi", "gyro"]
    borders: Borders
    sigma: float

    def mix(self, gyro_trace: Path | str | None = None) -> MotionMix:
        """Motions of this recipe.

        Raises
        ------
        ValueError
            If the motion is driven by a gyroscope and there is no recording.
        """
        from motdiff.training.motion_bank import MotionMix

        if self.motion == "boracchi-foi":
            return MotionMix()
        if gyro_trace is None:
            raise ValueError("gyro_trace: gyro-driven motion needs a gyroscope recording, got none")
        return MotionMix(
            boracchi_foi=0.0,
            gyro=1.0,
            min_extent_px=12.0,
            max_extent_px=36.0,
            exposure_s=(0.05, 0.5),
            gyro_trace=str(gyro_trace),
        )


RECIPES: dict[str, Recipe] = {
    "paper": Recipe("boracchi-foi", "symmetric", 0.0),
    "boracchi-foi": Recipe("boracchi-foi", "real", 0.01),
    "gyro": Recipe("gyro", "real", 0.01),
}
"""The simulated sets by name: the MoTDiff paper's test (section IV-A), and two that are closer to photographs."""


def load_scenes(source: Path | str, *, least_px: int, grey: bool = False) -> list[FloatArray | NDArray[np.uint8]]:
    """Read sharp photos, their code values taken as light.

    Parameters
    ----------
    source : folder, or pack of ``python -m motdiff pack``
    least_px : int, px
        Photos with a shorter side are left out.
    grey : bool
        Mean of the channels instead of the colour photo.

    Returns
    -------
    list of (H, W, 3) uint8, or of (H, W) float 0..1 when ``grey``

    Raises
    ------
    ValueError
        If there is no photo large enough, or a file cannot be read.
    """
    from motdiff.training.photos import load_photos

    photos = [photo.numpy().transpose(1, 2, 0) for photo in load_photos(source, least_px=least_px)]
    return [photo.mean(axis=2) / 255.0 for photo in photos] if grey else photos


def simulated(
    photos: Sequence[NDArray[Any]],
    *,
    count: int,
    seed: int,
    mix: MotionMix,
    sigma: float,
    borders: Borders,
    size: int = CROP_PX,
) -> Iterator[Case]:
    """Take blurred photos of sharp scenes; case i depends on the scenes and (seed, i) only.

    Recipes of the same motion share their motions, so that rows of two sets can be compared one by one.

    Parameters
    ----------
    photos : sequence of (H, W) or (H, W, 3), uint8 or float 0..1
        Scene ``i mod len(photos)`` is cropped at random for case i.
    count, seed : int
    mix : MotionMix
        Motions to draw.
    sigma : float
        Standard deviation of the noise of each channel, full scale 1; the photo is clipped to 0..1.
    borders : {"real", "symmetric"}
        "symmetric" blurs the crop with its mirror image beyond the border, as the MoTDiff paper's data.
    size : int, px
        Side of the blurred photos.

    Raises
    ------
    ValueError
        If a photo is too small, ``borders`` is unknown, or there is nothing to do.
    """
    from motdiff.training.motion_bank import draw_motion

    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    side = size + border_px(borders)
    shortest = min((min(photo.shape[:2]) for photo in photos), default=0)
    if shortest < side:
        raise ValueError(f"photos: must be at least {side} x {side} px for {borders} borders, got {shortest} px")
    trace = read_gyro(mix.gyro_trace) if mix.gyro > 0 else None
    for i in range(count):
        rng = np.random.default_rng([_STREAM, seed, i])
        motion = draw_motion(mix, rng, trace)
        scene = photos[i % len(photos)]
        row, column = (int(rng.integers(n - side + 1)) for n in scene.shape[:2])
        crop = _light(scene[row : row + side, column : column + side])
        psf = motion.psf(PSF_PX)
        photo = photograph(crop, psf, rng=rng, borders=borders, read_sigma=sigma)
        yield Case(f"{i:04d}", photo, psf, visible(crop, PSF_PX, borders=borders), motion)


def levin(folder: Path | str) -> Iterator[Case]:
    """Read Levin's real camera shakes, one ``.mat`` file (``x`` sharp, ``y`` blurred, ``f`` kernel) each.

    The true PSF is ``f`` turned by 180 degrees, see :func:`motdiff.io.mat_files.levin_psf`.

    Parameters
    ----------
    folder : folder of the files

    Raises
    ------
    ValueError
        If there are none, or a file lacks a variable.

    References
    ----------
    Levin, Weiss, Durand, Freeman, "Understanding and evaluating blind deconvolution algorithms", CVPR 2009.
    """
    paths = sorted(Path(folder).glob("*.mat"))
    if not paths:
        raise ValueError(f"{folder}: holds no .mat file")
    for path in paths:
        yield levin_photo(path)


def levin_photo(path: Path) -> Case:
    """Read one file of :func:`levin`.

    Raises
    ------
    ValueError
        If it is no ``.mat`` file, lacks a variable, or one is no table of finite numbers.
    """
    data = read_mat(path, "xyf")
    if missing := [name for name in "xyf" if name not in data]:
        raise ValueError(f"{path}: lacks the variable {missing[0]}; wanted x (sharp), y (blurred) and f (kernel)")
    for name, table in data.items():
        if table.ndim != 2 or table.dtype.kind not in "fiub" or not table.size or not np.isfinite(table).all():
            raise ValueError(f"{path}: its variable {name} must be one table of finite numbers")
    sharp, blurred, kernel = (np.asarray(data[name], dtype=np.float64) for name in "xyf")
    if sharp.shape != blurred.shape or kernel.min() < 0 or not 0 < kernel.sum() < np.inf:
        raise ValueError(f"{path}: x and y must have the same size, and f be non-negative and not all zero")
    psf = levin_psf(kernel)
    return Case(path.stem, np.clip(blurred, 0, 1), psf / psf.sum(), sharp)


def _light(crop: NDArray[Any]) -> FloatArray:
    scale = 255.0 if crop.dtype == np.uint8 else 1.0
    return np.asarray(crop, dtype=np.float64) / scale
