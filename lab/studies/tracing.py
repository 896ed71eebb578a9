"""Tracing, measured: order along simulated maps, and the PSF that path and fitted dwell make.

    python -m lab.studies.tracing [--maps 200] [--motions 25] [--gyro FILE] [--seed 0]

Without ``--gyro`` the second table uses synthetic shakes: band-limited Gaussian angular rates.
"""

from __future__ import annotations

import time

import numpy as np
from scipy import spatial

from lab.bench.blind.protocol import synthetic_trace
from lab.evaluation.map_tracing import trace_map
from lab.evaluation.metrics import ordered_distance_px
from lab.studies.inputs import refusals, study_parser
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.psf_frame import MAP_CENTRE, MAP_PITCH, PSF_PX
from motdiff.tracing.dwell import fit_dwell
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.trajectory import Trajectory

HR_PX = 0.25
EXPOSURES_S = (0.05, 0.1, 0.25, 0.5)
FRAME = 96  # holds a 24-px motion wherever its centroid lies
NOISE = 0.05  # of the PSF's maximum


def draws_the_same(path: np.ndarray, hr_map: np.ndarray) -> bool:
    """Tell whether a path covers every drawn pixel, and nothing else, within 1.5 pixels of the
    map.
    """
    steps = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    fine = np.linspace(0, steps[-1], int(steps[-1] * 8) + 2)
    on_path = MAP_CENTRE + MAP_PITCH * np.stack(
        [np.interp(fine, steps, path[:, axis]) for axis in (0, 1)], axis=-1
    )
    map_pixels = np.argwhere(hr_map)[:, ::-1]
    reach = 1.5
    missed = spatial.cKDTree(on_path).query(map_pixels)[0] > reach
    invented = spatial.cKDTree(map_pixels).query(on_path)[0] > reach
    return bool(missed.mean() < 0.02 and invented.mean() < 0.02)


def bending(path: np.ndarray) -> float:
    """Sum of squared turns, rad^2, at 1-px spacing: what little order a map can show goes by
    this.
    """
    steps = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    where = np.linspace(0, steps[-1], int(steps[-1]) + 1)
    points = np.stack([np.interp(where, steps, path[:, axis]) for axis in (0, 1)], axis=-1)
    heading = np.diff(points, axis=0) @ np.array([1, 1j])
    return float(np.sum(np.angle(heading[1:] * np.conj(heading[:-1])) ** 2))


def order_table(maps: int, seed: int) -> None:
    distances = []
    lengths = []
    explained = []
    shorter = []
    seconds = 0.0
    for k in range(maps):
        truth = boracchi_foi(np.random.default_rng([seed, k]))
        hr_map = truth.hr_map()
        start = time.process_time()
        path = trace_map(hr_map)
        seconds += time.process_time() - start
        distances.append(ordered_distance_px(path, truth.xy) / HR_PX)
        lengths.append(hr_map.sum() / (4 * truth.length_px))
        explained.append(draws_the_same(path, hr_map))
        shorter.append(bending(path) <= bending(truth.arc_resampled(500)) + 0.3)
    d = np.array(distances)
    same = np.array(explained)
    smooth = np.array(shorter)
    wrong = d > 1
    print(
        f"order, {maps} Boracchi-Foi maps (60 px of path; distance = best monotone matching, up to"
        " reversal)"
    )
    print(f"  right (<= 1 HR px)            {np.mean(~wrong):.3f}")
    print(f"  distance, HR px               mean {d.mean():.2f}  median {np.median(d):.2f}")
    print(f"  distance of the right ones    mean {d[~wrong].mean():.2f}")
    print(
        "  wrong, same pixels, no more bending than the truth (unobservable) "
        f" {np.mean(wrong & same & smooth):.3f}"
    )
    print(
        "  wrong, same pixels, more bending than the truth                   "
        f" {np.mean(wrong & same & ~smooth):.3f}"
    )
    print(
        "  wrong, other pixels                                               "
        f" {np.mean(wrong & ~same):.3f}"
    )
    print(f"  cpu per map {seconds / maps:.3f} s")
    print("  right, by pixels drawn per HR px of arc (little = strands share pixels)")
    lengths_ = np.array(lengths)
    for low, high in ((0, 0.8), (0.8, 0.9), (0.9, 2)):
        inside = (lengths_ >= low) & (lengths_ < high)
        if inside.any():
            print(f"    {low:.1f}..{high:.1f}  {np.mean(~wrong[inside]):.3f} of {inside.sum()}")


def dwell_table(motions: int, trace: GyroTrace, seed: int) -> None:
    print(
        f"\nPSF MNC, sub-pixel, {motions} gyro-driven motions of 24 px per exposure; noise"
        f" {NOISE:.0%} of the maximum"
    )
    print(
        "  exposure   bare map   map + dwell (p5)   + noise   PSF traced (p5)   + noise   map's"
        " order right"
    )
    for exposure_s in EXPOSURES_S:
        rows = []
        for k in range(motions):
            rng = np.random.default_rng([seed, k, int(1000 * exposure_s)])
            truth = random_gyro_motion(trace, rng, exposure_s=exposure_s, extent_px=24.0)
            psf = truth.psf()
            hr_map = truth.hr_map()
            noisy = np.maximum(psf + rng.normal(0, NOISE * psf.max(), psf.shape), 0)
            path = trace_map(hr_map)

            def score(trajectory: Trajectory, psf: np.ndarray = psf) -> float:
                return mnc_subpixel(trajectory.psf(trajectory.frame_size(FRAME)), psf)

            bare = mnc_subpixel(
                hr_map.reshape(PSF_PX, MAP_PITCH, PSF_PX, MAP_PITCH).mean(axis=(1, 3)), psf
            )
            fits = [
                fit_dwell(path, psf),
                fit_dwell(path, noisy),
                *map(trace_psf_to_trajectory, (psf, noisy)),
            ]
            rows.append([bare, *map(score, fits), ordered_distance_px(path, truth.xy) <= HR_PX])
        mean = np.mean(rows, axis=0)
        low = np.percentile(rows, 5, axis=0)
        print(
            f"  {1000 * exposure_s:5.0f} ms   {mean[0]:8.3f}   {mean[1]:.3f} ({low[1]:.3f})     "
            f" {mean[2]:.3f}     {mean[3]:.3f} ({low[3]:.3f})     {mean[4]:.3f}     {mean[5]:.2f}"
        )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--maps", type=int, default=200)
    parser.add_argument("--motions", type=int, default=25)
    parser.add_argument(
        "--gyro", metavar="FILE", help="angular-rate trace; synthetic when omitted"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with refusals(parser):
        trace = (
            read_gyro(options.gyro)
            if options.gyro
            else synthetic_trace(options.seed, duration_s=120.0, rate_hz=200.0)
        )
    order_table(options.maps, options.seed)
    dwell_table(options.motions, trace, options.seed)


if __name__ == "__main__":
    main()
