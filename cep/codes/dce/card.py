"""What a weights file says of itself: its code, and how both were trained. Read without torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cep.optics.code import ShutterCode
from motdiff.io.inputs import one_line
from motdiff.weights_io import read_header

__all__ = ["SCHEMA", "Card", "read_card"]

SCHEMA = "cep.dce/1"


@dataclass(frozen=True)
class Card:
    """The header of a weights file.

    Attributes
    ----------
    code : ShutterCode
        The learned code.
    start : ShutterCode
        The one it began with.
    steps : int
        Updates.
    seconds : float
        Time they took.
    notes : mapping
        Data and figures.
    """

    code: ShutterCode
    start: ShutterCode
    steps: int
    seconds: float
    notes: Mapping[str, object]


def read_card(path: Path | str) -> Card:
    """Read the header of a weights file.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    header = read_header(path)
    if SCHEMA not in header:
        found = one_line(", ".join(sorted(header)) or "nothing")
        raise ValueError(f"{path}: is no {SCHEMA} file, its header has {found}")
    try:
        card = json.loads(header[SCHEMA])
        code, start = ShutterCode(card["bits"]), ShutterCode(card["settings"]["start"])
        return Card(code, start, int(card["steps"]), float(card["seconds"]), dict(card["notes"]))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path}: its header is not whole: {one_line(error)}") from error
