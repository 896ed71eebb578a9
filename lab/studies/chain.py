"""The whole chain on simulated hand shakes: (estimate ->) optimise -> capture -> restore, coded
against uncoded.

    python -m lab.studies.chain [--estimate true|pmp] [--shakes 10] [--chips 52] [--seconds 8]
    [--objective mse]

Rows compare exposures of the SAME time along the same path by the PSNR of their Wiener
restorations (camera's noise, 32 px of border cropped). The code is designed once per shake for
both directions of the path, at 10,000 photons. "coded, tested" picks the direction by the
two-direction test, "coded" is told it; "snapshot" opens the shutter only while the image moves
about one pixel. With `--estimate pmp` the path comes from one ordinary blurred photo, and every
restoration but the snapshot's leans on it; PSNR is then up to shift.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable

import numpy as np
from skimage import data

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.direction import compare_psfs
from cep.restoration.wiener import wiener
from cep.search.annealing.anneal import anneal
from cep.search.problem import OBJECTIVES, SearchProblem, open_range_of_duty
from motdiff.metrics import mnc_subpixel, psnr_up_to_shift
from motdiff.motions import boracchi_foi
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

SCENES = (
    "camera",
    "astronaut",
    "coffee",
    "chelsea",
    "rocket",
    "moon",
    "brick",
    "coins",
    "page",
    "clock",
)
LIGHT = (100.0, 300.0, 1000.0, 3000.0, 10_000.0, 30_000.0, 100_000.0)
CROP_PX = 32
READ_NOISE_E = Camera().read_noise_e
SHARP_PX = (
    1.09  # image motion that leaves an exposure practically sharp (Tendero, Morel, Rouge 2013)
)


def scene(name: str) -> np.ndarray:
    image = np.asarray(getattr(data, name)(), dtype=float) / 255
    grey = image if image.ndim == 2 else image[..., :3] @ np.array([0.2126, 0.7152, 0.0722])
    return (grey**2.2)[:384, :384]


def snapshot_psf(path: Trajectory) -> np.ndarray:
    """PSF of the longest single opening around mid-exposure that moves the image by at most
    SHARP_PX.
    """
    low = 0.0
    high = 0.5
    for _ in range(40):
        half = 0.5 * (low + high)
        extent_px = np.ptp(path.at(np.linspace(0.5 - half, 0.5 + half, 101)), axis=0).max()
        low, high = (half, high) if extent_px <= SHARP_PX else (low, half)
    return path.slice_psfs((0.5 - low, 0.5 + low), PSF_PX)[0]


def psnr(restored: np.ndarray, truth: np.ndarray, *, up_to_shift: bool) -> float:
    if up_to_shift:
        return psnr_up_to_shift(restored, truth, crop_px=CROP_PX)
    error = (restored - truth)[CROP_PX:-CROP_PX, CROP_PX:-CROP_PX]
    return float(-10 * np.log10(np.mean(error**2)))


def estimator(name: str) -> Callable[[np.ndarray, Trajectory], Trajectory]:
    if name == "true":
        return lambda _photo, path: path
    from motdiff.estimators.pmp.estimator import PmpEstimator

    return lambda photo, _path: PmpEstimator().estimate(photo).trajectories[0]


def row(label: str, gains: list[float]) -> None:
    mean = np.mean(gains)
    spread = np.std(gains)
    print(f"  {label:<26}{mean:>8.2f}{spread:>8.2f}{min(gains):>8.2f}{max(gains):>8.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--estimate", choices=("true", "pmp"), default="true")
    parser.add_argument("--shakes", type=int, default=10)
    parser.add_argument("--chips", type=int, default=52)
    parser.add_argument("--seconds", type=float, default=8.0, help="search time per shake")
    parser.add_argument("--objective", default="mse", choices=OBJECTIVES)
    parser.add_argument("--duty", default="0.2:0.8", help="LOW:HIGH")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    estimate = estimator(options.estimate)
    shifted = options.estimate != "true"
    light_range = open_range_of_duty(
        options.chips, *(float(share) for share in options.duty.split(":"))
    )
    results: dict[float, dict[str, list[float]]] = {level: defaultdict(list) for level in LIGHT}
    overview = defaultdict(list)
    started = time.process_time()
    for index in range(options.shakes):
        # apart, since a time-limited search draws as often as the machine allows
        rng, search_rng = np.random.default_rng([options.seed, index]).spawn(2)
        sharp = scene(SCENES[index % len(SCENES)])
        path = boracchi_foi(rng)
        truth = visible(sharp, PSF_PX)
        open_psf = path.psf(PSF_PX)
        estimated_path = estimate(capture(sharp, open_psf, camera=Camera(), rng=rng), path)
        problem = SearchProblem.along(
            estimated_path,
            chips=options.chips,
            objective=options.objective,
            direction="unknown",
            open_range=light_range,
        )
        code: ShutterCode = anneal(problem, rng=search_rng, time_s=options.seconds).code
        frame = max(
            PSF_PX, estimated_path.frame_size(), estimated_path.reversed().frame_size()
        )  # a lost estimate can be large
        true_psf = coded_psf(path, code, PSF_PX)
        flash = snapshot_psf(path)
        psfs = [coded_psf(p, code, frame) for p in (estimated_path, estimated_path.reversed())]
        if mnc_subpixel(psfs[1], true_psf) > mnc_subpixel(psfs[0], true_psf):
            psfs.reverse()  # an estimate may run backwards; the first is now the right one
        overview["duty"].append(code.duty)
        overview["pulses"].append(float(code.pulses))
        overview["snapshot"].append(float(flash.sum()))
        overview["mnc"].append(mnc_subpixel(estimated_path.psf(frame), open_psf))
        for level in LIGHT:
            # a raw file's pedestal of 6 sigma: without it, clipped read noise would brighten the
            # darkest photos
            camera = Camera(
                photons_full_scale=level, black_level=min(1.0, 6 * READ_NOISE_E / level)
            )
            coded = capture(sharp, true_psf, camera=camera, rng=rng)
            tested = compare_psfs(coded, *psfs)
            scores = {}
            for name, photo, psf in (
                (
                    "uncoded",
                    capture(sharp, open_psf, camera=camera, rng=rng),
                    estimated_path.psf(frame),
                ),
                ("coded", coded, psfs[0]),
                ("tested", coded, tested.psf),
                ("snapshot", capture(sharp, flash, camera=camera, rng=rng), flash),
            ):
                scores[name] = psnr(wiener(photo, psf, camera=camera), truth, up_to_shift=shifted)
                results[level][name].append(scores[name])
            results[level]["coded - uncoded"].append(scores["coded"] - scores["uncoded"])
            results[level]["coded, tested - uncoded"].append(scores["tested"] - scores["uncoded"])
            results[level]["snapshot - uncoded"].append(scores["snapshot"] - scores["uncoded"])
            results[level]["coded - snapshot"].append(scores["coded"] - scores["snapshot"])
            results[level][tested.direction].append(1.0)
    print(
        f"{options.shakes} shakes, {options.chips} chips, objective {options.objective}: "
        f"mean duty {np.mean(overview['duty']):.2f} in {np.mean(overview['pulses']):.1f} pulses, "
        f"snapshot open for {np.mean(overview['snapshot']):.3f} of the exposure, "
        f"motion {options.estimate} (PSF MNC {np.mean(overview['mnc']):.3f})"
    )
    print(f"  {'PSNR difference, dB':<26}{'mean':>8}{'sd':>8}{'min':>8}{'max':>8}")
    for level, table in results.items():
        print(
            f"{level:g} photons at full scale: uncoded {np.mean(table['uncoded']):.2f} dB, coded"
            f" {np.mean(table['coded']):.2f} dB, snapshot {np.mean(table['snapshot']):.2f} dB;"
            f" direction {len(table['forward'])} right, {len(table['reverse'])} wrong,"
            f" {len(table['undecidable'])} undecidable"
        )
        for label in (
            "coded - uncoded",
            "coded, tested - uncoded",
            "snapshot - uncoded",
            "coded - snapshot",
        ):
            row(label, table[label])
    print(f"{time.process_time() - started:.0f} CPU-s")


if __name__ == "__main__":
    main()
