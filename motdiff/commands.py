"""The commands of ``python -m motdiff``: everything about the network that is done in a shell."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

__all__ = ["run"]

_EXAMPLES = """\
examples:
  python -m motdiff pack photos/ photos.zip            # sharp photos, to travel to another machine
  python -m motdiff train configs/gpu.toml -o run      # again: goes on where it stopped
  torchrun --nproc-per-node 4 -m motdiff train configs/gpu.toml -o run
  python -m motdiff prepare configs/cpu.toml -o samples --shards 0:100
  python -m motdiff train configs/cpu.toml -o run --minutes 30
  python -m motdiff export run -o motdiff.safetensors
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 2 input that can be mended, 1 a failure, 130 Ctrl-C."""
    parser = argparse.ArgumentParser(
        prog="python -m motdiff", epilog=_EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (_add_train, _add_prepare, _add_pack, _add_export):
        add(commands)
    given = parser.parse_args(arguments)
    command: Callable[[argparse.Namespace], None] = given.command
    try:
        command(given)
    except (ValueError, FileNotFoundError, FileExistsError, NotADirectoryError) as error:
        return _told(error, 2)
    except (OSError, FloatingPointError) as error:
        return _told(error, 1)
    except KeyboardInterrupt:
        return _told("stopped", 130)
    return 0


def _told(error: object, code: int) -> int:
    print(f"error: {str(error).splitlines()[0]}", file=sys.stderr)  # noqa: T201
    return code


_Commands = argparse._SubParsersAction  # the only name argparse has for it


def _add_train(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("train", help="train, or go on training")
    parser.add_argument("config", type=Path, help="TOML file of the run")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the run: checkpoint, log, plot")
    parser.add_argument("--device", default="", help="cpu or cuda; the GPU of this process where there is one")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="end this piece after so many minutes")
    parser.add_argument("--validate-every", type=int, default=1000, metavar="STEPS")
    parser.add_argument("--save-every", type=float, default=60.0, metavar="SECONDS")
    parser.set_defaults(command=_train)


def _train(given: argparse.Namespace) -> None:
    import torch

    from motdiff.training.config import read_config
    from motdiff.training.run import Pace, train

    device = given.device or (f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if torch.cuda.is_available() else "cpu")
    if device.startswith("cuda"):
        torch.cuda.set_device(device)
    train(
        read_config(given.config),
        given.out,
        device=device,
        pace=Pace(minutes=given.minutes, save_s=given.save_every, validate_steps=given.validate_every),
        workers=os.cpu_count() or 1,
    )


def _add_prepare(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("prepare", help="simulate samples ahead, for training without a GPU")
    parser.add_argument("config", type=Path, help="TOML file of the run (photos, motions, photography)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the shards; existing ones are kept")
    parser.add_argument("--shards", default="0:10", metavar="FIRST:LAST[:STEP]", help="64 samples each")
    parser.add_argument("--held-out", action="store_true", help="of the photos held out for validation")
    parser.set_defaults(command=_prepare)


def _prepare(given: argparse.Namespace) -> None:
    import torch

    from motdiff.training.config import read_config
    from motdiff.training.photos import load_photos, split_photos
    from motdiff.training.prepared import prepare
    from motdiff.training.samples import PHOTO_PX

    torch.set_num_threads(1)  # the arrays are small: more threads only wait for each other
    try:
        shards = range(*(int(number) for number in given.shards.split(":")))
    except (TypeError, ValueError):
        raise ValueError(f"--shards: must be FIRST:LAST or FIRST:LAST:STEP, got {given.shards!r}") from None
    config = read_config(given.config)
    if not config.data.photos:
        raise ValueError(f"{given.config}: data.photos is needed to prepare samples")
    photos = load_photos(config.data.photos, least_px=PHOTO_PX + config.photography.margin)
    seen, held_out = split_photos(photos, config.data.held_out)
    prepare(
        given.out,
        scenes=held_out if given.held_out else seen,
        mix=config.motions,
        photography=config.photography,
        shards=shards,
        seed=config.optimiser.seed + (1 if given.held_out else 0),
        told=lambda shard: print(f"shard {shard} of {shards.stop}", file=sys.stderr, flush=True),  # noqa: T201
    )


def _add_pack(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("pack", help="pack sharp photos into one small file")
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path, help=".zip file")
    parser.add_argument("--side", type=int, default=512, help="longest short side, px")
    parser.add_argument("--quality", type=int, default=92, help="of the JPEGs")
    parser.set_defaults(command=_pack)


def _pack(given: argparse.Namespace) -> None:
    from motdiff.training.photos import pack_photos

    size = pack_photos(given.photos, given.out, most_px=given.side, quality=given.quality)
    print(f"{given.out}: {size / 2**20:.1f} MiB", file=sys.stderr)  # noqa: T201


def _add_export(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("export", help="write a run's averaged weights as one small file")
    parser.add_argument("run", type=Path, help="folder of the run")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    parser.set_defaults(command=_export)


def _export(given: argparse.Namespace) -> None:
    from motdiff.weights import export_weights

    size = export_weights(given.run / "checkpoint", given.out)
    print(f"{given.out}: {size / 2**20:.1f} MiB", file=sys.stderr)  # noqa: T201
