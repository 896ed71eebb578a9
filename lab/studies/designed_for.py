"""Codes searched for photographs, beside codes searched for the earlier Gaussian scene.

    python -m lab.studies.designed_for PHOTOS [--count 12]

The earlier scene had the spectrum 1/f^2, a standard deviation of 0.2 and a mean light of 0.25. Its
code is the search's best by its own expectation; that for photographs is the one that ``cep
advise`` ends on. Both take the photos of a folder, and pnp restores them. Prints the difference of
PSNR for each motion, read noise and light, dB, its standard deviation from photo to photo, and the
mean over the cases with an interval over them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import Scene
from cep.photographs.trial import PhotoTrial
from cep.search.advise import advise
from cep.search.problem import SearchProblem
from lab.photo_gains.__main__ import motions
from lab.photo_gains.photographs import load_scenes

EARLIER = Scene(exponent=2.0, knee_cy_px=0.25, fall=0.0, level_db=-8.8, spread_db=0.0, mean=0.25)
"""Gaussian scene of variance 0.2^2 in the band 1/256 to 1/2 cycles/px."""

LIGHT = ((10.0, 3_000.0), (50.0, 10_000.0), (200.0, 100_000.0))
CHIPS = 40
_SIDE_PX = 300
_JUDGED_PX = 128


def best_code(problem: SearchProblem, **how: object) -> ShutterCode:
    code = advise(problem, levels=(), **how).here.best("code")  # type: ignore[arg-type]
    assert code is not None
    return code.code


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photos", type=Path)
    parser.add_argument("--count", type=int, default=12)
    options = parser.parse_args()
    scenes = load_scenes(options.photos, side_px=_SIDE_PX, count=options.count)
    print(f"{len(scenes)} photographs")
    print("| motion | e- / photo-electrons | for photographs less the earlier, dB | deviation |")
    print("|---|---|---:|---:|")
    means_db = []
    for name, path in motions().items():
        for read_noise_e, photons in LIGHT:
            camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
            problem = SearchProblem.along(path, chips=CHIPS, camera=camera)
            earlier = best_code(replace(problem, scene=EARLIER), photographs=())
            trial = PhotoTrial([path], scenes, camera=camera, judged_px=_JUDGED_PX)
            for_photographs_db, earlier_db = trial.psnr_db([best_code(problem), earlier])
            gains_db = for_photographs_db - earlier_db
            means_db.append(gains_db.mean())
            print(
                f"| {name} | {read_noise_e:g} / {photons:,.0f} | {gains_db.mean():+.2f} |"
                f" {gains_db.std(ddof=1):.2f} |",
                flush=True,
            )
    spread_db = np.std(means_db, ddof=1) / np.sqrt(len(means_db))
    print(
        f"mean of the cases {np.mean(means_db):+.2f} dB"
        f" ({np.mean(means_db) - 2 * spread_db:+.2f} to {np.mean(means_db) + 2 * spread_db:+.2f})"
    )


if __name__ == "__main__":
    main()
