"""Aggregation of features at four scales, coarse to fine, to one condition z1 at a quarter of the
photo's size.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional


class LocalEmphasis(nn.Module):
    """Two 3x3 convolutions with ReLU, then bilinear upsampling; each stage has its own.

    Parameters
    ----------
    inputs, width : int
        Channels of the feature and of the result.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equation 3; after SSFormer's progressive locality
    decoder.
    """

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.convs = nn.Sequential(
            nn.Conv2d(inputs, width, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, 1),
            nn.ReLU(),
        )

    def forward(self, feature: Tensor, size: Sequence[int]) -> Tensor:
        """Feature (B, C, h, w) to (B, width, *size)."""
        emphasised: Tensor = self.convs(feature)  # (B, width, h, w)
        if emphasised.shape[-2:] == torch.Size(size):
            return emphasised
        return functional.interpolate(
            emphasised, tuple(size), mode="bilinear", align_corners=False
        )


class StepwiseAggregation(nn.Module):
    """z4 = f4up, then z_s = ReLU(conv1x1(cat(z_{s+1}, f_s_up))) for s = 3, 2, 1.

    Neighbouring scales meet first, so that no layer has to join global and local motion cues at
    once.

    Parameters
    ----------
    scales : int
        Number of features, 4 in the paper.
    width : int
        Channels of each and of the result.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equation 4.
    """

    def __init__(self, scales: int, width: int) -> None:
        super().__init__()
        self.joins = nn.ModuleList(
            nn.Conv2d(2 * width, width, 1) for _ in range(scales - 1)
        )  # joins[s - 1] gives z_s

    def forward(self, emphasised: Sequence[Tensor]) -> Tensor:
        """Features f1up, f2up, ... (B, width, h, w) to z1 (B, width, h, w)."""
        z = emphasised[-1]
        for join, feature in zip(reversed(self.joins), reversed(emphasised[:-1]), strict=True):
            z = functional.relu(join(torch.cat([z, feature], dim=1)))
        return z
