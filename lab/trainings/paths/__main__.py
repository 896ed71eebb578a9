"""Command line of the training of drawn paths: ``python -m lab.trainings.paths``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from lab.trainings.command_line import run_command, training_parser

_EXAMPLES = """half an hour of one core; the file is written every minute:
  python -m lab.trainings.paths train --gyro gyro.txt -o paths.safetensors
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code (:func:`lab.trainings.command_line.run_command`)."""
    parser, commands = training_parser("paths", _EXAMPLES)
    train = commands.add_parser("train", help="train on simulated motions")
    train.add_argument(
        "--gyro", type=Path, required=True, help="gyroscope recording, for hand shakes"
    )
    train.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    train.add_argument("--minutes", type=float, default=30.0)
    train.add_argument("--batch", type=int, default=1024, help="motions in each update")
    train.add_argument("--motions", type=int, default=300_000, help="a millisecond each")
    train.add_argument("--seed", type=int, default=0)
    train.set_defaults(command=_train)
    return run_command(parser, arguments)


def _train(options: argparse.Namespace) -> None:
    import torch

    from lab.trainings.paths.training import Settings, simulated, train
    from motdiff.files.gyro_tables import read_gyro
    from motdiff.training.motion_bank import MotionMix

    settings = Settings(minutes=options.minutes, batch=options.batch, seed=options.seed)
    read_gyro(options.gyro)  # refused before five minutes of simulation
    mix = MotionMix(
        boracchi_foi=0.40,
        boracchi_foi_short=0.10,
        gyro=0.36,
        straight=0.05,
        quadratic=0.09,
        gyro_trace=str(options.gyro),
    )
    torch.set_num_threads(1)  # the layers are small: more threads are slower
    report = partial(print, file=sys.stderr, flush=True)
    report(f"simulating {options.motions} motions")
    motions = simulated(mix, count=options.motions, seed=options.seed)
    train(motions, options.out, settings=settings, report=report)


if __name__ == "__main__":
    sys.exit(run())
