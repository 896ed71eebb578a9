"""Command line of the correction's training: ``python -m lab.trainings.correction``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from lab.trainings.command_line import add_prepare, prepare_shards, run_command, training_parser

_EXAMPLES = """a training like that of the shipped weights, in minutes on a GPU; CONFIG is motdiff/configs/gpu.toml, its paths set:
  python -m lab.trainings.correction prepare CONFIG -o kernels --shards 0:84 --device cuda
  python -m lab.trainings.correction prepare CONFIG -o held_out --shards 0:6 --held-out --device cuda
  python -m lab.trainings.correction train kernels -o correction.safetensors --device cuda
  python -m lab.trainings.correction evaluate held_out --weights correction.safetensors
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code (:func:`lab.trainings.command_line.run_command`)."""
    parser, commands = training_parser("correction", _EXAMPLES)
    prepare = add_prepare(
        commands, "simulate photos and search their kernels; about 3 s a photo on a CPU"
    )
    prepare.set_defaults(command=_prepare)
    train = commands.add_parser(
        "train", help="train the correction; Ctrl-C keeps the weights of the last minute"
    )
    train.add_argument("kernels", type=Path, help="folder of prepared kernels")
    train.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    train.add_argument("--steps", type=int, default=2500)
    train.add_argument("--batch", type=int, default=512, help="kernels in each update")
    train.add_argument("--seed", type=int, default=0)
    train.set_defaults(command=_train)
    evaluate = commands.add_parser(
        "evaluate", help="print the MNC of kernels before and after their correction"
    )
    evaluate.add_argument(
        "kernels", type=Path, help="folder of prepared kernels of photos that no training has seen"
    )
    evaluate.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    evaluate.set_defaults(command=_evaluate)
    for command in (prepare, train, evaluate):
        command.add_argument("--device", default="cpu", help="cpu, cuda or cuda:NUMBER")
    return run_command(parser, arguments)


def _prepare(options: argparse.Namespace) -> None:
    from lab.trainings.correction.samples import prepare

    prepare_shards(options, prepare)


def _train(options: argparse.Namespace) -> None:
    from lab.trainings.correction.samples import read_samples
    from lab.trainings.correction.training import Settings, train
    from motdiff.training.run_piece import device_named

    device = device_named(options.device)
    settings = Settings(steps=options.steps, batch=options.batch, seed=options.seed)
    train(
        read_samples(options.kernels),
        options.out,
        settings=settings,
        device=device,
        report=partial(print, file=sys.stderr, flush=True),
    )


def _evaluate(options: argparse.Namespace) -> None:
    from lab.trainings.correction.samples import read_samples
    from lab.trainings.correction.training import corrected_mnc
    from motdiff.training.run_piece import device_named
    from motdiff.weights import CORRECTION_WEIGHTS, load_correction

    device = device_named(options.device)
    samples = read_samples(options.kernels)
    network = load_correction(options.weights or CORRECTION_WEIGHTS)
    searched, once, twice = corrected_mnc(samples, network, device=device)
    print(f"{len(samples)} photos: MNC {searched:.3f}, corrected {once:.3f}, twice {twice:.3f}")


if __name__ == "__main__":
    sys.exit(run())
