"""Prepared training samples: simulated and searched once, stored in shards, numbered files."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motdiff.files.inputs import one_line, regular_file
from motdiff.files.outputs import new_file
from motdiff.network.condition import PHOTO_PX
from motdiff.psf_frame import MAP_PX
from motdiff.training.config import read_config
from motdiff.training.motion_bank import MotionMix, bank_of, drawn_motions
from motdiff.training.photos import load_scenes
from motdiff.training.samples import Samples, simulate
from motdiff.training.simulation import Photography
from motdiff.trajectory import Trajectory

SHARD_SAMPLES = 64  # about 7 MB in a file
_NAME = "shard"
_SEEDS_APART = 1_000_003  # of two runs: a shard of one has no seed of the other's
_Loaded = TypeVar("_Loaded")


@dataclass(frozen=True)
class Source:
    """Scenes, motions and photography of samples, and the seed of their training or validation."""

    scenes: Sequence[Tensor]
    mix: MotionMix
    photography: Photography
    seed: int

    def motions_of(self, shard: int, count: int) -> list[Trajectory]:
        """Draw the motions of a shard of ``count``; they depend on its number and the seed."""
        indices = range(shard * count, (shard + 1) * count)
        return drawn_motions(self.mix, seed=self.seed, indices=indices)

    def photos_of(
        self, shard: int, motions: Sequence[Trajectory], *, physics: bool = False
    ) -> Samples:
        """Simulate a photo of each motion of a shard; ``physics`` as of :func:`simulate`."""
        with torch.no_grad():
            return simulate(
                bank_of(motions),
                self.scenes,
                torch.arange(len(motions)),
                photography=self.photography,
                physics=physics,
                seed=self.seed * _SEEDS_APART + shard,
            )


def prepare(
    folder: Path | str,
    source: Source,
    *,
    shards: range,
    on_shard: Callable[[int], None] = lambda _shard: None,
) -> None:
    """Write the missing ones of the ``shards``, 64 samples each, as :func:`write_shards`."""

    def simulated_arrays(shard: int) -> dict[str, NDArray[np.generic]]:
        motions = source.motions_of(shard, SHARD_SAMPLES)
        return sample_arrays(source.photos_of(shard, motions, physics=True))

    write_shards(folder, shards, name=_NAME, make=simulated_arrays, on_shard=on_shard)


def read_source(config_file: Path | str, *, held_out: bool) -> Source:
    """Read the source of a run's samples from its TOML file, with its training or held-out scenes.

    ValueError if the file is not valid, names no photos, or these cannot be used.
    """
    config = read_config(config_file)
    if not config.data.photos:
        raise ValueError(f"{config_file}: data.photos is needed to prepare samples")
    least_px = PHOTO_PX + config.photography.margin
    scenes = load_scenes(config.data.photos, held_out=config.data.held_out, least_px=least_px)
    seed = config.optimiser.seed + held_out
    return Source(scenes[held_out], config.motions, config.photography, seed)


def read_shards(folder: Path | str) -> Samples:
    """Read every shard of a folder into memory (about 110 KB a sample); ValueError without one.

    The photos are uint8 (B, 1, 256, 256), luminance as ``255 sqrt(light)``, x0 is uint8, kernels
    and dwell are float16.
    """
    missing = "prepared samples (shard_*.npz); write them with: python -m motdiff prepare"
    return joined(load_shards(folder, name=_NAME, load=samples_of, missing=missing))


def joined(shards: Sequence[Samples]) -> Samples:
    """Join the samples of several shards."""
    return Samples(
        *(torch.cat([getattr(shard, field.name) for shard in shards]) for field in fields(Samples))
    )


def light_of(stored: Tensor) -> Tensor:
    """Light 0..1 of the photos of a shard, which hold ``255 sqrt(light)``."""
    return stored.float().div(255).square()


def sample_arrays(samples: Samples) -> dict[str, NDArray[np.generic]]:
    """Make the arrays of a shard, see :func:`read_shards`."""
    # the root spreads 8 bits over the light evenly to the eye: without it, shadows would band
    grey = samples.photos.mean(dim=1, keepdim=True).clamp(0, 1).sqrt()
    path = samples.x0 > 0
    return {
        "photos": (255 * grey).round().to(torch.uint8).numpy(),
        "kernels": samples.kernels.half().numpy(),
        "x0": np.packbits(path.numpy().reshape(len(samples), -1), axis=1),
        "dwell": samples.dwell[path].half().numpy(),
    }


def samples_of(stored: Mapping[str, NDArray[Any]]) -> Samples:
    """Make the samples of a shard's arrays, as :func:`read_shards` returns them."""
    count = len(stored["photos"])
    path = np.unpackbits(stored["x0"], axis=1).reshape(count, 1, MAP_PX, MAP_PX)
    dwell = np.zeros(path.shape, np.float16)
    dwell[path > 0] = stored["dwell"]
    photos = stored["photos"].reshape(count, 1, PHOTO_PX, PHOTO_PX)
    return Samples(
        *(torch.from_numpy(array) for array in (photos, stored["kernels"], path, dwell))
    )


