"""Blind estimation measured: Levin's real blurs, simulated shakes, and real photos without truth.

    python benchmarks/blind.py [simulated [DIR]] [--gyro-trace FILE] [--count 24] [--sigma 0.01]
    python benchmarks/blind.py levin DIR       # .mat files with x (sharp), y (blurred), f (kernel)
    python benchmarks/blind.py photos DIR -o OUT   # contact sheet of what was found
    OMP_NUM_THREADS=2 taskset -c 0,1 python benchmarks/blind.py seconds [DIR]   # wall time on two cores, 256 x 256 px
    ... --method motdiff                           # pmp when omitted

Without a folder the sharp photos are scikit-image's own, and without a trace the hand shake is synthetic.

Every figure comes from the estimator's own PSF (what ``cep calibrate`` writes).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from _inputs import FloatArray, smooth_trace
from _inputs import photos as photos_of

from cep.io.images import read_image, write_image
from cep.restoration import restore
from cep.workflows.calibrate import METHODS, make_estimator
from motdiff.crops import CROP_PX
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.evaluation.sets import levin as levin_cases
from motdiff.gyro import GyroTrace
from motdiff.io.gyro_tables import read_gyro
from motdiff.metrics import mnc, mnc_subpixel, psnr_up_to_shift
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import photograph

PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff"}


def pictures(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in PICTURES and "kernel" not in path.name)


def estimated(estimator: Estimator, photo: FloatArray) -> tuple[MotionEstimate, float]:
    start = time.process_time()
    estimate = estimator.estimate(photo)
    return estimate, time.process_time() - start


def levin(folder: Path, estimator: Estimator) -> None:
    rows = []
    print("image            MNC int  sub-pixel  path MNC  conf   TV dB   CPU s   published: MNC   TV dB")
    for case in levin_cases(folder):
        truth, blurred = case.psf, case.photo
        estimate, seconds = estimated(estimator, blurred)
        published = folder / "pmp_kernels" / f"tvmpr_{case.name}_kernel.png"
        figures = [mnc(estimate.psf, truth), mnc_subpixel(estimate.psf, truth)]
        figures += [mnc_subpixel(estimate.trajectories[0].psf(), truth), estimate.confidence]
        figures += [restored_db(blurred, estimate.psf, case.sharp), seconds]
        if published.exists():
            kernel = cv2.imread(str(published), cv2.IMREAD_GRAYSCALE).astype(float)
            kernel /= kernel.sum()
            figures += [mnc_subpixel(kernel, truth), restored_db(blurred, kernel, case.sharp)]
        rows.append(figures)
        print(f"{case.name:16s}", "  ".join(f"{figure:7.3f}" for figure in figures), flush=True)
    print(f"{'mean':16s}", "  ".join(f"{figure:7.3f}" for figure in np.mean(rows, axis=0)))


def restored_db(blurred: FloatArray, psf: FloatArray, sharp: FloatArray) -> float:
    return psnr_up_to_shift(restore(blurred, psf, method="tv").image, sharp)


def wall_times(
    folder: Path | None, trace_file: Path | None, count: int, sigma: float, seed: int, estimator: Estimator
) -> None:
    """Wall time of each estimate, after loading, of photos of 256 x 256 px; the first is not counted."""
    side = CROP_PX + PSF_PX  # the kernel's frame is lost at the borders
    scenes = [scene[:side, :side] for scene in sharp_photos(folder) if min(scene.shape[:2]) >= side]
    took = []
    for kind, photo, _ in shaken(scenes, trace_of(trace_file, seed), count + 1, sigma, seed):
        start = time.perf_counter()
        estimate = estimator.estimate(photo)
        took.append(time.perf_counter() - start)
        searches = estimate.details.get("classical", estimate.details.get("starts"))
        print(f"{kind:14s} {photo.shape}  {took[-1]:5.2f} s  {searches} searches", flush=True)
    print(f"mean {np.mean(took[1:]):.2f} s, {min(took[1:]):.2f} to {max(took[1:]):.2f} s, n {count}")


def trace_of(file: Path | None, seed: int) -> GyroTrace:
    if file is not None:
        return read_gyro(file)
    return smooth_trace(np.random.default_rng(seed), duration_s=60.0, rate_hz=200.0)


def simulated(
    folder: Path | None, trace_file: Path | None, count: int, sigma: float, seed: int, estimator: Estimator
) -> None:
    trace = trace_of(trace_file, seed)
    rows: dict[str, list[list[float]]] = {}
    for i, (kind, photo, psf) in enumerate(shaken(sharp_photos(folder), trace, count, sigma, seed)):
        estimate, seconds = estimated(estimator, photo)
        path_mnc = mnc_subpixel(estimate.trajectories[0].psf(estimate.trajectories[0].frame_size(PSF_PX)), psf)
        rows.setdefault(kind, []).append(
            [mnc(estimate.psf, psf), mnc_subpixel(estimate.psf, psf), path_mnc, estimate.confidence, seconds]
        )
        print(f"{i:3d} {kind:14s}", "  ".join(f"{figure:7.3f}" for figure in rows[kind][-1]), flush=True)
    print("\nkind            MNC int  sub-pixel  path MNC  conf   CPU s   (mean; sd, min of sub-pixel)")
    for kind, figures in rows.items():
        table = np.array(figures)
        means = "  ".join(f"{value:7.3f}" for value in table.mean(axis=0))
        print(f"{kind:14s} {means}   sd {table[:, 1].std():.3f}  min {table[:, 1].min():.3f}  n {len(table)}")
    merged = np.array([row for figures in rows.values() for row in figures])
    for low, high in ((0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        inside = merged[(merged[:, 3] >= low) & (merged[:, 3] < high)]
        if len(inside):
            good = float((inside[:, 1] >= 0.7).mean())
            said = f"confidence {low:.2f}..{min(high, 1):.2f}: said {inside[:, 3].mean():.2f}"
            print(f"{said}, good (sub-pixel MNC >= 0.7) {good:.2f} of {len(inside)}")


def sharp_photos(folder: Path | None) -> list[FloatArray]:
    if folder is None:
        return [image for _, image in photos_of(None)]
    return [read_image(path, gamma="linear") for path in pictures(folder)]  # code values as light, as the field does


def shaken(
    scenes: list[FloatArray], trace: GyroTrace, count: int, sigma: float, seed: int
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Photos with real borders and white noise: Boracchi-Foi (60 px) and gyro motions (12-36 px, 50-500 ms) in turn."""
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
        tiles = [thumbnail(photo), thumbnail(restored), cv2.resize(psf, (300, 300), interpolation=cv2.INTER_NEAREST)]
        strips.append(np.hstack([tile if tile.ndim == 3 else np.repeat(tile[:, :, None], 3, axis=2) for tile in tiles]))
    out.mkdir(parents=True, exist_ok=True)
    write_image(out / "sheet.png", np.clip(np.vstack(strips), 0, 1))


