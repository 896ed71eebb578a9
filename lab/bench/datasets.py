"""Photos for benchmarks: folders, layouts of published data sets, or scikit-image's photos; scenes
cut from them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np

from cep.files.images import PICTURE_SUFFIXES, read_image
from lab.bench.own_files import is_own_output
from motdiff.photo_values import luminance
from motdiff.types import FloatArray

Layout = Literal["photos", "gopro", "rsblur", "levin", "koehler"]
"""Layouts of folders, recognised by content: see :func:`layout_of`."""

_BLURRED = ("blur", "blur_gamma")
_COMPARED = 4
_BUNDLED = (  # those that a quick run picks are the first and the sixth
    "astronaut.png",
    "motorcycle_left.png",
    "camera.png",
    "brick.png",
    "hubble_deep_field.jpg",
    "coffee.png",
    "rocket.jpg",
    "gravel.png",
    "ihc.png",
    "retina.jpg",
)
BUNDLED_WARNING = (
    "photos are those of scikit-image: too few and too odd for a claim, name a folder with --data"
)


def bundled_photos() -> tuple[Path, ...]:
    """Ten photos of scikit-image, for a run without a folder: too few and too unusual for a
    claim.
    """
    spec = find_spec("skimage")
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / "data"
    return tuple(folder / name for name in _BUNDLED)


def layout_of(folder: Path | str) -> Layout:
    """Recognise the layout of a folder.

    "gopro" has folders ``sharp`` beside ``blur`` or ``blur_gamma``, "rsblur" has
    ``real_blur/real_blur.png`` beside ``gt/gt_sharp.png``, "levin" has ``.mat`` files that are no
    PSFs of ours, "koehler" has ``Blurry1_1.png``; anything else is "photos".

    Raises
    ------
    ValueError
        If there is no such folder.
    """
    root = _folder(folder)
    if any(root.glob("Blurry*_*.png")):  # before Levin's: its sharp frames come as .mat files too
        return "koehler"
    if not all(is_own_output(path) for path in root.glob("*.mat")):
        return "levin"
    if next(root.rglob("gt_sharp.png"), None) or next(root.rglob("real_blur.png"), None):
        return "rsblur"
    halves = {
        path.name
        for path in root.rglob("*")
        if path.name in ("sharp", *_BLURRED) and path.is_dir()
    }
    return "gopro" if halves else "photos"


def photo_folder(folder: Path | str) -> tuple[Path, ...]:
    """List the sharp photos of a folder, sorted: all of them, or the sharp halves of GoPro's and
    RSBlur's layouts.

    Pictures written by the project's own commands are left out: see :mod:`lab.bench.own_files`.

    Parameters
    ----------
    folder : folder, searched with its subfolders

    Raises
    ------
    ValueError
        If there is no such folder, it holds no photos or blurred ones only, or blurred and sharp
        ones are mixed up: a sequence lacks one half, names or sizes differ, or the half called
        sharp is less sharp.
    """
    root = _folder(folder)
    layout = layout_of(root)
    if layout == "levin":
        raise ValueError(
            f"{root}: holds Levin's .mat files, blurred already; a folder of sharp photos is"
            " needed"
        )
    if layout == "koehler":
        raise ValueError(
            f"{root}: holds Koehler's photos, blurred already; a folder of sharp photos is needed"
        )
    if layout == "gopro":
        return _sharp_of_gopro(root)
    if layout == "rsblur":
        paired = next(root.rglob("real_blur.png"), None) is not None
        photos = (
            [sharp for _, sharp in rsblur_pairs(root)]
            if paired
            else sorted(root.rglob("gt/gt_sharp.png"))
        )
        what = "gt/gt_sharp.png, the sharp halves of RSBlur's layout"
    elif root.name in _BLURRED:
        raise ValueError(
            f"{root}: is the blurred half of GoPro's layout; give the folder above it"
        )
    else:
        photos = _photos(root.rglob("*"))
        what = "photos (.png, .jpg or .tif)"
    if not photos:
        raise ValueError(f"{root}: holds no {what}")
    return tuple(photos)


def pick(photos: Sequence[Path], count: int, *, least_px: int) -> tuple[Path, ...]:
    """Choose photos evenly over the list (neighbours are often frames of one film), all of them
    where there are fewer.

    For one that is too small the next in the list is taken.

    Parameters
    ----------
    photos : sequence of Path
    count : int
    least_px : int, px
        Shortest side that is needed.

    Raises
    ------
    ValueError
        If none is large enough, or one cannot be read; the line names it.
    """
    number = min(count, len(photos))
    chosen: dict[int, Path] = {}
    small: dict[int, ValueError] = {}
    for i in range(number):
        start = i * len(photos) // number
        for index in [*range(start, len(photos)), *range(start)]:
            if index in chosen or index in small:
                continue
            try:
                _large_enough(photos[index], read_image(photos[index]), least_px)
            except _TooSmallError as error:
                small[index] = error
                continue
            chosen[index] = photos[index]
            break
    if small and not chosen:
        raise small[min(small)]
    return tuple(chosen[index] for index in sorted(chosen))


def crop(path: Path, size: int, rng: np.random.Generator, *, gamma: str = "linear") -> FloatArray:
    """Cut a square at random from a photo.

    Parameters
    ----------
    path : Path
    size : int, px
    rng : numpy Generator
    gamma : {"linear", "srgb"}
        "linear" uses code values as light, as the literature does; "srgb" decodes them to light.

    Returns
    -------
    (size, size) or (size, size, 3) float, 0..1

    Raises
    ------
    ValueError
        If the photo is too small or cannot be read; the line names it.
    """
    image = read_image(path, gamma=gamma)
    _large_enough(path, image, size)
    row, column = (int(rng.integers(length - size + 1)) for length in image.shape[:2])
    return np.ascontiguousarray(image[row : row + size, column : column + size])


def _folder(folder: Path | str) -> Path:
    root = Path(folder)
    if not root.is_dir():
        raise ValueError(
            f"{root}:"
            f" {'is a file, a folder of photos is needed' if root.exists() else 'no such folder'}"
        )
    return root


def _photos(paths: Iterable[Path]) -> list[Path]:
    return sorted(
        p
        for p in paths
        if p.suffix.lower() in PICTURE_SUFFIXES
        and not p.name.startswith(".")
        and p.is_file()
        and not is_own_output(p)
    )


def _sharp_of_gopro(root: Path) -> tuple[Path, ...]:
    halves = [
        path for path in root.rglob("*") if path.name in ("sharp", *_BLURRED) and path.is_dir()
    ]
    sharp: list[Path] = []
    pairs: list[tuple[Path, Path]] = []
    for sequence in sorted({half.parent for half in halves}):
        blurred = [half for half in halves if half.parent == sequence and half.name in _BLURRED]
        if not (sequence / "sharp").is_dir():
            raise ValueError(
                f"{sequence}: has {blurred[0].name} but no folder sharp beside it, as GoPro's"
                " layout has"
            )
        sharp_files = {path.name: path for path in _photos((sequence / "sharp").glob("*"))}
        for half in blurred:
            blurred_files = {path.name: path for path in _photos(half.glob("*"))}
            if odd := sorted(sharp_files.keys() ^ blurred_files.keys()):
                raise ValueError(
                    f"{sequence}: {odd[0]} is in only one of {half.name} and sharp, which must be"
                    " pairs"
                )
            pairs += [(blurred_files[name], sharp_files[name]) for name in sharp_files]
        sharp += sharp_files.values()
    if not sharp:
        raise ValueError(f"{root}: its folders sharp hold no photos (.png, .jpg or .tif)")
    _check_some(root, pairs)
    return tuple(sharp)


def _check_some(root: Path, pairs: Sequence[tuple[Path, Path]]) -> None:
    """Refuse where of a few pairs, evenly chosen, one differs in size, or most are sharper on the
    blurred side.
    """
    count = min(_COMPARED, len(pairs))
    swapped = 0
    for blurred, sharp in (pairs[i * len(pairs) // count] for i in range(count)):
        images = [read_image(path, gamma="linear") for path in (blurred, sharp)]
        names = [f"{path.parent.name}/{path.name}" for path in (blurred, sharp)]
        if images[0].shape[:2] != images[1].shape[:2]:
            sizes = [f"{image.shape[1]} x {image.shape[0]} px" for image in images]
            place = sharp.parent.parent
            raise ValueError(
                f"{place}: {names[0]} has {sizes[0]}, {names[1]} {sizes[1]}; they must be pairs"
            )
        swapped += _detail(images[0]) > _detail(images[1])
        if 2 * swapped > count:
            raise ValueError(
                f"{root}: blurred and sharp photos seem to be swapped: {names[0]} is sharper than"
                f" {names[1]}"
            )


def _detail(image: FloatArray) -> float:
    """Mean size of the differences between neighbours."""
    grey = luminance(image)
    return float(np.abs(np.diff(grey, axis=0)).mean() + np.abs(np.diff(grey, axis=1)).mean())


class _TooSmallError(ValueError):
    """A photo does not hold the crop."""


def _large_enough(path: Path, image: FloatArray, least_px: int) -> None:
    height, width = image.shape[:2]
    if min(height, width) < least_px:
        raise _TooSmallError(
            f"{path}: {width} x {height} px is too small, the protocol needs {least_px} px a side"
        )


RSBLUR_LIST = "RSBlur_real_test.txt"
"""RSBlur's own list of the pairs to test on; where a folder holds it, the other pairs do not
count."""

_BLURRED_OF_PAIRS = "real_blur/real_blur.png"
_SHARP = "gt/gt_sharp.png"
_LINE = re.compile(
    rf"(?:\S*/)?([^/\s]+/[^/\s]+)/{_SHARP}\s+(?:\S*/)?([^/\s]+/[^/\s]+)/{_BLURRED_OF_PAIRS}"
)
_SHOT = re.compile(r"Blurry(\d+)_(\d+)\.png")
_FRAME = re.compile(r"GroundTruth\d+_\d+_(\d+)\.png")


def rsblur_pairs(root: Path) -> list[tuple[Path, Path]]:
    """List RSBlur's blurred and sharp photos, ``SCENE/NUMBER/real_blur/real_blur.png`` and
    ``.../gt/gt_sharp.png``.

    Parameters
    ----------
    root : folder, searched with its subfolders

    Returns
    -------
    list of (blurred, sharp), sorted; those of :data:`RSBLUR_LIST` where the folder holds it

    Raises
    ------
    ValueError
        If one lacks its other half, or the list names one that is not there.

    References
    ----------
    Rim et al., "Realistic blur synthesis for learning image deblurring", ECCV 2022.
    """
    blurred = {path.parent.parent: path for path in root.rglob(_BLURRED_OF_PAIRS)}
    sharp = {path.parent.parent: path for path in root.rglob(_SHARP)}
    if odd := sorted(blurred.keys() ^ sharp.keys()):
        missing = _SHARP if odd[0] in blurred else _BLURRED_OF_PAIRS
        raise ValueError(f"{odd[0]}: lacks {missing}; RSBlur's photos must be pairs")
    places = sorted(blurred)
    listed = root / RSBLUR_LIST
    if listed.is_file():
        by_name = {"/".join(place.absolute().parts[-2:]): place for place in places}
        names = _listed(listed)
        if absent := [name for name in names if name not in by_name]:
            raise ValueError(f"{listed}: names {absent[0]}, which is not in this folder")
        places = sorted(by_name[name] for name in names)
    return [(blurred[place], sharp[place]) for place in places]


def koehler_pairs(root: Path) -> list[tuple[Path, Path | None]]:
    """List Koehler's photos ``BlurryI_J.png``, image I shaken by J, each with a sharp frame where
    there are frames.

    The frames are those of the camera stepped through the same shake,
    ``ImageI/KernelJ/GroundTruthI_J_K.png``. The one in the middle is taken; the benchmark's own
    score is the best over all of them.

    Parameters
    ----------
    root : folder

    Returns
    -------
    list of (blurred, sharp), None for each sharp one where the folder holds no frames

    Raises
    ------
    ValueError
        If some photos have frames and others none.

    References
    ----------
    Koehler et al., "Recording and playback of camera shake", ECCV 2012.
    """
    shots = {
        (int(match[1]), int(match[2])): path
        for path in root.glob("Blurry*_*.png")
        if (match := _SHOT.fullmatch(path.name))
    }
    frames = {key: _frames(root / f"Image{key[0]}" / f"Kernel{key[1]}") for key in shots}
    without = [key for key in sorted(shots) if not frames[key]]
    if without and len(without) < len(shots):
        image, shake = without[0]
        raise ValueError(
            f"{root}: Blurry{image}_{shake}.png has no frames in Image{image}/Kernel{shake},"
            " others have"
        )
    return [
        (shots[key], frames[key][(len(frames[key]) - 1) // 2] if frames[key] else None)
        for key in sorted(shots)
    ]


def _listed(path: Path) -> list[str]:
    """Read the list: a sharp and a blurred photo a line; names are SCENE/NUMBER."""
    names = []
    for number, line in enumerate(
        path.read_text(encoding="utf-8", errors="replace").splitlines(), 1
    ):
        match = _LINE.fullmatch(line.strip())
        if match is not None and match[1] == match[2]:
            names.append(match[1])
        elif line.strip():
            raise ValueError(
                f"{path}: line {number}: wanted 0001/000022/{_SHARP}"
                f" 0001/000022/{_BLURRED_OF_PAIRS}, got {line[:80]!r}"
            )
    if not names:
        raise ValueError(f"{path}: names no pair")
    return names


def _frames(folder: Path) -> list[Path]:
    frames = [
        (int(match[1]), path)
        for path in folder.glob("*.png")
        if (match := _FRAME.fullmatch(path.name))
    ]
    return [path for _, path in sorted(frames)]


@dataclass(frozen=True)
class Cut:
    """A scene as a square cut from a photo.

    Attributes
    ----------
    size_px : int, px
    gamma : {"linear", "srgb"}
        Whether code values are used as light, or decoded to it.
    seed : tuple of int
        Of the place.
    """

    size_px: int
    gamma: Literal["linear", "srgb"]
    seed: tuple[int, ...]


def sharp_scene(photo: Path, cut: Cut) -> FloatArray:
    """Cut the scene's luminance, (size, size) linear light 0..1, read-only.

    Raises
    ------
    ValueError
        If the file is no photo, or too small.
    OSError
        If there is none.
    """
    status = photo.stat()
    return _read(photo, cut, (status.st_mtime_ns, status.st_size))


@lru_cache(maxsize=16)
def _read(photo: Path, cut: Cut, _state: tuple[int, int]) -> FloatArray:
    # kept from cell to cell: a camera's photo of 24 megapixels takes longer to read than its crop
    # to restore
    scene = luminance(crop(photo, cut.size_px, np.random.default_rng(cut.seed), gamma=cut.gamma))
    scene.flags.writeable = False
    return scene


def labels_of(photos: Sequence[Path]) -> tuple[str, ...]:
    """Name photos: by their stems where these differ, otherwise by their paths below the folder
    they share.
    """
    stems = [path.stem for path in photos]
    if len(set(stems)) == len(stems):
        return tuple(stems)
    parts = [path.absolute().parts for path in photos]
    shared = next(i for i, level in enumerate(zip(*parts, strict=False)) if len(set(level)) > 1)
    return tuple("/".join(parts_of_path[shared:]) for parts_of_path in parts)
