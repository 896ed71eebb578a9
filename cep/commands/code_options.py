"""Declarations of the options that say which code is searched, shared by ``cep optimize`` and
``python -m lab pareto``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cep.commands.options import MOTION

_CODE = "Code"
_OBJECTIVE = "Objective"
_LIMITS = "Limits of the shutter"
_UNSURE = "Uncertain motion and shutter"
SEARCH = "Search"
"""Panel of the help pages for how the code is searched."""


def _option(panel: str, name: str, metavar: str | None, help: str, **more: Any) -> Any:
    return typer.Option(name, metavar=metavar, help=help, rich_help_panel=panel, **more)


def _limit(name: str, help: str) -> Any:
    return _option(_LIMITS, name, "N", help, min=1)


def chips_option(*, least: int, help: str = "Number of chips.") -> Any:
    """Make the option ``--chips`` of a command."""
    return typer.Option("--chips", "-n", metavar="N", min=least, help=help, rich_help_panel=_CODE)


def exposure_seconds(text: str | None) -> float | None:
    """Read ``--exposure``: seconds, a fraction of one, or a number with its unit.

    Raises
    ------
    ValueError
        If it is none of these, or not above 0.

    Examples
    --------
    >>> exposure_seconds("1/50"), exposure_seconds("20ms"), exposure_seconds("0.5")
    (0.02, 0.02, 0.5)
    """
    if text is None:
        return None
    from cep.files.formatting import seconds_of

    try:
        return seconds_of(text)
    except ValueError as error:
        raise ValueError(f"--{error}") from None


Each = Annotated[
    Path | None,
    _option(
        MOTION,
        "--each",
        "FOLDER",
        "A code for each motion of a folder, FOLDER/*/trajectory.json, as cep calibrate FOLDER"
        " writes them.",
    ),
]

OpenChips = Annotated[
    str | None, _option(_CODE, "--open", "K|LOW:HIGH", "Open chips; any number when omitted.")
]
Duty = Annotated[
    str | None,
    _option(_CODE, "--duty", "LOW:HIGH", "Instead of --open: open fraction of the time, 0..1."),
]
ChipTime = Annotated[int, _option(_CODE, "--chip-ns", "NS", "Chip time, ns.", min=1)]
ChipTimeInstead = Annotated[
    int | None,
    _option(
        _CODE, "--chip-ns", "NS", "Instead of --exposure: chip time, ns; 1 ms when omitted.", min=1
    ),
]
Exposure = Annotated[
    str | None,
    _option(
        _CODE,
        "--exposure",
        "S",
        "Length of the exposure, which sets the chip time: 1/30, 0.02, 20ms or 500us.",
    ),
]
Frames = Annotated[
    int,
    _option(
        _CODE,
        "--frames",
        "N",
        "Exposures restored together, each with its own code: code_1.json, ... With --method"
        " anneal.",
        min=1,
    ),
]

Objective = Annotated[
    str | None,
    _option(
        _OBJECTIVE,
        "--objective",
        "NAME",
        "mse (expected error of the restored photo), min-mtf, flatness, noise, or a mix as"
        " min-mtf:0.15,noise:1. When omitted: mse; min-mtf with --method exact along a uniform"
        " straight motion.",
    ),
]
Direction = Annotated[
    str,
    _option(
        _OBJECTIVE,
        "--direction",
        "WAY",
        "Of the motion: unknown (the worse way counts), forward, or auto: as the file says.",
    ),
]

Device = Annotated[
    str | None,
    _option(
        _LIMITS,
        "--device",
        "NAME|FILE",
        "What this shutter can play: a built-in profile or a .toml file. Stricter limits may be"
        " added.",
    ),
]
MinOpen = Annotated[int, _limit("--min-open", "Shortest open run, chips.")]
MaxOpen = Annotated[int | None, _limit("--max-open", "Longest open run, chips.")]
MinClosed = Annotated[int, _limit("--min-closed", "Shortest closed run, chips.")]
MinPeriod = Annotated[int, _limit("--min-period", "Fewest chips from one opening to the next.")]
MaxPulses = Annotated[int | None, _limit("--max-pulses", "Most open runs.")]
FirstOpen = Annotated[bool, _option(_LIMITS, "--first-open", None, "The first chip is open.")]
LastOpen = Annotated[bool, _option(_LIMITS, "--last-open", None, "The last chip is open.")]
Fixed = Annotated[
    str | None,
    _option(
        _LIMITS, "--fixed", "MARKS", "A mark for each chip: 1 open, 0 closed, ? free, as 1???0?1."
    ),
]

Alternatives = Annotated[
    bool,
    _option(
        _UNSURE,
        "--alternatives",
        None,
        "Design for the other motions that the file holds as well.",
    ),
]
Speed = Annotated[
    str | None,
    _option(
        _UNSURE,
        "--speed",
        "LOW:HIGH",
        "Design for these factors of the path's length, as 0.8:1.2.",
    ),
]
Drift = Annotated[
    float | None,
    _option(
        _UNSURE,
        "--drift",
        "SHARE",
        "Design for a shutter clock off by this share either way, as 0.02.",
    ),
]
Jitter = Annotated[
    float | None,
    _option(_UNSURE, "--jitter", "CHIPS", "Design for edges off by this many chips rms, 0..0.15."),
]
Rule = Annotated[
    str, _option(_UNSURE, "--rule", "NAME", "Over several motions: worst, or mean (weighted).")
]

Method = Annotated[
    str,
    _option(
        SEARCH,
        "--method",
        "NAME",
        "anneal; or exact, which proves the best min-mtf, to about 40 chips.",
    ),
]
Effort = Annotated[
    str,
    _option(
        SEARCH,
        "--bound",
        "NAME",
        "quick; or sdp: half a minute for a tighter bound, and starts drawn from it, along curved"
        " motion.",
    ),
]
