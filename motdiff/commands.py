"""Command line of ``python -m motdiff``: training, preparation, export, evaluation and sampling of the network."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from motdiff.io.outputs import check_file, check_folder

__all__ = ["run"]

_EXAMPLES = """\
examples:
  python -m motdiff pack photos/ photos.zip            # sharp photos, to travel to another machine
  python -m motdiff train motdiff/configs/gpu.toml -o run      # again: goes on where it stopped
  torchrun --nproc-per-node 4 -m motdiff train motdiff/configs/gpu.toml -o run
  python -m motdiff prepare motdiff/configs/cpu.toml -o samples --shards 0:100
  python -m motdiff train motdiff/configs/cpu.toml -o run --minutes 30
  python -m motdiff export run -o motdiff.safetensors
  python -m motdiff eval --set paper --set gyro --photos photos/ --gyro gyro.txt --weights motdiff.safetensors
"""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 2 bad input, 1 a failure, 130 Ctrl-C."""
    parser: argparse.ArgumentParser = _Parser(
        prog="python -m motdiff", epilog=_EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add in (_add_train, _add_prepare, _add_pack, _add_export, _add_sample, _add_eval):
        add(commands)
    given = parser.parse_args(arguments)
    command: Callable[[argparse.Namespace], None] = given.command
    try:
        given.check(given.out)  # before anything is read
        command(given)
    except (ValueError, FileNotFoundError, FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        return _told(error, 2)
    except (OSError, FloatingPointError, RuntimeError) as error:
        return _told(error, 1)
    except KeyboardInterrupt:
        return _told("stopped", 130)
    return 0


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        sys.exit(_told(f"{message} (see {self.prog} --help)", 2))


def _told(error: object, code: int) -> int:
    if isinstance(error, OSError) and error.filename and error.strerror:
        error = f"{error.filename}: {error.strerror}"
    line = (str(error) or type(error).__name__).splitlines()[0]
    print(f"error: {line}", file=sys.stderr)  # noqa: T201
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
    parser.set_defaults(command=_train, check=check_folder)


def _train(given: argparse.Namespace) -> None:
    from motdiff.training.config import read_config
    from motdiff.training.run import Pace, train

    train(
        read_config(given.config),
        given.out,
        device=_device(given.device),
        pace=Pace(minutes=given.minutes, save_s=given.save_every, validate_steps=given.validate_every),
        workers=os.cpu_count() or 1,
    )


def _device(wanted: str) -> str:
    import torch

    there = torch.cuda.is_available()
    name = wanted or ("cuda" if there else "cpu")
    if name == "cuda":
        name = f"cuda:{os.environ.get('LOCAL_RANK', '0')}"  # torchrun's: one GPU for each process
    kind, _, number = name.partition(":")
    if kind not in ("cpu", "cuda") or (number and not number.isdecimal()):
        raise ValueError(f"--device: must be cpu, cuda or cuda:NUMBER, got {wanted!r}")
    if kind == "cuda":
        if not there or int(number) >= torch.cuda.device_count():
            raise ValueError(f"--device: there is no GPU {name} here, use --device cpu")
        torch.cuda.set_device(name)
    return name


def _add_prepare(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("prepare", help="simulate samples ahead, for training without a GPU")
    parser.add_argument("config", type=Path, help="TOML file of the run (photos, motions, photography)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the shards; existing ones are kept")
    parser.add_argument("--shards", default="0:10", metavar="FIRST:LAST[:STEP]", help="64 samples each")
    parser.add_argument("--held-out", action="store_true", help="of the photos held out for validation")
    parser.set_defaults(command=_prepare, check=check_folder)


def _prepare(given: argparse.Namespace) -> None:
    import torch

    from motdiff.network.condition import PHOTO_PX
    from motdiff.training.config import read_config
    from motdiff.training.photos import load_photos, split_photos
    from motdiff.training.prepared import prepare

    torch.set_num_threads(1)  # the arrays are small: more threads are slower
    shards = _shards(given.shards)
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
        on_shard=lambda shard: print(f"shard {shard} of {shards.stop}", file=sys.stderr, flush=True),  # noqa: T201
    )


def _shards(text: str) -> range:
    try:
        first, last, *step = (int(number) for number in text.split(":"))
        shards = range(first, last, *step)
    except (TypeError, ValueError):
        raise ValueError(f"--shards: must be FIRST:LAST or FIRST:LAST:STEP, got {text!r}") from None
    if not shards or min(shards) < 0:
        raise ValueError(f"--shards: must hold numbers from 0 upwards, FIRST below LAST, got {text!r}")
    return shards


def _add_pack(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("pack", help="pack sharp photos into one small file")
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path, help=".zip file")
    parser.add_argument("--side", type=int, default=512, help="longest short side, px")
    parser.add_argument("--quality", type=int, default=92, help="of the JPEGs")
    parser.set_defaults(command=_pack, check=check_file)


def _pack(given: argparse.Namespace) -> None:
    from motdiff.training.photos import pack_photos

    size = pack_photos(given.photos, given.out, most_px=given.side, quality=given.quality)
    print(f"{given.out}: {size / 2**20:.1f} MiB", file=sys.stderr)  # noqa: T201


def _add_export(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("export", help="write a run's averaged weights as one small file")
    parser.add_argument("run", type=Path, help="folder of the run")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".safetensors file")
    parser.add_argument("--offset", type=float, default=0.0, help="taken from the path's logits")
    parser.add_argument("--card", type=Path, help="JSON file: what else the header should say (data, figures)")
    parser.set_defaults(command=_export, check=check_file)


def _export(given: argparse.Namespace) -> None:
    from motdiff.io.inputs import read_json
    from motdiff.weights import export_weights

    card = None if given.card is None else read_json(given.card)
    if not isinstance(card, dict | None):
        raise ValueError(f"{given.card}: must hold a JSON object")
    size = export_weights(given.run / "checkpoint", given.out, offset=given.offset, card=card)
    print(f"{given.out}: {size / 2**20:.1f} MiB", file=sys.stderr)  # noqa: T201


def _add_sample(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("sample", help="draw motions from one blurred photo and show them as they are")
    parser.add_argument("photo", type=Path, help="its middle 256 x 256 px are looked at")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".png file: the photo and the drawn PSFs")
    parser.add_argument("--weights", type=Path, help="the shipped ones when omitted")
    parser.add_argument("--count", type=int, default=8)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.set_defaults(command=_sample, check=check_file)


def _sample(given: argparse.Namespace) -> None:
    import torch

    from motdiff.estimators.kernel_score import noise_sigma
    from motdiff.estimators.motdiff.drawing import draw_psfs, quick_search
    from motdiff.evaluation.pictures import drawn_sheet
    from motdiff.io.decoding import decode
    from motdiff.io.outputs import write_bytes
    from motdiff.io.photo_files import photo_bytes
    from motdiff.network.condition import PHOTO_PX
    from motdiff.simulate import to_linear
    from motdiff.weights import DEFAULT_WEIGHTS, load_network

    image, _ = decode(photo_bytes(given.photo), given.photo, colour=True)
    if min(image.shape[:2]) < PHOTO_PX:
        raise ValueError(
            f"{given.photo}: must have at least {PHOTO_PX} x {PHOTO_PX} px, has {image.shape[1]} x {image.shape[0]}"
        )
    if given.count < 1:
        raise ValueError(f"--count: must be at least 1, got {given.count}")
    top, left = ((n - PHOTO_PX) // 2 for n in image.shape[:2])
    light = to_linear(image[top : top + PHOTO_PX, left : left + PHOTO_PX] / 255).mean(axis=2)[None]
    classical = quick_search(light, sigma=noise_sigma(light[0]))
    generator = torch.Generator().manual_seed(given.seed)
    network = load_network(given.weights or DEFAULT_WEIGHTS)
    psfs = draw_psfs(network, light, classical, count=given.count, steps=given.steps, generator=generator)
    write_bytes(given.out, drawn_sheet(light[0], classical, psfs))


def _add_eval(commands: _Commands[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("eval", help="measure estimators where the motion is known")
    parser.add_argument(
        "--set", dest="sets", action="append", default=[], metavar="SET", help="paper, boracchi-foi or gyro; repeatable"
    )
    parser.add_argument("--photos", type=Path, help="sharp photos for the simulated sets: a folder, or a pack")
    parser.add_argument("--gyro", type=Path, metavar="FILE", help="gyroscope recording for the set gyro")
    parser.add_argument("--levin", type=Path, metavar="DIR", help="Levin's .mat files: adds the set levin")
    parser.add_argument(
        "--method", dest="methods", action="append", default=[], metavar="METHOD",
        help="pmp, motdiff, network (one draw as it is) or network:SAMPLER:STEPS, parametric or "
        "psf-diffusion (baselines of other representations), selfdeblur[:ITERATIONS] or blinddps:FOLDER (hours per "
        "photo); repeatable; pmp and motdiff when omitted",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=Path, action="append", default=[], metavar="FILE",
        help="weights of motdiff; several give a row each, named by the file's stem",
    )  # fmt: skip
    parser.add_argument("--count", type=int, default=24, help="photos per simulated set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sigma", type=float, help="noise, full scale 1, instead of each set's own (0; 0.01; 0.01)")
    parser.add_argument("--grey", action="store_true", help="photos of one channel instead of colour")
    parser.add_argument("--no-restore", action="store_true", help="leave out PSNR and SSIM")
    parser.add_argument("--shown", type=int, default=8, metavar="N", help="cases on each contact sheet")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout instead of tables")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/eval"), help="folder of rows, tables and pictures")
    parser.set_defaults(command=_eval, check=check_folder)


def _eval(given: argparse.Namespace) -> None:
    from motdiff.evaluation.methods import named_estimators
    from motdiff.evaluation.report import report_document, report_text, write_report
    from motdiff.evaluation.run import evaluate, levin_set, simulated_sets

    if not given.sets and given.levin is None:
        raise ValueError("--set: name at least one of paper, boracchi-foi and gyro, or give --levin DIR")
    if given.sets and given.photos is None:
        raise ValueError("--photos: the simulated sets need sharp photos, a folder or a pack")
    methods = given.methods or ["pmp", "motdiff"]
    estimators = named_estimators(methods, given.weights)
    sets = [] if given.levin is None else [levin_set(given.levin)]
    if given.sets:
        sets += simulated_sets(
            given.sets,
            given.photos,
            count=given.count,
            seed=given.seed,
            sigma=given.sigma,
            gyro_trace=given.gyro,
            grey=given.grey,
        )
    outcome = evaluate(
        sets,
        estimators,
        given.out,
        restore=not given.no_restore,
        shown=given.shown,
        report=lambda line: print(line, file=sys.stderr, flush=True),  # noqa: T201
    )
    options = {name: value for name, value in vars(given).items() if name not in ("command", "check")}
    document = report_document(outcome, options)
    write_report(outcome, document, given.out)
    print(json.dumps(document) if given.json else report_text(outcome))  # noqa: T201
    if outcome.stopped:
        raise KeyboardInterrupt
