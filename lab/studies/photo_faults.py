"""Kernels of photos with the faults of real ones: a turning camera, clipped light, JPEG, noise.

    python -m lab.studies.photo_faults FILE --photos DIR... --gyro RECORDING [--count 24]
    [--seed 0]

Whole photos of the folders (sides of 400 px and more) along walks, arcs and shakes, while the
camera turns by 0, 0.4 or 1 degree about the photo's middle, exposed up to 2.5 times too long, with
noise of 0.3 to 2 % of full scale, as JPEG of quality 85 or 95, read as sRGB. A row a photo: the
mean sub-pixel MNC of the kernel with the true ones at nine places, the confidence that
``cep calibrate`` states for it, and seconds. One thread; an interrupted run goes on where it
stopped: a row says its options and the version of the estimator.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lab.studies.inputs import (
    add_row,
    case_key,
    finished_cases,
    large_scenes,
    photos,
    refusals,
    study_parser,
    study_version,
)
from lab.studies.motions import KINDS, motion_in_photo
from motdiff.estimators.motdiff.estimator import MotDiffEstimator
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.metrics import mnc_subpixel
from motdiff.photo_values import clipped_mask, luminance, to_display, to_linear
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_LEAST_SIDE_PX = 400
_BORDER_PX = 30  # cut off: what came from outside the scene
_MOMENTS = 161
_PLACES = (0.2, 0.5, 0.8)  # of the photo's height and width
_GOOD_MNC = 0.7


@dataclass(frozen=True)
class FaultyPhoto:
    """A photo (H, W), linear light as read, and how it was taken.

    Attributes
    ----------
    name : str
    light : (H, W) float
    xy : (N, 2) float, px
        Motion of the photo's middle.
    roll_rad : (N,) float
        Turn about it.
    """

    name: str
    light: FloatArray
    xy: FloatArray
    roll_rad: FloatArray

    def psf_at(self, down: float, right: float) -> FloatArray:
        """PSF (S, S) at a place, given as shares of height and width."""
        height, width = self.light.shape
        x, y = (right - 0.5) * width, (down - 0.5) * height
        cosine, sine = np.cos(self.roll_rad), np.sin(self.roll_rad)
        displacement = np.stack([cosine * x + sine * y - x, cosine * y - sine * x - y], axis=1)
        path = Trajectory.from_samples(self.xy + displacement)
        return path.psf(path.frame_size(64))

    def mnc(self, psf: FloatArray) -> float:
        """Mean MNC of a PSF with those at nine places."""
        return float(
            np.mean([mnc_subpixel(psf, self.psf_at(a, b)) for a in _PLACES for b in _PLACES])
        )


def faulty_photos(
    scenes: Sequence[tuple[str, FloatArray]], trace: GyroTrace, *, count: int, seed: int
) -> Iterator[FaultyPhoto]:
    """Simulate the photos."""
    for number in range(count):
        name, light = scenes[(number * 7 + seed) % len(scenes)]
        kind = KINDS[number % len(KINDS)]
        rng = np.random.default_rng([seed, number])
        motion = motion_in_photo(kind, trace, rng, widest_px=45.0)
        moments = np.linspace(0, 1, _MOMENTS)
        xy = np.stack([np.interp(moments, motion.t, axis) for axis in motion.xy.T], axis=1)
        xy -= xy.mean(axis=0)
        degrees = float(rng.choice([0.0, 0.4, 1.0]))
        roll_rad = np.radians(degrees) * (moments - 0.5) * rng.choice([-1, 1])
        gain = float(rng.choice([1.0, 1.5, 2.5]))
        photo = gain * _blurred(luminance(light), xy, roll_rad)
        photo += rng.normal(0, float(rng.choice([0.003, 0.01, 0.02])), photo.shape)
        read = _through_jpeg(photo, quality=int(rng.choice([85, 95])))
        yield FaultyPhoto(f"{number:03d}/{kind}/{degrees:g}/{name}", read, xy, roll_rad)


def _blurred(scene: FloatArray, xy: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Mean of a scene (H, W) moved and turned about its middle, without its borders."""
    height, width = scene.shape
    total = np.zeros_like(scene)
    for (x, y), angle_rad in zip(xy, roll_rad, strict=True):
        matrix = cv2.getRotationMatrix2D((width / 2, height / 2), np.degrees(angle_rad), 1.0)
        matrix[:, 2] += (x, y)
        total += cv2.warpAffine(
            scene, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
    inside = slice(_BORDER_PX, -_BORDER_PX)
    return np.asarray(total[inside, inside] / len(xy), dtype=np.float64)


def _through_jpeg(light: FloatArray, *, quality: int) -> FloatArray:
    values = np.rint(255 * to_display(np.clip(light, 0, 1))).astype(np.uint8)
    _, buffer = cv2.imencode(".jpg", values, [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = cv2.imdecode(buffer, cv2.IMREAD_GRAYSCALE)
    return to_linear(np.asarray(decoded) / 255.0)


def figures(photo: FaultyPhoto, estimator: MotDiffEstimator) -> dict[str, object]:
    """Estimate one photo's motion, and compare it with the truth."""
    began_s = time.perf_counter()
    estimate = estimator.estimate(photo.light)
    return {
        "name": photo.name,
        "mnc": photo.mnc(estimate.psf),
        "confidence": estimate.confidence,
        "psf_confidence": estimate.details["psf_confidence"],
        "clipped": float(clipped_mask(photo.light).mean()),
        "chosen": estimate.details["chosen"],
        "wall_s": time.perf_counter() - began_s,
    }


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of the table: all photos, and those by what the camera turned."""
    yield "| turn, degrees | photos | MNC | good | stated confidence | s, mean | s, worst |"
    yield "|---|---:|---:|---:|---:|---:|---:|"
    for degrees in ("0", "0.4", "1", "all"):
        group = [row for row in rows if degrees in ("all", row["name"].split("/")[2])]
        if not group:
            continue
        mnc, confidence, wall_s = (
            np.array([row[key] for row in group]) for key in ("mnc", "confidence", "wall_s")
        )
        yield (
            f"| {degrees} | {len(group)} | {mnc.mean():.3f} | {(mnc >= _GOOD_MNC).mean():.2f}"
            f" | {confidence.mean():.2f} | {wall_s.mean():.1f} | {wall_s.max():.1f} |"
        )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--photos", type=Path, nargs="+", required=True)
    parser.add_argument("--gyro", type=Path, required=True)
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with refusals(parser):
        finished = finished_cases(options.file)
        trace = read_gyro(options.gyro)
        scenes = large_scenes(
            (scene for folder in options.photos for scene in photos(folder)),
            least_px=_LEAST_SIDE_PX,
        )
    shared = {
        "photos": list(map(str, options.photos)),
        "gyro": str(options.gyro),
        "seed": options.seed,
        "version": study_version("photo_faults"),
    }
    estimator = MotDiffEstimator()
    rows = []
    with one_thread():
        for photo in faulty_photos(scenes, trace, count=options.count, seed=options.seed):
            case = {"name": photo.name, **shared}
            row = finished.get(case_key(case))
            if row is None:
                row = figures(photo, estimator)
                add_row(options.file, {"case": case, **row})
            rows.append(row)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
