"""Diffusion network: a condition computed once per photo, a denoiser run at every step."""

from __future__ import annotations

from torch import Tensor

from motdiff.network.condition import ConditionNetwork
from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import Denoiser
from motdiff.psf_frame import MAP_PITCH


class MotDiffNetwork(ConditionNetwork):
    """Logits of the path map (or the PSF) from photo, physics maps, noisy map and timestep.

    `condition` depends on the photo only: call it once, then `denoise` at every step.

    Parameters
    ----------
    config : NetworkConfig
        Sizes; kept as `config`. Its target is "map" or "psf".

    Attributes
    ----------
    pitch : int
        Map pixels per condition pixel: 4 for HR maps, 1 for PSFs.
    denoiser : Denoiser
        Network of every step.

    References
    ----------
    Choi et al., "MoTDiff: High-resolution motion trajectory estimation from a single blurred image
    using diffusion models", arXiv 2510.26173. The physics maps are ours.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.pitch = {"map": MAP_PITCH, "psf": 1}[config.target]
        self.denoiser = Denoiser(
            self.condition_channels,
            width=config.denoiser_width,
            decoder_widths=config.decoder_widths,
            outputs=2 if config.dwell else 1,
            dropout=config.dropout,
            time_width=config.time_width,
            pitch=self.pitch,
            view=config.denoiser_view,
        )

    def denoise(self, x_t: Tensor, t: Tensor, condition: Tensor) -> Tensor:
        """Logits (B, 1 or 2, H, W) of x0 (and dwell) from x_t (B, 1, H, W), t (B,) in 0..999."""
        logits: Tensor = self.denoiser(x_t, t, condition)
        return logits

    def forward(
        self,
        x_t: Tensor,
        t: Tensor,
        photo: Tensor | None = None,
        physics: Tensor | None = None,
        corner: tuple[int, int] = (0, 0),
    ) -> Tensor:
        """`condition` and `denoise` in one, for training: each photo has one timestep.

        An `x_t` smaller than the photo's map is a window of it, whose first pixel is `pitch` times
        `corner` (row, column).
        """
        condition = self.condition(photo, physics)
        rows, columns = (
            slice(c, c + n // self.pitch) for c, n in zip(corner, x_t.shape[-2:], strict=True)
        )
        return self.denoise(x_t, t, condition[..., rows, columns])
