"""Paths drawn for the kernels of blurred photos: one draw, the best of eight, and the likeliest.

    python -m lab.studies.drawn_path rows FILE --photos DIR... --gyro RECORDING
        [--every N] [--count 12] [--seed 0] [--noise 0.005] [--draws 8] [--weights FILE]
    python -m lab.studies.drawn_path table FILE...

The photos are those of ``lab.studies.photo_path``. Paths are drawn for the kernel that ``cep
calibrate`` chooses, whether a simple motion explains it or not. Figures: sub-pixel MNC of the
kernel, of the PSFs of one draw, of the best of all and of the likeliest order; and whether one,
any, and the likeliest are right: within 1 px rms at equal times, in the better direction. One
thread; an interrupted run goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lab.bench.statistics import mean_interval
from lab.studies.inputs import study_version
from lab.studies.motions import KINDS
from lab.studies.photo_path import Shot, run_study, shots_parser
from motdiff.estimators.motdiff.estimator import MotDiffEstimator
from motdiff.metrics import mnc_subpixel, timed_distance_px
from motdiff.network.path_denoiser import PathDenoiser
from motdiff.network.path_drawing import draw_paths
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray
from motdiff.weights import PATH_WEIGHTS, load_path_denoiser

_RIGHT_PX = 1.0


def figures(
    shot: Shot, estimator: MotDiffEstimator, denoiser: PathDenoiser, *, draws: int
) -> dict[str, object]:
    """Draw paths for one photo's kernel, and compare them with the truth."""
    kernel = estimator.estimate(shot.light).psf
    truth = shot.motion.psf(shot.motion.frame_size(64))
    samples = draw_paths(denoiser, kernel, count=draws, rng=np.random.default_rng(0))

    def mnc(path: Trajectory) -> float:
        return mnc_subpixel(path.psf(path.frame_size(64)), truth)

    def timed_px(path: Trajectory) -> float:
        return min(
            timed_distance_px(directed, shot.motion) for directed in (path, path.reversed())
        )

    paths = [samples.path(number) for number in range(draws)]
    order = samples.orders()[0]
    return {
        "name": shot.name,
        "kind": shot.kind,
        "kernel": mnc_subpixel(kernel, truth),
        "draws": [mnc(path) for path in paths],
        "likeliest": mnc(order.path),
        "draws_px": [timed_px(path) for path in paths],
        "likeliest_px": timed_px(order.path),
        "stated": order.right,
    }


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Lines of the table, a row for each kind of motion and one for all; intervals of 95 %."""
    yield (
        "| motions | photos | kernel | one draw | best of all | best less kernel | likeliest |"
        " likeliest less kernel | right: one | any | likeliest | stated |"
    )
    yield "|---|" + "---:|" * 11
    for kind in (*KINDS, "all"):
        group = [row for row in rows if kind in (row["kind"], "all")]
        if not group:
            continue
        kernel, likeliest, likeliest_px, right_stated = (
            np.array([row[key] for row in group])
            for key in ("kernel", "likeliest", "likeliest_px", "stated")
        )
        draws, draws_px = (np.array([row[key] for row in group]) for key in ("draws", "draws_px"))
        right = draws_px < _RIGHT_PX
        best = draws.max(axis=1)
        yield (
            f"| {kind} | {len(group)} | {kernel.mean():.3f} | {draws[:, 0].mean():.3f}"
            f" | {best.mean():.3f} | {_interval(best - kernel)} | {likeliest.mean():.3f}"
            f" | {_interval(likeliest - kernel)} | {right[:, 0].mean():.2f}"
            f" | {right.any(axis=1).mean():.2f} | {(likeliest_px < _RIGHT_PX).mean():.2f}"
            f" | {right_stated.mean():.2f} |"
        )


def _interval(differences: FloatArray) -> str:
    interval = mean_interval(differences, rng=np.random.default_rng(0))
    return f"{interval.mean:+.3f} [{interval.low:+.3f}, {interval.high:+.3f}]"


def main() -> None:
    parser = shots_parser(__doc__)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--weights", type=Path, default=PATH_WEIGHTS)
    options = parser.parse_args()
    if options.draws < 1:
        parser.error(f"--draws: must be at least 1, got {options.draws}")

    def prepare() -> tuple[dict[str, object], Callable[[Shot], dict[str, object]]]:
        denoiser = load_path_denoiser(options.weights)
        estimator = MotDiffEstimator()
        dependences: dict[str, object] = {
            "draws": options.draws,
            "weights": str(options.weights),
            "version": study_version("drawn_path"),
        }
        return dependences, lambda shot: figures(shot, estimator, denoiser, draws=options.draws)

    run_study(parser, options, prepare=prepare, table=table)


if __name__ == "__main__":
    main()
