"""Gains that photographs show beside those of the model, by which the model is shifted.

The table beside this file is measured by ``python -m lab.photo_gains.table``: seconds for each
case, which a page that follows a hand, and a first sentence, do not have.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from cep.optics.band import straight_axis
from cep.optics.camera import Camera
from cep.optics.scene import PHOTO
from cep.search.ways import Choice
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

TABLE = Path(__file__).with_name("gains.csv")
"""The table."""

# distances at which a case of the table counts e^-1/2: a third of a step between its cases
_DECADES = 0.4  # of light and of read noise
_OCTAVES = 0.5  # of the extent
_BENT = 2.0  # straight and bent paths count half a step apart


@dataclass(frozen=True, kw_only=True)
class MeasuredGain:
    """A case of the table.

    Attributes
    ----------
    motion : str
    extent_px : float
    straight : int
        1 where the path is straight.
    photons : float
        At full scale.
    read_noise_e : float
    snapshot_model_db, code_model_db : float
        Gain over the open shutter of the best single exposure and of the best code, by the model.
    snapshot_measured_db, code_measured_db : float
        The mean over photographs.
    """

    motion: str
    extent_px: float
    straight: int
    photons: float
    read_noise_e: float
    snapshot_model_db: float
    code_model_db: float
    snapshot_measured_db: float
    code_measured_db: float


@cache
def measured_gains() -> tuple[MeasuredGain, ...]:
    """Return the cases of the table."""
    with TABLE.open(encoding="utf-8", newline="") as stream:
        return tuple(
            MeasuredGain(
                motion=row.pop("motion"),
                straight=int(row.pop("straight")),
                **{name: float(value) for name, value in row.items()},
            )
            for row in csv.DictReader(stream)
        )


def shifts_db(path: Trajectory, camera: Camera) -> dict[Choice, float]:
    """Return what the model's gains over the open shutter lack on photographs, dB, by kind.

    The mean over the table's cases, each with a weight that falls with the distance in light, read
    noise and extent of the motion. Cases far from all of them get the nearest one's.

    Parameters
    ----------
    path : Trajectory
    camera : Camera
    """
    cases = measured_gains()
    places = np.array(
        [_place(case.extent_px, case.straight, case.photons, case.read_noise_e) for case in cases]
    )
    # what of the noise does not come from the light: quantisation counts as well
    photons = camera.photons_full_scale
    variance = float(camera.noise_variance(PHOTO.mean)) - PHOTO.mean / photons
    fixed_e = photons * float(np.sqrt(max(variance, 0.0)))
    place = _place(path.extent_px, straight_axis(path) is not None, photons, fixed_e)
    squares = ((places - place) ** 2).sum(axis=1)
    weights = np.exp(-(squares - squares.min()) / 2)
    weights /= weights.sum()
    lacks = np.array(
        [
            [
                case.snapshot_measured_db - case.snapshot_model_db,
                case.code_measured_db - case.code_model_db,
            ]
            for case in cases
        ]
    )
    snapshot_db, code_db = (float(lack) for lack in weights @ lacks)
    return {"open": 0.0, "snapshot": snapshot_db, "strobe": code_db, "code": code_db}


def _place(extent_px: float, straight: float, photons: float, read_noise_e: float) -> FloatArray:
    """Place of a case, in steps at which it counts e^-1/2."""
    return np.array(
        [
            np.log10(photons) / _DECADES,
            np.log10(max(read_noise_e, 1.0)) / _DECADES,
            np.log2(max(extent_px, 1.0)) / _OCTAVES,
            float(straight) / _BENT,
        ]
    )
