"""Error in a photo with borders beside the objective: which of equal codes photographs prefer.

    python -m lab.studies.frame_error PHOTOS [--count 8] [--codes 40] [--motions 8] [--bend 0]
        [--seed 0]

PHOTOS is a folder of sharp photographs that chose nothing: the verdict's own are bundled. Along
straight motions of several lengths, first codes that are nearly equal by the objective, each of a
search of its own: the correlation of objective and of error in a photo with the mean PSNR of the
restored photographs, the standard deviation of that PSNR over the codes, and the gain over their
mean of the code that each puts first. Then the code of ``cep optimize`` at drawn lengths, light
and read noise, beside that of searches for less light, which it was before, and what each advises.
With a bend the drawn motions are those of constant acceleration, as of
:func:`motdiff.motions.quadratic`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np

import cep
from cep.photographs.trial import PhotoTrial
from cep.search.chip_count import STANDARD_CHIPS, STANDARD_EXPOSURE_S
from cep.search.cost import CodeCost
from cep.search.exposures import ExposureFinder
from cep.search.frame_error import FrameError
from cep.search.problem import SearchProblem
from lab.photo_gains.photographs import load_scenes
from lab.studies.inputs import refusals, study_parser
from motdiff.motions import quadratic
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

SIDE_PX = 420  # a photo of the longest motion and its borders
EQUAL = ((107.0, 9_000.0, 14.0), (83.0, 12_600.0, 20.0), (60.0, 1e4, 10.0), (40.0, 3e4, 20.0))
"""Length, px, photo-electrons at full scale and electrons of read noise."""
LENGTHS_PX = (14.0, 120.0)  # shortest and longest of drawn motions
PHOTONS = (3_000.0, 60_000.0)
READ_NOISE_E = (5.0, 60.0)


def problem_of(path: Trajectory, *, photons: float, read_noise_e: float) -> SearchProblem:
    camera = cep.Camera(photons_full_scale=photons, read_noise_e=read_noise_e)
    return cep.SearchProblem.along(
        path,
        chips=STANDARD_CHIPS,
        camera=camera,
        objective="mse",
        exposure_s=STANDARD_EXPOSURE_S,
    )


def trial_of(problem: SearchProblem, scenes: Sequence[FloatArray]) -> PhotoTrial:
    return PhotoTrial(
        problem.directed_paths(), scenes, camera=problem.camera, chip_ns=problem.chip_ns
    )


def compare_equal_codes(scenes: Sequence[FloatArray], count: int) -> None:
    """Print a row for each motion of :data:`EQUAL`."""
    print(
        "| length, px | objective, dB, best to worst | PSNR, standard deviation, dB"
        " | correlation: objective, in a photo | gain of the first by: objective, in a photo, dB |"
    )
    print("|---:|---:|---:|---:|---:|")
    for length_px, photons, read_noise_e in EQUAL:
        path = Trajectory.straight(length_px)
        problem = problem_of(path, photons=photons, read_noise_e=read_noise_e)
        finder = ExposureFinder(problem)
        searched = [
            code
            for seed in range(count)
            for code in finder.codes(problem.camera, (), seed=seed, threads=None)
        ]
        codes = [*dict.fromkeys(searched)]
        costs_db = CodeCost.fine(problem).cost_of(np.array([code.array for code in codes]))
        errors_db = FrameError(problem).of_codes_db(codes)
        levels_db = trial_of(problem, scenes).psnr_db(codes).mean(axis=1)
        correlations = [
            np.corrcoef(-error_db, levels_db)[0, 1] for error_db in (costs_db, errors_db)
        ]
        gains_db = [
            levels_db[error_db.argmin()] - levels_db.mean() for error_db in (costs_db, errors_db)
        ]
        print(
            f"| {length_px:g} | {costs_db.min():.2f} to {costs_db.max():.2f} |"
            f" {levels_db.std():.2f} | {correlations[0]:+.2f}, {correlations[1]:+.2f} |"
            f" {gains_db[0]:+.2f}, {gains_db[1]:+.2f} |",
            flush=True,
        )


def compare_optimize(scenes: Sequence[FloatArray], count: int, *, bend: float, seed: int) -> None:
    """Print a row for each of ``count`` drawn motions: PSNR of the code and of what is advised."""
    print(
        "| length, px | photo-electrons | read noise, e- | code before, dB | now, dB | gain, dB |"
        " advised before, dB | now, dB | gain, dB |"
    )
    print("|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    rng = np.random.default_rng(seed)
    gains_db = []
    for _ in range(count):
        length_px, photons, read_noise_e = (
            float(np.exp(rng.uniform(*np.log(span))))
            for span in (LENGTHS_PX, PHOTONS, READ_NOISE_E)
        )
        if bend:
            path = quadratic(rng, min_length_px=length_px, max_length_px=length_px, max_bend=bend)
        else:
            path = Trajectory.straight(length_px, angle_rad=float(rng.uniform(0, np.pi)))
        problem = problem_of(path, photons=photons, read_noise_e=read_noise_e)
        with (
            patch("cep.search.optimize.is_framed", return_value=False),
            patch("cep.search.measured.is_framed", return_value=False),
        ):
            former = cep.optimize(problem, seed=seed)
        results = (former, cep.optimize(problem, seed=seed))
        codes = [result.code for result in results]
        codes += [result.verdict.advised.code for result in results]
        levels_db = trial_of(problem, scenes).psnr_db(codes).mean(axis=1).reshape(2, 2)
        gains_db.append(np.diff(levels_db)[:, 0])
        cells = " | ".join(
            f"{before_db:.2f} | {now_db:.2f} | {now_db - before_db:+.2f}"
            for before_db, now_db in levels_db
        )
        print(
            f"| {length_px:.0f} | {photons:,.0f} | {read_noise_e:.0f} | {cells} |",
            flush=True,
        )
    errors_db = np.std(gains_db, axis=0, ddof=1) / np.sqrt(count)
    code, advised = (
        f"{mean_db:+.2f} +- {error_db:.2f}"
        for mean_db, error_db in zip(np.mean(gains_db, axis=0), errors_db, strict=True)
    )
    print(f"| mean | | | | | {code} | | | {advised} |")


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=8, help="photographs")
    parser.add_argument("--codes", type=int, default=40, help="of each motion; 0 for none")
    parser.add_argument("--motions", type=int, default=8, help="drawn for cep optimize")
    parser.add_argument("--bend", type=float, default=0.0, help="of the drawn motions")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with refusals(parser):
        scenes = load_scenes(options.photos, side_px=SIDE_PX, count=options.count)
    if options.codes:
        compare_equal_codes(scenes, options.codes)
    compare_optimize(scenes, options.motions, bend=options.bend, seed=options.seed)


if __name__ == "__main__":
    main()
