"""Batches for training: simulated on the fly on the training device, or from prepared samples.

A batch depends on the seed, the step and the process's rank alone, so that a run goes on exactly
where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import torch
from torch import Tensor

from motdiff.blind_search.grids import SYMMETRIES, mirrored
from motdiff.network.condition import PHOTO_PX
from motdiff.network.physics_maps import (
    QUICK_STARTS,
    display_photo,
    physics_maps,
    spectral_maps,
    stacked_maps,
)
from motdiff.psf_frame import MAP_PITCH
from motdiff.training.config import TrainingConfig
from motdiff.training.motion_bank import MotionBank, build_bank
from motdiff.training.photos import load_scenes
from motdiff.training.prepared import light_of, read_shards
from motdiff.training.samples import Samples, simulate
from motdiff.training.simulation import Photography

VALIDATION_SEED = 7  # any, but the same: runs are compared on the same draws
_VALIDATION_BATCH = 32
_SPECTRAL_BATCH = 64  # bounds the memory of the spectra
_MOTIONS = 1  # one seed for both would give each motion the same scene every time
_PHOTOS = 2


@dataclass(frozen=True)
class Batch:
    """Samples of one update.

    Attributes
    ----------
    photo : (B, 3, 256, 256) float32 or None
        Luminance as display values 0..1; None without a photo encoder.
    physics : (B, P, 64, 64) float32 or None
        Physics maps; None where the network takes none.
    x0, dwell : (B, 1, 256, 256) float32
        HR map, and relative time per path pixel.
    """

    photo: Tensor | None
    physics: Tensor | None
    x0: Tensor
    dwell: Tensor

    def __len__(self) -> int:
        return len(self.x0)

    def to(self, device: str | torch.device) -> Batch:
        """Copy to a device."""
        return self._each(lambda maps: maps.to(device))

    def split(self, size: int) -> list[Batch]:
        """Cut into batches of ``size``; the last may be smaller."""
        firsts = range(0, len(self), size)
        return [self._each(lambda maps, i=i: maps[i : i + size]) for i in firsts]  # type: ignore[misc]

    def _each(self, change: Callable[[Tensor], Tensor]) -> Batch:
        photo, physics = (
            maps if maps is None else change(maps) for maps in (self.photo, self.physics)
        )
        return Batch(photo, physics, change(self.x0), change(self.dwell))


class BatchSource(Protocol):
    """Anything that gives the batch of a step."""

    def batch(self, step: int, size: int, *, rank: int = 0) -> Batch:
        """Give ``size`` samples for ``step``, others for every ``rank``."""
        ...


@dataclass(frozen=True)
class Sources:
    """Training batches, and fixed validation batches of other photos and motions."""

    training: BatchSource
    validation: tuple[Batch, ...]


@dataclass(frozen=True)
class LiveSource:
    """Samples simulated on the fly: no two steps have the same photo.

    The scenes are sharp photos, (3, H, W) uint8, on the bank's device; ``photo`` and ``physics``
    are the inputs that the network takes.
    """

    bank: MotionBank
    scenes: Sequence[Tensor]
    photography: Photography
    photo: bool
    physics: bool
    seed: int

    def batch(self, step: int, size: int, *, rank: int = 0) -> Batch:
        """Simulate the batch of a step."""
        draw = torch.Generator().manual_seed(seed_of(self.seed, step, rank, _MOTIONS))
        index = torch.randint(len(self.bank), (size,), generator=draw)
        samples = simulate(
            self.bank,
            self.scenes,
            index.to(self.bank.psfs.device),
            photography=self.photography,
            physics=self.physics,
            seed=seed_of(self.seed, step, rank, _PHOTOS),
        )
        grey = samples.photos.mean(dim=1, keepdim=True)
        return Batch(
            display_photo(grey) if self.photo else None,
            physics_maps(grey, samples.kernels) if self.physics else None,
            samples.x0,
            samples.dwell,
        )


class PreparedSource:
    """Prepared samples, shuffled anew every epoch, each turned and mirrored at random.

    The samples are those of :func:`motdiff.training.prepared.read_shards`; ``photo`` and
    ``physics`` are the inputs that the network takes.
    """

    def __init__(
        self, samples: Samples, *, photo: bool, physics: bool, seed: int, symmetries: bool = True
    ) -> None:
        self._seed = seed
        self._symmetries = symmetries
        self._photos = samples.photos if photo else None
        self._maps: tuple[Tensor, Tensor] | None = None
        if physics:
            chunks = torch.split(samples.photos, _SPECTRAL_BATCH)
            spectral = torch.cat([spectral_maps(light_of(photos)).half() for photos in chunks])
            self._maps = (spectral, samples.kernels)
        self._x0 = samples.x0
        self._dwell = samples.dwell

    def __len__(self) -> int:
        return len(self._x0)

    def batch(self, step: int, size: int, *, rank: int = 0) -> Batch:
        """Gather the batch of a step."""
        first = step * size
        # a batch may run across the end of an epoch
        epochs = range(first // len(self), (first + size - 1) // len(self) + 1)
        order = torch.cat([self._order(epoch, rank) for epoch in epochs])
        index = order[first - epochs[0] * len(self) :][:size]
        groups = torch.zeros(size, dtype=torch.int64)
        if self._symmetries:
            draw = torch.Generator().manual_seed(seed_of(self._seed, step, rank))
            groups = torch.randint(SYMMETRIES, (size,), generator=draw)
        return _joined(
            [
                self._turned(index[groups == s], s)
                for s in range(SYMMETRIES)
                if bool((groups == s).any())
            ]
        )

    def _order(self, epoch: int, rank: int) -> Tensor:
        # negative numbers are no steps: the order has seeds of its own
        draw = torch.Generator().manual_seed(seed_of(self._seed, -1 - epoch, rank))
        return torch.randperm(len(self), generator=draw)

    def _turned(self, index: Tensor, symmetry: int) -> Batch:
        photo = physics = None
        if self._photos is not None:
            photo = display_photo(mirrored(light_of(self._photos[index]), symmetry, pitch=0))
        if self._maps is not None:
            spectral, kernels = (
                mirrored(maps[index].float(), symmetry, pitch=1) for maps in self._maps
            )
            physics = stacked_maps(spectral, kernels)
        x0, dwell = (
            mirrored(maps[index].float(), symmetry, pitch=MAP_PITCH)
            for maps in (self._x0, self._dwell)
        )
        return Batch(photo, physics, x0, dwell)


def _joined(batches: Sequence[Batch]) -> Batch:
    def joined(name: str) -> Any:
        chunks = [getattr(batch, name) for batch in batches]
        return None if chunks[0] is None else torch.cat(chunks)

    return Batch(*(joined(field.name) for field in fields(Batch)))


def make_sources(
    config: TrainingConfig, *, device: torch.device | str = "cpu", workers: int = 1
) -> Sources:
    """Read or simulate the samples of the run; photos on the ``device``, motions by ``workers``.

    ValueError if the network takes another number of physics maps than there are, or there are too
    few photos.
    """
    data = config.data
    seed = config.optimiser.seed
    inputs = {
        "photo": config.network.backbone != "none",
        "physics": config.network.physics_channels > 0,
    }
    if data.prepared:
        samples = _shards("prepared", data.prepared)
        _check_channels(config, samples.kernels.shape[1])
        held_out = _shards("prepared_validation", data.prepared_validation)
        validation = PreparedSource(held_out, seed=VALIDATION_SEED, symmetries=False, **inputs)
        count = min(data.validation, len(validation))
        batches = validation.batch(0, count).split(_VALIDATION_BATCH)
        return Sources(
            PreparedSource(samples, seed=seed, **inputs),
            tuple(batch.to(device) for batch in batches),
        )
    _check_channels(config, len(QUICK_STARTS))
    sizes = [
        min(_VALIDATION_BATCH, data.validation - first)
        for first in range(0, data.validation, _VALIDATION_BATCH)
    ]
    least_px = PHOTO_PX + config.photography.margin
    scenes = load_scenes(
        data.photos, held_out=data.held_out, least_px=least_px, device=str(device)
    )
    # other motions and other photos than those of the training
    seeds = (seed, seed_of(seed, VALIDATION_SEED))
    banks = [
        build_bank(config.motions, count=n, seed=bank_seed, workers=workers).to(device)
        for n, bank_seed in zip((data.motions, data.validation), seeds, strict=True)
    ]
    training, validation_source = (
        LiveSource(bank, photos, config.photography, seed=source_seed, **inputs)
        for bank, photos, source_seed in zip(banks, scenes, (seed, VALIDATION_SEED), strict=True)
    )
    return Sources(training, tuple(validation_source.batch(i, n) for i, n in enumerate(sizes)))


def _shards(entry: str, folder: str) -> Samples:
    """Read prepared samples; errors name the entry of the run's file."""
    try:
        return read_shards(folder)
    except ValueError as error:
        raise ValueError(f"data.{entry}: {error}") from None


def _check_channels(config: TrainingConfig, kernels: int) -> None:
    maps = 2 + 2 * kernels
    channels = config.network.physics_channels
    if channels not in (0, maps):
        raise ValueError(
            f"network.physics_channels: must be {maps}, as many as there are physics maps, got"
            f" {channels}"
        )


def seed_of(*numbers: int) -> int:
    """Mix whole numbers into one seed, below 2^62."""
    # golden ratio and multiplier of SplitMix64 (Steele et al., OOPSLA 2014)
    mixed = 0x9E3779B97F4A7C15
    for number in numbers:
        mixed = (mixed ^ (number & 0xFFFFFFFFFFFFFFFF)) * 0xBF58476D1CE4E5B9 & 0xFFFFFFFFFFFFFFFF
        mixed ^= mixed >> 31
    return mixed % 2**62
