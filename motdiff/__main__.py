"""``python -m motdiff``: train, prepare, pack, sample, export."""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from motdiff.files.inputs import printable
from motdiff.files.outputs import check_file, check_folder
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from motdiff.training.trainer import Trainer

_TILE_IN = 1.3  # inches of each picture on the sheet

_EXAMPLES = """\
examples:
  python -m motdiff pack photos/ photos.zip            # sharp photos, to travel to another machine
  python -m motdiff train motdiff/configs/gpu.toml -o run      # again: goes on where it stopped
  torchrun --nproc-per-node 4 -m motdiff train motdiff/configs/gpu.toml -o run
  python -m motdiff prepare motdiff/configs/cpu.toml -o samples --shards 0:100
  python -m motdiff train motdiff/configs/cpu.toml -o run --minutes 30
  python -m motdiff export run -o motdiff.safetensors
measured where the motion is known:
  python -m lab bench blind --data photos/ --methods pmp,network:ddim:10@motdiff.safetensors
"""


def parser() -> argparse.ArgumentParser:
    """Build the parser of the command line."""
    root: argparse.ArgumentParser = _Parser(
        prog="python -m motdiff",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = root.add_subparsers(required=True, metavar="COMMAND")
    for add in (_add_train, _add_prepare, _add_pack, _add_export, _add_sample):
        add(commands)
    return root


def run(arguments: Sequence[str] | None = None, *, trainers: Sequence[type[Trainer]] = ()) -> int:
    """Run a command; returns the exit code: 0 done, 2 bad input, 1 a failure, 130 Ctrl-C.

    ``arguments`` are the process's when omitted; ``trainers`` those of other networks' targets.
    """
    options = parser().parse_args(arguments)
    options.trainers = trainers

    def work() -> None:
        options.check(options.out)  # before anything is read: training would fail only at its end
        options.command(options)

    return exit_code(work)


def exit_code(work: Callable[[], None]) -> int:
    """Do the work of a command; 0 done, 2 bad input, 1 a failure, 130 Ctrl-C, in one line."""
    try:
        work()
    except (
        ValueError,
        FileNotFoundError,
        FileExistsError,
        NotADirectoryError,
        IsADirectoryError,
    ) as error:
        return _fail(error, 2)
    except (OSError, FloatingPointError, RuntimeError) as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _fail("stopped", 130)
    return 0


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        sys.exit(_fail(f"{message} (see {self.prog} --help)", 2))


def _fail(error: object, code: int) -> int:
    if isinstance(error, OSError) and error.filename and error.strerror:
        error = f"{error.filename}: {error.strerror}"
    line = (str(error) or type(error).__name__).splitlines()[0]
    print(f"error: {printable(line)}", file=sys.stderr)  # noqa: T201
    return code


_Commands = argparse._SubParsersAction  # the only name argparse has for it


def _add_out(parser: argparse.ArgumentParser, help_text: str) -> None:
    parser.add_argument("-o", "--out", type=Path, required=True, help=help_text)


def _add_train(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("train", help="train, or go on training")
    parser.add_argument("config", type=Path, help="TOML file of the run")
    _add_out(parser, "folder of the run: checkpoint, log, plot")
    parser.add_argument(
        "--device", default="", help="cpu or cuda; the GPU of this process where there is one"
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=float("inf"),
        help="end this piece after so many minutes, with all it does",
    )
    parser.add_argument("--validate-every", type=int, default=1000, metavar="STEPS")
    parser.add_argument(
        "--validate-minutes",
        type=float,
        default=float("inf"),
        metavar="MINUTES",
        help="validate as well where so much time went by without",
    )
    parser.add_argument("--save-every", type=float, default=60.0, metavar="SECONDS")
    parser.set_defaults(command=_train, check=check_folder)


def _train(options: argparse.Namespace) -> None:
    from motdiff.training.config import read_config
    from motdiff.training.run_piece import Pace, device_named, train
    from motdiff.training.trainer import Trainer

    with _entries_of(options.config):
        config = read_config(options.config)
        trainers = {trainer.target: trainer for trainer in (Trainer, *options.trainers)}
        train(
            config,
            options.out,
            trainer_type=trainers.get(config.network.target, Trainer),
            device=device_named(options.device),
            pace=Pace(
                minutes=options.minutes,
                save_s=options.save_every,
                validate_steps=options.validate_every,
                validate_minutes=options.validate_minutes,
            ),
            workers=os.cpu_count() or 1,
        )


@contextmanager
def _entries_of(config: Path) -> Iterator[None]:
    """Name the run's file in errors that begin with an entry of it, as ``data.photos:``."""
    from motdiff.training.config import TrainingConfig

    try:
        yield
    except ValueError as error:
        if str(error).partition(".")[0] in {section.name for section in fields(TrainingConfig)}:
            raise ValueError(f"{config}: {error}") from None
        raise


def _add_prepare(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "prepare", help="simulate samples ahead, for training without a GPU"
    )
    parser.add_argument(
        "config", type=Path, help="TOML file of the run (photos, motions, photography)"
    )
    _add_out(parser, "folder of the shards; existing ones are kept")
    parser.add_argument(
        "--shards", default="0:10", metavar="FIRST:LAST[:STEP]", help="64 samples each"
    )
    parser.add_argument(
        "--held-out", action="store_true", help="of the photos held out for validation"
    )
    parser.set_defaults(command=_prepare, check=check_folder)


def _prepare(options: argparse.Namespace) -> None:
    import torch

    from motdiff.training.prepared import prepare, read_source, shard_range

    torch.set_num_threads(1)  # the arrays are small: more threads are slower
    shards = shard_range(options.shards)
    with _entries_of(options.config):
        prepare(
            options.out,
            read_source(options.config, held_out=options.held_out),
            shards=shards,
            on_shard=lambda shard: print(  # noqa: T201
                f"shard {shard} of {shards.stop}", file=sys.stderr, flush=True
            ),
        )


def _add_pack(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("pack", help="pack sharp photos into one small file")
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path, help=".zip file")
    parser.add_argument("--side", type=int, default=512, help="longest short side, px")
    parser.add_argument("--quality", type=int, default=92, help="of the JPEGs")
    parser.set_defaults(command=_pack, check=check_file)


def _pack(options: argparse.Namespace) -> None:
    from motdiff.training.photos import pack_photos

    size = pack_photos(options.photos, options.out, most_px=options.side, quality=options.quality)
    print(printable(f"{options.out}: {size / 2**20:.1f} MiB"), file=sys.stderr)  # noqa: T201


def _add_export(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("export", help="write a run's averaged weights as one small file")
    parser.add_argument("run", type=Path, help="folder of the run")
    _add_out(parser, ".safetensors file")
    parser.add_argument("--offset", type=float, default=0.0, help="taken from the path's logits")
    parser.add_argument(
        "--card", type=Path, help="JSON file: what else the header should say (data, figures)"
    )
    parser.set_defaults(command=_export, check=check_file)


def _export(options: argparse.Namespace) -> None:
    from motdiff.files.inputs import read_json
    from motdiff.training.log import last_validation
    from motdiff.training.weight_files import export_weights
    from motdiff.weights import read_network_card

    card = None if options.card is None else read_json(options.card)
    if not isinstance(card, dict | None):
        raise ValueError(f"{options.card}: must hold a JSON object")
    score = last_validation(options.run / "log.csv")
    size = export_weights(
        options.run / "checkpoint",
        options.out,
        offset=options.offset,
        card=card,
        validation_mnc=score,
    )
    runs = read_network_card(options.out)["run"]["history"]
    samples, hours = (sum(piece[name] for piece in runs) for name in ("samples", "hours"))
    text = f"{options.out}: {size / 2**20:.1f} MiB; {samples:,} samples in {hours:.1f} h, "
    text += "1 run" if len(runs) == 1 else f"{len(runs)} runs"
    if score is not None:
        text += f", validation MNC {score:.3f}"
    print(printable(text), file=sys.stderr)  # noqa: T201


def _add_sample(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "sample", help="draw motions from one blurred photo and show them as they are"
    )
    parser.add_argument("photo", type=Path, help="its middle 256 x 256 px are looked at")
    _add_out(parser, ".png file: the photo and the drawn PSFs")
    parser.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.set_defaults(command=_sample, check=check_file)


def _sample(options: argparse.Namespace) -> None:
    import torch

    from motdiff.estimators.motdiff.drawing import draw_psfs, quick_search
    from motdiff.files.decoding import decode
    from motdiff.files.outputs import write_bytes
    from motdiff.files.photo_files import photo_bytes
    from motdiff.network.condition import PHOTO_PX
    from motdiff.photo_noise import noise_sigma
    from motdiff.photo_values import luminance, to_linear
    from motdiff.weights import DEFAULT_WEIGHTS, load_network

    image, _ = decode(photo_bytes(options.photo), options.photo)
    height, width = image.shape[:2]
    if min(height, width) < PHOTO_PX:
        raise ValueError(
            f"{options.photo}: must have at least {PHOTO_PX} x {PHOTO_PX} px, has {width} x"
            f" {height}"
        )
    if options.count < 1:
        raise ValueError(f"--count: must be at least 1, got {options.count}")
    top = (height - PHOTO_PX) // 2
    left_edge = (width - PHOTO_PX) // 2
    middle = image[top : top + PHOTO_PX, left_edge : left_edge + PHOTO_PX]
    if middle.dtype.kind != "f":  # files of floats hold linear light already
        middle = to_linear(middle / np.iinfo(middle.dtype).max)
    light = luminance(middle)[None]
    classical = quick_search(light, sigma=noise_sigma(light[0]))
    generator = torch.Generator().manual_seed(options.seed)
    network = load_network(options.weights or DEFAULT_WEIGHTS)
    psfs = draw_psfs(
        network, light, classical, count=options.count, steps=options.steps, generator=generator
    )
    write_bytes(options.out, _drawn_sheet(light[0], classical, psfs))


def _drawn_sheet(photo: FloatArray, classical: FloatArray, psfs: FloatArray) -> bytes:
    """PNG of a photo (H, W), classical kernels (Q, 64, 64) and drawn PSFs (K, 64, 64)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    draws = [f"draw {i + 1}" for i in range(len(psfs))]
    titles = ["photo", *["classical"] * len(classical), *draws]
    figure = Figure(
        figsize=(_TILE_IN * len(titles), _TILE_IN + 0.3), layout="constrained", facecolor="white"
    )
    FigureCanvasAgg(figure)
    # the root shows faint light too
    pictures = [np.clip(photo, 0, 1) ** (1 / 2.2), *np.sqrt(classical), *np.sqrt(psfs)]
    for number, (title, picture) in enumerate(zip(titles, pictures, strict=True), 1):
        axes = figure.add_subplot(1, len(titles), number)
        axes.imshow(picture, cmap="gray")
        axes.set_title(title, fontsize=8)
        axes.set_axis_off()
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()


if __name__ == "__main__":
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # signs that its encoding lacks
    sys.exit(run())
