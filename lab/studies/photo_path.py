"""Kernel and path of ``cep calibrate`` from one photo: how alike they are, and to the truth.

    python -m lab.studies.photo_path rows FILE --photos DIR... --gyro RECORDING
        [--every N] [--count 12] [--seed 0]
    python -m lab.studies.photo_path table FILE...

Photos of 256 x 256 px, linear light, grey, real borders, noise of 0.5 %: walks of 60 px, arcs
(straight, curved, accelerated; 18 to 40 px) and shakes of the recording (12 to 36 px, 50 to 500
ms), the same scenes for each. ``--every N`` takes every N-th photo of the folders, as the
networks' held-out scenes are. Figures: sub-pixel MNC of the kernel and of the path's PSF, mean
distance of the path at equal arc length and rms distance at equal times in the better direction,
the stated confidences, and seconds. One thread; an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.studies.inputs import add_row, finished_rows, kept_rows, photos, study_parser
from motdiff.estimators.motdiff.estimator import MotDiffEstimator
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.metrics import mnc_subpixel, path_distance_px, timed_distance_px
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.photo_values import luminance
from motdiff.simulate import photograph
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

KINDS = ("walk", "arc", "shake")
_PHOTO_PX = 256
_SCENE_PX = 340  # least side: photo and motion
_NOISE = 0.005
_SURE = 0.5  # a stated path confidence of more: the path's figures are those of such photos, too


@dataclass(frozen=True)
class Shot:
    """A simulated photo (256, 256) of a known motion."""

    name: str
    kind: str
    light: FloatArray
    motion: Trajectory


def arc(rng: np.random.Generator) -> Trajectory:
    """Draw a motion of constant curvature and constant acceleration, 18 to 40 px long."""
    t = np.linspace(0, 1, 401)
    bend_rad = rng.choice([0.0, 1.0]) * rng.uniform(0.3, 1.6) * rng.choice([-1, 1])
    heading = rng.uniform(0, 2 * np.pi) + bend_rad * t
    speed = 1 + rng.choice([0.0, 1.0]) * rng.uniform(-0.5, 0.8) * t
    velocity = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * speed[:, None]
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(velocity[1:] + velocity[:-1], axis=0)])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    return Trajectory.from_samples(path * (rng.uniform(18, 40) / length), t=t)


def drawn_motion(
    kind: str, trace: GyroTrace, rng: np.random.Generator, *, widest_px: float = 36.0
) -> Trajectory:
    """Draw a motion of one of :data:`KINDS`; a shake of the trace is 12 px to ``widest_px``."""
    if kind == "walk":
        return boracchi_foi(rng)
    if kind == "arc":
        return arc(rng)
    exposure_s = np.exp(rng.uniform(np.log(0.05), np.log(0.5)))
    extent_px = rng.uniform(12, widest_px)
    return random_gyro_motion(trace, rng, exposure_s=exposure_s, extent_px=extent_px)


def shots(
    folders: list[Path], trace: GyroTrace, *, step: int, count: int, seed: int
) -> Iterator[Shot]:
    """Simulate ``count`` photos of each kind of motion."""
    scenes = [scene for folder in folders for scene in photos(folder)][::step]
    large = [(name, light) for name, light in scenes if min(light.shape[:2]) >= _SCENE_PX]
    for number in range(count):
        name, light = large[number % len(large)]
        for k, kind in enumerate(KINDS):
            rng = np.random.default_rng([seed, number, k])
            motion = drawn_motion(kind, trace, rng)
            side = _PHOTO_PX - 1 + (motion.frame_size() | 1)
            row, column = (rng.integers(n - side + 1) for n in light.shape[:2])
            scene = luminance(light[row : row + side, column : column + side])
            photo = photograph(scene, motion, rng=rng, read_sigma=_NOISE)
            yield Shot(f"{kind}/{number:03d}/{name}", kind, photo, motion)


def figures(shot: Shot, estimator: MotDiffEstimator) -> dict[str, object]:
    """Estimate one photo's motion, and compare it with the truth."""
    began_s = time.perf_counter()
    estimate = estimator.estimate(shot.light)
    wall_s = time.perf_counter() - began_s
    truth = shot.motion.psf(shot.motion.frame_size(64))
    path = estimate.best
    return {
        "name": shot.name,
        "kind": shot.kind,
        "kernel": mnc_subpixel(estimate.psf, truth),
        "path": mnc_subpixel(path.psf(path.frame_size(64)), truth),
        "distance_px": path_distance_px(path, shot.motion),
        "timed_px": min(
            timed_distance_px(ordered, shot.motion) for ordered in (path, path.reversed())
        ),
        "confidence": estimate.confidence,
        "path_confidence": estimate.details["path_confidence"],
        "stated_px": estimate.path_error_px,
        "wall_s": wall_s,
    }


def table(rows: list[dict]) -> Iterator[str]:
    """Lines of the table, a row for each kind of motion."""
    yield (
        "| motions | photos | kernel | path's PSF | difference | path, px | timed, px | sure |"
        " path, sure, px | timed, sure, px | s, mean | s, worst |"
    )
    yield "|---|" + "---:|" * 11
    for kind in KINDS:
        group = [row for row in rows if row["kind"] == kind]
        if not group:
            continue
        confident = [row for row in group if row["path_confidence"] > _SURE]
        kernel, path, wall_s = (
            np.array([row[key] for row in group]) for key in ("kernel", "path", "wall_s")
        )
        medians = [
            np.median([row[key] for row in chosen]) if chosen else np.nan
            for chosen in (group, confident)
            for key in ("distance_px", "timed_px")
        ]
        yield (
            f"| {kind} | {len(group)} | {kernel.mean():.3f} | {path.mean():.3f}"
            f" | {(path - kernel).mean():+.3f} | {medians[0]:.2f} | {medians[1]:.2f}"
            f" | {len(confident)} | {medians[2]:.2f} | {medians[3]:.2f}"
            f" | {wall_s.mean():.1f} | {wall_s.max():.1f} |"
        )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("what", choices=["rows", "table"])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--photos", type=Path, nargs="+")
    parser.add_argument("--gyro", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.what == "table":
        print("\n".join(table([row for file in options.files for row in kept_rows(file)])))
        return
    if len(options.files) != 1 or options.photos is None or options.gyro is None:
        parser.error("rows: give one FILE, --photos and --gyro")
    (file,) = options.files
    finished = {row["name"] for row in finished_rows(file)}
    estimator = MotDiffEstimator()
    simulated = shots(
        options.photos,
        read_gyro(options.gyro),
        step=options.every,
        count=options.count,
        seed=options.seed,
    )
    with one_thread():
        for shot in simulated:
            if shot.name not in finished:
                add_row(file, figures(shot, estimator))


if __name__ == "__main__":
    main()
