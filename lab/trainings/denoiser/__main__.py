"""Command line of the denoiser's training: ``python -m lab.trainings.denoiser``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from lab.trainings.command_line import run_command

_EXAMPLES = """the shipped weights:
  OMP_NUM_THREADS=1 python -m lab.trainings.denoiser train PHOTOS --minutes 21 -o denoiser.safetensors
  python -m lab.trainings.denoiser evaluate OTHER_PHOTOS
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code (:func:`lab.trainings.command_line.run_command`)."""
    parser = argparse.ArgumentParser(
        prog="python -m lab.trainings.denoiser",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    train = commands.add_parser(
        "train", help="train the denoiser; Ctrl-C keeps the weights of the last minute"
    )
    train.add_argument("photos", type=Path, help="folder of sharp photos")
    train.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    train.add_argument("--minutes", type=float, default=21.0, help="length of the run")
    train.add_argument("--seed", type=int, default=0)
    train.set_defaults(command=_train)
    evaluate = commands.add_parser(
        "evaluate", help="print the PSNR of noisy and denoised photos, linear light"
    )
    evaluate.add_argument(
        "photos", type=Path, help="folder of sharp photos that no training has seen"
    )
    evaluate.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    evaluate.set_defaults(command=_evaluate)
    return run_command(parser, arguments)


def _train(options: argparse.Namespace) -> None:
    from lab.trainings.denoiser.training import Settings, train
    from motdiff.training.photos import load_photos

    settings = Settings(seed=options.seed)
    photos = load_photos(options.photos, least_px=settings.crop_px)
    train(
        photos,
        options.out,
        minutes=options.minutes,
        settings=settings,
        report=lambda line: print(line, file=sys.stderr),
    )


def _evaluate(options: argparse.Namespace) -> None:
    from cep.restoration.denoiser.weights import SHIPPED, load_denoiser
    from lab.trainings.denoiser.evaluation import denoising_gains
    from motdiff.training.photos import load_photos

    denoise = load_denoiser(options.weights or SHIPPED)
    for sigma, before, after in denoising_gains(load_photos(options.photos, least_px=64), denoise):
        print(f"sigma {sigma:g}: {before:.2f} dB -> {after:.2f} dB")


if __name__ == "__main__":
    sys.exit(run())
