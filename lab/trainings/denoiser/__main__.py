"""Command line of the denoiser's training: ``python -m lab.trainings.denoiser``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from lab.trainings.command_line import run_command, training_parser

_EXAMPLES = """a training like that of the shipped weights, ten minutes of a GPU:
  python -m lab.trainings.denoiser pack PHOTOS -o photos.zip
  python -m lab.trainings.denoiser train photos.zip --gyro gyro.txt --minutes 9.7 --device cuda -o denoiser.safetensors
  python -m lab.trainings.denoiser evaluate OTHER_PHOTOS --weights denoiser.safetensors
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code (:func:`lab.trainings.command_line.run_command`)."""
    parser, commands = training_parser("denoiser", _EXAMPLES)
    pack = commands.add_parser(
        "pack", help="shrink photos to where JPEG has left their colours whole, into one .zip file"
    )
    pack.add_argument("photos", type=Path, help="folder of sharp photos")
    pack.add_argument("-o", "--out", type=Path, required=True, help=".zip file")
    pack.set_defaults(command=_pack)
    train = commands.add_parser(
        "train", help="train the denoiser; Ctrl-C keeps the weights of the last minute"
    )
    train.add_argument("photos", type=Path, help="folder of sharp photos, or a pack of them")
    train.add_argument("--gyro", type=Path, help="gyroscope recording, for motions of a hand")
    train.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    train.add_argument("--minutes", type=float, default=10.0, help="length of the run")
    train.add_argument("--batch", type=int, default=256, help="noisy crops in an update")
    train.add_argument("--blurred-batch", type=int, default=96, help="blurred photos in an update")
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--device", default="cpu", help="cpu, cuda or cuda:NUMBER")
    train.set_defaults(command=_train)
    evaluate = commands.add_parser(
        "evaluate", help="print the PSNR of restored photos in linear light"
    )
    evaluate.add_argument(
        "photos", type=Path, help="folder of sharp photos that no training has seen"
    )
    evaluate.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    evaluate.add_argument("--count", type=int, help="of photos; all when omitted")
    evaluate.set_defaults(command=_evaluate)
    return run_command(parser, arguments)


def _pack(options: argparse.Namespace) -> None:
    from lab.trainings.denoiser.photos import pack_shrunk

    size = pack_shrunk(options.photos, options.out)
    print(f"{options.out}: {size / 2**20:.1f} MiB", file=sys.stderr)


def _train(options: argparse.Namespace) -> None:
    from lab.trainings.denoiser.photos import random_paths
    from lab.trainings.denoiser.samples import Photos
    from lab.trainings.denoiser.training import Settings, train
    from motdiff.training.photos import load_photos
    from motdiff.training.run_piece import device_named

    device = device_named(options.device)
    settings = Settings(
        batch=options.batch, blurred_batch=options.blurred_batch, seed=options.seed
    )
    photos = load_photos(
        options.photos, least_px=settings.blurred_px, most_px=10_000, device=device
    )
    train(
        Photos.joined(photos),
        random_paths(options.gyro, seed=options.seed).to(device),
        options.out,
        minutes=options.minutes,
        settings=settings,
        report=lambda line: print(line, file=sys.stderr, flush=True),
    )


def _evaluate(options: argparse.Namespace) -> None:
    from cep.restoration.denoiser.network import SHIPPED, load_denoiser
    from lab.trainings.denoiser.evaluation import restoration_rows
    from motdiff.training.photos import load_photos

    photos = load_photos(options.photos, least_px=100, most_px=10_000)[: options.count]
    denoiser = load_denoiser(options.weights or SHIPPED)
    print("| motion | shutter | e- / photo-electrons | Wiener | pnp |\n|---|---|---|---:|---:|")
    for motion, shutter, noise_e, photons, wiener, pnp in restoration_rows(photos, denoiser):
        noise = f"{noise_e:g} / {photons:,.0f}"
        print(f"| {motion} | {shutter} | {noise} | {wiener:.2f} | {pnp:.2f} |", flush=True)


if __name__ == "__main__":
    sys.exit(run())
