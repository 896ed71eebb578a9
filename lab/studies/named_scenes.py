"""Fits of the scenes that `--scene` names, besides photographs.

    python -m lab.studies.named_scenes

Prints the fit of each scene (`cep.photographs.scene_photo.fitted_scene`) and the mean distance of
its bands' levels from the fit: `text`, 12 pages of 256 x 256 px set in DejaVu Sans of 10 to 40 px
to the em, ink 0.05 and paper 0.7 of full scale, through a lens of 0.5 px rms and square pixels;
`texture`, four windows of 256 px each of scikit-image's brick, grass and gravel; `flat-part`, the
quarter of the 64 px windows of the bundled photographs that have the least contrast.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cep.photographs.scene_photo import band_levels, fitted_levels, fitted_scene, windows
from cep.photographs.scenes import photographs
from lab.studies.inputs import study_parser
from motdiff.photo_values import to_linear
from motdiff.types import FloatArray

PAGE_PX = 256
FINER = 4  # times, before the pixels' means
INK = 0.05
PAPER = 0.7
LENS_PX = 0.5
FLAT_PX = 64


def main() -> None:
    study_parser(__doc__).parse_args()
    print("| scene | pictures | g | h | level, dB | spread, dB | mean light | off the fit, dB |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name, pictures in {"text": pages(), "texture": textures(), "flat-part": flats()}.items():
        scene = fitted_scene(pictures, name=name)
        levels = np.mean([band_levels(picture) for picture in pictures], axis=0)
        off_db = np.abs(levels - fitted_levels(scene)).mean()
        print(
            f"| {name} | {len(pictures)} | {scene.exponent:.2f} | {scene.fall:.2f} |"
            f" {scene.level_db:.1f} | {scene.spread_db:.1f} | {scene.mean:.2f} | {off_db:.1f} |"
        )


def pages() -> list[FloatArray]:
    """Pages of text, (256, 256) in linear light, the letters ever larger."""
    import cv2
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    words = (__doc__ or "").split()
    font_file = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    rng = np.random.default_rng(0)
    side = FINER * PAGE_PX
    results = []
    for em_px in np.geomspace(10, 40, 12):
        font = ImageFont.truetype(str(font_file), round(FINER * em_px))
        page = Image.new("L", (side, side), 255)
        pen = ImageDraw.Draw(page)
        pitch = 1.3 * FINER * em_px
        for line in range(int(side / pitch) + 1):
            text = " ".join(rng.permutation(words).tolist())
            pen.text((-FINER * em_px, line * pitch), text, font=font, fill=0)
        ink = 1 - np.asarray(page) / 255
        light = PAPER + (INK - PAPER) * ink
        light = cv2.GaussianBlur(light, (0, 0), FINER * LENS_PX)
        results.append(light.reshape(PAGE_PX, FINER, PAGE_PX, FINER).mean(axis=(1, 3)))
    return results


def textures() -> list[FloatArray]:
    """Windows of surfaces, (256, 256) in linear light."""
    from skimage import data

    surfaces = (to_linear(surface() / 255) for surface in (data.brick, data.grass, data.gravel))
    return [window for surface in surfaces for window in windows(surface, (256, 256), (2, 2))]


def flats() -> Sequence[FloatArray]:
    """Windows of the bundled photographs with the least contrast, (64, 64)."""
    tiles = [
        window
        for photograph in photographs()
        for window in windows(photograph, (FLAT_PX, FLAT_PX), (4, 4))
    ]
    return sorted(tiles, key=lambda window: window.std() / window.mean())[: len(tiles) // 4]


if __name__ == "__main__":
    main()
