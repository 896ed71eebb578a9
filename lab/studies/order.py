"""How often the order in time of a motion is found from photos taken through known codes, and how
well that is known.

    python -m lab.studies.order [--photos FOLDER] [--gyro FILE] [--set open+gray3 open+one one]
        [--motions walks] [--count 4] [--noise 0.005] [--moved 2] [--results FILE]
        [--workers 1] [--seed 0]

A set names the photos' codes, as `codes_of_set` of lab/bench/coded/calibrations.py does; `one` is
Raskar's code; `open+next3`, the open shutter and codes that are each chosen after the photos
before it, until an order is sure, three at most (`open+next`: one). Each photo shows one crop,
moved by up to `--moved` px of its own, through the light-true PSF of its code, with Gauss noise of
so much of full scale. The n-th motion is the same in every set and at every noise. What may differ
from photo to photo beside: `--brightness`, `--scaled`, `--wobble`. With `--light` the photos show
a small light in the dark.

`right`: the rms distance from the truth, at equal times after the best shift, is at most 1 px and
smaller than that of the path run backwards; `any given`: one of the paths that the estimate gives
is within 1 px. With `--results` each finished motion is a line of that file; the same command goes
on from it, while all sources that it runs are the same.
"""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cep.calibration.next_code import SURE, next_code
from lab.bench.coded.calibrations import codes_of_set, moved_psfs
from lab.studies.inputs import (
    add_row,
    case_key,
    finished_cases,
    photo_files,
    refusals,
    study_parser,
    study_version,
    textured_scene,
)
from lab.studies.motions import MOTIONS, known_motion
from motdiff.files.gyro_tables import read_gyro
from motdiff.metrics import timed_distance_px
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from motdiff.estimators.base import MotionEstimate

RIGHT_PX = 1.0
CHOSEN = "open+next"  # the codes after the first are those that cep calibrate --next chooses
LIT = 0.8  # of full scale: a light's trail at its brightest, and what is around it
DARK = 0.01


@dataclass(frozen=True)
class Case:
    """One motion photographed through one set of codes: all that its figures depend on but the
    estimator.
    """

    set: str
    codes: tuple[str, ...]
    motions: str
    index: int
    noise: float
    moved_px: float
    brightness: float
    scaled: float
    wobble_px: float
    side_px: int
    seed: int
    photos: str
    gyro: str
    light: bool


# -- photos


def wobbled(path: Trajectory, wobble_px: float, rng: np.random.Generator) -> Trajectory:
    """Return the path with a smooth error of so many px rms."""
    t = np.linspace(0, 1, 201)
    knots = np.linspace(0, 1, 6)
    error = np.stack([np.interp(t, knots, rng.standard_normal(6)) for _ in range(2)], axis=1)
    error -= error.mean(axis=0)
    error *= wobble_px / np.sqrt((error**2).sum(axis=1).mean())
    t = np.union1d(t, path.t)
    return Trajectory.from_samples(
        path.at(t)
        + np.stack([np.interp(t, np.linspace(0, 1, 201), column) for column in error.T], axis=1),
        t=t,
    )


