"""Gains as photographs show them: `python -m lab.photo_gains`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import cep
from cep.optics.camera import Camera
from cep.search.problem import SearchProblem
from lab.photo_gains.gains import CHIPS, SIDE_PX, measured_gain, motions, trial_of
from lab.photo_gains.photographs import load_scenes

LIGHT = ((2.0, 10_000.0), (10.0, 3_000.0), (50.0, 10_000.0), (200.0, 100_000.0))
_CLEAR_DB = 0.5
ABOUT = """For each motion, read noise and light: the gain of the best code over the best
single exposure as `cep advise` states it, with its range, dB; the gain that these two have on
other photographs, whether it lies in that range, and the standard deviation from photograph to
photograph; and the gain over the single exposure that is best on the other photographs, and its
length. Linear light, the path known, the middle of each photo. Last, means over the rows."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m lab.photo_gains", description=ABOUT)
    parser.add_argument("photos", type=Path, help="folder of sharp photos")
    parser.add_argument("--count", type=int, default=24, help="photos at most")
    arguments = parser.parse_args()
    try:
        scenes = load_scenes(arguments.photos, side_px=SIDE_PX, count=arguments.count)
    except ValueError as error:
        parser.error(f"photos: {error}")
    print(f"{len(scenes)} photographs")
    print(
        "| motion | e- / photo-electrons | stated | measured, same two | in the range | spread"
        " | measured, best single exposure | its chips (stated) |"
    )
    print("|---|---|---:|---:|---|---:|---:|---:|")
    gains = []
    for name, path in motions().items():
        for read_noise_e, photons in LIGHT:
            camera = Camera(photons_full_scale=photons, read_noise_e=read_noise_e, bits=16)
            problem = SearchProblem.along(path, chips=CHIPS, camera=camera)
            verdict = cep.advise(problem).here
            gain = measured_gain(verdict, trial_of(problem, scenes))
            cells = "no code or no single exposure is possible"
            if gain is not None:
                gains.append(gain)
                cells = gain.cells
            print(f"| {name} | {read_noise_e:g} / {photons:,.0f} | {cells} |", flush=True)
    misses = np.array([gain.stated_db - gain.measured_db for gain in gains])
    best_misses = np.array([gain.stated_db - gain.over_best_db for gain in gains])
    signs = [
        gain.stated_db * gain.measured_db > 0
        for gain in gains
        if max(abs(gain.stated_db), abs(gain.measured_db)) > _CLEAR_DB
    ]
    print(
        f"stated less measured: mean size {np.abs(misses).mean():.2f} dB (over the best single"
        f" exposure {np.abs(best_misses).mean():.2f}); in the range"
        f" {sum(gain.covered for gain in gains)} of {len(gains)}; sign right in"
        f" {sum(signs)} of {len(signs)} over {_CLEAR_DB} dB"
    )


if __name__ == "__main__":
    main()
