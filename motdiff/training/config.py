"""Configuration of a training run, from a TOML file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_type_hints

from motdiff.files.inputs import one_line, read_toml, typed_fields
from motdiff.network.config import NetworkConfig
from motdiff.psf_frame import PSF_PX
from motdiff.training.motion_bank import MotionMix
from motdiff.training.simulation import Photography


@dataclass(frozen=True)
class DataConfig:
    """Source of the samples.

    Attributes
    ----------
    photos : str
        Sharp photos: a folder, or a pack from ``python -m motdiff pack``. Every ``held_out``-th is
        for validation.
    motions : int
        Size of the bank of motions; 0 draws new ones for every shard (prepared samples only).
    prepared : str
        Folder of prepared samples (``python -m motdiff prepare``) instead of simulation on the
        fly; "" for none.
    validation : int
        Number of validation samples.
    physics_dropout : float
        Share of physics maps blanked in training, so that the network does not depend on one.
    """

    photos: str = ""
    held_out: int = 12
    motions: int = 20_000
    prepared: str = ""
    prepared_validation: str = ""
    validation: int = 256
    physics_dropout: float = 0.05

    def __post_init__(self) -> None:
        if not self.photos and not self.prepared:
            raise ValueError("data: needs photos, or prepared samples")
        if bool(self.prepared) != bool(self.prepared_validation):
            raise ValueError(
                "data.prepared_validation: prepared samples need both folders, or neither"
            )
        _check(self, "data", self.held_out >= 2, "held_out", "at least 2")
        _check(self, "data", self.validation >= 1, "validation", "at least 1")
        enough = self.motions >= 1 or bool(self.prepared)
        _check(self, "data", enough, "motions", "at least 1 without prepared samples")
        _check_share(self, "data", "physics_dropout")


@dataclass(frozen=True)
class LossConfig:
    """Loss function.

    Attributes
    ----------
    kind : {"structure", "denoising"}
        Weighted cross-entropy and IoU as the paper's, or the plain squared error of its ablation.
    path_weight : float
        The paper's lambda: a path pixel counts this much more than a background pixel.
    iou : float
        Weight of the IoU part; 1 as the paper's, 0 leaves the cross-entropy alone.
    stpd : float
        Probability that a path pixel is dropped before noising (the paper's p).
    dwell : float
        Weight of the dwell output's loss, where the network has one.
    """

    kind: str = "structure"
    path_weight: float = 5.0
    iou: float = 1.0
    stpd: float = 0.1
    dwell: float = 0.2

    def __post_init__(self) -> None:
        is_known = self.kind in ("structure", "denoising")
        _check(self, "loss", is_known, "kind", '"structure" or "denoising"')
        _check_share(self, "loss", "stpd")
        for name in ("path_weight", "iou", "dwell"):
            _check(self, "loss", getattr(self, name) >= 0, name, "at least 0")


@dataclass(frozen=True)
class OptimiserConfig:
    """Optimiser.

    Attributes
    ----------
    steps, batch : int
        Number of updates; samples of each, over all processes together.
    rate, last_rate : float
        Adam's rate, from the first to the last along a cosine, after ``warm_up`` steps of linear
        rise.
    ema : float
        Decay of the averaged weights, which are the ones used.
    clip : float
        Largest norm of the gradient.
    precision : {"fp32", "bf16"}
        bf16 runs the forward pass under autocast.
    window : int
        Side of the denoiser's random window of the 64-px field in each step; 64 is all. Smaller
        ones are cheaper: the denoiser is local, and the condition always covers everything.
    compile : bool
        Whether torch.compile is used.
    start : str
        Weights file that the run starts from: all of it where it holds the same network, else its
        condition network; "" for random weights.
    only : {"", "photo"}
        "photo" trains the photo encoder and the layer that adds its features, which shows the
        encoder's own gain. "" trains all.
    """

    steps: int = 60_000
    batch: int = 128
    rate: float = 1e-4
    last_rate: float = 1e-6
    warm_up: int = 200
    ema: float = 0.999
    clip: float = 1.0
    precision: str = "fp32"
    window: int = PSF_PX
    compile: bool = False
    start: str = ""
    only: str = ""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "batch"):
            _check(self, "optimiser", getattr(self, name) >= 1, name, "at least 1")
        for name in ("rate", "clip"):
            _check(self, "optimiser", getattr(self, name) > 0, name, "above 0")
        for name in ("last_rate", "warm_up"):
            _check(self, "optimiser", getattr(self, name) >= 0, name, "at least 0")
        # what torch and numpy both take
        if not 0 <= self.seed < 2**32:
            raise ValueError(f"optimiser.seed: must lie within 0..2^32 - 1, got {self.seed}")
        is_known = self.precision in ("fp32", "bf16")
        _check(self, "optimiser", is_known, "precision", '"fp32" or "bf16"')
        _check(self, "optimiser", self.only in ("", "photo"), "only", '"photo", or "" for all')
        if self.only and not self.start:
            raise ValueError("optimiser.only: needs weights to start from, optimiser.start")
        if not 8 <= self.window <= PSF_PX:
            raise ValueError(f"optimiser.window: must lie within 8..{PSF_PX}, got {self.window}")
        _check_share(self, "optimiser", "ema")


@dataclass(frozen=True)
class TrainingConfig:
    """Sections of the file: all settings that determine the result of a run."""

    data: DataConfig
    motions: MotionMix = field(default_factory=MotionMix)
    photography: Photography = field(default_factory=Photography)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)

    def __post_init__(self) -> None:
        if self.network.denoiser_view and self.optimiser.window != PSF_PX:
            raise ValueError(
                f"optimiser.window: must be {PSF_PX} for a denoiser that sees the whole map, got"
                f" {self.optimiser.window}"
            )
        if self.optimiser.only == "photo" and self.network.backbone == "none":
            raise ValueError(
                'optimiser.only: must be "" for a network without a photo encoder, got "photo"'
            )


_SECTIONS = get_type_hints(TrainingConfig)


def _check(config: object, section: str, holds: bool, name: str, rule: str) -> None:
    if not holds:
        raise ValueError(f"{section}.{name}: must be {rule}, got {getattr(config, name)!r}")


def _check_share(config: object, section: str, name: str) -> None:
    share = 0 <= getattr(config, name) < 1
    _check(config, section, share, name, "at least 0 and below 1")


def read_config(path: Path | str) -> TrainingConfig:
    """Read a run's TOML file; paths in it are relative to where the command runs.

    ValueError if the file is not TOML, or a section, an entry, a type or a value is not known or
    wrong; the message names it.
    """
    content = read_toml(path)
    unknown = set(content) - set(_SECTIONS)
    if unknown:
        raise ValueError(
            f"{path}: unknown section [{min(unknown)}]; known are {', '.join(_SECTIONS)}"
        )
    if "data" not in content:
        raise ValueError(f"{path}: needs a section [data] with photos or prepared samples")
    try:
        return TrainingConfig(**{name: _section(name, values) for name, values in content.items()})
    except (ValueError, OverflowError) as error:  # whole numbers that no float reaches
        raise ValueError(f"{path}: {one_line(error)}") from error


def _section(name: str, values: object) -> Any:
    kind = _SECTIONS[name]
    if not isinstance(values, dict):
        raise ValueError(f"{name}: must be a section, [{name}]")
    plain = typed_fields(values, kind, where=f"{name}.")
    try:
        return kind(**plain)
    except ValueError as error:  # a class used outside of runs too does not name the section
        text = str(error)
        raise ValueError(text if text.startswith(name) else f"{name}.{text}") from error
