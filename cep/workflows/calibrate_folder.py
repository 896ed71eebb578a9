"""Folders of photos and of motions: what is in them, and the motion of one photo as the work of a cell."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from cep.io.files import plain
from cep.io.images import PHOTO_SUFFIXES, read_image, read_photo
from cep.jobs.cells import Figure
from cep.jobs.fingerprint import source_version
from cep.workflows.calibrate import METHODS, estimate_motion
from motdiff.estimators.base import MotionEstimate
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory

__all__ = [
    "estimate_from_figures",
    "estimate_photo",
    "estimator_version",
    "motions_in",
    "photos_in",
    "sharp_of",
    "unreadable",
]

_MOTION = "trajectory.json"
_WITH_TORCH = ("motdiff", "pmp")


# -- what is in a folder ----------------------------------------------------------------------------------------------


def photos_in(folder: Path | str, *, but: Path | None = None) -> tuple[Path, ...]:
    """List the photos of a folder, sorted; no hidden files, no subfolders, and no pictures of PSFs.

    A ``NAME_psf.png`` beside ``NAME_psf.npy`` is what ``cep simulate`` writes beside a photo.

    Parameters
    ----------
    folder : Path
    but : Path, optional
        A photo that is left out.

    Raises
    ------
    ValueError
        If there are none, or two would have the same name without its suffix.
    """
    root = Path(folder)
    found = [
        path
        for path in sorted(root.iterdir())
        if path.suffix.lower() in PHOTO_SUFFIXES
        and not path.name.startswith(".")
        and not (path.name.endswith("_psf.png") and path.with_suffix(".npy").is_file())
        and (path.is_file() or not path.exists())  # a link that leads nowhere is told of, not passed over
        and not (but is not None and path.exists() and path.samefile(but))
    ]
    if not found:
        raise ValueError(f"{root}: holds no photos (.png, .tif, .jpg, .webp or RAW files; subfolders are left alone)")
    by_stem: dict[str, Path] = {}
    for path in found:
        other = by_stem.setdefault(path.stem.casefold(), path)  # some file systems do not tell A from a
        if other is not path:
            raise ValueError(
                f"{root}: {other.name} and {path.name} would be written to one folder {path.stem}; rename one of them"
            )
    return tuple(found)


def motions_in(folder: Path | str) -> dict[str, Path]:
    """List the motions of a folder that :func:`photos_in` led to, ``FOLDER/NAME/trajectory.json``, by name, sorted.

    Raises
    ------
    ValueError
        If there is no such folder, or it holds no motions.
    """
    root = Path(folder)
    if not root.is_dir():
        raise ValueError(f"{root}: {'is a file, a folder of motions is needed' if root.exists() else 'no such folder'}")
    found = {path.parent.name: path for path in sorted(root.glob(f"*/{_MOTION}")) if not path.is_dir()}
    if not found:
        single = root / _MOTION
        hint = f"; for a single motion give --trajectory {single}" if single.is_file() else ""
        raise ValueError(f"{root}: holds no */{_MOTION}, as cep calibrate FOLDER writes them{hint}")
    if odd := [name for name in found if not _spelled(name)]:
        raise ValueError(f"{root}: the name {odd[0]!a} is no UTF-8, rename it")
    return found


def unreadable(photo: Path) -> str:
    """Say why a photo cannot even be opened, empty where it can; and a name that no table can hold is refused."""
    if not _spelled(photo.name):
        return "the name is no UTF-8, rename it"
    try:
        photo.open("rb").close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def sharp_of(photos: Iterable[Path], sharp: Path | str) -> dict[Path, Path]:
    """Find the sharp photo of each blurred one: the same for all, or of the same name in a folder.

    Parameters
    ----------
    photos : iterable of Path
    sharp : Path
        A photo, or a folder with a photo for each.

    Raises
    ------
    ValueError
        If the folder lacks one; the line names it.
    """
    root = Path(sharp)
    if not root.is_dir():
        return dict.fromkeys(photos, root)
    by_stem = {path.stem: path for path in photos_in(root)}
    pairs = {}
    for photo in photos:
        if photo.stem not in by_stem:
            raise ValueError(f"{root}: holds no sharp photo named {photo.stem}, for {photo}")
        pairs[photo] = by_stem[photo.stem]
    return pairs


def _spelled(name: str) -> bool:
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:  # bytes that the file system had and Python keeps as lone surrogates
        return False
    return True


# -- one photo --------------------------------------------------------------------------------------------------------


def estimate_photo(
    *,
    photo: Path,
    method: str,
    samples: int | None = None,
    gamma: str = "srgb",
    seed: int = 0,
    sharp: Path | None = None,
) -> dict[str, Figure]:
    """Estimate the motion in a photo on one thread: the work of a cell, see :mod:`cep.jobs.engine`.

    Parameters
    ----------
    photo : Path
    method, samples, seed
        As of :func:`cep.workflows.calibrate.make_estimator`, any method but "gyro".
    gamma : str
        Of the photos, as of :func:`cep.io.images.read_photo`.
    sharp : Path, optional
        For "reference".

    Returns
    -------
    dict
        ``estimate`` and ``warnings`` of the file, as texts for :func:`estimate_from_figures`, and ``seconds``.

    Raises
    ------
    ValueError
        If the photo cannot be read, has no texture, or the estimator refuses it.
    """
    try:
        read = read_photo(photo, gamma=gamma)
        sharp_pixels = None if sharp is None else read_image(sharp, gamma=gamma, variable="x")
        began_s = time.perf_counter()
        # as many as there are workers run at once, and sums must not depend on how many do
        with one_thread() if method in _WITH_TORCH else nullcontext():
            found = estimate_motion(read.pixels, method=method, samples=samples, seed=seed, sharp=sharp_pixels)
    except ValueError as error:
        raise ValueError(str(error).removeprefix(f"{photo}: ")) from None
    seconds = time.perf_counter() - began_s
    warnings = [*(line.removeprefix(f"{photo}: ") for line in read.warnings), *found.warnings]
    return {"estimate": _text_of(found), "warnings": json.dumps(warnings), "seconds": seconds}


def estimate_from_figures(figures: Mapping[str, Figure]) -> tuple[MotionEstimate, list[str]]:
    """Return the estimate as it was, to the last bit, and the warnings about it and its photo."""
    stored: dict[str, Any] = json.loads(str(figures["estimate"]))
    paths = tuple(Trajectory(path["t"], np.array(path["xy"]), path["direction"]) for path in stored.pop("trajectories"))
    psf = np.frombuffer(base64.b64decode(stored["psf"]["data"]), dtype="<f8").reshape(stored["psf"]["shape"])
    warnings = json.loads(str(figures["warnings"]))
    found = MotionEstimate(
        stored["method"], paths, tuple(stored["weights"]), psf, stored["confidence"], details=stored["details"]
    )
    return found, warnings


def estimator_version(method: str) -> str:
    """Fingerprint of all that makes an estimate: the code and, where there are, the weights."""
    files = []
    if method == "motdiff":
        from motdiff.weights import DEFAULT_WEIGHTS

        files.append(DEFAULT_WEIGHTS)
    named = f"motdiff.estimators.{method}" if method in METHODS else method.partition(":")[0]
    followed = [named, "motdiff.simulate"]
    decoding = ["cep.io.images", "motdiff.io.decoding"]
    return source_version(followed, alone=[__name__, "cep.workflows.calibrate", *decoding], files=files)


def _text_of(found: MotionEstimate) -> str:
    """Spell an estimate without its warnings; floats come back as they were."""
    psf = np.ascontiguousarray(found.psf, dtype="<f8")
    return json.dumps(
        {
            "method": found.method,
            "trajectories": [
                {"t": path.t.tolist(), "xy": path.xy.tolist(), "direction": path.direction}
                for path in found.trajectories
            ],
            "weights": [float(weight) for weight in found.weights],
            "psf": {"shape": psf.shape, "data": base64.b64encode(psf.tobytes()).decode()},
            "confidence": float(found.confidence),
            "details": plain(found.details),
        }
    )
