"""How much better one motion is found in several photos of it together than in each alone, and who
is left out.

    python -m lab.studies.fusion [--method motdiff] [--count 8] [--photos 3] [--noise 0.01 0.02]
    [--scaled 0]
        [--strangers 0] [--same-scene] [--seed 7]

Motions are walks and arcs of 20 to 40 px, in turn. Photos of 236 px show the most textured parts
of different scenes of scikit-image, or of one; with `--strangers` more photos show another motion.
With `--scaled` the motion of each photo is that much longer or shorter, at most.

`single best` is chosen by the truth, as nobody can; `surest` by the estimates' confidence. MNC is
with the true PSF.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np

from cep.calibration.calibrate import estimate_motion
from lab.studies.inputs import photos, study_parser
from lab.studies.motions import circular_arc
from motdiff.crops import pick_crops
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi
from motdiff.photo_values import luminance
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

SCENE_PX = 300
FRAME_PX = 65


@dataclass(frozen=True)
class Row:
    """MNC of a motion's estimates, and the photos that the fusion left out."""

    singles: tuple[float, ...]
    surest: float
    fused: float
    seen_in: int
    left_out: tuple[int, ...]


def motion_of(index: int, rng: np.random.Generator) -> Trajectory:
    length_px = rng.uniform(20, 40)
    if index % 2 == 0:
        return boracchi_foi(rng, max_length_px=length_px)
    turn_rad = rng.choice((-1, 1)) * rng.uniform(0.5, 3.0)
    return circular_arc(turn_rad, start_rad=rng.uniform(0, 2 * np.pi), length_px=length_px)


def scenes() -> list[FloatArray]:
    images = []
    for _, photo in photos(None):
        grey = luminance(photo)
        if min(grey.shape) >= SCENE_PX:
            row, column = pick_crops(grey, size=SCENE_PX, count=1)[0]
            images.append(grey[row : row + SCENE_PX, column : column + SCENE_PX])
    return images


def figures_of(options: argparse.Namespace, index: int, noise: float) -> Row:
    rng = np.random.default_rng([options.seed, index])
    path = motion_of(index, rng)
    stranger_path = motion_of(index + 1, rng)
    scene_list = scenes()
    count = options.photos + options.strangers
    which = (
        [int(rng.integers(len(scene_list)))] * count
        if options.same_scene
        else rng.permutation(len(scene_list))[:count]
    )
    blurred = []
    for i, scene in enumerate(which):
        photo_rng = np.random.default_rng([options.seed, index, i])
        photo_path = path if i < options.photos else stranger_path
        photo_path = photo_path.scaled(1 + photo_rng.uniform(-options.scaled, options.scaled))
        blurred.append(
            photograph(
                scene_list[scene], photo_path.psf(FRAME_PX), rng=photo_rng, read_sigma=noise
            )
        )
    estimates = [
        estimate_motion(photo, method=options.method) for photo in blurred[: options.photos]
    ]
    fused = estimate_motion(blurred, method=options.method)
    truth = path.psf(FRAME_PX)
    singles = tuple(mnc_subpixel(estimate.psf, truth) for estimate in estimates)
    details: dict[str, Any] = fused.details
    return Row(
        singles,
        singles[int(np.argmax([estimate.confidence for estimate in estimates]))],
        mnc_subpixel(fused.psf, truth),
        int(details["seen_in"]),
        tuple(details["left_out"]),
    )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--method", default="motdiff", choices=("motdiff", "pmp"))
    parser.add_argument("--count", type=int, default=8, help="motions")
    parser.add_argument("--photos", type=int, default=3, help="of each motion")
    parser.add_argument(
        "--noise", nargs="+", type=float, default=[0.01, 0.02], help="shares of full scale"
    )
    parser.add_argument(
        "--scaled", type=float, default=0.0, metavar="SHARE", help="of a photo's motion, at most"
    )
    parser.add_argument("--strangers", type=int, default=0, help="photos of another motion")
    parser.add_argument("--same-scene", action="store_true")
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    for noise in options.noise:
        rows = []
        for index in range(options.count):
            rows.append(row := figures_of(options, index, noise))
            singles = " ".join(f"{mnc:.3f}" for mnc in row.singles)
            print(
                f"{index} {noise:g}: {singles} fused {row.fused:.3f} seen {row.seen_in} without"
                f" {row.left_out}",
                flush=True,
            )
        strangers = set(range(options.photos + 1, options.photos + options.strangers + 1))
        detected = sum(len(strangers & set(row.left_out)) for row in rows)
        wrong = sum(len(set(row.left_out) - strangers) for row in rows)
        mean, best = (np.mean([pick(row.singles) for row in rows]) for pick in (np.mean, np.max))
        surest, fused = (
            np.mean([getattr(row, name) for row in rows]) for name in ("surest", "fused")
        )
        print(
            "| noise | single, mean | surest | single best | fused | strangers left out | others"
            " left out |"
        )
        print(
            f"| {100 * noise:g} % | {mean:.3f} | {surest:.3f} | {best:.3f} | {fused:.3f} "
            f"| {detected} of {len(strangers) * len(rows)} |"
            f" {wrong} of {options.photos * len(rows)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
