"""Blind estimation: wall time of an estimate, and contact sheets of real photos without truth.

    OMP_NUM_THREADS=2 taskset -c 0,1 python -m lab.studies.blind seconds [DIR]
    python -m lab.studies.blind photos DIR -o OUT
    ... --method motdiff

The first form takes photos of 256 x 256 px, on two cores; the second draws the contact sheet. The
method is pmp when omitted.

Without a folder the sharp photos are scikit-image's own, without a trace the hand shake is
synthetic. What estimates are worth where the motion is known is measured by ``python -m lab bench
blind``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from cep.files.images import read_image, write_image
from cep.restoration.restore import restore
from lab.studies.inputs import photos as photos_of
from lab.studies.inputs import smooth_trace
from motdiff.crops import CROP_PX
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.registry import blind_methods, make_method
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import photograph
from motdiff.types import FloatArray

PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff"}


def pictures(folder: Path) -> list[Path]:
    return sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in PICTURES and "kernel" not in path.name
    )


def estimated(estimator: Estimator, photo: FloatArray) -> tuple[MotionEstimate, float]:
    start = time.process_time()
    estimate = estimator.estimate(photo)
    return estimate, time.process_time() - start


def wall_times(
    folder: Path | None,
    trace_file: Path | None,
    count: int,
    sigma: float,
    seed: int,
    estimator: Estimator,
) -> None:
    """Wall time of each estimate, after loading, of photos of 256 x 256 px; the first is not
    counted.
    """
    side = CROP_PX + PSF_PX  # the kernel's frame is lost at the borders
    scenes = [
        scene[:side, :side] for scene in sharp_photos(folder) if min(scene.shape[:2]) >= side
    ]
    took = []
    for kind, photo, _ in shaken(scenes, trace_of(trace_file, seed), count + 1, sigma, seed):
        start = time.perf_counter()
        estimate = estimator.estimate(photo)
        took.append(time.perf_counter() - start)
        searches = estimate.details.get("classical", estimate.details.get("starts"))
        print(f"{kind:14s} {photo.shape}  {took[-1]:5.2f} s  {searches} searches", flush=True)
    print(
        f"mean {np.mean(took[1:]):.2f} s, {min(took[1:]):.2f} to {max(took[1:]):.2f} s, n {count}"
    )


def trace_of(file: Path | None, seed: int) -> GyroTrace:
    if file is not None:
        return read_gyro(file)
    return smooth_trace(np.random.default_rng(seed), duration_s=60.0, rate_hz=200.0)


def sharp_photos(folder: Path | None) -> list[FloatArray]:
    if folder is None:
        return [image for _, image in photos_of(None)]
    return [
        read_image(path, gamma="linear") for path in pictures(folder)
    ]  # code values as light, as the field does


def shaken(
    scenes: list[FloatArray], trace: GyroTrace, count: int, sigma: float, seed: int
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Photos with real borders and white noise: Boracchi-Foi (60 px) and gyro motions (12-36 px,
    50-500 ms) in turn.
    """
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        sharp = scenes[(i // 2) % len(scenes)]
        kind = "boracchi-foi" if i % 2 == 0 else "gyro"
        while True:
            if kind == "gyro":
                motion = random_gyro_motion(
                    trace, rng, exposure_s=rng.uniform(0.05, 0.5), extent_px=rng.uniform(12, 36)
                )
            else:
                motion = boracchi_foi(rng)
            if motion.frame_size() <= PSF_PX:
                break
        psf = motion.psf(65)
        grey = sharp.mean(axis=2) if sharp.ndim == 3 else sharp
        yield kind, photograph(grey, psf, rng=rng, read_sigma=sigma), psf


def photos(folder: Path, out: Path, gamma: str, estimator: Estimator) -> None:
    strips = []
    for path in pictures(folder):
        photo = read_image(path, gamma=gamma)
        estimate, seconds = estimated(estimator, photo)
        print(
            f"{path.name:32s} {photo.shape[1]}x{photo.shape[0]}  conf {estimate.confidence:.2f}  "
            f"extent {estimate.trajectories[0].extent_px:5.1f} px  {seconds:5.1f} CPU-s",
            "; ".join(estimate.warnings),
            flush=True,
        )
        restored = restore(photo, estimate.psf, method="tv").image
        psf = np.sqrt(estimate.psf / estimate.psf.max())
        tiles = [
            thumbnail(photo),
            thumbnail(restored),
            cv2.resize(psf, (300, 300), interpolation=cv2.INTER_NEAREST),
        ]
        strips.append(
            np.hstack(
                [
                    tile if tile.ndim == 3 else np.repeat(tile[:, :, None], 3, axis=2)
                    for tile in tiles
                ]
            )
        )
    out.mkdir(parents=True, exist_ok=True)
    write_image(out / "sheet.png", np.clip(np.vstack(strips), 0, 1))


def thumbnail(photo: FloatArray) -> FloatArray:
    """Middle 300 x 300 px, padded when smaller."""
    rows, columns = photo.shape[:2]
    top = max(0, (rows - 300) // 2)
    column = max(0, (columns - 300) // 2)
    crop = photo[top : top + 300, column : column + 300]
    pad = [(0, 300 - crop.shape[0]), (0, 300 - crop.shape[1])] + [(0, 0)] * (crop.ndim - 2)
    return np.pad(np.clip(crop, 0, 1), pad)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["seconds", "photos"], nargs="?", default="seconds")
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--gyro-trace", type=Path)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--sigma", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gamma", default="srgb")
    parser.add_argument("--method", choices=blind_methods(), default="pmp")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/blind"))
    options = parser.parse_args()
    if options.folder is None and options.what == "photos":
        parser.error(f"{options.what} needs a folder")
    estimator = make_method(options.method, {}).make()
    if options.what == "seconds":
        wall_times(
            options.folder,
            options.gyro_trace,
            options.count,
            options.sigma,
            options.seed,
            estimator,
        )
    else:
        photos(options.folder, options.out, options.gamma, estimator)


if __name__ == "__main__":
    main()