def thumbnail(photo: FloatArray) -> FloatArray:
    """Middle 300 x 300 px, padded when smaller."""
    rows, columns = photo.shape[:2]
    top, left = max(0, (rows - 300) // 2), max(0, (columns - 300) // 2)
    part = photo[top : top + 300, left : left + 300]
    pad = [(0, 300 - part.shape[0]), (0, 300 - part.shape[1])] + [(0, 0)] * (part.ndim - 2)
    return np.pad(np.clip(part, 0, 1), pad)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["simulated", "levin", "photos", "seconds"], nargs="?", default="simulated")
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--gyro-trace", type=Path)
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--sigma", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--gamma", default="srgb")
    parser.add_argument("--method", choices=METHODS[:2], default="pmp")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/blind"))
    given = parser.parse_args()
    if given.folder is None and given.what not in ("simulated", "seconds"):
        parser.error(f"{given.what} needs a folder")
    estimator = make_estimator(given.method)
    if given.what == "levin":
        levin(given.folder, estimator)
    elif given.what in ("simulated", "seconds"):
        measure = simulated if given.what == "simulated" else wall_times
        measure(given.folder, given.gyro_trace, given.count, given.sigma, given.seed, estimator)
    else:
        photos(given.folder, given.out, given.gamma, estimator)


if __name__ == "__main__":
    main()
