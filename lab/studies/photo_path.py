"""Kernel and path of ``cep calibrate`` from one photo: how alike they are, and to the truth.

    python -m lab.studies.photo_path rows FILE --photos DIR... --gyro RECORDING
        [--every N] [--count 12] [--seed 0] [--noise 0.005]
    python -m lab.studies.photo_path table FILE...

Photos of 256 x 256 px, linear light, grey, real borders, with noise: walks of 60 px, arcs
(straight, curved, accelerated; 18 to 40 px) and shakes of the recording (12 to 36 px, 50 to 500
ms), the same scenes for each. ``--every N`` takes every N-th photo of the folders, as the
networks' held-out scenes are. Figures: sub-pixel MNC of the kernel and of the path's PSF, mean
distance of the path at equal arc length and rms distance at equal times in the better direction,
the stated confidences, and seconds. One thread; an interrupted run goes on where it stopped: a
row says its options and the version of the estimator.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lab.studies.inputs import (
    add_row,
    case_key,
    check_version,
    finished_cases,
    kept_rows,
    large_scenes,
    photo_files,
    read_light,
    refusals,
    study_parser,
    study_version,
)
from lab.studies.motions import KINDS, motion_in_photo
from motdiff.estimators.motdiff.estimator import MotDiffEstimator
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.metrics import mnc_subpixel, path_distance_px, timed_distance_px
from motdiff.photo_values import luminance
from motdiff.simulate import photograph
from motdiff.threads import one_thread
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_PHOTO_PX = 256
_SCENE_PX = 340  # least side: photo and motion
_SURE = 0.5  # a stated path confidence of more: the path's figures are those of such photos, too


@dataclass(frozen=True)
class Shot:
    """A simulated photo (256, 256) of a known motion."""

    name: str
    kind: str
    light: FloatArray
    motion: Trajectory


def shots(
    scenes: Sequence[tuple[str, FloatArray]],
    trace: GyroTrace,
    *,
    count: int,
    seed: int,
    noise: float = 0.005,
) -> Iterator[Shot]:
    """Simulate ``count`` photos of each kind of motion, with noise of this standard deviation."""
    for number in range(count):
        name, light = scenes[number % len(scenes)]
        for k, kind in enumerate(KINDS):
            rng = np.random.default_rng([seed, number, k])
            motion = motion_in_photo(kind, trace, rng)
            side = _PHOTO_PX - 1 + (motion.frame_size() | 1)
            row, column = (rng.integers(n - side + 1) for n in light.shape[:2])
            scene = luminance(light[row : row + side, column : column + side])
            photo = photograph(scene, motion, rng=rng, read_sigma=noise)
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


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
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


def shots_parser(documentation: str | None) -> argparse.ArgumentParser:
    """Parser of a study of :func:`shots`: rows of photos, or their table."""
    parser = study_parser(documentation)
    parser.add_argument("what", choices=["rows", "table"])
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--photos", type=Path, nargs="+")
    parser.add_argument("--gyro", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.005, help="of full scale")
    return parser


def run_study(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    *,
    prepare: Callable[[], tuple[dict[str, object], Callable[[Shot], dict[str, object]]]],
    table: Callable[[list[dict[str, Any]]], Iterator[str]],
) -> None:
    """Print the table of finished rows, or measure the missing ones.

    Parameters
    ----------
    prepare : callable
        Returns what a row depends on beside the options of :func:`shots_parser`, and the function
        that measures a shot; called for rows alone.
    table : callable
        Lines of the table of rows.
    """
    if options.what == "table":
        with refusals(parser):
            rows = [row for file in options.files for row in kept_rows(file)]
            check_version(rows)
        if len({row["case"].get("noise") for row in rows}) > 1:
            parser.error("table: rows of one --noise at a time, found several")
        print("\n".join(table(rows)))
        return
    if len(options.files) != 1 or options.photos is None or options.gyro is None:
        parser.error("rows: give one FILE, --photos and --gyro")
    (file,) = options.files
    if options.noise < 0:
        parser.error(f"--noise: must be 0 or more, got {options.noise:g}")
    with refusals(parser):
        finished = finished_cases(file)
        trace = read_gyro(options.gyro)
        files = [file for folder in options.photos for file in photo_files(folder)]
        scenes = ((file.name, read_light(file)) for file in files[:: options.every])
        large = large_scenes(scenes, least_px=_SCENE_PX)
        dependences, measure = prepare()
    shared = {
        "photos": list(map(str, options.photos)),
        "gyro": str(options.gyro),
        "every": options.every,
        "seed": options.seed,
        "noise": options.noise,
        **dependences,
    }
    with one_thread():
        for shot in shots(
            large, trace, count=options.count, seed=options.seed, noise=options.noise
        ):
            case = {"name": shot.name, **shared}
            if case_key(case) not in finished:
                add_row(file, {"case": case, **measure(shot)})


def main() -> None:
    parser = shots_parser(__doc__)

    def prepare() -> tuple[dict[str, object], Callable[[Shot], dict[str, object]]]:
        estimator = MotDiffEstimator()
        return {"version": study_version("photo_path")}, lambda shot: figures(shot, estimator)

    run_study(parser, parser.parse_args(), prepare=prepare, table=table)


if __name__ == "__main__":
    main()
