"""Denoiser of a known level of white Gaussian noise: its network, its weights file, float16, and
the function on arrays.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.types import FloatArray
from motdiff.weights_io import filled

SCHEMA = "cep.denoiser/1"
"""Of the weights file. Its card has ``steps``, ``seconds`` and ``settings`` of the training."""
SHIPPED = Path(__file__).with_name("denoiser.safetensors")
"""The weights in the package."""
WIDTHS = (48, 64, 96)
_SHUFFLE = 2  # the finest features are at half the resolution: four times as quick
_WRAP_PX = 16
_TILE_PX = 1024  # side of what is denoised at once: larger tiles' features take long to allocate
_MARGIN_PX = 64  # as far as the network sees: tiles join without a seam
_MULTIPLE_PX = 8


class DenoisingNetwork(nn.Module):
    """Removes white Gaussian noise of a known level from a photo.

    Without biases it is homogeneous: image and noise level times a > 0 give the result times a.

    Parameters
    ----------
    widths : sequence of int
        Channels from half the resolution downwards, each level half as fine as the one before.

    References
    ----------
    Zhang, Zuo, Zhang, "FFDNet", IEEE TIP 2018: shuffled pixels and a map of the noise level.
    Mohan, Kadkhodaie, Simoncelli, Fernandez-Granda, "Robust and interpretable blind image
    denoising via bias-free convolutional neural networks", ICLR 2020.
    """

    def __init__(self, widths: Sequence[int] = WIDTHS) -> None:
        super().__init__()
        self.multiple_px = _SHUFFLE << (len(widths) - 1)
        self.stem = nn.Conv2d(_SHUFFLE**2 + 1, widths[0], 3, padding=1, bias=False)
        self.encoders = nn.ModuleList([_Block(w) for w in widths[:-1]])
        self.encoders.append(nn.Sequential(_Block(widths[-1]), _Block(widths[-1])))
        steps = list(itertools.pairwise(widths))
        self.downs = nn.ModuleList(
            [nn.Conv2d(fine, coarse, 2, stride=2, bias=False) for fine, coarse in steps]
        )
        self.ups = nn.ModuleList(
            [nn.Conv2d(coarse, 4 * fine, 1, bias=False) for fine, coarse in steps]
        )
        self.decoders = nn.ModuleList([_Block(w) for w in widths[:-1]])
        self.head = nn.Conv2d(widths[0], _SHUFFLE**2, 3, padding=1, bias=False)

    def forward(self, images: Tensor, sigma: Tensor) -> Tensor:
        """Denoise images.

        Parameters
        ----------
        images : (B, 1, H, W) float, linear light; any H and W
        sigma : (B,) float
            Standard deviation of each image's noise.

        Returns
        -------
        (B, 1, H, W) tensor
        """
        height, width = images.shape[2:]
        extra = (-width % self.multiple_px, -height % self.multiple_px)
        padded = functional.pad(images, (0, extra[0], 0, extra[1]), mode="replicate")
        shuffled = functional.pixel_unshuffle(padded, _SHUFFLE)
        level = sigma.view(-1, 1, 1, 1).expand(-1, 1, *shuffled.shape[2:])
        features: Tensor = self.stem(torch.cat([shuffled, level], dim=1))
        skips: list[Tensor] = []
        for encoder, down in zip(self.encoders, self.downs, strict=False):
            features = encoder(features)
            skips.append(features)
            features = down(features)
        features = self.encoders[-1](features)
        for up, decoder in zip(reversed(self.ups), reversed(self.decoders), strict=True):
            features = decoder(skips.pop() + functional.pixel_shuffle(up(features), 2))
        noise = functional.pixel_shuffle(self.head(features), _SHUFFLE)
        return images - noise[..., :height, :width]


class _Block(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.second = nn.Conv2d(width, width, 3, padding=1, bias=False)

    def forward(self, features: Tensor) -> Tensor:
        # in place: fresh memory of a large photo's features takes as long as their convolutions
        added: Tensor = self.second(functional.relu_(self.first(features)))
        return added.add_(features)


def load_denoiser(path: Path | str = SHIPPED) -> Callable[[FloatArray, FloatArray], FloatArray]:
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
