"""Weights file of the denoiser, float16, and the denoiser as a function on arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cep.restoration.denoiser.network import DenoisingNetwork
from motdiff import weights_io
from motdiff.types import FloatArray
from motdiff.weights_io import filled, write_with_card

SCHEMA = "cep.denoiser/1"
SHIPPED = Path(__file__).with_name("denoiser.safetensors")
"""The weights in the package."""
_WRAP_PX = 16


def write_weights(
    state: Mapping[str, Tensor], target: Path | str, *, about: Mapping[str, Any]
) -> int:
    """Write a network's weights as float16, with a JSON card in the header; returns the bytes.

    Raises
    ------
    ValueError
        If float16 cannot hold them.
    """
    return write_with_card(state, target, schema=SCHEMA, card=about, source=target)


def read_card(path: Path | str = SHIPPED) -> dict[str, Any]:
    """Read the header of a weights file: ``steps``, ``seconds`` and ``settings`` of its training.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    return weights_io.read_card(path, SCHEMA)


def load_denoiser(
    path: Path | str = SHIPPED,
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return a file's denoiser: a function of images (C, H, W), each one period of its scene and
    denoised by itself, and the standard deviations (C,) of their noise.

    Levels above the trained ones are equivalent to a darker photo, see :class:`DenoisingNetwork`.

    Raises
    ------
    ValueError
        If the file is not one of ours.
    """
    network = filled(DenoisingNetwork(), path, schema=SCHEMA)
    # a quarter quicker on processors
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def denoise(images: FloatArray, sigma: FloatArray) -> FloatArray:
        # the network takes what lies outside for dark, and was not trained at its border
        around = np.pad(images, ((0, 0), (_WRAP_PX, _WRAP_PX), (_WRAP_PX, _WRAP_PX)), mode="wrap")
        batch, levels = (torch.from_numpy(array).float() for array in (around[:, None], sigma))
        with torch.inference_mode():
            output = network(batch.contiguous(memory_format=torch.channels_last), levels)
        inner = output[:, 0, _WRAP_PX:-_WRAP_PX, _WRAP_PX:-_WRAP_PX]
        return np.asarray(inner.numpy(), dtype=np.float64)

    return denoise
