"""Settings of SelfDeblur: sizes of its two generators and the recipe of their fit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SelfDeblurConfig:
    """Sizes and recipe; the defaults are the published ones, but for the kernel's frame, which is
    given there.

    Attributes
    ----------
    kernel_px : int, px
        Odd side of the kernel's frame. Blur may fill it; a frame much larger than the blur costs
        accuracy.
    iterations : int
        Updates of both generators.
    structure_from : int
        Iteration from which the loss is 1 - SSIM; the mean squared error before.
    milestones : tuple of int
        Iterations at which both rates are halved.
    image_rate, kernel_rate : float
        Adam's rates of the two generators.
    input_noise : float
        Standard deviation of the noise that is added anew at each iteration to the image
        generator's input.
    levels, channels, skip_channels, input_channels : int
        Of the image generator.
    kernel_inputs, kernel_hidden : int
        Of the kernel generator.
    seed : int
        Of the networks' first weights, their inputs and the noise.

    Raises
    ------
    ValueError
        If a value is unusable.
    """

    kernel_px: int = 63
    iterations: int = 5000
    structure_from: int = 1000
    milestones: tuple[int, ...] = (2000, 3000, 4000)
    image_rate: float = 1e-2
    kernel_rate: float = 1e-4
    input_noise: float = 1e-3
    levels: int = 5
    channels: int = 128
    skip_channels: int = 16
    input_channels: int = 8
    kernel_inputs: int = 200
    kernel_hidden: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kernel_px < 3 or self.kernel_px % 2 == 0:
            raise ValueError(f"kernel_px: must be odd and at least 3, got {self.kernel_px}")
        sizes = (
            "iterations",
            "levels",
            "channels",
            "skip_channels",
            "input_channels",
            "kernel_inputs",
            "kernel_hidden",
        )
        for name in sizes:
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: must be at least 1, got {getattr(self, name)}")
        for name in ("image_rate", "kernel_rate"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: must be positive, got {getattr(self, name)}")
        for name in ("input_noise", "structure_from", "seed"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: must be at least 0, got {getattr(self, name)}")

    def decay(self, iteration: int) -> float:
        """Share of the first rates that is left at ``iteration``."""
        return float(0.5 ** sum(iteration >= milestone for milestone in self.milestones))
