"""Denoising network: a small bias-free U-Net, with the noise level as its second input."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTHS = (48, 64, 96)
_SHUFFLE = 2  # the finest features are at half the resolution: four times as quick


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
