"""How many chips: what the code of ``cep optimize`` restores with 16 to 104 of them.

    python -m lab.studies.chip_count PHOTOS [--count 8] [--motions 3] [--seed 0]
        [--photons N] [--read-noise 10]

PHOTOS is a folder of sharp photographs that chose nothing: the verdict's own are bundled. Straight
motions and walks of several lengths, in dim and bright light, known exactly or to 0.3 px. Prints
the mean PSNR, dB, of photographs taken through each code and restored.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

import cep
from cep.optics.path_limits import resolved_chips
from cep.photographs.trial import PhotoTrial
from cep.search.chip_count import STANDARD_EXPOSURE_S
from lab.photo_gains.photographs import load_scenes
from lab.studies.inputs import refusals, study_parser
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

COUNTS = (16, 32, 52, 104)
SIDE_PX = 420  # a photo of the longest motion and its borders
LENGTHS_PX = (12.0, 100.0)  # shortest and longest
ERRORS_PX = (0.0, 0.3)
PHOTONS = (3_000.0, 30_000.0)  # least and most, photo-electrons at full scale


def cases(count: int, seed: int) -> Iterator[tuple[str, Trajectory, float, float]]:
    """Draw motions, straight and bent in turn: name, path, its error in px, photo-electrons."""
    for number in range(2 * count):
        rng = np.random.default_rng([seed, number, 78])
        length_px = float(np.exp(rng.uniform(*np.log(LENGTHS_PX))))
        photons = float(np.exp(rng.uniform(*np.log(PHOTONS))))
        error_px = ERRORS_PX[number // 2 % 2]
        if number % 2:
            path = boracchi_foi(rng, max_length_px=length_px)
            yield f"walk {length_px:.0f} px", path, error_px, photons
        else:
            yield f"straight {length_px:.0f} px", Trajectory.straight(length_px), error_px, photons


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=8, help="photographs")
    parser.add_argument("--motions", type=int, default=3, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--photons", type=float, help="at full scale; drawn when omitted")
    parser.add_argument("--read-noise", type=float, default=10.0, help="electrons")
    options = parser.parse_args()
    with refusals(parser):
        scenes = load_scenes(options.photos, side_px=SIDE_PX, count=options.count)
    print("| motion | error, px | photo-electrons | " + " | ".join(map(str, COUNTS)) + " |")
    print("|---|---:|---:|" + "---:|" * len(COUNTS))
    losses_db: list[list[float]] = []
    for name, path, error_px, drawn_photons in cases(options.motions, options.seed):
        photons = options.photons or drawn_photons
        camera = cep.Camera(photons_full_scale=photons, read_noise_e=options.read_noise)
        levels_db = []
        for chips in (count for count in COUNTS if count <= resolved_chips(path)):
            problem = cep.SearchProblem.along(
                path,
                chips=chips,
                camera=camera,
                objective="mse",
                exposure_s=STANDARD_EXPOSURE_S,
            )
            best = cep.optimize(problem, path_error_px=error_px, seed=options.seed)
            trial = PhotoTrial(
                problem.directed_paths(),
                scenes,
                camera=camera,
                chip_ns=problem.chip_ns,
                path_error_px=error_px,
                seed=options.seed,
            )
            levels_db.append(float(trial.psnr_db([best.code]).mean()))
        unresolved = len(COUNTS) - len(levels_db)
        row = [f"{level_db:.2f}" for level_db in levels_db] + ["-"] * unresolved
        print(f"| {name} | {error_px:g} | {photons:,.0f} | {' | '.join(row)} |", flush=True)
        if not unresolved:
            losses_db.append([max(levels_db) - level_db for level_db in levels_db])
    means = " | ".join(f"{mean_db:.2f}" for mean_db in np.mean(losses_db, axis=0))
    print(f"| behind the best, mean where all are resolved | | | {means} |")


if __name__ == "__main__":
    main()
