"""Command line of DCE's training: ``python -m lab.trainings.dce``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from lab.trainings.command_line import run_command, training_parser

_EXAMPLES = """the shipped weights:
  python -m lab.trainings.dce train PHOTOS --gyro gyro.txt -o run
  python -m lab.trainings.dce export run -o dce.safetensors
  python -m lab.trainings.dce evaluate OTHER_PHOTOS --gyro gyro.txt --weights dce.safetensors
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code (:func:`lab.trainings.command_line.run_command`)."""
    parser, commands = training_parser("dce", _EXAMPLES)
    train = commands.add_parser("train", help="train code and network, or go on training")
    train.add_argument("photos", type=Path, help="folder of sharp photos")
    train.add_argument(
        "-o", "--out", type=Path, required=True, help="folder of the run: checkpoint and log.csv"
    )
    train.add_argument(
        "--gyro", type=Path, help="gyroscope recording: adds real hand shake to the motions"
    )
    train.add_argument(
        "--start", metavar="BITS", help="code to begin with; DCE's of 32 chips when omitted"
    )
    train.add_argument("--steps", type=int, default=5000, help="updates of 4 samples")
    train.add_argument(
        "--minutes", type=float, default=float("inf"), help="end this piece after so many minutes"
    )
    train.add_argument("--seed", type=int, default=0)
    train.set_defaults(command=_train)
    export = commands.add_parser("export", help="write a run's code and network as one small file")
    export.add_argument("run", type=Path, help="folder of the run")
    export.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    export.add_argument(
        "--notes", type=Path, help="JSON file: what else the header should say (data, figures)"
    )
    export.set_defaults(command=_export)
    evaluate = commands.add_parser(
        "evaluate", help="measure the learned code and the network; prints JSON lines"
    )
    evaluate.add_argument(
        "photos", type=Path, help="folder of sharp photos that no training has seen"
    )
    evaluate.add_argument(
        "--gyro", type=Path, help="gyroscope recording: adds real hand shake to the motions"
    )
    evaluate.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    evaluate.add_argument("--count", type=int, default=32)
    evaluate.add_argument("--sigma", type=float, default=0.01, help="noise, full scale 1")
    evaluate.add_argument("--seed", type=int, default=0)
    evaluate.set_defaults(command=_evaluate)
    return run_command(parser, arguments)


def _train(options: argparse.Namespace) -> None:
    from lab.trainings.dce.samples import Samples, motion_mix
    from lab.trainings.dce.training import START, CodeTrainer, Settings, train
    from motdiff.psf_frame import PSF_PX
    from motdiff.training.photos import load_photos

    settings = Settings(start=options.start or START, seed=options.seed)
    photos = load_photos(options.photos, least_px=settings.crop_px + PSF_PX - 1)
    mix = motion_mix(options.gyro)
    chips = len(settings.start)
    samples = Samples(photos, mix, chips=chips, crop_px=settings.crop_px, seed=settings.seed)
    train(
        CodeTrainer(settings), samples, options.out, steps=options.steps, minutes=options.minutes
    )


def _export(options: argparse.Namespace) -> None:
    from lab.trainings.dce.weights import export_weights
    from motdiff.files.inputs import read_json

    notes = None if options.notes is None else read_json(options.notes)
    if not isinstance(notes, dict | None):
        raise ValueError(f"{options.notes}: must hold a JSON object")
    size = export_weights(options.run / "checkpoint", options.out, notes=notes)
    print(f"{options.out}: {size / 2**20:.1f} MiB", file=sys.stderr)


def _evaluate(options: argparse.Namespace) -> None:
    from lab.trainings.dce.evaluation import evaluate, scenes_of
    from lab.trainings.dce.samples import motion_mix
    from lab.trainings.dce.weights import WEIGHTS

    rows = evaluate(
        scenes_of(options.photos),
        motion_mix(options.gyro),
        count=options.count,
        seed=options.seed,
        sigma=options.sigma,
        weights=options.weights or WEIGHTS,
    )
    for row in rows:
        print(json.dumps(asdict(row) | {"code": row.code.bits}))


if __name__ == "__main__":
    sys.exit(run())
