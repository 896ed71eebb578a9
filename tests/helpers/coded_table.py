"""A tiny protocol of the coded table, scenes, and estimators that know the path."""

from dataclasses import asdict, replace

import numpy as np

from cep.optics.camera import Camera
from lab.bench.coded.calibrations import (
    CALIBRATIONS,
    POINT,
)
from lab.bench.coded.designs import DESIGNS, MotionPrior, design_code
from lab.bench.coded.protocol import CodedProtocol
from lab.bench.coded.run import Shot
from lab.bench.coded.stages import Exposure
from lab.bench.table_io import Provenance
from motdiff.estimators.base import MotionEstimate
from motdiff.trajectory import Trajectory

INVERSE = "lab.rivals.inverse_filter:inverse_filter"
MADE = Provenance("again", 0, [], [])
TINY = CodedProtocol(
    name="tiny",
    photos=1,
    motions=2,
    crop_px=96,
    borders="symmetric",
    shakes="mixed",
    chips=16,
    open_range=(6, 10),
    objective="noise",
    photons=(),
    calibration_photons=1e4,
    bits=12,
    read_noise_e=0.0,
    restoration=INVERSE,
    border_rounds=10,
    restored_by="psf",
    steps=2000,
    seed=0,
    quick_photos=1,
    quick_motions=1,
    quick_steps=1000,
    quick_photons=(),
)
CLEAN = Camera(photons_full_scale=1e9, read_noise_e=0.0, bits=16)
BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11], [7, 16]])
LOPSIDED = "1101000101101111"


def blocks(side, seed=0):
    """Make a scene with edges in all places and much light and shade."""
    rng = np.random.default_rng(seed)
    return (
        0.05
        + 0.9 * np.kron(rng.random((side // 8 + 1, side // 8 + 1)), np.ones((8, 8)))[:side, :side]
    )


def shown(
    motion,
    *,
    assumed=None,
    bits=LOPSIDED,
    borders="symmetric",
    light_true=True,
    camera=CLEAN,
    side=128,
    **other,
):
    return {
        "scene": blocks(side),
        "exposure": Exposure(motion, bits, light_true, camera, borders, seed=0),
        "assumed": assumed,
        "restoration": "wiener",
        "border_rounds": 10,
        **other,
    }


def written(path, **changes):
    entries = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in asdict(TINY).items()
    } | changes
    lines = (
        f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}"
        for key, value in entries.items()
    )
    path.write_text("\n".join(line for line in lines if not line.endswith("None")) + "\n")
    return str(path)


GUESS = Trajectory.straight(7.0, angle_rad=1.0)
PARAMETRIC = Trajectory.straight(9.0)


class Guesses:
    """Stands in for the slow estimators: always the same motions; at a call it fails or stops."""

    def __init__(self):
        self.photos = []
        self.fails = 0
        self.stops = 0

    def __call__(self, names):
        self.path = PARAMETRIC if names == ["parametric"] else GUESS
        return dict.fromkeys(names, self)

    def estimate(self, photo):
        self.photos.append(photo)
        if len(self.photos) == self.stops:
            raise KeyboardInterrupt
        if len(self.photos) == self.fails:
            raise ValueError("photo: too dark")
        return MotionEstimate("guess", (self.path, BENT), (0.75, 0.25), self.path.psf(32), 0.4)


TOLD = {
    "none": MotionPrior(),
    "class": MotionPrior((BENT, GUESS), (0.5, 0.5)),
    "length": MotionPrior(length_px=20.0),
    "ours": MotionPrior((BENT, GUESS), (0.75, 0.25)),
    **dict.fromkeys(
        (*CALIBRATIONS, POINT), MotionPrior((replace(BENT, direction="known"),), (1.0,))
    ),
    "parametric": MotionPrior((PARAMETRIC,), (1.0,)),
    "parametric oracle": MotionPrior((PARAMETRIC,), (1.0,)),
    "true": MotionPrior((BENT,), (1.0,)),
}


def chosen(design, known=None, **options):
    return design_code(
        design,
        known or TOLD[DESIGNS[design].path],
        **{
            "chips": 16,
            "open_range": (6, 8),
            "objective": "noise",
            "camera": Camera(),
            "steps": 800,
            "rng": np.random.default_rng(0),
            **options,
        },
    )


def shot(design, photo, motion, psnr_db, gains=(10.0, 10.0), photons=None):
    figures = {
        "psnr_db": psnr_db,
        "ssim": 0.5,
        "noise_gain_db": gains[0],
        "reversed_noise_gain_db": gains[1],
        "min_mtf": 0.1,
    }
    return Shot(design, photo, motion, photons, figures, "10", {})
