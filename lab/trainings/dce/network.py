"""The restoration network: a small residual U-Net on half the resolution, one channel at a
time.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTHS = (24, 48, 72, 96)
_SHUFFLE = 2  # the finest features are at half the resolution: four times as quick


class RestorationNetwork(nn.Module):
    """Restores coded photos of unknown motion.

    Parameters
    ----------
    widths : sequence of int
        Channels from half the resolution downwards, each level half as fine as the one before.

    Notes
    -----
    The network adds a correction to the photo. The correction of an untrained one is zero.
    """

    def __init__(self, widths: Sequence[int] = WIDTHS) -> None:
        super().__init__()
        self.multiple_px = _SHUFFLE << (len(widths) - 1)
        self.stem = nn.Conv2d(_SHUFFLE**2, widths[0], 3, padding=1)
        self.encoders = nn.ModuleList([nn.Sequential(_Block(w), _Block(w)) for w in widths])
        steps = list(itertools.pairwise(widths))
        self.downs = nn.ModuleList(
            [nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in steps]
        )
        self.ups = nn.ModuleList([nn.Conv2d(coarse, 4 * fine, 1) for fine, coarse in steps])
        self.decoders = nn.ModuleList([nn.Sequential(_Block(w), _Block(w)) for w in widths[:-1]])
        self.head = nn.Conv2d(widths[0], _SHUFFLE**2, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]

    def forward(self, photos: Tensor) -> Tensor:
        """Restore photos.

        Parameters
        ----------
        photos : (B, 1, H, W) float, linear light
            At the scale of the full open exposure: a coded photo over its code's duty. Any H and
            W.

        Returns
        -------
        (B, 1, H, W) tensor, at the same scale
        """
        height, width = photos.shape[2:]
        extra = (-width % self.multiple_px, -height % self.multiple_px)
        padded = functional.pad(photos, (0, extra[0], 0, extra[1]), mode="replicate")
        features: Tensor = self.stem(functional.pixel_unshuffle(padded, _SHUFFLE))
        skips: list[Tensor] = []
        for encoder, down in zip(self.encoders, self.downs, strict=False):
            features = encoder(features)
            skips.append(features)
            features = down(features)
        features = self.encoders[-1](features)
        for up, decoder in zip(reversed(self.ups), reversed(self.decoders), strict=True):
            features = decoder(skips.pop() + functional.pixel_shuffle(up(features), 2))
        correction = functional.pixel_shuffle(self.head(features), _SHUFFLE)
        return photos + correction[..., :height, :width]


class _Block(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        added: Tensor = self.second(functional.leaky_relu(self.first(features), 0.1))
        return torch.add(features, added)
