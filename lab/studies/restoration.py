"""Restoration methods side by side, with the true PSF and with a slightly wrong one
(docs/decisions/restoration.md).

Motions, light and noise are those of ``python -m lab bench cep --protocol ours``, shutter open and
Raskar-52. The wrong PSF is that of the path, bent and sped up at random until its open PSF is 0.9
alike (MNC).

    OMP_NUM_THREADS=1 python -m lab.studies.restoration PHOTOS
"""

from __future__ import annotations

import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from cep.codes.published import published
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.registry import METHODS
from lab.bench.coded.protocol import coded_protocol, drawn_motions
from lab.bench.datasets import crop, photo_folder, pick
from lab.bench.statistics import mean_interval
from lab.evaluation.metrics import psnr_ssim_up_to_shift
from lab.studies.inputs import refusals, study_parser
from motdiff.metrics import mnc_subpixel
from motdiff.photo_values import luminance
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

PROTOCOL = coded_protocol("ours")
CODES = (ShutterCode("1" * 52), published("raskar-52").code)
LEVELS = (300.0, 1000.0, 10_000.0, 100_000.0)
COMPARED = ("wiener", "tv", "pnp")
TOLD_THE_NOISE = ("wiener", "pnp")
BORDER_PX = 32
ALIKE = 0.9


def alike(path: Trajectory, rng: np.random.Generator) -> Trajectory:
    """Bend the path and change its speed, as far as its open PSF stays as much alike as asked."""
    t = np.linspace(0, 1, 400)
    xy = path.at(t)
    bend = sum(
        rng.normal(size=2) / (k + 1) * np.cos(np.pi * k * t[:, None] + rng.uniform(0, 6))
        for k in range(1, 5)
    )
    speed = sum(rng.normal() / (k + 1) * np.sin(np.pi * k * t) for k in range(1, 4))

    def bent(share: float) -> Trajectory:
        times = np.maximum.accumulate(t + 0.5 * share * speed)
        times = (times - times[0]) / np.ptp(times) + 1e-6 * t
        return Trajectory.from_samples(
            xy + share * np.ptp(xy, axis=0).max() * bend, t=times / times[-1]
        )

    low = 0.0
    high = 0.3
    for _ in range(14):
        middle = (low + high) / 2
        bent_path = bent(middle)
        likeness = mnc_subpixel(bent_path.psf(bent_path.frame_size(PSF_PX)), path.psf(PSF_PX))
        low, high = (middle, high) if likeness > ALIKE else (low, middle)
    return bent(low)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--turns", type=int, default=2, help="motions per photo, 1 to 3")
    options = parser.parse_args()
    side = PROTOCOL.crop_px + PSF_PX - 1
    motions = drawn_motions(PROTOCOL)
    scores: dict[tuple[bool, float, str], list[tuple[float, float, float]]] = defaultdict(list)
    whose: list[int] = []  # photo of each figure
    with refusals(parser):
        photos = pick(photo_folder(options.photos), options.count, least_px=side)
    for number, path in enumerate(photos):
        scene = luminance(crop(path, side, np.random.default_rng([0, 5, number]), gamma="srgb"))
        truth = visible(scene, PSF_PX)
        for turn in range(options.turns):
            index = 3 * (number % 3) + (number + turn) % 3
            wrong = alike(motions[index], np.random.default_rng([9, number, index]))
            for which, code in enumerate(CODES):
                psf = coded_psf(motions[index], code, PSF_PX)
                wrong_psf = coded_psf(wrong, code, wrong.frame_size(PSF_PX))
                whose.append(number)
                for level in LEVELS:
                    camera = PROTOCOL.camera(level)
                    photo = capture(
                        scene,
                        psf,
                        camera=camera,
                        rng=np.random.default_rng([8, number, index, which]),
                    )
                    for is_true, assumed in ((True, psf), (False, wrong_psf)):
                        for name in COMPARED:
                            noise_options = {"camera": camera} if name in TOLD_THE_NOISE else {}
                            started = time.process_time()
                            restored = METHODS[name].function(photo, assumed, **noise_options)
                            seconds = time.process_time() - started
                            psnr_db, ssim = psnr_ssim_up_to_shift(
                                np.clip(restored, 0, 1), truth, crop_px=BORDER_PX
                            )
                            scores[is_true, level, name].append((psnr_db, ssim, seconds))
    print("PSF    electrons  method   PSNR dB   SSIM  CPU-s  pnp less it, dB")
    for (is_true, level, name), figures in scores.items():
        psnr_db, ssim, seconds = np.mean(figures, axis=0)
        gains = np.subtract(scores[is_true, level, "pnp"], figures)[:, 0]
        interval = mean_interval(gains, rng=np.random.default_rng(0), clusters=whose)
        gain = (
            ""
            if name == "pnp"
            else f"{interval.mean:+.2f} [{interval.low:+.2f}, {interval.high:+.2f}]"
        )
        label = "true" if is_true else "wrong"
        print(
            f"{label:6} {level:9.0f}  {name:7} {psnr_db:8.2f} {ssim:6.3f} {seconds:6.2f}  {gain}"
        )


if __name__ == "__main__":
    main()
