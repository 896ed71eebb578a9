"""DCE's model: a binary code that can be trained, coded photos with a gradient by every chip, the
network that restores them, and the losses.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from cep.optics.code import ShutterCode
from motdiff.training.simulation import blurred

WIDTHS = (24, 48, 72, 96)
_THRESHOLD = 0.5
_SHUFFLE = 2  # the finest features are at half the resolution: four times as quick
_EPSILON = 1e-3
_EDGE_WEIGHT = 0.05
_SPECTRAL_WEIGHT = 0.01
_BINOMIAL = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)


# -- the code -------------------------------------------------------------------------------------


def binarise(weights: Tensor) -> Tensor:
    """Open the chips whose weight is above one half; if none is, the one of the largest weight.

    Straight-through estimator: Bengio, Leonard and Courville, arXiv:1308.3432, 2013.

    Backward, the gradient by a weight is the gradient by its chip as if that could be open in
    part. Weights outside 0..1 have none; training keeps them within, or those far outside could
    never come back.

    Parameters
    ----------
    weights : (n,) float

    Returns
    -------
    (n,) tensor of 0 and 1, at least one of them 1
    """
    relaxed = weights.clamp(0, 1)
    is_open = weights > _THRESHOLD
    is_open = is_open | ((torch.arange(weights.numel()) == weights.argmax()) & ~is_open.any())
    return is_open.to(weights.dtype) + (relaxed - relaxed.detach())


def code_of(weights: Tensor, *, chip_ns: int = 1_000_000) -> ShutterCode:
    """Shutter code that the weights (n,) stand for."""
    return ShutterCode(binarise(weights.detach()).numpy(), chip_ns=chip_ns)


def weights_of(code: ShutterCode, *, margin: float) -> Tensor:
    """Weights (n,) float32 that stand for ``code``, each ``margin`` from the threshold.

    Raises
    ------
    ValueError
        If the margin is not within 0..0.5, above 0.
    """
    if not 0 < margin <= _THRESHOLD:
        raise ValueError(f"margin: must be above 0 and at most {_THRESHOLD}, got {margin}")
    return torch.from_numpy(_THRESHOLD + margin * (2 * code.array - 1)).float()


def coded_photos(scenes: Tensor, chip_psfs: Tensor, chips: Tensor) -> Tensor:
    """Take light-true photos with real borders: the mean over all chips' frames, the closed ones
    dark.

    A frame is the scene shifted along the path, averaged over the time of its chip, so that
    blurring with the chip's PSF is the same as adding up shifted scenes.

    Parameters
    ----------
    scenes : (B, 1, H + S - 1, W + S - 1) float, linear light
    chip_psfs : (B, n, S, S) float
        Each chip's share of the PSF (:func:`cep.optics.exposure.chip_psfs`); those of a sample sum
        to 1.
    chips : (n,) float, 0..1
        How far each chip is open.

    Returns
    -------
    (B, 1, H, W) tensor
        Noise-free; a still scene is as bright as the open share of the chips.
    """
    psfs = torch.einsum("n,bnyx->byx", chips, chip_psfs)[:, None]
    return blurred(scenes, psfs)


# -- the network ----------------------------------------------------------------------------------


class RestorationNetwork(nn.Module):
    """Restores coded photos of unknown motion: a small residual U-Net, one channel at a time.

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


# -- losses ---------------------------------------------------------------------------------------


def restoration_loss(restored: Tensor, sharp: Tensor) -> Tensor:
    """Charbonnier + 0.05 edges + 0.01 Fourier transform, (), of (B, 1, H, W) linear light.

    References
    ----------
    Zhang et al., "Deep coded exposure", Photonics Research 11(10), 1678, 2023: the weights.
    """
    return (
        charbonnier(restored, sharp)
        + _EDGE_WEIGHT * edge_loss(restored, sharp)
        + _SPECTRAL_WEIGHT * spectral_loss(restored, sharp)
    )


def charbonnier(restored: Tensor, sharp: Tensor) -> Tensor:
    """Mean of ``sqrt(d^2 + 1e-6)`` over the differences d: their mean modulus, smooth at 0."""
    return torch.sqrt((restored - sharp) ** 2 + _EPSILON**2).mean()


def edge_loss(restored: Tensor, sharp: Tensor) -> Tensor:
    """:func:`charbonnier` of the finest level of a Laplacian pyramid: photos minus their 5 x 5
    binomial blur.
    """
    return charbonnier(_fine(restored), _fine(sharp))


def spectral_loss(restored: Tensor, sharp: Tensor) -> Tensor:
    """Mean modulus of the difference's discrete Fourier transform, not normalised: it grows with
    the photo's side.
    """
    spectrum: Tensor = torch.fft.fft2(restored - sharp)
    return spectrum.abs().mean()


def _fine(image: Tensor) -> Tensor:
    line = torch.tensor(_BINOMIAL, dtype=image.dtype)
    channels = image.shape[1]
    padded = functional.pad(image, (2, 2, 2, 2), mode="replicate")
    smooth = functional.conv2d(
        padded, line.view(1, 1, 1, 5).repeat(channels, 1, 1, 1), groups=channels
    )
    return image - functional.conv2d(
        smooth, line.view(1, 1, 5, 1).repeat(channels, 1, 1, 1), groups=channels
    )
