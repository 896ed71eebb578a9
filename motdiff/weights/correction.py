"""Weights file of the correction of searched kernels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from motdiff import weights_io
from motdiff.network.correction import CorrectionNetwork
from motdiff.weights_io import filled, packed, write_with_card

SCHEMA = "motdiff.correction/1"
CORRECTION_WEIGHTS = Path(__file__).with_name("correction.safetensors")
"""The weights in the package."""


def write_correction(
    state: Mapping[str, Tensor], target: Path | str, *, about: Mapping[str, Any]
) -> int:
    """Write a network's weights; returns the bytes.

    Parameters
    ----------
    state : mapping of tensors
        Of a :class:`motdiff.network.correction.CorrectionNetwork`.
    target : .safetensors file to write
    about : mapping
        Figures of its training, for the header.

    Raises
    ------
    ValueError
        If float16 cannot hold them.
    """
    return write_with_card(packed(state, source=target), target, schema=SCHEMA, card=about)


def read_card(path: Path | str = CORRECTION_WEIGHTS) -> dict[str, Any]:
    """Read the header of a weights file: the figures of its training.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    return weights_io.read_card(path, SCHEMA)


def load_correction(path: Path | str = CORRECTION_WEIGHTS) -> CorrectionNetwork:
    """Build the network with the weights of a file, in eval mode and float32.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    return filled(CorrectionNetwork(), path, schema=SCHEMA)
