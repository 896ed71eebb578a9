"""Photos of ``cep shoot``: the frame's code values, and beside them how they were taken."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from cep.files.images import Photo, read_code_values, read_photo
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from hw.cameras.camera import Frame
from motdiff.files.inputs import one_line
from motdiff.files.json_files import fault, json_text, load_schema, read_versioned, stated_schema
from motdiff.files.outputs import new_files
from motdiff.files.trajectories import parse_motion, trajectory_text
from motdiff.metrics import timed_distance_px
from motdiff.photo_values import to_linear
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

PHOTO_SCHEMA = "cep.photo/1"
_SAME_PX = 1e-3  # distance of paths that differ by the rounding of files alone


@dataclass(frozen=True, kw_only=True)
class ShotRecord:
    """How a photo was taken: all that its restoration needs.

    Attributes
    ----------
    code : ShutterCode
        As the shutter played it, without the closed time before it.
    bits : int
        White is the code value ``2**bits - 1``.
    black_level : float
        Code value of no light.
    bayer : str or None
        Colours of the first two rows and columns, as ``RGGB``.
    gamma : {"linear", "srgb"}
    trajectory : Trajectory or None
        Of the image during the code, where it is known.
    noise : Camera or None
        Noise model, where it is known.
    problems : tuple of str
        Why the photo does not count; none where it does.
    details : mapping
        Further figures, by their names in the file.
    """

    code: ShutterCode
    bits: int
    black_level: float = 0.0
    bayer: str | None = None
    gamma: str = "linear"
    trajectory: Trajectory | None = None
    noise: Camera | None = None
    problems: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def counts(self) -> bool:
        """Whether the photo was taken through the whole code, once."""
        return not self.problems

    def light(self, values: np.ndarray[Any, Any]) -> FloatArray:
        """Linear light, 1 at white, of code values; noise below the black level is negative."""
        white = 2**self.bits - 1
        light = (values.astype(np.float64) - self.black_level) / (white - self.black_level)
        if self.bayer is not None:
            light = _interpolated(light, self.bayer)
        return to_linear(light) if self.gamma == "srgb" else light

    def to_dict(self) -> dict[str, Any]:
        """Content of the file."""
        path = self.trajectory
        return {
            "schema": PHOTO_SCHEMA,
            "counts": self.counts,
            "problems": list(self.problems),
            "code": {"bits": self.code.bits, "chip_ns": self.code.chip_ns},
            "bits": self.bits,
            "black_level": self.black_level,
            "bayer": self.bayer,
            "gamma": self.gamma,
            **self.details,
            "noise": self.noise and self.noise.to_dict(),
            "trajectory": path and json.loads(trajectory_text(path)),
        }


def write_shot(folder: Path, stem: str, frame: Frame, record: ShotRecord, *, force: bool) -> Path:
    """Write ``STEM.tif`` and ``STEM.json`` into a folder, both or none; return the photo's path.

    The code values are the frame's own, 8 or 16 bits: nothing is scaled.

    Raises
    ------
    ValueError
        If one is there and ``force`` is not given.
    OSError
        If the disk is full. The photo is then kept in a temporary folder, which a note names.
    """
    try:
        return _written(folder, stem, frame, record, force=force)
    except OSError as error:
        # it cannot be taken again
        with suppress(OSError):
            spare = _written(Path(mkdtemp(prefix="cep-")), stem, frame, record, force=force)
            error.add_note(f"the photo is kept as {spare}")
        raise


def _written(folder: Path, stem: str, frame: Frame, record: ShotRecord, *, force: bool) -> Path:
    import tifffile

    photo = folder / f"{stem}.tif"
    about = photo.with_suffix(".json")
    colours = "rgb" if frame.values.ndim == 3 else "minisblack"
    with new_files([photo, about], force=force) as staged:
        try:
            tifffile.imwrite(staged[photo], frame.values, photometric=colours)
        except OSError as error:
            if error.errno is not None:
                raise
            # numpy names neither the file nor a reason where the disk takes a part
            raise OSError(f"{photo}: cannot be written whole: free space on its disk") from None
        staged[about].write_text(json_text(record.to_dict()), encoding="utf-8")
    return photo


def record_beside(photo: Path | str) -> ShotRecord | None:
    """Read the record beside a photo; None where there is none.

    ValueError if there is one, but damaged; the line names the file.
    """
    path = Path(photo).with_suffix(".json")
    if not path.is_file() or stated_schema(path) != PHOTO_SCHEMA:
        return None
    document = read_versioned(path, PHOTO_SCHEMA)
    if (wrong := fault(document, load_schema("cep.files", "photo"))) is not None:
        raise ValueError(f"{path}: {wrong}")
    noise = document.get("noise")
    samples = document.get("trajectory")
    bits = int(document["bits"])
    black_level = float(document.get("black_level", 0.0))
    if black_level >= 2**bits - 1:
        raise ValueError(f"{path}: black_level {black_level:g} is not below white, {2**bits - 1}")
    try:
        return ShotRecord(
            code=ShutterCode(document["code"]["bits"], int(document["code"]["chip_ns"])),
            bits=bits,
            black_level=black_level,
            bayer=document.get("bayer"),
            gamma=document.get("gamma", "linear"),
            trajectory=None if samples is None else parse_motion(samples).trajectory,
            noise=None if noise is None else Camera.from_dict(noise),
            problems=tuple(document.get("problems", ())),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {one_line(error)}") from None


def stated_motion(
    photos: Sequence[Path], records: Sequence[ShotRecord | None]
) -> Trajectory | None:
    """Return the one motion that the records of photos state; None where none states one.

    ValueError if two state different ones; the line names the photos.
    """
    motions = [
        (photo, record.trajectory)
        for photo, record in zip(photos, records, strict=True)
        if record is not None and record.trajectory is not None
    ]
    for photo, trajectory in motions[1:]:
        if timed_distance_px(trajectory, motions[0][1]) > _SAME_PX:
            raise ValueError(
                f"{photo}: its record has another motion than that of {motions[0][0]}; give"
                " --trajectory"
            )
    return motions[0][1] if motions else None


def read_shot(photo: Path | str, record: ShotRecord) -> Photo:
    """Read a photo as its record says.

    ValueError if it cannot be decoded, or does not hold such code values; the line names it.
    """
    values, warnings = read_code_values(photo)
    if values.max() > 2**record.bits - 1:
        raise ValueError(
            f"{photo}: has code values up to {values.max()}, its record says {record.bits} bits"
        )
    if record.bayer is not None and values.ndim != 2:
        raise ValueError(f"{photo}: has colours, but its record says a mosaic, {record.bayer}")
    return Photo(record.light(values), 8 if record.bits <= 8 else 16, warnings)


def read_light(photo: Path | str, *, gamma: str | float = "srgb") -> Photo:
    """Read a photo as its record says; without one as `cep.files.images.read_photo`."""
    record = record_beside(photo)
    if record is None:
        return read_photo(photo, gamma=gamma)
    return read_shot(photo, record)


def _interpolated(mosaic: FloatArray, bayer: str) -> FloatArray:
    """Colours (H, W, 3) of a mosaic: of each, the mean of the pixels that have it around."""
    import cv2

    rows, columns = np.indices(mosaic.shape) % 2
    colour = np.array(["RGB".index(letter) for letter in bayer])[2 * rows + columns]
    kernel = np.outer([1, 2, 1], [1, 2, 1]).astype(np.float64)
    planes = []
    for index in range(3):
        has_colour = (colour == index).astype(np.float64)
        light, weight = (
            cv2.filter2D(plane, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT)
            for plane in (mosaic * has_colour, has_colour)
        )
        planes.append(np.where(has_colour > 0, mosaic, light / weight))
    return np.stack(planes, axis=-1)
