"""Photos of the blind table: simulated from sharp scenes, or real ones with sharp references or
kernels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cep.files.images import read_image
from lab.bench.blind.protocol import Protocol
from lab.bench.datasets import crop, koehler_pairs, layout_of, pick, rsblur_pairs
from lab.evaluation.sets import Case, levin_photo
from motdiff.photo_values import luminance
from motdiff.simulate import border_px, photograph, visible
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray


@dataclass(frozen=True)
class Shot:
    """Settings of one simulated photo of a sharp scene.

    Attributes
    ----------
    crop_px, psf_px, borders, gamma, grey
        As of :class:`lab.bench.blind.protocol.Protocol`.
    photons : float or None
        Photo-electrons of full scale; None: no photon noise.
    read_sigma : float
        Standard deviation of the read noise, full scale 1.
    crop_seed, noise_seed : tuple of int
    generator : mapping, optional
        State of the generator that draws both, instead of the seeds.
    """

    crop_px: int
    psf_px: int
    borders: Literal["symmetric", "real"]
    gamma: Literal["linear", "srgb"]
    grey: bool
    photons: float | None
    read_sigma: float
    crop_seed: tuple[int, ...]
    noise_seed: tuple[int, ...]
    generator: Mapping[str, Any] | None = None

    def generators(self) -> tuple[np.random.Generator, np.random.Generator]:
        """Make the generators of the crop and of the noise."""
        if self.generator is None:
            return np.random.default_rng(self.crop_seed), np.random.default_rng(self.noise_seed)
        rng = np.random.default_rng()
        rng.bit_generator.state = self.generator
        return rng, rng


def shot_of(
    protocol: Protocol,
    label: str,
    motion: int,
    photons: float | None,
    generator: Mapping[str, Any] | None = None,
) -> Shot:
    """Return the settings of photo ``label`` with a motion in a protocol; independent of other
    photos and motions.
    """
    name = tuple(label.encode())
    return Shot(
        protocol.crop_px,
        protocol.psf_px,
        protocol.borders,
        protocol.gamma,
        protocol.grey,
        photons,
        protocol.read_sigma if photons is None else protocol.read_noise_e / photons,
        crop_seed=(protocol.seed, 0, *name),
        noise_seed=(protocol.seed, 1, motion, *name),
        generator=generator,
    )


def make_case(photo: Path, motion: Trajectory, shot: Shot) -> Case:
    """Simulate the photo: crop the scene, blur it, add noise, clip it to 0..1.

    Raises
    ------
    ValueError
        If the file is no photo, or too small.
    """
    psf = motion.psf(shot.psf_px)
    side = shot.crop_px + border_px(shot.borders, shot.psf_px)
    of_crop, of_noise = shot.generators()
    scene = crop(photo, side, of_crop, gamma=shot.gamma)
    scene = luminance(scene) if shot.grey else scene
    blurred = photograph(
        scene,
        psf,
        rng=of_noise,
        borders=shot.borders,
        photons_full_scale=shot.photons,
        read_sigma=shot.read_sigma,
    )
    return Case(blurred, psf, visible(scene, shot.psf_px, borders=shot.borders), motion)


# -- real photos ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class RealPhoto:
    """A photo blurred by a real shake.

    Attributes
    ----------
    scene, shake : str
        The scene, and the number of its shake.
    blurred : Path
        Levin's ``.mat`` file holds the sharp photo and the kernel too.
    sharp : Path or None
    """

    scene: str
    shake: str
    blurred: Path
    sharp: Path | None = None


def real_photos(folder: Path | str, count: int) -> tuple[RealPhoto, ...]:
    """List photos with real blur, at most ``count`` of them, evenly chosen; empty where the folder
    has another layout.

    Levin's have sharp photos and kernels, RSBlur's sharp photos, Koehler's sharp frames; Koehler's
    photos as distributed with PMP have neither.

    Raises
    ------
    ValueError
        If there is no such folder, or only some photos have a sharp one.
    """
    root = Path(folder)
    layout = layout_of(folder)
    photos = _LISTED[layout](root) if layout in _LISTED else []
    number = min(count, len(photos))
    # from the first to the last: four of Levin's sixteen are then four scenes with four shakes
    return tuple(photos[i * (len(photos) - 1) // max(number - 1, 1)] for i in range(number))


def check_real(photos: Sequence[RealPhoto], crop_px: int) -> None:
    """Check real photos before any work is done on them.

    Raises
    ------
    ValueError
        If a file is no photo or too small, or a photo and its sharp one differ in size; the line
        names the file.
    """
    for photo in photos:
        if photo.blurred.suffix == ".mat":
            levin_photo(photo.blurred)
            continue
        pick([photo.blurred], 1, least_px=crop_px)
        if photo.sharp is not None:
            _check_sizes(photo.blurred, photo.sharp)


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
    _check_sizes(photo.blurred, photo.sharp)
    return blurred, crop(photo.sharp, crop_px, np.random.default_rng(crop_seed), gamma=gamma)


def _levin(root: Path) -> list[RealPhoto]:
    paths = sorted(root.glob("*.mat"))
    return [
        RealPhoto(path.stem.partition("_")[0], path.stem.partition("_")[2] or "1", path)
        for path in paths
    ]


def _koehler(root: Path) -> list[RealPhoto]:
    pairs = [(path.stem.partition("_"), path, sharp) for path, sharp in koehler_pairs(root)]
    return [RealPhoto(scene, shake, path, sharp) for (scene, _, shake), path, sharp in pairs]


def _rsblur(root: Path) -> list[RealPhoto]:
    places = [(blurred.absolute().parts, blurred, sharp) for blurred, sharp in rsblur_pairs(root)]
    return [RealPhoto(parts[-4], parts[-3], blurred, sharp) for parts, blurred, sharp in places]


def _check_sizes(blurred: Path, sharp: Path) -> None:
    shapes = [read_image(path).shape for path in (blurred, sharp)]
    if shapes[0] != shapes[1]:
        raise ValueError(
            f"{blurred}: has the shape {shapes[0]}, its sharp photo {shapes[1]}; they must be"
            " pairs"
        )


_LISTED = {"levin": _levin, "koehler": _koehler, "rsblur": _rsblur}
