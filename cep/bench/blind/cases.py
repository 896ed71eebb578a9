"""The photos of a blind table: taken of sharp scenes, or real ones, with what is known of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.bench.blind.protocol import Protocol
from cep.bench.photos import crop, layout_of
from cep.images import read_image
from motdiff.evaluation.sets import Case
from motdiff.simulate import add_noise, blur_symmetric, blur_valid, valid_window
from motdiff.trajectory import Trajectory

__all__ = ["RealPhoto", "Shot", "labels_of", "real_pair", "real_photos", "shot_of", "taken"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Shot:
    """How one photo is taken of a sharp scene.

    Attributes
    ----------
    crop_px, psf_px, borders, gamma, read_noise_e
        As of :class:`cep.bench.blind.protocol.Protocol`.
    photons : float or None
        Photo-electrons of full scale; None: no noise.
    crop_seed, noise_seed : tuple of int
    """

    crop_px: int
    psf_px: int
    borders: Literal["symmetric", "real"]
    gamma: Literal["linear", "srgb"]
    photons: float | None
    read_noise_e: float
    crop_seed: tuple[int, ...]
    noise_seed: tuple[int, ...]


def shot_of(protocol: Protocol, label: str, motion: int, photons: float | None) -> Shot:
    """Say how a protocol takes photo ``label`` with a motion; other photos and motions change nothing about it."""
    name = tuple(label.encode())
    return Shot(
        protocol.crop_px,
        protocol.psf_px,
        protocol.borders,
        protocol.gamma,
        photons,
        protocol.read_noise_e,
        crop_seed=(protocol.seed, 0, *name),
        noise_seed=(protocol.seed, 1, motion, *name),
    )


def taken(photo: Path, motion: Trajectory, shot: Shot) -> Case:
    """Take the photo: crop the scene, blur it, add noise, clip it to 0..1.

    Raises
    ------
    ValueError
        If the file is no photo, or too small.
    """
    psf = motion.psf(shot.psf_px)
    reach = shot.psf_px - 1 if shot.borders == "real" else 0
    scene = crop(photo, shot.crop_px + reach, np.random.default_rng(shot.crop_seed), gamma=shot.gamma)
    if shot.borders == "symmetric":
        sharp, blurred = scene, blur_symmetric(scene, psf)
    else:
        sharp, blurred = scene[valid_window(scene.shape, psf.shape)], blur_valid(scene, psf)
    if shot.photons is not None:
        rng = np.random.default_rng(shot.noise_seed)
        read_sigma = shot.read_noise_e / shot.photons
        blurred = add_noise(blurred, rng, photons_full_scale=shot.photons, read_sigma=read_sigma)
    return Case(photo.stem, np.clip(blurred, 0, 1), psf, sharp, motion)


def labels_of(photos: Sequence[Path]) -> tuple[str, ...]:
    """Name photos: by their stems where these differ, otherwise by their paths below the folder they share."""
    stems = [path.stem for path in photos]
    if len(set(stems)) == len(stems):
        return tuple(stems)
    parts = [path.absolute().parts for path in photos]
    shared = next(i for i, level in enumerate(zip(*parts, strict=False)) if len(set(level)) > 1)
    return tuple("/".join(part[shared:]) for part in parts)


# -- real photos ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RealPhoto:
    """A photo blurred by a real shake.

    Attributes
    ----------
    scene, shake : str
        What it shows, and which of the scene's shakes it has.
    blurred : Path
        Levin's ``.mat`` file holds the sharp photo and the kernel too.
    sharp : Path or None
    """

    scene: str
    shake: str
    blurred: Path
    sharp: Path | None = None


def real_photos(folder: Path | str, count: int) -> tuple[RealPhoto, ...]:
    """List photos with real blur, at most ``count`` of them, evenly chosen; empty where the folder has another layout.

    Levin's come with sharp photos and kernels, RSBlur's with sharp photos; Koehler's, as they are spread with PMP, with
    nothing.

    Raises
    ------
    ValueError
        If there is no such folder, or one of RSBlur's halves is missing.
    """
    root, layout = Path(folder), layout_of(folder)
    found = _LISTED[layout](root) if layout in _LISTED else []
    number = min(count, len(found))
    # from the first to the last: four of Levin's sixteen are then four scenes with four shakes
    return tuple(found[i * (len(found) - 1) // max(number - 1, 1)] for i in range(number))


def real_pair(
    photo: RealPhoto, *, crop_px: int, gamma: str, crop_seed: tuple[int, ...]
) -> tuple[FloatArray, FloatArray | None]:
    """Cut the same square from a real photo and its sharp one, where there is one.

    Raises
    ------
    ValueError
        If a file is no photo or too small, or the two differ in size.
    """
    blurred = crop(photo.blurred, crop_px, np.random.default_rng(crop_seed), gamma=gamma)
    if photo.sharp is None:
        return blurred, None
    shapes = [read_image(path).shape for path in (photo.blurred, photo.sharp)]
    if shapes[0] != shapes[1]:
        raise ValueError(f"{photo.blurred}: has the shape {shapes[0]}, its sharp photo {shapes[1]}; they must be pairs")
    return blurred, crop(photo.sharp, crop_px, np.random.default_rng(crop_seed), gamma=gamma)


def _levin(root: Path) -> list[RealPhoto]:
    paths = sorted(root.glob("*.mat"))
    return [RealPhoto(path.stem.partition("_")[0], path.stem.partition("_")[2] or "1", path) for path in paths]


def _koehler(root: Path) -> list[RealPhoto]:
    paths = sorted(root.glob("Blurry*_*.png"))
    return [RealPhoto(path.stem.partition("_")[0], path.stem.partition("_")[2], path) for path in paths]


def _rsblur(root: Path) -> list[RealPhoto]:
    blurred = {path.parent.parent: path for path in root.rglob("real_blur/real_blur.png")}
    sharp = {path.parent.parent: path for path in root.rglob("gt/gt_sharp.png")}
    if odd := sorted(blurred.keys() ^ sharp.keys()):
        missing = "gt/gt_sharp.png" if odd[0] in blurred else "real_blur/real_blur.png"
        raise ValueError(f"{odd[0]}: lacks {missing}; RSBlur's photos must be pairs")
    return [RealPhoto(at.parent.name or "scene", at.name, blurred[at], sharp[at]) for at in sorted(blurred)]


_LISTED = {"levin": _levin, "koehler": _koehler, "rsblur": _rsblur}
