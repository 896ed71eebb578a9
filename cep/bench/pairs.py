"""Photos with real blur and their sharp ones, as published data sets lay them out."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["RSBLUR_LIST", "koehler_pairs", "rsblur_pairs"]

RSBLUR_LIST = "RSBlur_real_test.txt"
"""RSBlur's own list of the pairs to test on; where a folder holds it, the other pairs do not count."""

_BLURRED, _SHARP = "real_blur/real_blur.png", "gt/gt_sharp.png"
_LINE = re.compile(rf"(?:\S*/)?([^/\s]+/[^/\s]+)/{_SHARP}\s+(?:\S*/)?([^/\s]+/[^/\s]+)/{_BLURRED}")
_SHOT = re.compile(r"Blurry(\d+)_(\d+)\.png")
_FRAME = re.compile(r"GroundTruth\d+_\d+_(\d+)\.png")


def rsblur_pairs(root: Path) -> list[tuple[Path, Path]]:
    """List RSBlur's blurred and sharp photos, ``SCENE/NUMBER/real_blur/real_blur.png`` and ``.../gt/gt_sharp.png``.

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
    blurred = {path.parent.parent: path for path in root.rglob(_BLURRED)}
    sharp = {path.parent.parent: path for path in root.rglob(_SHARP)}
    if odd := sorted(blurred.keys() ^ sharp.keys()):
        missing = _SHARP if odd[0] in blurred else _BLURRED
        raise ValueError(f"{odd[0]}: lacks {missing}; RSBlur's photos must be pairs")
    places = sorted(blurred)
    listed = root / RSBLUR_LIST
    if listed.is_file():
        by_name = {"/".join(place.absolute().parts[-2:]): place for place in places}
        wanted = _listed(listed)
        if absent := [name for name in wanted if name not in by_name]:
            raise ValueError(f"{listed}: names {absent[0]}, which is not in this folder")
        places = sorted(by_name[name] for name in wanted)
    return [(blurred[place], sharp[place]) for place in places]


def koehler_pairs(root: Path) -> list[tuple[Path, Path | None]]:
    """List Koehler's photos ``BlurryI_J.png``, image I shaken by J, each with a sharp frame where there are frames.

    The frames are those of the camera stepped through the same shake, ``ImageI/KernelJ/GroundTruthI_J_K.png``. The one
    in the middle is taken; the benchmark's own score is the best over all of them.

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
        (int(found[1]), int(found[2])): path
        for path in root.glob("Blurry*_*.png")
        if (found := _SHOT.fullmatch(path.name))
    }
    frames = {key: _frames(root / f"Image{key[0]}" / f"Kernel{key[1]}") for key in shots}
    without = [key for key in sorted(shots) if not frames[key]]
    if without and len(without) < len(shots):
        image, shake = without[0]
        raise ValueError(f"{root}: Blurry{image}_{shake}.png has no frames in Image{image}/Kernel{shake}, others have")
    return [(shots[key], frames[key][(len(frames[key]) - 1) // 2] if frames[key] else None) for key in sorted(shots)]


def _listed(path: Path) -> list[str]:
    """Read the list: a sharp and a blurred photo a line; names are SCENE/NUMBER."""
    names = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        found = _LINE.fullmatch(line.strip())
        if found is not None and found[1] == found[2]:
            names.append(found[1])
        elif line.strip():
            raise ValueError(
                f"{path}: line {number}: wanted 0001/000022/{_SHARP} 0001/000022/{_BLURRED}, got {line[:80]!r}"
            )
    if not names:
        raise ValueError(f"{path}: names no pair")
    return names


def _frames(folder: Path) -> list[Path]:
    found = [(int(match[1]), path) for path in folder.glob("*.png") if (match := _FRAME.fullmatch(path.name))]
    return [path for _, path in sorted(found)]