def spot(scene: FloatArray, psf: FloatArray) -> FloatArray:
    """Scene of the same size with a small light in the dark, as bright as it may be."""
    night = np.full_like(scene, DARK)
    night[night.shape[0] // 2, night.shape[1] // 2] += LIT / psf.max()
    return night


def photos_of(case: Case) -> tuple[Trajectory, list[FloatArray]]:
    """Path, and the photos of it."""
    # what does not depend on the codes and the noise is drawn first: all sets are compared on the
    # same
    path, rng = known_motion(case.motions, case.index, seed=case.seed, gyro=case.gyro)
    scene = textured_scene(case.photos, side_px=case.side_px, rng=rng)
    own_scenes = [
        np.random.default_rng([case.seed, MOTIONS.index(case.motions), case.index, photo])
        for photo in range(len(case.codes))
    ]
    shifts_px = []
    motions = []
    light = []
    for rng in own_scenes:
        shifts_px.append(rng.uniform(-case.moved_px, case.moved_px, 2))
        factor = 1 + rng.uniform(-case.scaled, case.scaled)
        light.append(np.exp(rng.uniform(-case.brightness, case.brightness)))
        motions.append(
            (wobbled(path, case.wobble_px, rng) if case.wobble_px else path).scaled(factor)
        )
    psfs = moved_psfs(motions, case.codes, shifts_px)
    frame = psfs.shape[-1]
    margin = (2 * case.side_px - (case.side_px + frame - 1)) // 2
    if margin < 0:
        raise SystemExit(f"error: --side: {case.side_px} px do not hold a blur of {frame} px")
    window = slice(margin, margin + case.side_px + frame - 1)
    scenes = [spot(scene, psf) if case.light else scene for psf in psfs]
    photos = [
        photograph(scene[window, window], level * psf, rng=rng, read_sigma=case.noise)
        for scene, psf, level, rng in zip(scenes, psfs, light, own_scenes, strict=True)
    ]
    return path, photos


# -- one case


def figures_of(case: Case) -> dict[str, Any]:
    if case.set.startswith(CHOSEN):
        return chosen_figures(case)
    _, figures = estimated(case)
    return figures


def estimated(case: Case) -> tuple[MotionEstimate | None, dict[str, Any]]:
    """Estimate of a case's photos, None where they are refused, and its figures."""
    from motdiff.estimators.coded.estimator import CodedEstimator
    from motdiff.estimators.coded.trail_estimator import TrailEstimator

    estimator = TrailEstimator if case.light else CodedEstimator
    path, photos = photos_of(case)
    started = time.perf_counter()
    began_cpu = time.process_time()
    row: dict[str, Any]
    estimate = None
    try:
        estimate = estimator(case.codes, seed=case.index).estimate_from(photos)
    except ValueError as refusal:
        row = {"refused": str(refusal)}
    else:
        row = {
            "error_px": timed_distance_px(estimate.best, path),
            "reversed_px": timed_distance_px(estimate.best.reversed(), path),
            "best_of_all_px": min(
                timed_distance_px(candidate, path) for candidate in estimate.trajectories
            ),
            "confidence": estimate.confidence,
            "stated_px": estimate.details["path_uncertainty_px"],
            "misfit": estimate.details["misfit"],
            "cost_gap": estimate.details.get("cost_gap"),
            "searches_agreeing": estimate.details["searches_agreeing"],
            "kernels": estimate.details.get("kernel_confidences", []),
        }
    seconds = {
        "seconds": time.perf_counter() - started,
        "cpu_s": time.process_time() - began_cpu,
    }
    return estimate, row | seconds


def chosen_figures(case: Case) -> dict[str, Any]:
    """Figures of the last of several photos, each code chosen after the photos before it.

    ``steps`` holds those of each photo from the second on.
    """
    from cep.calibration.calibrate import estimate_motion
    from cep.optics.code import ShutterCode

    chips = len(case.codes[0])
    rng = np.random.default_rng(case.index)
    case = replace(case, codes=case.codes[:1])
    _, photos = photos_of(case)
    estimate: MotionEstimate = estimate_motion(photos[0], seed=case.index)
    steps: list[dict[str, Any]] = []
    for _ in range(int(case.set.removeprefix(CHOSEN) or 1)):
        began_cpu = time.process_time()
        codes = [ShutterCode(bits) for bits in case.codes]
        choice = next_code(photos, codes, estimate, chips=chips, rng=rng)
        if choice is None:
            break
        design = {
            "design_cpu_s": time.process_time() - began_cpu,
            "design_orders": choice.orders,
            "design_chi_square": choice.chi_square,
            "bits": choice.code.bits,
        }
        case = replace(case, codes=(*case.codes, choice.code.bits))
        _, photos = photos_of(case)
        next_estimate, figures = estimated(case)
        steps.append(figures | design)
        if next_estimate is None:
            break
        estimate = next_estimate
    if not steps:
        return {"refused": "the open photo shows no motion"}
    return steps[-1] | {"steps": steps}


def is_right(row: dict[str, Any]) -> bool:
    return (
        "error_px" in row and row["error_px"] <= RIGHT_PX and row["error_px"] < row["reversed_px"]
    )


# -- many cases


def measured(cases: Sequence[Case], workers: int) -> Iterator[tuple[Case, dict[str, Any]]]:
    if workers == 1:
        yield from ((case, figures_of(case)) for case in cases)
        return
    pool = ProcessPoolExecutor(
        workers,
        mp_context=get_context("spawn"),  # torch's threads do not survive a fork
        initializer=signal.signal,
        initargs=(
            signal.SIGINT,
            signal.SIG_IGN,
        ),  # Ctrl-C ends the run; what is being measured is finished first
    )
    try:
        running = {pool.submit(figures_of, case): case for case in cases}
        for future in as_completed(running):
            yield running[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


# -- tables


def numbers(rows: Sequence[dict[str, Any]], name: str) -> FloatArray:
    return np.array([row[name] for row in rows], dtype=np.float64)


def order_table(rows: Sequence[tuple[Case, dict[str, Any]]]) -> None:
    print(
        "\n| motions | noise | set | count | right | error, px: median | p90 | backwards | any"
        " given | s | CPU s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for motions, noise, name in sorted({(case.motions, case.noise, case.set) for case, _ in rows}):
        chosen = [
            row
            for case, row in rows
            if (case.motions, case.noise, case.set) == (motions, noise, name)
        ]
        finished_rows = [row for row in chosen if "error_px" in row]
        right = np.mean([is_right(row) for row in chosen])
        line = f"| {motions} | {100 * noise:g} % | {name} | {len(chosen)} | {right:.2f} "
        if finished_rows:
            errors = numbers(finished_rows, "error_px")
            best = numbers(finished_rows, "best_of_all_px")
            backwards = np.mean(numbers(finished_rows, "reversed_px") < errors)
            line += (
                f"| {np.median(errors):.2f} | {np.percentile(errors, 90):.2f} | {backwards:.2f} "
            )
            line += f"| {np.mean(best <= RIGHT_PX):.2f} "
        else:
            line += "| - | - | - | - "
        print(
            line + f"| {numbers(chosen, 'seconds').mean():.0f} |"
            f" {numbers(chosen, 'cpu_s').mean():.0f} |"
        )


def confidence_table(rows: Sequence[tuple[Case, dict[str, Any]]]) -> None:
    print("\n| set | stated confidence | motions | mean stated | right |\n|---|---|---|---|---|")
    for name in sorted({case.set for case, _ in rows}):
        finished_rows = [row for case, row in rows if case.set == name and "error_px" in row]
        for low in (0, 0.25, 0.5, 0.75):
            within = [
                row
                for row in finished_rows
                if low <= row["confidence"] < low + 0.25 + (low == 0.75)
            ]
            if within:
                right = np.mean([is_right(row) for row in within])
                mean = numbers(within, "confidence").mean()
                print(
                    f"| {name} | {low:.2f} to {low + 0.25:.2f} | {len(within)} | {mean:.2f} |"
                    f" {right:.2f} |"
                )


def uncertainty_table(rows: Sequence[tuple[Case, dict[str, Any]]]) -> None:
    print(
        "\nof the right ones\n| set | motions | stated, px: median | true | true / stated: median"
        " | p90 |"
    )
    print("|---|---|---|---|---|---|")
    for name in sorted({case.set for case, _ in rows}):
        right = [row for case, row in rows if case.set == name and is_right(row)]
        if right:
            stated_px = numbers(right, "stated_px")
            true = numbers(right, "error_px")
            ratio = true / np.maximum(stated_px, 1e-3)
            print(
                f"| {name} | {len(right)} | {np.median(stated_px):.2f} | {np.median(true):.2f} |"
                f" {np.median(ratio):.2f} | {np.percentile(ratio, 90):.2f} |"
            )


def stopped_table(rows: Sequence[tuple[Case, dict[str, Any]]]) -> None:
    """Print what comes of taking photos until the order is stated as sure."""
    print(f"\n| until {SURE:g} | motions | right | photos, mean | sure |\n|---|---|---|---|---|")
    for motions, name in sorted(
        {(case.motions, case.set) for case, row in rows if "steps" in row}
    ):
        outcomes = []
        for case, row in rows:
            if (case.motions, case.set) != (motions, name):
                continue
            steps = [step for step in row["steps"] if "confidence" in step]
            sure_steps = [n for n, step in enumerate(steps) if step["confidence"] >= SURE]
            last_step = sure_steps[0] if sure_steps else len(steps) - 1
            outcomes.append(
                (is_right(steps[last_step]) if steps else False, last_step + 2, bool(sure_steps))
            )
        right, photos, sure_share = np.mean(outcomes, axis=0)
        print(
            f"| {name} | {motions} | {right:.2f} of {len(outcomes)} | {photos:.2f} |"
            f" {sure_share:.2f} |"
        )


# -- the command


def parsed_options() -> argparse.Namespace:
    """Return the options, with the codes of each set as ``codes``."""
    parser = study_parser(__doc__)
    parser.add_argument(
        "--photos", default="", metavar="FOLDER", help="scenes; scikit-image's own when omitted"
    )
    parser.add_argument(
        "--light", action="store_true", help="a small light's trails in place of photos of a scene"
    )
    parser.add_argument(
        "--gyro", default="", metavar="FILE", help="angular-rate trace; synthetic when omitted"
    )
    parser.add_argument(
        "--set", nargs="+", default=["open+gray3", "open+one", "one"], metavar="CODES"
    )
    parser.add_argument("--motions", nargs="+", default=["walks"], choices=MOTIONS)
    parser.add_argument("--count", type=int, default=4, help="of each kind of motion")
    parser.add_argument(
        "--noise", nargs="+", type=float, default=[0.005], help="shares of full scale"
    )
    parser.add_argument("--chips", type=int, default=52, help="of `gray` and `half`")
    parser.add_argument("--side", type=int, default=256, help="of the photos, px")
    parser.add_argument(
        "--moved",
        type=float,
        default=2.0,
        metavar="PX",
        help="shift of a photo, at most, on each axis",
    )
    parser.add_argument(
        "--brightness",
        type=float,
        default=0.0,
        metavar="SPREAD",
        help="at most, log of the factor",
    )
    parser.add_argument(
        "--scaled", type=float, default=0.0, metavar="SHARE", help="of a photo's motion, at most"
    )
    parser.add_argument(
        "--wobble",
        type=float,
        default=0.0,
        metavar="PX",
        help="smooth error of a photo's motion, rms",
    )
    parser.add_argument("--results", type=Path, metavar="FILE", help="JSON lines")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with refusals(parser):
        if options.photos:
            photo_files(Path(options.photos))
        if options.gyro:
            read_gyro(options.gyro)
        options.earlier = finished_cases(options.results)
    try:
        options.codes = {
            name: (
                ("1" * options.chips,)
                if name.startswith(CHOSEN)
                else codes_of_set(name.replace("one", "raskar-52"), options.chips)
            )
            for name in options.set
        }
    except ValueError as refusal:
        parser.error(f"--set: {refusal}")
    return options


def cases_of(options: argparse.Namespace) -> list[Case]:
    """Return all cases: each motion at each noise through each set of codes."""
    return [
        Case(
            set=name,
            codes=codes,
            motions=motions,
            index=index,
            noise=noise,
            moved_px=options.moved,
            brightness=options.brightness,
            scaled=options.scaled,
            wobble_px=options.wobble,
            side_px=options.side,
            seed=options.seed,
            photos=options.photos,
            gyro=options.gyro if motions == "gyro" else "",
            light=options.light,
        )
        for index in range(options.count)
        for motions in options.motions
        for noise in options.noise
        for name, codes in options.codes.items()
    ]


def case_line(case: Case, row: dict[str, Any]) -> str:
    """Say how one case came out."""
    verdict = "right" if is_right(row) else "wrong"
    figures = "  ".join(
        f"{name} {value:.2f}" for name, value in row.items() if isinstance(value, float)
    )
    refused = row.get("refused", "")
    return f"{case.motions} {case.index} {case.noise:g} {case.set}: {verdict}  {figures}{refused}"


def main() -> None:
    options = parsed_options()
    cases = cases_of(options)
    version = study_version("order")
    labels = {case: {**asdict(case), "version": version} for case in cases}
    keys = {case: case_key(label) for case, label in labels.items()}
    rows = [(case, options.earlier[key]) for case, key in keys.items() if key in options.earlier]
    missing = [case for case, key in keys.items() if key not in options.earlier]
    print(f"{len(cases)} motions x sets, {len(rows)} of them known", flush=True)
    try:
        for case, row in measured(missing, options.workers):
            if options.results is not None:
                add_row(options.results, {"case": labels[case], **row})
            rows.append((case, row))
            print(case_line(case, row), flush=True)
    except KeyboardInterrupt:
        print("stopped: the motions so far")
    if rows:
        order_table(rows)
        confidence_table(rows)
        uncertainty_table(rows)
    if any("steps" in row for _, row in rows):
        stopped_table(rows)


if __name__ == "__main__":
    main()
