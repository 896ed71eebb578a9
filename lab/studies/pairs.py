"""What two photos of one exposure through complementary codes show of a motion that never repeats.

    python -m lab.studies.pairs --photos FOLDER --gyro FILE [--motions gyro walks arcs] [--count 4]
        [--code raskar-52] [--read-noise 50] [--photons 10000] [--seed 1] [--results pairs.jsonl]

Each motion is photographed once, and each photo restored without the motion, as `cep deblur` does:
with the shutter open, by two such cameras (`two open`, their mean), through the code alone, in the
better of two snapshots (a quarter and an eighth of the time, in the middle), by two cameras
through the code and its complement (`pair`), and by the same two behind a beam splitter, with half
the light each (`split`). `pair, true path` and `open, true path` are restored along the true
motion. PSNR in dB, light 0..1, over shifts, without the outer 30 px. With `--results` each
finished motion is a line of that file; the same command goes on from it, while the restorations'
sources are the same.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from cep.codes.sources import code_file, load_code
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.restoration.restore import restore
from cep.restoration.together import restore_together
from lab.bench.statistics import mean_interval
from lab.photo_gains.gains import centred
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
from motdiff.metrics import psnr_up_to_shift, timed_distance_px
from motdiff.types import FloatArray

BORDER_PX = 30
SIDE_PX = 256
ROWS = (
    "open",
    "two open",
    "snapshot",
    "coded",
    "pair",
    "split",
    "open, true path",
    "pair, true path",
)
KINDS = {"gyro": "shakes", "walks": "walks", "arcs": "arcs"}


def figures(motions: str, index: int, options: argparse.Namespace) -> dict[str, Any]:
    """PSNR of each row, and of the pairs the error, stated probability and seconds."""
    code = load_code(options.code)
    path, rng = known_motion(motions, index, seed=options.seed, gyro=options.gyro)
    frame = path.frame_size() | 1
    margin = (2 * SIDE_PX - (SIDE_PX + frame - 1)) // 2
    window = slice(margin, margin + SIDE_PX + frame - 1)
    scene = textured_scene(options.photos, side_px=SIDE_PX, rng=rng)[window, window]
    sharp = scene[frame // 2 :, frame // 2 :][:SIDE_PX, :SIDE_PX]
    camera = Camera(photons_full_scale=options.photons, read_noise_e=options.read_noise)

    def photo(played: ShutterCode, light: float = 1.0) -> FloatArray:
        return capture(light * scene, path, played, camera, rng=rng)

    def psnr_db(image: FloatArray) -> float:
        return psnr_up_to_shift(
            np.clip(image, 0, 1), np.clip(sharp, 0, 1), max_shift_px=8, crop_px=BORDER_PX
        )

    open_photo = photo(ShutterCode("1" * code.chips))
    row: dict[str, Any] = {"open": psnr_db(restore(open_photo, anyway=True).image)}
    mean_photo = (open_photo + photo(ShutterCode("1" * code.chips))) / 2
    row["two open"] = psnr_db(restore(mean_photo, anyway=True).image)
    row["open, true path"] = psnr_db(
        restore(open_photo, trajectory=path, method="pnp", camera=camera).image
    )
    shots = [centred(code.chips, round(code.chips / count)) for count in (4, 8)]
    row["snapshot"] = max(psnr_db(restore(photo(shot), code=shot).image) for shot in shots)
    row["coded"] = psnr_db(restore(photo(code), code=code).image)
    codes = [code, code.complement()]
    for name, light in (("pair", 1.0), ("split", 0.5)):
        photos = [photo(played, light) for played in codes]
        start_s = time.process_time()
        restored = restore_together(photos, codes)
        row[name] = psnr_db(restored.image / light)
        row[f"{name}: cpu_s"] = time.process_time() - start_s
        row[f"{name}: probability"] = restored.psf_confidence
        assert restored.trajectory is not None
        row[f"{name}: error_px"] = timed_distance_px(restored.trajectory, path)
        if name == "pair":
            informed = restore_together(photos, codes, path, cameras=[camera] * 2)
            row["pair, true path"] = psnr_db(informed.image)
    return row


def table(rows: list[tuple[str, dict[str, Any]]]) -> None:
    rng = np.random.default_rng(0)
    for kind in sorted({motions for motions, _ in rows}):
        chosen = [row for motions, row in rows if motions == kind]
        print(f"\n{KINDS[kind]}: {len(chosen)}")
        for name in ROWS:
            gains = [row[name] - row["open"] for row in chosen]
            low = high = float("nan")
            if len(gains) > 2:
                interval = mean_interval(gains, rng=rng)
                low, high = interval.low, interval.high
            mean_db = np.mean([row[name] for row in chosen])
            print(
                f"  {name:<16}{mean_db:>7.2f} dB, less open {np.mean(gains):+.2f}"
                f" ({low:+.2f}..{high:+.2f}), in {sum(gain > 0 for gain in gains)}"
            )
        for name in ("pair", "split"):
            errors = np.array([row[f"{name}: error_px"] for row in chosen])
            probability = np.mean([row[f"{name}: probability"] for row in chosen])
            print(
                f"  {name}: path within 1 px in {np.sum(errors < 1)}, median"
                f" {np.median(errors):.2f} px; stated {probability:.2f}; CPU-s, median"
                f" {np.median([row[f'{name}: cpu_s'] for row in chosen]):.0f}"
            )


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--photos", default="", help="folder; scikit-image's when omitted")
    parser.add_argument("--gyro", default="", help="recording; noise when omitted")
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=MOTIONS)
    parser.add_argument("--count", type=int, default=4, help="motions of each kind")
    parser.add_argument("--code", default="raskar-52")
    parser.add_argument("--photons", type=float, default=10_000.0)
    parser.add_argument("--read-noise", type=float, default=50.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    shared = {
        name: getattr(options, name) for name in ("code", "photons", "read_noise", "seed")
    } | {"photos": options.photos, "gyro": options.gyro}
    if code_file(options.code) is not None:
        shared["code"] = load_code(options.code).bits  # another code may lie in the file later
    shared["version"] = study_version("pairs")
    with refusals(parser):
        if options.photos:
            photo_files(Path(options.photos))
        finished = finished_cases(options.results)
    rows = []
    for index in range(options.count):
        for motions in options.motions:
            case = {"motions": motions, "index": index, **shared}
            row = finished.get(case_key(case))
            if row is None:
                row = figures(motions, index, options)
                if options.results is not None:
                    add_row(options.results, {"case": case, **row})
            brief = "  ".join(
                f"{name} {value:.2f}" for name, value in row.items() if value is not None
            )
            print(f"{motions} {index}: {brief}", flush=True)
            rows.append((motions, row))
    table(rows)


if __name__ == "__main__":
    main()
