"""Command line of the training of drawn paths: ``python -m lab.trainings.paths``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from lab.trainings.command_line import add_prepare, prepare_shards, run_command, training_parser

_EXAMPLES = """on one GPU, 4 and 7 minutes; CONFIG is motdiff/configs/gpu.toml, its paths set:
  python -m lab.trainings.paths prepare CONFIG -o photos --shards 0:73 --device cuda
  python -m lab.trainings.paths prepare CONFIG -o held_out --shards 0:6 --held-out --device cuda
  python -m lab.trainings.paths train photos held_out CONFIG -o paths.safetensors --device cuda
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code (:func:`lab.trainings.command_line.run_command`)."""
    parser, commands = training_parser("paths", _EXAMPLES)
    prepare = add_prepare(commands, "simulate photos, search and correct their kernels")
    prepare.set_defaults(command=_prepare)
    train = commands.add_parser("train", help="train; the file holds the best weights so far")
    train.add_argument("photos", type=Path, help="folder of prepared photos")
    train.add_argument("held_out", type=Path, help="folder of held-out ones")
    train.add_argument("config", type=Path, help="the TOML file, for clean motions")
    train.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    train.add_argument("--minutes", type=float, default=7.0)
    train.add_argument("--batch", type=int, default=256, help="photos in each update")
    train.add_argument("--motions", type=int, default=60_000, help="clean ones; 1 ms each")
    train.add_argument("--seed", type=int, default=0)
    train.set_defaults(command=_train)
    for command in (prepare, train):
        command.add_argument("--device", default="cpu", help="cpu, cuda or cuda:NUMBER")
    return run_command(parser, arguments)


def _prepare(options: argparse.Namespace) -> None:
    from lab.trainings.paths.samples import prepare
    from motdiff.weights import load_correction

    prepare_shards(options, partial(prepare, network=load_correction()))


def _train(options: argparse.Namespace) -> None:
    from lab.trainings.paths.samples import clean_points, read_samples
    from lab.trainings.paths.training import Settings, train
    from motdiff.training.config import read_config
    from motdiff.training.run_piece import device_named

    mix = read_config(options.config).motions
    settings = Settings(minutes=options.minutes, batch=options.batch, seed=options.seed)
    photos, held_out = (read_samples(folder) for folder in (options.photos, options.held_out))
    # seeds of the photos' motions are the run's and the next
    motions = clean_points(mix, count=options.motions, seed=options.seed + 77)
    train(
        photos,
        held_out,
        motions,
        options.out,
        settings=settings,
        device=device_named(options.device),
        report=partial(print, file=sys.stderr, flush=True),
    )


if __name__ == "__main__":
    sys.exit(run())
