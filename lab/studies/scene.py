"""Power spectra of photographs in linear light, and how much they differ.

    python -m lab.studies.scene [PHOTOS]

PHOTOS is a folder of sharp photographs; those of cep.photographs when omitted. Prints the mean and
the spread of each band's level over the photographs (their middle 300 x 300 px, Hann window), the
least-squares fit of ``S(f) = A f^-g (1 + f^2 / f_k^2)^-h`` with the knee at f_k = 0.25 cycles/px,
and how much of the variance between photographs is one common level.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cep.photographs.scene_photo import BANDS, band_levels
from cep.photographs.scenes import photographs
from lab.photo_gains.photographs import load_scenes
from lab.studies.inputs import refusals, study_parser

SIDE_PX = 300  # of a folder's
KNEE_CY_PX = 0.25


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("photos", type=Path, nargs="?")
    arguments = parser.parse_args()
    scenes = photographs()
    if arguments.photos is not None:
        with refusals(parser):
            scenes = load_scenes(arguments.photos, side_px=SIDE_PX)
    f = np.sqrt(BANDS[1:] * BANDS[:-1])
    levels = np.array([band_levels(scene) for scene in scenes])
    for centre, mean, spread in zip(f, levels.mean(axis=0), levels.std(axis=0), strict=True):
        print(f"{centre:.3f} cy/px: {mean:6.1f} dB, spread {spread:.1f} dB")
    columns = np.column_stack(
        [np.ones(f.size), -10 * np.log10(f), -10 * np.log10(1 + (f / KNEE_CY_PX) ** 2)]
    )
    (level, g, h), *_ = np.linalg.lstsq(columns, levels.mean(axis=0), rcond=None)
    variance = np.linalg.svd(levels - levels.mean(axis=0), compute_uv=False) ** 2
    light = np.mean([scene.mean() for scene in scenes])
    print(
        f"{len(scenes)} photographs, mean light {light:.2f}: g = {g:.2f}, h = {h:.2f},"
        f" {level + 10 * g:.1f} dB at 0.1 cy/px without the knee; a common level is"
        f" {variance[0] / variance.sum():.0%} of the variance, the next term"
        f" {variance[1] / variance.sum():.0%}"
    )


if __name__ == "__main__":
    main()
