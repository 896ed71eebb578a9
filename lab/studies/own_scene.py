"""Codes and gains for the user's own photo (`--scene`), beside those for photographs of all kinds.

    python -m lab.studies.own_scene PHOTOS [--count 18]

Of each sharp photo of a folder the left half is the user's photo, and the right half is what is
then photographed. Along an arc and at two lights, the best code and the best single exposure are
those that `cep advise` states by the bundled photographs, or by the left half; both are simulated
on the right half and restored by default. Prints for each photo and light the gain stated and
measured, and what the own code gains over the other, dB; last means over the photos with their
standard errors.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import cep
from cep.optics.camera import Camera
from cep.photographs.scene_photo import ScenePhoto
from cep.photographs.trial import PhotoTrial
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict
from lab.photo_gains.gains import motions
from lab.photo_gains.photographs import load_scenes
from lab.studies.inputs import refusals, study_parser

LIGHT = ((10.0, 3_000.0), (50.0, 10_000.0))
CHIPS = 32
SIDE_PX = 480


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=18)
    arguments = parser.parse_args()
    with refusals(parser):
        scenes = load_scenes(arguments.photos, side_px=SIDE_PX, count=arguments.count)
    path = motions()["arc"]
    print("| photo | e- / photo-electrons | by the bundled | by its half | own code's gain |")
    print("|---:|---|---:|---:|---:|")
    rows = []
    for read_noise_e, photons in LIGHT:
        camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
        problem = SearchProblem.along(path, chips=CHIPS, camera=camera)
        bundled = cep.advise(problem, levels=()).here
        for number, light in enumerate(scenes):
            half, photographed = (
                ScenePhoto.of(side, name="half") for side in np.split(light, 2, axis=1)
            )
            by_half = cep.advise(
                replace(problem, scene=half.scene), levels=(), photographs=half.crops([path])
            ).here
            trial = PhotoTrial([path], photographed.crops([path]), camera=camera)
            results = [_stated_and_measured(verdict, trial) for verdict in (bundled, by_half)]
            code_gain_db = results[1][2] - results[0][2]
            rows.append([*results[0][:2], *results[1][:2], code_gain_db])
            cells = " | ".join(
                f"{promise_db:+.2f}, {gain_db:+.2f}" for promise_db, gain_db, _ in results
            )
            print(
                f"| {number} | {read_noise_e:g} / {photons:,.0f} | {cells} |"
                f" {code_gain_db:+.2f} |",
                flush=True,
            )
    table = np.array(rows)
    misses = np.abs(table[:, [0, 2]] - table[:, [1, 3]])
    right = [(table[:, i] * table[:, i + 1] > 0).sum() for i in (0, 2)]
    error_db = table[:, 4].std(ddof=1) / np.sqrt(len(table))
    print(
        f"stated less measured, mean size: bundled {misses[:, 0].mean():.2f} dB, half"
        f" {misses[:, 1].mean():.2f} dB; sign right in {right[0]} and {right[1]} of {len(table)};"
        f" own code {table[:, 4].mean():+.2f} +- {error_db:.2f} dB"
    )


def _stated_and_measured(verdict: Verdict, trial: PhotoTrial) -> tuple[float, float, float]:
    """Gain of a verdict's code over its single exposure, stated and measured; PSNR of the code."""
    code = verdict.best("code")
    single = verdict.best("snapshot")
    assert code is not None
    assert single is not None
    code_db, single_db = trial.psnr_db([code.code, single.code]).mean(axis=1).tolist()
    return code.psnr_db - single.psnr_db, code_db - single_db, code_db


if __name__ == "__main__":
    main()
