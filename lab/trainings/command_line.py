"""Command lines of the trainings: what they share, and how a command ends."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from motdiff.__main__ import exit_code

_Commands = argparse._SubParsersAction  # the only name argparse has for it


def training_parser(
    name: str, examples: str
) -> tuple[argparse.ArgumentParser, _Commands[argparse.ArgumentParser]]:
    """Make the parser of ``python -m lab.trainings.NAME``, and the place of its commands."""
    parser = argparse.ArgumentParser(
        prog=f"python -m lab.trainings.{name}",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser, parser.add_subparsers(required=True, metavar="COMMAND")


def add_prepare(
    commands: _Commands[argparse.ArgumentParser], help_text: str
) -> argparse.ArgumentParser:
    """Add the command that prepares shards of photos, for :func:`prepare_shards`."""
    prepare = commands.add_parser("prepare", help=help_text)
    prepare.add_argument(
        "config", type=Path, help="TOML file of a run of MoTDiff (photos, motions, photography)"
    )
    prepare.add_argument(
        "-o",
        "--out",
        type=Path,
        required=True,
        help="folder of the shards; existing ones are kept",
    )
    prepare.add_argument(
        "--shards", default="0:4", metavar="FIRST:LAST[:STEP]", help="128 photos each"
    )
    prepare.add_argument(
        "--held-out", action="store_true", help="of the photos held out for validation"
    )
    return prepare


def prepare_shards(options: argparse.Namespace, prepare: Callable[..., None]) -> None:
    """Prepare the shards that the options of :func:`add_prepare` and ``--device`` name.

    Parameters
    ----------
    prepare : callable
        ``prepare(folder, source, shards=, device=, on_shard=)``.
    """
    import torch

    from motdiff.training.prepared import read_source, shard_range
    from motdiff.training.run_piece import device_named

    torch.set_num_threads(1)  # the arrays are small: more threads are slower
    shards = shard_range(options.shards)
    prepare(
        options.out,
        read_source(options.config, held_out=options.held_out),
        shards=shards,
        device=device_named(options.device),
        on_shard=lambda shard: print(
            f"shard {shard} of {shards.stop}", file=sys.stderr, flush=True
        ),
    )


def run_command(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    """Parse the arguments and call the chosen command, which is the default ``command`` of its
    parser.

    Returns
    -------
    int
        Exit code, as of :func:`motdiff.__main__.exit_code`.
    """
    options = parser.parse_args(arguments)
    return exit_code(lambda: options.command(options))
