"""Gains as photographs show them: `python -m lab.photo_gains`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import cep
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.restoration.registry import METHODS, find_method
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict
from lab.photo_gains.photographs import load_scenes, photographs
from lab.photo_gains.trial import Trial
from motdiff.motions import quadratic
from motdiff.trajectory import Trajectory

CHIPS = 40
LENGTHS = (1, 2, 3, 4, 5, 6, 8, 12, 20)  # of the single exposures, chips
LIGHT = ((2.0, 10_000.0), (10.0, 3_000.0), (50.0, 10_000.0), (200.0, 100_000.0))
SIDE_PX = 300
ABOUT = """For each motion, read noise and light: the gain of the best code over the best
single exposure as `cep advise` expects it, dB; the gain that these two have on the
photographs; and the gain over the single exposure that is best on the photographs, its length,
and the standard deviation from photograph to photograph. Linear light, the path known, the
middle of each photo."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m lab.photo_gains", description=ABOUT)
    parser.add_argument("--photos", type=Path, help="folder of sharp photos (12 of ours)")
    parser.add_argument("--method", choices=[*METHODS], default="pnp", help="restoration")
    parser.add_argument("--count", type=int, default=12, help="photos at most")
    arguments = parser.parse_args()
    scenes = photographs()
    if arguments.photos is not None:
        try:
            scenes = load_scenes(arguments.photos, side_px=SIDE_PX, count=arguments.count)
        except ValueError as error:
            parser.error(f"--photos: {error}")
    _, restore = find_method(arguments.method)
    print(f"{len(scenes)} photographs, {arguments.method}")
    print(
        "| motion | e- / photo-electrons | expected | measured, same two | measured, best single"
        " exposure | its chips (expected) | spread |"
    )
    print("|---|---|---:|---:|---:|---:|---:|")
    arc = quadratic(np.random.default_rng(12), min_length_px=24, max_length_px=30, max_bend=1.5)
    for name, path in {"straight 40 px": Trajectory.straight(40.0), "arc": arc}.items():
        for read_noise_e, photons in LIGHT:
            camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
            problem = SearchProblem.along(path, chips=CHIPS, camera=camera)
            verdict = cep.advise(problem, levels=[]).here
            trial = Trial(problem, scenes, restore)
            row = measured_row(verdict, trial)
            print(f"| {name} | {read_noise_e:g} / {photons:,.0f} | {row} |", flush=True)


def measured_row(verdict: Verdict, trial: Trial) -> str:
    """Measure the gains of a verdict's best code: the cells of a table."""
    code = verdict.best("code")
    single = verdict.best("snapshot")
    if code is None or single is None:
        return "no code or no single exposure is possible | | | | "
    lengths = {centred(length).bits: centred(length) for length in LENGTHS}
    levels = trial.psnr_db([code.code, single.code, *lengths.values()])
    means = levels[1:].mean(axis=1)
    best = int(means.argmax())
    gains = levels[0] - levels[1 + best]
    singles = [single.code, *lengths.values()]
    return (
        f"{code.psnr_db - single.psnr_db:+.2f} | {levels[0].mean() - means[0]:+.2f} |"
        f" {gains.mean():+.2f} | {singles[best].open_chips} ({single.code.open_chips}) |"
        f" {gains.std(ddof=1):.2f}"
    )


def centred(length: int) -> ShutterCode:
    """Return a single opening of so many chips in the middle of the exposure."""
    before = (CHIPS - length) // 2
    return ShutterCode("0" * before + "1" * length + "0" * (CHIPS - length - before))


if __name__ == "__main__":
    main()
