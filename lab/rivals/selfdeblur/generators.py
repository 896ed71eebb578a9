"""Untrained generators of photo and kernel: their architecture is the prior (deep image prior)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from lab.rivals.selfdeblur.config import SelfDeblurConfig

_SLOPE = 0.2
_FIRST_NON_LOCAL = 2  # level


class ImageGenerator(nn.Module):
    """Encoder-decoder with narrow skips: from noise to a photo within 0..1.

    Such a network fits a sharp photo sooner than noise, or than a photo blurred with the kernel's
    inverse.

    Parameters
    ----------
    config : SelfDeblurConfig

    References
    ----------
    Ulyanov, Vedaldi, Lempitsky, "Deep image prior", CVPR 2018 (the network's kind).
    """

    def __init__(self, config: SelfDeblurConfig) -> None:
        super().__init__()
        entering = [config.input_channels, *[config.channels] * (config.levels - 1)]
        wide = config.channels
        narrow = config.skip_channels
        self.skips = nn.ModuleList(_block(channels, narrow, 1) for channels in entering)
        self.downs = nn.ModuleList(
            nn.Sequential(
                _block(channels, wide, 3, stride=2),
                *([_NonLocal(wide)] if level >= _FIRST_NON_LOCAL else []),
                _block(wide, wide, 3),
            )
            for level, channels in enumerate(entering)
        )
        self.ups = nn.ModuleList(
            nn.Sequential(
                _norm(narrow + wide), _block(narrow + wide, wide, 3), _block(wide, wide, 1)
            )
            for _ in entering
        )
        self.output = nn.Conv2d(wide, 1, 1)

    def forward(self, noise: Tensor) -> Tensor:
        """Photo (1, 1, H, W) from noise (1, C, H, W); H and W are multiples of 2 to the number of
        levels.
        """
        skipped: list[Tensor] = []
        features = noise
        for skip, down in zip(self.skips, self.downs, strict=True):
            skipped.append(skip(features))
            features = down(features)
        for up, beside in zip(self.ups, reversed(skipped), strict=True):
            larger = functional.interpolate(features, scale_factor=2, mode="bilinear")
            features = up(torch.cat([beside, larger], dim=1))
        photo: Tensor = torch.sigmoid(self.output(features))
        return photo


class KernelGenerator(nn.Module):
    """Fully connected network with one hidden layer: from noise to a kernel, non-negative with sum
    1 by its softmax.

    Parameters
    ----------
    config : SelfDeblurConfig
    """

    def __init__(self, config: SelfDeblurConfig) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(config.kernel_inputs, config.kernel_hidden),
            nn.ReLU6(),
            nn.Linear(config.kernel_hidden, config.kernel_px**2),
        )
        self._side_px = config.kernel_px

    def forward(self, noise: Tensor) -> Tensor:
        """Kernel (k, k) from noise (N,)."""
        light: Tensor = torch.softmax(self.layers(noise), dim=0)
        return light.view(self._side_px, self._side_px)


class _NonLocal(nn.Module):
    """Non-local block with dot products: each place gathers from all others; the identity, before
    it is fitted.

    References
    ----------
    Wang, Girshick, Gupta, He, "Non-local neural networks", CVPR 2018, eq. 4 and 6.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = max(1, channels // 2)
        self.asked, self.offered, self.content = (nn.Conv2d(channels, inner, 1) for _ in range(3))
        norm = _norm(channels)
        nn.init.zeros_(norm.weight)
        self.back = nn.Sequential(nn.Conv2d(inner, channels, 1), norm)

    def forward(self, features: Tensor) -> Tensor:
        query, key, content = (
            layer(features).flatten(2) for layer in (self.asked, self.offered, self.content)
        )  # (1, inner, places)
        # (query^T key) content^T, summed over places first: no matrix of places by places
        gathered = (content @ key.transpose(1, 2)) @ query / features[0, 0].numel()
        added: Tensor = self.back(gathered.unflatten(2, features.shape[2:]))
        return features + added


def _block(entering: int, leaving: int, size: int, *, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(
        entering, leaving, size, stride=stride, padding=size // 2, padding_mode="reflect"
    )
    return nn.Sequential(convolution, _norm(leaving), nn.LeakyReLU(_SLOPE))


def _norm(channels: int) -> nn.InstanceNorm2d:
    return nn.InstanceNorm2d(
        channels, affine=True
    )  # what batch norm is in training, where the batch is one photo
