"""Command line of the denoiser's training: ``python -m cep.restoration.denoiser``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

_EXAMPLES = """the shipped weights:
  OMP_NUM_THREADS=1 python -m cep.restoration.denoiser train PHOTOS --minutes 21 -o denoiser.safetensors
  python -m cep.restoration.denoiser evaluate OTHER_PHOTOS
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 2 input that can be mended, 1 a failure, 130 Ctrl-C."""
    parser = argparse.ArgumentParser(
        prog="python -m cep.restoration.denoiser",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    train = commands.add_parser("train", help="train the denoiser; Ctrl-C keeps the weights of the last minute")
    train.add_argument("photos", type=Path, help="folder of sharp photos")
    train.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    train.add_argument("--minutes", type=float, default=21.0, help="length of the run")
    train.add_argument("--seed", type=int, default=0)
    train.set_defaults(command=_train)
    evaluate = commands.add_parser("evaluate", help="print the PSNR of noisy and denoised photos, linear light")
    evaluate.add_argument("photos", type=Path, help="folder of sharp photos that no training has seen")
    evaluate.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    evaluate.set_defaults(command=_evaluate)
    given = parser.parse_args(arguments)
    try:
        given.command(given)
    except (ValueError, FileNotFoundError, NotADirectoryError) as error:
        return _told(error, 2)
    except (OSError, FloatingPointError) as error:
        return _told(error, 1)
    except KeyboardInterrupt:
        return _told("stopped", 130)
    return 0


def _train(given: argparse.Namespace) -> None:
    from cep.restoration.denoiser.training import Settings, train
    from motdiff.training.photos import load_photos

    settings = Settings(seed=given.seed)
    photos = load_photos(given.photos, least_px=settings.crop_px)
    train(photos, given.out, minutes=given.minutes, settings=settings, say=lambda line: print(line, file=sys.stderr))  # noqa: T201


def _evaluate(given: argparse.Namespace) -> None:
    from cep.restoration.denoiser.evaluation import denoising_gains
    from cep.restoration.denoiser.weights import SHIPPED, load_denoiser
    from motdiff.training.photos import load_photos

    denoise = load_denoiser(given.weights or SHIPPED)
    for sigma, before, after in denoising_gains(load_photos(given.photos, least_px=64), denoise):
        print(f"sigma {sigma:g}: {before:.2f} dB -> {after:.2f} dB")  # noqa: T201


def _told(error: object, code: int) -> int:
    line = (str(error) or type(error).__name__).splitlines()[0]
    print(f"error: {line}", file=sys.stderr)  # noqa: T201
    return code


if __name__ == "__main__":
    sys.exit(run())
