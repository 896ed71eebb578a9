"""How exactly the motion is found when something besides the photo is known: a sharp photo, or a
gyroscope.

    python -m lab.studies.known_motion [--photos DIR] [--pairs 24] [--gyro-trace FILE] [--seed 0]

Pairs: each photo is blurred by a Boracchi-Foi walk or by an (integrated) smooth shake, real
borders; the sharp photo is 1.5 px off in a random direction; both carry noise of sigma 0.01. Gyro:
rates sampled at 200 Hz with noise, against the path they were taken from. MNC is sub-pixel
throughout.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from scipy import ndimage

from lab.studies.inputs import photos, smooth_trace
from motdiff.estimators.gyro.estimator import GyroEstimator
from motdiff.estimators.reference.estimator import ReferenceEstimator
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace, trajectory_from_gyro
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import photograph

MISREGISTRATION_PX = 1.5
SIGMA = 0.01


def spread(values: list[float]) -> str:
    low, middle, high = np.percentile(values, [10, 50, 90])
    return (
        f"{np.mean(values):.4f} {np.std(values):.4f} {min(values):.4f} {low:.4f} {middle:.4f}"
        f" {high:.4f}"
    )


def reference_rows(folder: Path | None, pairs: int, trace: GyroTrace, seed: int) -> None:
    scores: dict[str, list[float]] = {"boracchi-foi": [], "hand shake": []}
    confidences = []
    seconds = []
    scenes = photos(folder)
    print(
        f"{'photo':24s} {'motion':13s} {'extent px':>9s} {'MNC':>7s} {'confidence':>10s}"
        f" {'uniformity':>10s} CPU-s"
    )
    for index in range(pairs):
        rng = np.random.default_rng([seed, index])
        name, scene = scenes[index % len(scenes)]
        kind = list(scores)[(index + index // len(scenes)) % 2]
        if kind == "boracchi-foi":
            motion = boracchi_foi(rng)
        else:
            exposure_s = float(rng.choice([0.05, 0.1, 0.25, 0.5]))
            motion = random_gyro_motion(
                trace, rng, exposure_s=exposure_s, extent_px=rng.uniform(8, 32)
            )
        psf = motion.psf(motion.frame_size() | 1)
        angle_rad = rng.uniform(0, 2 * np.pi)
        offset = MISREGISTRATION_PX * np.array([np.sin(angle_rad), np.cos(angle_rad)])
        shifted = ndimage.shift(scene, (*offset, 0)[: scene.ndim], order=5, mode="reflect")
        sharp = np.clip(shifted + SIGMA * rng.standard_normal(scene.shape), 0, 1)
        photo = photograph(scene, psf, rng=rng, read_sigma=SIGMA)
        start = time.process_time()
        estimate = ReferenceEstimator(sharp).estimate(photo)
        seconds.append(time.process_time() - start)
        score = mnc_subpixel(estimate.psf, psf)
        scores[kind].append(score)
        confidences.append(estimate.confidence)
        print(
            f"{name[:24]:24s} {kind:13s} {motion.extent_px:9.1f} {score:7.4f}"
            f" {estimate.confidence:10.3f} {estimate.details['uniformity']:10.3f}"
            f" {seconds[-1]:5.1f}  {' '.join(estimate.warnings)}"
        )
    print(f"\n{'reference, MNC':24s} mean   std    min    p10    median p90")
    for kind, values in scores.items():
        print(f"{kind:24s} {spread(values)}  n={len(values)}")
    all_scores = [value for values in scores.values() for value in values]
    print(
        f"{'all':24s} {spread(all_scores)}  n={len(all_scores)}  {np.mean(seconds):.1f} CPU-s a"
        " pair"
    )
    print(
        f"confidence against MNC: correlation {np.corrcoef(confidences, all_scores)[0, 1]:.2f}\n"
    )


def gyro_rows(count: int, seed: int) -> None:
    """Print PSF MNC of the estimator fed sampled, noisy rates against the path of the 4 kHz
    rates.
    """
    print(f"{'gyro, PSF MNC':24s} mean   std    min    p10    median p90")
    focal_px = 3000.0
    fine_hz = 4000.0
    for rate_hz in (100, 200, 400):
        for noise_rad_s in (0.0, 0.002, 0.005):
            scores = []
            for index in range(count):
                rng = np.random.default_rng([seed, index])
                exact = smooth_trace(rng, duration_s=2.0, rate_hz=fine_hz)
                start_s = rng.uniform(0.2, 1.2)
                exposure_s = float(rng.choice([0.05, 0.1, 0.25]))
                window = {"focal_px": focal_px, "start_s": start_s, "exposure_s": exposure_s}
                path = trajectory_from_gyro(exact, **window)
                step = round(fine_hz / rate_hz)
                noisy = exact.rate_rad_s[::step] + noise_rad_s * rng.standard_normal(
                    (len(exact.t_s[::step]), 3)
                )
                estimate = GyroEstimator(GyroTrace(exact.t_s[::step], noisy), **window).estimate(
                    np.zeros((8, 8))
                )
                size = path.frame_size(PSF_PX)
                scores.append(mnc_subpixel(estimate.psf, path.psf(size)))
            print(f"{rate_hz:4d} Hz, noise {noise_rad_s:.3f} rad/s {spread(scores)}  n={count}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--photos", type=Path, help="folder of sharp photos; scikit-image's own when omitted"
    )
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument(
        "--gyro-trace",
        type=Path,
        help="recorded trace for the hand shakes; a synthetic one when omitted",
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng([options.seed, 2**31])
    trace = (
        read_gyro(options.gyro_trace)
        if options.gyro_trace
        else smooth_trace(rng, duration_s=60.0, rate_hz=200.0)
    )
    reference_rows(options.photos, options.pairs, trace, options.seed)
    gyro_rows(options.pairs, options.seed)


if __name__ == "__main__":
    main()
