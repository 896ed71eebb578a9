"""Weights file of the denoiser, float16, and the denoiser as a function on arrays."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cep.restoration.denoiser.network import DenoisingNetwork
from motdiff import weights_io
from motdiff.types import FloatArray
from motdiff.weights_io import filled, halved, write_with_card

SCHEMA = "cep.denoiser/1"
SHIPPED = Path(__file__).with_name("denoiser.safetensors")
"""The weights in the package."""
_WRAP_PX = 16
_TILE_PX = (
    1024  # side of what is denoised at once: features of larger tiles take longer to allocate
)
_MARGIN_PX = 64  # as far as the network sees: tiles join without a seam
_MULTIPLE_PX = 8


def write_weights(
    state: Mapping[str, Tensor], target: Path | str, *, about: Mapping[str, Any]
) -> int:
    """Write a network's weights as float16, with a JSON card in the header; returns the bytes.

    Raises
    ------
    ValueError
        If float16 cannot hold them.
    """
    return write_with_card(halved(state, source=target), target, schema=SCHEMA, card=about)


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
        noisy, levels = (torch.from_numpy(array).float() for array in (around[:, None], sigma))
        clean = torch.empty_like(noisy)
        with (
            torch.inference_mode(),
            torch.autocast("cpu", torch.bfloat16, enabled=_has_bfloat16()),
        ):
            tiles = itertools.product(*map(_spans, noisy.shape[2:]))
            for (row, column), channel in itertools.product(tiles, range(len(images))):
                tile = noisy[channel : channel + 1, :, row.outer, column.outer]
                output = network(
                    tile.contiguous(memory_format=torch.channels_last), levels[channel, None]
                )
                clean[channel, :, row.inner, column.inner] = output[
                    0, :, row.inside, column.inside
                ]
        inner: FloatArray = clean[:, 0, _WRAP_PX:-_WRAP_PX, _WRAP_PX:-_WRAP_PX].numpy()
        return inner

    return denoise


def _has_bfloat16() -> bool:
    """Whether the processor multiplies bfloat16 itself: half the time, for 0.01 dB."""
    capabilities: Mapping[str, bool] = getattr(torch.cpu, "get_capabilities", dict)()
    return capabilities.get("avx512_bf16", False)


@dataclass(frozen=True)
class _Span:
    """Extent of a tile along one axis: without and with the margin that it is denoised with."""

    inner: slice
    outer: slice

    @property
    def inside(self) -> slice:
        return slice(self.inner.start - self.outer.start, self.inner.stop - self.outer.start)


def _spans(side_px: int) -> list[_Span]:
    count = -(-side_px // _TILE_PX)
    # the network's own grid of pixels goes on from tile to tile
    step = -(-side_px // (count * _MULTIPLE_PX)) * _MULTIPLE_PX
    spans = []
    for start in range(0, side_px, step):
        stop = min(start + step, side_px)
        outer = slice(max(0, start - _MARGIN_PX), min(stop + _MARGIN_PX, side_px))
        spans.append(_Span(slice(start, stop), outer))
    return spans
