"""Photos with clipped lights: restored with and without the fill, and their PSFs estimated.

Eight scenes of scikit-image at 0.7 of full scale at most, 256 x 256 px, with 20 to 60 lights 3 to
20 times full scale, blurred along walks of 20 to 40 px, with 0.5 % noise, clipped
(docs/decisions/restoration.md, motion-estimation.md). The page is text on paper about as white as
full scale. PSNR is in linear light cut to 0..1, 20 px from the border.

    OMP_NUM_THREADS=1 python -m lab.studies.clipping
"""

from __future__ import annotations

from collections import defaultdict

import cv2
import numpy as np
from skimage import data

from cep.restoration.clipping import fill_clipped
from cep.restoration.registry import METHODS
from lab.studies.inputs import study_parser
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.metrics import mnc_subpixel, psnr
from motdiff.motions import boracchi_foi
from motdiff.photo_values import clipped_mask, luminance, to_linear
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import blur_valid, visible

SCENES = ("camera", "astronaut", "coffee", "chelsea", "rocket", "coins", "brick", "gravel")
SIDE_PX = 256
BORDER_PX = 20
SIGMA = 0.005


def cropped(image: np.ndarray) -> np.ndarray:
    side = SIDE_PX + PSF_PX - 1
    grey = luminance(image)
    scale = max(1.0, 1.01 * side / min(grey.shape))
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    row, column = ((n - side) // 2 for n in grey.shape)
    return np.asarray(grey[row : row + side, column : column + side], dtype=np.float64)


def with_lights(scene: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y, x = np.indices(scene.shape)
    for _ in range(int(rng.integers(20, 61))):
        centre = rng.uniform(0, scene.shape)
        strength = rng.uniform(3, 20)
        radius = rng.uniform(0.6, 1.2) if rng.random() < 0.6 else rng.uniform(1.5, 4)
        disc = np.clip(radius + 0.5 - np.hypot(y - centre[0], x - centre[1]), 0, 1)
        scene = np.maximum(scene, strength * disc)
    return scene


def main() -> None:
    study_parser(__doc__).parse_args()
    scores: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    likeness: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for number, name in enumerate((*SCENES, "page")):
        rng = np.random.default_rng([7, number])
        path = boracchi_foi(rng, max_length_px=float(rng.uniform(20, 40)))
        psf = path.psf(PSF_PX)
        scene = cropped(to_linear(getattr(data, name)() / 255.0, gamma=2.2))
        kinds = {"page": scene / np.quantile(scene, 0.5)}
        if name != "page":
            dark = 0.7 * scene / scene.max()
            kinds = {"lights": with_lights(dark, rng), "no lights": dark, "3 % clipped": scene}
        for kind, kind_scene in kinds.items():
            blurred = blur_valid(kind_scene, psf)
            if kind == "3 % clipped":
                kind_scene = kind_scene / np.quantile(blurred, 0.97)
                blurred = blurred / np.quantile(blurred, 0.97)
            photo = np.clip(blurred + SIGMA * rng.standard_normal(blurred.shape), 0, 1)
            inner = (slice(BORDER_PX, -BORDER_PX),) * 2
            truth = np.clip(visible(kind_scene, PSF_PX), 0, 1)[inner]
            filled = fill_clipped(photo, psf)
            for method, registered in METHODS.items():
                pair = [
                    psnr(np.clip(registered.function(image, psf), 0, 1)[inner], truth)
                    for image in (photo, filled)
                ]
                scores[kind, method].append((pair[0], pair[1]))
            estimate = PmpEstimator().estimate(photo)
            confidence = float(str(estimate.details["psf_confidence"]))
            likeness[kind].append((mnc_subpixel(psf, estimate.psf), confidence))
            print(f"{name}, {kind}: {100 * clipped_mask(photo).mean():.1f} % clipped", flush=True)
    for (kind, method), pairs in scores.items():
        without, with_fill = np.array(pairs).T
        gain = with_fill - without
        print(
            f"{kind:12} {method:8} {without.mean():6.2f} {with_fill.mean():6.2f} dB, least gain"
            f" {gain.min():5.2f}"
        )
    for kind, values in likeness.items():
        mnc, confidence = np.array(values).T
        print(
            f"{kind:12} MNC of pmp {mnc.mean():.3f}, least {mnc.min():.3f}, stated"
            f" {confidence.mean():.2f}"
        )


if __name__ == "__main__":
    main()
