"""What a code that is designed for two cameras gains over Raskar's code and its complement.

    python -m lab.studies.pair_codes [--motions gyro walks arcs] [--count 5] [--gyro FILE]
        [--photographs 6] [--read-noise 50] [--photons 10000] [--steps N] [--seed 1]

Along each motion two cameras record one exposure of 52 chips: both open, both through the best
single exposure, and through pairs of a code and its complement: Raskar's, the first half and the
second, the code designed for the motion before, and the code designed for this one, as `cep
optimize --frames 2` does. Figures: the model's PSNR, and the PSNR on photographs restored from
both photos along the known path, in dB.
"""

from __future__ import annotations

import argparse

import numpy as np

from cep.codes.published import published
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.photographs.scenes import photographs
from cep.photographs.trial import PhotoTrial
from cep.search.code_search import SearchOptions, search_code
from cep.search.exposures import pair_exposures
from cep.search.pairs import measure_pairs
from cep.search.problem import SearchProblem
from lab.studies.inputs import study_parser
from lab.studies.motions import MOTIONS, known_motion
from motdiff.trajectory import Trajectory

CHIPS = 52
RASKAR = "Raskar's code"
DESIGNED = "designed"


def problem_along(path: Trajectory, options: argparse.Namespace) -> SearchProblem:
    camera = Camera(photons_full_scale=options.photons, read_noise_e=options.read_noise)
    return SearchProblem.along(path, chips=CHIPS, objective="mse", camera=camera, frames=2)


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=["gyro"])
    parser.add_argument("--count", type=int, default=5, help="motions of each kind")
    parser.add_argument("--gyro", default="", help="recording; noise when omitted")
    parser.add_argument("--photographs", type=int, default=6)
    parser.add_argument("--photons", type=float, default=10_000.0)
    parser.add_argument("--read-noise", type=float, default=50.0)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    half = ShutterCode("1" * (CHIPS // 2) + "0" * (CHIPS // 2))
    how = SearchOptions(steps=options.steps, time_s=None if options.steps else 120.0)
    for motions in options.motions:
        gains: dict[str, list[tuple[float, float]]] = {}
        before: ShutterCode | None = None
        for index in range(options.count):
            path, _ = known_motion(motions, index, seed=options.seed, gyro=options.gyro)
            problem = problem_along(path, options)
            design = search_code(problem, how).code
            alike = [e for e in pair_exposures(problem, ()) if e.kind in ("open", "snapshot")]
            snapshot = max(alike[1:], key=lambda exposure: exposure.psnr_db).code
            pairs = {"open": (alike[0].code,) * 2, "snapshots": (snapshot,) * 2}
            single_codes = {RASKAR: published("raskar-52").code, "halves": half}
            if before is not None:
                single_codes["of another motion"] = before
            single_codes[DESIGNED] = design
            pairs |= {name: (code, code.complement()) for name, code in single_codes.items()}
            before = design
            model_db = [-metrics.mse_db for metrics in measure_pairs(problem, pairs.values())]
            trial = PhotoTrial(
                problem.directed_paths(),
                photographs()[: options.photographs],
                camera=problem.camera,
                seed=options.seed,
            )
            photos_db = trial.psnr_db(list(pairs.values())).mean(axis=1).tolist()
            figures = dict(zip(pairs, zip(model_db, photos_db, strict=True), strict=True))
            text = "  ".join(f"{name} {a:.2f} {b:.2f}" for name, (a, b) in figures.items())
            print(f"{motions} {index}: {text}", flush=True)
            for name, pair in figures.items():
                difference = (pair[0] - figures[RASKAR][0], pair[1] - figures[RASKAR][1])
                gains.setdefault(name, []).append(difference)
        print(f"\n{motions}, less Raskar's code and complement: model, photographs; of how many")
        for name, differences in gains.items():
            means = [
                f"{np.mean(values):+.2f} ({min(values):+.2f}..{max(values):+.2f})"
                for values in zip(*differences, strict=True)
            ]
            print(f"  {name:<18}{'  '.join(means)}  {len(differences)}")


if __name__ == "__main__":
    main()
