"""The weights file of DCE: network and code together, with a card of their training in the
header.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from cep.restoration.blur import channels_first, channels_last
from lab.trainings.dce.model import RestorationNetwork, code_of
from motdiff import weights_io
from motdiff.files.inputs import one_line
from motdiff.training.checkpoint import read_checkpoint
from motdiff.types import FloatArray
from motdiff.weights_io import filled, halved, write_with_card

SCHEMA = "cep.dce/1"
WEIGHTS = Path(__file__).with_name("dce.safetensors")
"""The weights in this folder; their code is :data:`lab.trainings.dce.shipped_code.DCE_CODE`."""


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


def read_card(path: Path | str = WEIGHTS) -> Card:
    """Read the header of a weights file.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    card = weights_io.read_card(path, SCHEMA)
    try:
        code = ShutterCode(card["bits"])
        start = ShutterCode(card["settings"]["start"])
        return Card(code, start, int(card["steps"]), float(card["seconds"]), dict(card["notes"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: its header is not whole: {one_line(error)}") from error


def load_network(path: Path | str = WEIGHTS) -> RestorationNetwork:
    """Build the network of a weights file, in eval mode and float32.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    read_card(path)
    return filled(RestorationNetwork(), path, schema=SCHEMA)


def restore(
    photo: ArrayLike, *, code: ShutterCode | None = None, path: Path = WEIGHTS
) -> FloatArray:
    """Restore a coded photo with the network alone; the motion is no input.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
        Light-true: a scene of value 1 is recorded as the code's duty.
    code : ShutterCode, optional
        The code it was taken with; the file's own when omitted. Only its duty counts.
    path : path
        Weights file; the one of this folder when omitted.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure, not clipped. Each channel is restored by itself, in
        about 1.2 s and 120 MiB per megapixel on one core.

    Raises
    ------
    ValueError
        If the photo is malformed or the file is not one of ours.
    """
    channels = channels_first(photo) / (code or read_card(path).code).duty
    network = load_network(path)
    with torch.inference_mode():
        restored = [
            network(torch.from_numpy(channel[None, None]).float())[0, 0].numpy()
            for channel in channels
        ]
    return channels_last(np.stack(restored).astype(np.float64))


def export_weights(
    checkpoint: Path | str, target: Path | str, *, notes: Mapping[str, object] | None = None
) -> int:
    """Write a run's network as float16, and its code, as one .safetensors file; returns its size
    in bytes.

    Parameters
    ----------
    checkpoint : file of a checkpoint
    target : .safetensors file to write
    notes : mapping, optional
        Further entries of the card: data, figures.

    Raises
    ------
    ValueError
        If there is no checkpoint, or float16 cannot hold its weights.
    """
    stored = read_checkpoint(checkpoint)
    if stored is None:
        raise ValueError(f"{checkpoint}: holds no checkpoint")
    card = {
        "bits": code_of(stored.tensors["code"]).bits,
        "settings": stored.config,
        "steps": stored.step,
        "seconds": round(stored.seconds),
        "notes": dict(notes or {}),
    }
    tensors = halved(stored.under("model."), source=checkpoint)
    return write_with_card(tensors, target, schema=SCHEMA, card=card)
