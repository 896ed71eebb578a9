"""Codes for the mean scene and for the mean of the decibels over scenes, on photographs.

    python -m lab.studies.scene_spread PHOTOS

PHOTOS is a folder of sharp photographs. Along a motion and at a camera's light a code is searched
by objective "mse" for the mean scene (`cep.optics.scene.PHOTO`), and a code by the mean of its
decibels over scenes whose level has the standard deviation ``spread_db``, at the three nodes of
Gauss-Hermite quadrature, each with several seeds. All are simulated on the photographs and
restored by default. Prints a row for each case: open chips and openings of the codes, gain of the
second kind over the first by each objective and on the photographs, dB, with its standard error
over these, and the standard deviation from seed to seed; last the mean over the cases.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO
from cep.search.annealing.anneal import anneal
from cep.search.baselines import best_snapshot, best_strobe
from cep.search.cost import CodeCost
from cep.search.problem import Scenario, SearchProblem
from lab.photo_gains.gains import CHIPS, SIDE_PX, motions, trial_of
from lab.photo_gains.photographs import load_scenes
from lab.studies.inputs import refusals, study_parser
from motdiff.trajectory import Trajectory

LIGHT = ((10.0, 3_000.0), (50.0, 10_000.0), (200.0, 100_000.0))
NODES_DB = PHOTO.spread_db * np.sqrt(3) * np.array([-1.0, 0.0, 1.0])
WEIGHTS = (1 / 6, 2 / 3, 1 / 6)
MOVES = 400_000
OVERSAMPLING = 8
FINE = 64


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=8, help="photos at most")
    parser.add_argument("--seeds", type=int, default=4, help="searches of each code")
    arguments = parser.parse_args()
    with refusals(parser):
        scenes = load_scenes(arguments.photos, side_px=SIDE_PX, count=arguments.count)
    paths = {"straight 25 px": Trajectory.straight(25.0)} | motions()
    del paths["shake"]
    print(f"{len(scenes)} photographs, levels {NODES_DB.round(1).tolist()} dB")
    print(
        "| motion | e- / photo-electrons | open, openings: mean scene | mean of the decibels"
        " | by the mean scene | by the mean of the decibels | on photographs | from seed to seed |"
    )
    print("|---|---|---|---|---:|---:|---:|---:|")
    means = []
    for name, path in paths.items():
        for read_noise_e, photons in LIGHT:
            camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
            problem = SearchProblem.along(path, chips=CHIPS, camera=camera, objective="mse")
            spread = replace(
                problem,
                scenarios=tuple(Scenario(path, weight=weight) for weight in WEIGHTS),
                rule="mean",
            )
            designs = ((problem, [0.0]), (spread, NODES_DB))
            codes = [
                searched_code(designed, levels_db, seed)
                for designed, levels_db in designs
                for seed in range(arguments.seeds)
            ]
            chips = np.array([code.array for code in codes])
            model_gains = [
                -np.diff(
                    levelled_objective(designed, levels_db, fine=True)
                    .cost_of(chips)
                    .reshape(2, -1)
                    .mean(axis=1)
                )[0]
                for designed, levels_db in designs
            ]
            photo_db = trial_of(problem, scenes).psnr_db(codes).reshape(2, arguments.seeds, -1)
            by_seed = np.diff(photo_db.mean(axis=2), axis=0)[0]
            by_photo = np.diff(photo_db.mean(axis=1), axis=0)[0]
            scatter_db = photo_db.mean(axis=2).std(axis=1, ddof=1).mean()
            means.append(by_seed.mean())
            error_db = by_photo.std(ddof=1) / np.sqrt(by_photo.size)
            openings = (
                " ".join(f"{code.open_chips}, {code.pulses};" for code in group)
                for group in (codes[: arguments.seeds], codes[arguments.seeds :])
            )
            print(
                f"| {name} | {read_noise_e:g} / {photons:,.0f} | {' | '.join(openings)} |"
                f" {model_gains[0]:+.3f} | {model_gains[1]:+.3f} |"
                f" {means[-1]:+.2f} +- {error_db:.2f} | {scatter_db:.2f} |",
                flush=True,
            )
    error_db = np.std(means, ddof=1) / np.sqrt(len(means))
    print(f"mean over {len(means)} cases: {np.mean(means):+.3f} +- {error_db:.3f} dB")


def levelled_objective(
    problem: SearchProblem, levels_db: np.ndarray | list[float], *, fine: bool
) -> CodeCost:
    """Objective whose scenarios have scenes this much above the mean scene, dB."""
    code_cost = CodeCost(
        problem,
        oversampling=FINE if fine else OVERSAMPLING,
        dtype=np.float64 if fine else np.float32,
    )
    for motion in code_cost.parts:
        level = 10 ** (levels_db[motion.scenario] / 10)
        code_cost.priors[motion.columns] /= level
    return code_cost


def searched_code(
    problem: SearchProblem, levels_db: np.ndarray | list[float], seed: int
) -> ShutterCode:
    """Best code by the objective."""
    coarse = levelled_objective(problem, levels_db, fine=False)
    starts = [best(coarse) for best in (best_snapshot, best_strobe)]
    return anneal(
        problem,
        rng=np.random.default_rng(seed),
        steps=MOVES,
        time_s=float("inf"),
        start=[code for code in starts if code is not None],
        threads=1,
        judge=levelled_objective(problem, levels_db, fine=True),
        coarse=coarse,
    ).code


if __name__ == "__main__":
    main()