# -- shards of any samples -----------------------------------------------------------------------


def shard_range(text: str) -> range:
    """Numbers of ``--shards``, ``FIRST:LAST`` or ``FIRST:LAST:STEP``; ValueError for others."""
    try:
        first, last, *step = (int(number) for number in text.split(":"))
        shards = range(first, last, *step)
    except (TypeError, ValueError):
        raise ValueError(
            f"--shards: must be FIRST:LAST or FIRST:LAST:STEP, got {text!r}"
        ) from None
    if not shards or min(shards) < 0:
        raise ValueError(
            f"--shards: must hold numbers from 0 upwards, FIRST below LAST, got {text!r}"
        )
    return shards


def write_shards(
    folder: Path | str,
    shards: range,
    *,
    name: str,
    make: Callable[[int], Mapping[str, NDArray[np.generic]]],
    on_shard: Callable[[int], None],
) -> None:
    """Write the missing ones of the shards; several processes can share the work by strides.

    The files' names begin with ``name``. ``make`` turns a number into the arrays of its file;
    ``on_shard`` gets the number of every shard that is there.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for shard in shards:
        file = target / f"{name}_{shard:05d}.npz"
        if not file.exists():
            arrays = make(shard)
            with new_file(file) as temporary:
                np.savez(temporary, **arrays)  # type: ignore[arg-type]  # an array may be named as an option of savez
        on_shard(shard)


def load_shards(
    folder: Path | str,
    *,
    name: str,
    load: Callable[[Mapping[str, NDArray[np.generic]]], _Loaded],
    missing: str,
) -> list[_Loaded]:
    """Load every shard of a folder, in order; ValueError if there are none, or one is damaged.

    The files' names begin with ``name``; ``load`` turns the arrays of one into samples. The error
    without any ends with ``missing``: their kind, and the command that writes them.
    """
    files = sorted(Path(folder).glob(f"{name}_*.npz"))
    if not files:
        raise ValueError(f"{folder}: holds no {missing}")
    return [_loaded(file, load) for file in files]


def _loaded(file: Path, load: Callable[[Mapping[str, NDArray[np.generic]]], _Loaded]) -> _Loaded:
    regular_file(file)
    try:
        with file.open("rb") as stream, np.load(stream) as stored:
            return load(stored)
    except (zipfile.BadZipFile, EOFError, KeyError, ValueError) as error:
        # numpy takes a file that is no archive for a pickle, and says how to load it unsafely
        reason = "no archive of arrays" if "pickle" in str(error) else one_line(error)
        raise ValueError(
            f"{file}: is damaged ({reason}); delete it and prepare it again"
        ) from error
