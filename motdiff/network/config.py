"""Configuration of a MoTDiff network, stored as JSON in the weights file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

BACKBONES = ("b0", "b1", "b2", "b3", "b4", "b5", "none")
FEATURES = ("multi", "f2", "f4")
TARGETS = ("map", "psf", "path")


@dataclass(frozen=True)
class NetworkConfig:
    """Target and sizes of a network.

    Parameters
    ----------
    target : str
        "map": diffusion of HR path maps, MoTDiff. "psf" and "path" are the laboratory's baselines
        over the same condition: diffusion of 64x64 PSFs, and one quadratic path predicted at once,
        without a denoiser.
    backbone : str
        Size of the PVT v2 photo encoder, "b0".."b5"; "none": no photo encoder, physics maps only.
    features : str
        "multi": all four scales condition the denoiser; "f2" or "f4": only that one (the paper's
        ablation).
    photo_pool : int
        1, or 2: the photo encoder works on means of 2x2 pixels, at about a quarter of the cost.
    width : int
        Channels of local emphasis, aggregation and z_1.
    denoiser_width : int
        Channels of the denoiser's encoding block and mid layer; a multiple of 4 (PixelShuffle).
    denoiser_view : int
        Levels, 0..2, of the denoiser's U-Net over the whole map; 0: none, as the paper's.
    decoder_widths : tuple of two int
        Channels after each decoding block's convolution; the first a multiple of 4 (PixelShuffle).
    dropout : float
        Dropout probability before the output layer, 0 <= dropout < 1.
    physics_channels : int
        Number of physics maps on the 64x64 grid given besides the photo; 0 is the paper.
    physics_width : int
        Channels of the physics encoder; a multiple of 8 (normalisation groups, attention heads).
    physics_depth : int
        Levels of the physics U-Net below its first, 1..4.
    physics_patch : int
        1, or 2: the physics U-Net works on 32x32 with 2x2 pixels as channels, at about a third of
        the cost.
    dwell : bool
        A second output channel: time spent per map pixel.
    time_width : int
        Channels of the timestep's embedding; even.

    Raises
    ------
    ValueError
        If a field is out of range; the message starts with its name.
    """

    target: str = "map"
    backbone: str = "b0"
    features: str = "multi"
    photo_pool: int = 1
    width: int = 64
    denoiser_width: int = 64
    denoiser_view: int = 0
    decoder_widths: tuple[int, int] = (32, 16)
    dropout: float = 0.1
    physics_channels: int = 0
    physics_width: int = 48
    physics_depth: int = 3
    physics_patch: int = 1
    dwell: bool = False
    time_width: int = 128

    def __post_init__(self) -> None:
        _choice("target", self.target, TARGETS)
        _choice("backbone", self.backbone, BACKBONES)
        _choice("features", self.features, FEATURES)
        _choice("photo_pool", self.photo_pool, (1, 2))
        _multiple("width", self.width, 1)
        _multiple("denoiser_width", self.denoiser_width, 4)
        _choice("denoiser_view", self.denoiser_view, (0, 1, 2))
        # its U-Net normalises groups of 8 channels
        if self.denoiser_view:
            _multiple("denoiser_width", self.denoiser_width, 8)
        if not isinstance(self.decoder_widths, tuple) or len(self.decoder_widths) != 2:
            raise ValueError(
                f"decoder_widths is {self.decoder_widths!r}; it must be a tuple of two whole"
                " numbers"
            )
        _multiple("decoder_widths[0]", self.decoder_widths[0], 4)
        _multiple("decoder_widths[1]", self.decoder_widths[1], 1)
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout is {self.dropout}; it must be at least 0 and below 1")
        if self.physics_channels != 0:
            _multiple("physics_channels", self.physics_channels, 1)
        _multiple("physics_width", self.physics_width, 8)
        _choice("physics_depth", self.physics_depth, (1, 2, 3, 4))
        _choice("physics_patch", self.physics_patch, (1, 2))
        _choice("dwell", self.dwell, (False, True))
        _multiple("time_width", self.time_width, 2)
        if self.dwell and self.target != "map":
            raise ValueError(
                f"dwell is True; it must be False for target {self.target!r}, which holds the time"
                " already"
            )
        if self.backbone == "none" and self.physics_channels == 0:
            raise ValueError(
                "physics_channels is 0; a network without a photo encoder (backbone 'none') needs"
                " some"
            )

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> NetworkConfig:
        """Inverse of `asdict`, also after a JSON round trip (which makes tuples lists).

        ValueError if `values` has an unknown field, or one that is out of range.
        """
        unknown = sorted(set(values) - {field.name for field in fields(cls)})
        if unknown:
            raise ValueError(
                f"values has unknown fields {', '.join(unknown)}; known are those of NetworkConfig"
            )
        plain: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values.items()
        }
        return cls(**plain)


def _choice(name: str, value: object, allowed: tuple[object, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{name} is {value!r}; it must be one of {', '.join(map(repr, allowed))}")


def _multiple(name: str, value: object, factor: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < 1 or value % factor:
        kind = "a positive whole number" if factor == 1 else f"a positive multiple of {factor}"
        raise ValueError(f"{name} is {value!r}; it must be {kind}")
